"""``orennayar stereo``."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from ..core.errors import RangeError
from ..core.files import check_output
from .near_lights import check_near_options, pixel_mm, solve_at_positions, solve_at_some_distance, solve_if_near
from .options import (
    BallOutline,
    ChromeFolder,
    Crop,
    EncodingOption,
    LightFile,
    MaskChoice,
    Output,
    Report,
    Scale,
    Seed,
    StereoModel,
    parse_vector,
)

if TYPE_CHECKING:
    from torch import Tensor

    from ..io.capture import Capture
    from ..io.result_numbers import ResultNumbers
    from ..reconstruction import Reconstruction


PositionFile = Annotated[
    Path | None, typer.Option(help="File of near lights: x y z from the object, right, up, to the camera, in mm.")
]
UnitOption = Annotated[
    Literal["mm", "cm", "m", "in"] | None,
    typer.Option(help="Unit of --positions where the file states none, and of --camera-distance."),
]
FOV_HELP = "Vertical view of whole photographs in degrees, for --positions, or a ball (default: as Exif states)."
NearOption = Annotated[
    bool | None,
    typer.Option("--near/--distant", help="Lamps near, their distance found, or far away; default: what is seen."),
]
CameraDistance = Annotated[
    float | None,
    typer.Option("--camera-distance", help="Camera to object in mm, or in --unit, for --positions.", min=1),
]
PixelSize = Annotated[
    float | None,
    typer.Option("--pixel-size", metavar="MM", help="Of the object, what a pixel of the photographs covers, in mm."),
]
OwnIntensities = Annotated[
    bool, typer.Option("--own-intensities", help="Estimate the lights' intensities from the capture itself.")
]
RefineLights = Annotated[
    bool, typer.Option("--refine-lights", help="Replace lights of the file that the photographs contradict.")
]
Animation = Annotated[
    bool, typer.Option(" /--no-animation", help="Write no relight.gif and turntable.gif.", show_default=False)
]


def stereo(
    capture: Annotated[Path, typer.Argument(help="Folder of images, with or without a light file, or .lp file.")],
    output: Output = Path("out"),
    model: Annotated[StereoModel, typer.Option(help="Reflectance model, or network; auto chooses.")] = "auto",
    lights: LightFile = None,
    mask: MaskChoice = None,
    chrome: ChromeFolder = None,
    ball: BallOutline = None,
    ball_mask: Annotated[Path | None, typer.Option(help="Mask of that ball instead; white on the ball.")] = None,
    crop: Crop = None,
    scale: Scale = 1.0,
    positions: PositionFile = None,
    unit: UnitOption = None,
    near: NearOption = None,
    distance: CameraDistance = None,
    fov: Annotated[float | None, typer.Option(help=FOV_HELP, min=1, max=170)] = None,
    pixel_size: PixelSize = None,
    ambient: Annotated[Path | None, typer.Option(help="Photograph with all lights off; default: ambient.*.")] = None,
    encoding: EncodingOption = "auto",
    own_intensities: OwnIntensities = False,
    refine_lights: RefineLights = False,
    least_squares: Annotated[bool, typer.Option("--least-squares", help="Plain Lambertian least squares.")] = False,
    report: Report = True,
    animation: Animation = True,
    seed: Seed = 0,
) -> None:
    """Photographs under several lights in; normals, albedo, roughness, depth and a mesh out."""
    from ..io.capture import load_capture
    from ..io.contact_sheet import thumbnails
    from ..io.results import RECONSTRUCTION_FILES, write_reconstruction

    _check_options(model, positions, unit, pixel_size, least_squares=least_squares)
    other = refine_lights or least_squares
    distance = check_near_options(positions, distance, fov, crop, unit=unit, near=near, other=other)
    check_output(output, RECONSTRUCTION_FILES)
    begun = time.perf_counter()
    loaded = load_capture(
        capture, lights=lights, mask="whole" if str(mask) == "whole" else mask, chrome=chrome, positions=positions,
        ambient=ambient, encoding=encoding, scale=scale, unit=unit, ball_mask=ball_mask,
        ball=None if ball is None else parse_vector("--ball", ball, "320,240,55"),
        fov_y=math.radians(fov) if fov is not None and positions is None else None,
        crop=None if crop is None else [round(n) for n in parse_vector("--crop", crop, "100,50,800,600")],
    )  # fmt: skip
    loaded = loaded.with_own_intensities(seed=seed) if own_intensities else loaded
    ready = time.perf_counter()
    if distance is not None and fov is not None:
        found = solve_at_positions(loaded, model, distance, fov, seed)
    else:
        found = _solve(loaded, model, near=near, least_squares=least_squares, refine_lights=refine_lights, seed=seed)
    seconds = time.perf_counter() - ready
    shown = thumbnails(loaded, found.lights) if report else ()
    covers = pixel_mm(loaded, distance, fov) if distance and fov else pixel_size and pixel_size / scale
    loaded = replace(loaded, images=loaded.images[:0].clone())  # frees the memory of large captures for drawing
    written = write_reconstruction(
        output, found, loaded, title=capture.resolve().name, seconds=seconds, shown=shown, report=report,
        animation=animation, pixel_mm=covers,
    )  # fmt: skip
    _write_lights(output, loaded, found.lights)
    _say(written.numbers)
    _say_seconds(time.perf_counter() - begun, {"loading": ready - begun, "solving": seconds, **written.seconds})
    typer.echo(f"open {output / ('report.html' if report else 'mesh.glb')}")


def _say_seconds(total: float, steps: dict[str, float]) -> None:
    typer.echo(f"{total:.1f} s in all: {', '.join(f'{taken:.1f} {name}' for name, taken in steps.items())}")


def _write_lights(output: Path, loaded: Capture, found: Tensor | None) -> None:
    """Write lights that were found, by the solver or on loading, as files that `load_capture` reads, and say so."""
    from ..io.light_files import DIRECTIONS_FILE, INTENSITIES_FILE, write_lights

    if found is None and "lights-found" not in {note.code for note in loaded.notes}:
        return
    directions = loaded.lights if found is None else found
    write_lights(output, INTENSITIES_FILE, loaded.intensities)
    typer.echo(f"wrote {write_lights(output, DIRECTIONS_FILE, directions)} for the next time")


def _say(numbers: ResultNumbers) -> None:
    """Print the report, and the error where the truth is known."""
    for sentence in numbers["report"]:
        typer.echo(sentence)
    error = numbers["normal_error_degrees"]
    if error:
        of_all = f"{error['pixels']} of {numbers['pixels']} pixels"
        typer.echo(f"normal error: mean {error['mean']:.2f}, median {error['median']:.2f} degrees over {of_all}")


def _check_options(
    model: StereoModel, positions: Path | None, unit: str | None, pixel_size: float | None, *, least_squares: bool
) -> None:
    """Check what can be checked before photographs are read, but for near lights.

    Least squares have one model. A unit belongs to positions, and these say themselves what a pixel is.
    """
    if least_squares and model not in ("auto", "lambert"):
        raise RangeError("--least-squares", expected="no --model, or lambert", got=model, mend="leave one of them out")
    if unit is not None and positions is None:
        raise RangeError("--unit", expected="--positions beside it", got="none", mend="leave --unit out")
    if pixel_size is not None and (positions is not None or not 0 < pixel_size < math.inf):
        raise RangeError(
            "--pixel-size", expected="millimetres above 0, and no --positions", got=f"{pixel_size:g}",
            mend="measure something in the photographs: its millimetres divided by its pixels; with --positions the "
            "size follows from --camera-distance and --fov",
        )  # fmt: skip


def _solve(
    loaded: Capture, model: StereoModel, *, near: bool | None, least_squares: bool, refine_lights: bool, seed: int
) -> Reconstruction:
    """Solve under lights whose directions are known, near ones if ``near`` says or the photographs show so."""
    from ..stereo.solver import photometric_stereo

    if near:
        return solve_at_some_distance(loaded, model, seed)
    if near is None and not (least_squares or refine_lights):
        found = solve_if_near(loaded, model, seed)
        if found is not None:
            return found
    return photometric_stereo(
        loaded.images,
        loaded.lights,
        loaded.mask,
        model="lambert" if least_squares else model,
        robust=not least_squares,
        refine_lights=refine_lights,
        valid=loaded.valid,
        seed=seed,
    )
