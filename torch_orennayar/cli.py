"""The command ``orennayar``. Angles on the command line are degrees."""

from __future__ import annotations

import math
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from .core.errors import FileError, RangeError, TorchOrenNayarError
from .core.files import check_output
from .core.progress import say

if TYPE_CHECKING:
    from torch import Tensor

    from .geometry.camera import Camera

app = typer.Typer(
    help="Rough surfaces: shading, rendering, photometric stereo, shape from shading, ONNX export. Angles are degrees.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
out = Console(highlight=False, soft_wrap=True)
err = Console(stderr=True, highlight=False, soft_wrap=True)

INTERRUPTED = 130
"""The exit status of a command that was stopped with Ctrl-C."""

Output = Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")]
Seed = Annotated[int, typer.Option(help="Seed of everything drawn at random.", min=0, max=2**63 - 1)]
ModelName = Annotated[str, typer.Option(help="Reflectance model; `orennayar info` lists them.")]
ModelOrAuto = Annotated[str, typer.Option(help="auto, or a model that `orennayar info` lists.")]
Roughness = Annotated[float, typer.Option(help="Roughness in degrees, 0 to 90.", min=0, max=90)]

MaskFile = Annotated[Path | None, typer.Option(help="Mask image kept elsewhere; white is the object.")]
Encoding = Annotated[str, typer.Option(help="auto (8-bit is sRGB), linear or srgb.")]

Size = Annotated[int, typer.Option(help="Height and width in pixels.", min=1, max=4096)]
Azimuth = Annotated[float, typer.Option(help="Degrees that the camera walks to the right.", min=-360, max=360)]
Elevation = Annotated[float, typer.Option(help="Degrees that it climbs.", min=-89, max=89)]
FieldOfView = Annotated[
    float | None, typer.Option(help="Vertical field of view in degrees; default orthographic.", min=1, max=170)
]


@app.command()
def demo(
    output: Output = Path("out"),
    size: Annotated[int, typer.Option(help="Height and width of the pictures.", min=32, max=1024)] = 256,
    seed: Seed = 0,
) -> None:
    """Render a rough object, recover it from the pictures, and write a report."""
    from .demo import run_demo

    check_output(output)
    numbers = run_demo(output, size=size, seed=seed)
    table = Table("solved with", "normal error, mean", "roughness (truth 30)", "albedo error")
    for name, n in numbers.items():
        mean = n["normal_error_degrees"]["mean"]
        table.add_row(
            name if name != "auto" else f"auto: {n['model']}",
            f"{mean:.2f} degrees",
            f"{n['roughness_degrees']:.1f} degrees",
            f"{n['albedo_error_share']:.1%}",
        )
    out.print(table)
    out.print(f"open {output / 'report.html'}", markup=False)


@app.command()
def render(
    mesh: Annotated[Path, typer.Argument(help="OBJ, PLY, STL, GLB or OFF; it is centred and scaled to fit.")],
    output: Output = Path("out"),
    roughness: Roughness = 30.0,
    albedo: Annotated[float, typer.Option(help="Albedo, 0 to 1.", min=0, max=1)] = 0.8,
    light: Annotated[tuple[float, float, float], typer.Option(help="Direction to the light: right, up, to you.")] = (
        0.3,
        0.4,
        0.86,
    ),
    lights: Annotated[
        int, typer.Option(help="A sheet under that many lights, 45 degrees off the view.", min=0, max=96)
    ] = 0,
    model: ModelName = "vcavity",
    size: Size = 512,
    azimuth: Azimuth = 0.0,
    elevation: Elevation = 0.0,
    fov: FieldOfView = None,
    turntable: Annotated[Path | None, typer.Option(help="Also write a .gif or .mp4 of a walk around it.")] = None,
    frames: Annotated[int, typer.Option(help="Pictures of the turntable.", min=2, max=720)] = 36,
) -> None:
    """Draw a mesh: its normal map, depth, and the surface shaded smooth and rough."""
    import torch

    from .core.progress import track
    from .geometry.mesh import load_mesh, normalise_mesh
    from .io.figures import show_light
    from .io.images import ANIMATIONS, write_animation
    from .io.results import write_render
    from .render.normal_map import render_normals
    from .shading.layer import OrenNayar

    check_output(output)
    if turntable is not None:
        if turntable.suffix.lower() not in ANIMATIONS:
            got = turntable.suffix or "no suffix"
            raise FileError(str(turntable), expected="a .gif or .mp4 name", got=got, mend="rename it")
        check_output(turntable.parent)
    layer = OrenNayar(model)
    unit = _direction(light)[None]
    vertices, faces = load_mesh(mesh)
    vertices = normalise_mesh(vertices)
    seen = render_normals(vertices, faces, _camera(azimuth, elevation, fov), (size, size))
    if not bool(seen.mask.any()):
        raise RangeError(str(mesh), expected="a surface that can be seen", got="no pixel", mend="check the mesh")
    sigma = math.radians(roughness)
    pictures = {
        "Lambert": seen.shade(OrenNayar("lambert"), unit, albedo=albedo)[0],
        f"σ = {roughness:g}°": seen.shade(layer, unit, albedo=albedo, roughness=sigma)[0],
    }
    ring = torch.arange(lights) * (2 * math.pi / max(lights, 1))
    around = torch.stack((ring.cos(), ring.sin(), torch.ones_like(ring)), 1) * math.sqrt(0.5)
    sheet = {
        f"{math.degrees(angle):.0f}°": seen.shade(layer, toward[None], albedo=albedo, roughness=sigma)[0]
        for angle, toward in zip(ring.tolist(), around, strict=True)
    }
    write_render(output, seen, pictures, sheet)
    out.print(f"{len(faces)} faces, {int(seen.mask.sum())} pixels; wrote {output}", markup=False)
    if turntable is not None:
        even = size + size % 2  # what video needs
        walk = []
        for k in track(range(frames), "turntable"):
            view = render_normals(vertices, faces, _camera(azimuth + 360 * k / frames, elevation, fov), (even, even))
            shaded = view.shade(layer, unit, albedo=albedo, roughness=sigma)[0]
            walk.append(show_light(shaded, view.mask[0]))
        write_animation(turntable, walk)
        out.print(f"wrote {turntable}, {frames} pictures", markup=False)


def _camera(azimuth: float, elevation: float, fov: float | None) -> Camera:
    """Look at the unit sphere from a direction in degrees."""
    from .geometry.camera import Camera

    a, e = math.radians(azimuth), math.radians(elevation)
    toward = (math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e))
    if fov is None:
        return Camera.orthographic(1.05, eye=tuple(2 * x for x in toward))
    distance = 1.05 / math.sin(math.radians(fov) / 2)
    return Camera.perspective(math.radians(fov), eye=tuple(distance * x for x in toward))


