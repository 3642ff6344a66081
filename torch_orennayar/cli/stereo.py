"""``orennayar stereo``."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from ..core.errors import RangeError
from ..core.files import check_output
from .options import EncodingOption, LightFile, MaskFile, Output, Seed, StereoModel


def stereo(
    capture: Annotated[Path, typer.Argument(help="Folder of images, with or without a light file, or .lp file.")],
    output: Output = Path("out"),
    model: Annotated[StereoModel, typer.Option(help="Reflectance model, or network; auto chooses.")] = "auto",
    lights: LightFile = None,
    mask: MaskFile = None,
    chrome: Annotated[Path | None, typer.Option(help="Folder of a chrome ball under the same lights.")] = None,
    ambient: Annotated[Path | None, typer.Option(help="Photograph with all lights off; default: ambient.*.")] = None,
    encoding: EncodingOption = "auto",
    own_intensities: Annotated[
        bool, typer.Option("--own-intensities", help="Estimate the lights' intensities from the capture itself.")
    ] = False,
    refine_lights: Annotated[
        bool, typer.Option("--refine-lights", help="Replace lights of the file that the photographs contradict.")
    ] = False,
    least_squares: Annotated[bool, typer.Option("--least-squares", help="Plain Lambertian least squares.")] = False,
    seed: Seed = 0,
) -> None:
    """Photographs under several lights in; normals, albedo, roughness, depth and a mesh out."""
    from ..io.capture import load_capture
    from ..io.light_files import DIRECTIONS_FILE, INTENSITIES_FILE, write_lights
    from ..io.results import RECONSTRUCTION_FILES, write_reconstruction
    from ..stereo.solver import photometric_stereo

    if least_squares and model not in ("auto", "lambert"):
        raise RangeError("--least-squares", expected="no --model, or lambert", got=model, mend="leave one of them out")
    check_output(output, RECONSTRUCTION_FILES)
    begun = time.perf_counter()
    loaded = load_capture(capture, lights=lights, mask=mask, chrome=chrome, ambient=ambient, encoding=encoding)
    if own_intensities:
        loaded = loaded.with_own_intensities(seed=seed)
    ready = time.perf_counter()
    found = photometric_stereo(
        loaded.images,
        loaded.lights,
        loaded.mask,
        model="lambert" if least_squares else model,
        robust=not least_squares,
        refine_lights=refine_lights,
        valid=loaded.valid,
        seed=seed,
    )
    seconds = time.perf_counter() - ready
    loaded = replace(loaded, images=loaded.images[:0].clone())  # frees the memory of large captures for drawing
    numbers = write_reconstruction(output, found, loaded, title=capture.resolve().name, seconds=seconds).numbers
    if found.lights is not None or "lights-found" in {note.code for note in loaded.notes}:
        write_lights(output, INTENSITIES_FILE, loaded.intensities)
        directions = loaded.lights if found.lights is None else found.lights
        typer.echo(f"wrote {write_lights(output, DIRECTIONS_FILE, directions)} for the next time")
    for sentence in numbers["report"]:
        typer.echo(sentence)
    error = numbers["normal_error_degrees"]
    if error:
        of_all = f"{error['pixels']} of {numbers['pixels']} pixels"
        typer.echo(f"normal error: mean {error['mean']:.2f}, median {error['median']:.2f} degrees over {of_all}")
    total, loading = time.perf_counter() - begun, ready - begun
    typer.echo(f"{total:.1f} s in all: {loading:.1f} s loading, {seconds:.1f} s solving; open {output / 'report.html'}")