@app.command()
def stereo(
    capture: Annotated[Path, typer.Argument(help="Folder of images with a light file, DiLiGenT folder, or .lp file.")],
    output: Output = Path("out"),
    model: ModelOrAuto = "auto",
    lights: Annotated[Path | None, typer.Option(help="Light file kept elsewhere.")] = None,
    mask: MaskFile = None,
    chrome: Annotated[Path | None, typer.Option(help="Folder of a chrome ball under the same lights.")] = None,
    ambient: Annotated[Path | None, typer.Option(help="Photograph with all lights off; default ambient.*.")] = None,
    encoding: Encoding = "auto",
    own_intensities: Annotated[
        bool, typer.Option("--own-intensities", help="Find how bright each light is from the capture itself.")
    ] = False,
    least_squares: Annotated[bool, typer.Option("--least-squares", help="Plain Lambertian least squares.")] = False,
    seed: Seed = 0,
) -> None:
    """Photographs under known lights in; normals, albedo, roughness, depth and a mesh out."""
    from .io.capture import load_capture
    from .io.results import write_reconstruction
    from .stereo.solver import photometric_stereo

    if least_squares and model not in ("auto", "lambert"):
        raise RangeError("--least-squares", expected="no --model, or lambert", got=model, mend="leave one of them out")
    check_output(output)
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
        seed=seed,
    )
    seconds = time.perf_counter() - ready
    loaded = replace(loaded, images=loaded.images[:0].clone())  # large captures: room for drawing
    written = write_reconstruction(output, found, loaded, title=capture.resolve().name, seconds=seconds)
    for line in written.numbers["report"]:
        out.print(line, markup=False)
    error = written.numbers["normal_error_degrees"]
    if error:
        out.print(
            f"normal error: mean {error['mean']:.2f}, median {error['median']:.2f} degrees over "
            f"{error['pixels']} of {written.numbers['pixels']} pixels",
            markup=False,
        )
    total = time.perf_counter() - begun
    out.print(
        f"{total:.1f} s in all: {ready - begun:.1f} s loading, {seconds:.1f} s solving; open {output / 'report.html'}",
        markup=False,
    )


@app.command()
def shape(
    image: Annotated[Path, typer.Argument(help="One photograph of an object under one light.")],
    light: Annotated[tuple[float, float, float], typer.Option(help="Direction to the light: right, up, to you.")],
    output: Output = Path("out"),
    roughness: Annotated[
        float | None, typer.Option(help="Roughness in degrees, 0 to 90; default: estimated.", min=0, max=90)
    ] = None,
    albedo: Annotated[float | None, typer.Option(help="Albedo; default: estimated.", min=0)] = None,
    ambient: Annotated[
        float | None,
        typer.Option(
            help="Light from all around as a share of the light; default: estimated with a mask, else 0.", min=0, max=1
        ),
    ] = None,
    mask: MaskFile = None,
    model: ModelOrAuto = "auto",
    contour: Annotated[
        bool, typer.Option(help="Whether the mask's edge is where the surface turns away from the viewer.")
    ] = True,
    encoding: Encoding = "auto",
) -> None:
    """One photograph under a known light in; depth, normals and a mesh out."""
    from .io.capture import load_photograph
    from .io.results import write_reconstruction
    from .shape.solver import shape_from_shading

    check_output(output)
    direction = _direction(light)
    loaded = load_photograph(image, direction, mask=mask, encoding=encoding)
    begun = time.perf_counter()
    found = shape_from_shading(
        loaded.images[0],
        direction,
        loaded.mask,
        albedo=albedo,
        roughness=None if roughness is None else math.radians(roughness),
        ambient=0.0 if ambient is None and mask is None else ambient,
        model=model,
        contour=contour and mask is not None,
    )
    seconds = time.perf_counter() - begun
    written = write_reconstruction(output, found, loaded, title=image.stem, seconds=seconds)
    for line in written.numbers["report"]:
        out.print(line, markup=False)
    out.print(f"{seconds:.1f} s solving; open {output / 'report.html'}", markup=False)


def _direction(light: tuple[float, float, float]) -> Tensor:
    """A unit vector from an option."""
    import torch

    direction = torch.tensor(light)
    if not (bool(direction.isfinite().all()) and bool(direction.norm() > 0)):
        raise RangeError("--light", expected="a direction", got=str(light), mend="give three numbers, not all zero")
    return torch.nn.functional.normalize(direction, dim=0)


@app.command()
def calibrate(
    kind: Annotated[str, typer.Argument(help="chrome (directions), grey or own (intensities).")],
    folder: Annotated[Path, typer.Argument(help="Photographs, one per light; for grey and own with a light file.")],
    output: Output = Path("out"),
    lights: Annotated[Path | None, typer.Option(help="Light file kept elsewhere (grey, own).")] = None,
    mask: MaskFile = None,
    circle: Annotated[
        tuple[float, float, float] | None, typer.Option(help="The ball: column, row, radius in pixels.")
    ] = None,
    encoding: Encoding = "auto",
) -> None:
    """Find lights: directions from a chrome ball, intensities from a grey ball or from a capture itself."""
    from .geometry.primitives import Ball
    from .io.capture import load_ball, load_capture
    from .io.results import write_lights
    from .stereo.calibrate import ball_intensities, find_ball, find_circle, light_directions, own_intensities

    if kind not in ("chrome", "grey", "own"):
        raise RangeError("KIND", expected="chrome, grey or own", got=kind, mend="choose one")
    check_output(output)
    if kind == "chrome":
        images, shape = load_ball(folder, mask=mask, encoding=encoding)
    else:
        loaded = load_capture(folder, lights=lights, mask=mask, encoding=encoding)
        images, shape = loaded.images * loaded.intensities[:, :, None, None], loaded.mask
    if kind == "own":
        values, name = own_intensities(images, loaded.lights, loaded.mask), "light_intensities.txt"
    else:
        whole = shape is None or bool(shape.all())
        ball = Ball(*circle) if circle else find_circle(images) if shape is None or whole else find_ball(shape)
        out.print(f"ball at column {ball.x:.1f}, row {ball.y:.1f}, radius {ball.radius:.1f} pixels", markup=False)
        if kind == "chrome":
            values, name = light_directions(images, ball), "light_directions.txt"
        else:
            values, name = ball_intensities(images, loaded.lights, ball), "light_intensities.txt"
    write_lights(output, name, values)
    out.print(f"{len(values)} lights; wrote {output / name}", markup=False)


@app.command()
def export(
    path: Annotated[Path, typer.Argument(help="The .onnx file to write.")] = Path("out/shading.onnx"),
    graph: Annotated[str, typer.Option(help="What to export: shading, renderer, shaded_mesh or stereo.")] = "shading",
    model: ModelName = "vcavity",
    per_pixel_directions: Annotated[bool, typer.Option("--per-pixel", help="Light and view are maps.")] = False,
    half: Annotated[bool, typer.Option("--half", help="Inputs and outputs in float16.")] = False,
    size: Size = 512,
    azimuth: Azimuth = 0.0,
    elevation: Elevation = 0.0,
    fov: FieldOfView = None,
) -> None:
    """Write an ONNX graph and verify it; the last four options are a renderer's view of the unit sphere."""
    import torch

    from .export.api import export_onnx

    check_output(path.parent)
    say("exporting and verifying" + (", about half a minute" if graph in ("renderer", "shaded_mesh") else ""))
    export_onnx(
        graph,
        path,
        model=model,
        per_pixel_directions=per_pixel_directions,
        camera=_camera(azimuth, elevation, fov),
        size=(size, size),
        dtype=torch.float16 if half else torch.float32,
    )
    out.print(f"{path}: {path.stat().st_size / 1000:.0f} kB, equal to torch at every size tried", markup=False)


@app.command()
def info(
    path: Annotated[Path | None, typer.Argument(help="An .onnx file; default: versions and models.")] = None,
) -> None:
    """Versions and models, or what is inside an ONNX file."""
    if path is not None:
        _info_graph(path)
        return
    from importlib.metadata import version

    from .reflectance.models import MODELS

    packages = Table("package", "version")
    for name in (
        "torch_orennayar",
        "torch",
        "kornia",
        "opencv-contrib-python-headless",
        "trimesh",
        "onnxruntime",
        "onnx",
    ):
        packages.add_row(name, version(name))
    out.print(packages)
    models = Table("model", "RMS error", "cost", "gradients", "source")
    for model in MODELS.values():
        error, cost = (f"{v:.3g}" if v is not None else "" for v in (model.error, model.cost))
        models.add_row(model.name, error, cost, model.gradients, model.source)
    out.print(models)


def _info_graph(path: Path) -> None:
    from .export.describe import describe_onnx

    if path.suffix.lower() != ".onnx":
        raise FileError(str(path), expected="an .onnx file", got=path.suffix or "no suffix", mend="give a graph")
    for key, value in describe_onnx(path).items():
        if isinstance(value, dict):
            out.print(f"{key}:", markup=False)
            for name, entry in value.items():
                out.print(f"  {name}: {', '.join(entry) if isinstance(entry, list) else entry}", markup=False)
        else:
            out.print(f"{key}: {value}", markup=False)


def main() -> None:
    """Run the command; a user's mistake is one line on stderr and exit status 1."""
    try:
        app()
    except TorchOrenNayarError as error:
        err.print(f"error: {' '.join(str(error).split())}", markup=False)
        sys.exit(1)
    except SystemExit as leave:
        if leave.code == INTERRUPTED:
            err.print("interrupted; nothing half-written stays", markup=False)
        raise


if __name__ == "__main__":
    main()
