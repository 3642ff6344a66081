"""``orennayar render``."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from ..core.errors import FileError, RangeError
from ..core.files import check_output
from .options import (
    Azimuth,
    Elevation,
    FieldOfView,
    Light,
    ModelName,
    Output,
    make_camera,
    parse_direction,
)

if TYPE_CHECKING:
    from torch import Tensor

    from ..render.normal_map import NormalMap
    from ..shading.layer import OrenNayar


def render(
    mesh: Annotated[Path, typer.Argument(help="OBJ, PLY, STL, GLB or OFF; it is centred and scaled to fit.")],
    output: Output = Path("out"),
    roughness: Annotated[float, typer.Option(help="Roughness in degrees, 0 to 90.", min=0, max=90)] = 30.0,
    albedo: Annotated[float, typer.Option(help="Albedo, 0 to 1.", min=0, max=1)] = 0.8,
    light: Light = "0.3,0.4,0.86",
    lights: Annotated[
        int, typer.Option(help="Also write a sheet under that many lights, 45 degrees off the view.", min=0, max=96)
    ] = 0,
    model: Annotated[ModelName, typer.Option(help="Reflectance model; `orennayar info` describes them.")] = "vcavity",
    size: Annotated[int, typer.Option(help="Height and width in pixels.", min=1, max=4096)] = 512,
    azimuth: Azimuth = 0.0,
    elevation: Elevation = 0.0,
    fov: FieldOfView = None,
    turntable: Annotated[Path | None, typer.Option(help="Also write a .gif or .mp4 of a full turn around it.")] = None,
    flat: Annotated[bool, typer.Option("--flat", help="Draw every face flat.")] = False,
    crease: Annotated[
        float | None,
        typer.Option(
            help="Degrees between two faces from which their edge is sharp; 180: none. Default: as the file says."
        ),
    ] = None,
    frames: Annotated[int, typer.Option(help="Pictures of the turntable.", min=2, max=720)] = 36,
) -> None:
    """Render a mesh: its normal map, depth, and the surface shaded smooth and rough."""
    from ..geometry.mesh import normalise_mesh
    from ..geometry.mesh_files import load_mesh
    from ..io.results import RENDER_FILES, write_render
    from ..render.normal_map import render_normals
    from ..shading.layer import OrenNayar

    check_output(output, RENDER_FILES)
    if turntable is not None:
        _check_animation(turntable)
    rough = _Material(OrenNayar(model), albedo, math.radians(roughness))
    smooth = _Material(OrenNayar("lambert"), albedo, 0.0)
    direction = parse_direction("--light", light)
    loaded = load_mesh(mesh, crease=None if crease is None else math.radians(crease))
    vertices, faces = normalise_mesh(loaded.vertices), loaded.faces
    draw = partial(render_normals, vertices, faces, smooth=not flat)
    seen = draw(make_camera(azimuth, elevation, fov), (size, size))
    if not bool(seen.mask.any()):
        raise RangeError(str(mesh), expected="a surface that can be seen", got="no pixel", mend="check the mesh")
    pictures = {"Lambert": smooth.shade(seen, direction), f"σ = {roughness:g}°": rough.shade(seen, direction)}
    write_render(output, seen, pictures, _shade_around(seen, rough, lights))
    for finding in loaded.report:
        typer.echo(finding)
    typer.echo(f"{len(faces)} faces, {int(seen.mask.sum())} pixels; wrote {output}")
    if turntable is not None:
        even = size + size % 2  # video needs even sizes
        views = (
            render_normals(
                vertices, faces, make_camera(azimuth + 360 * k / frames, elevation, fov), (even, even), smooth=not flat
            )
            for k in range(frames)
        )
        _write_turntable(turntable, views, frames, rough, direction)
        typer.echo(f"wrote {turntable}, {frames} pictures")


class _Material(NamedTuple):
    layer: OrenNayar
    albedo: float
    roughness: float

    def shade(self, view: NormalMap, direction: Tensor) -> Tensor:
        """What ``view`` shows under one light, (1, H, W) linear."""
        shaded: Tensor = view.shade(self.layer, direction[None], albedo=self.albedo, roughness=self.roughness)[0]
        return shaded


def _check_animation(path: Path) -> None:
    """Refuse a name that no animation can have, or a place that cannot be written, before any work is done."""
    from ..io.images import ANIMATIONS

    if path.suffix.lower() not in ANIMATIONS:
        got = path.suffix or "no suffix"
        raise FileError(str(path), expected="a .gif or .mp4 name", got=got, mend="rename it")
    check_output(path.parent)


def _shade_around(view: NormalMap, material: _Material, count: int) -> dict[str, Tensor]:
    """What ``view`` shows under ``count`` lights on a circle, by their azimuth."""
    import torch

    azimuth = torch.arange(count) * (2 * math.pi / max(count, 1))
    directions = torch.stack((azimuth.cos(), azimuth.sin(), torch.ones_like(azimuth)), 1) * math.sqrt(0.5)
    return {
        f"{math.degrees(angle):.0f}°": material.shade(view, direction)
        for angle, direction in zip(azimuth.tolist(), directions, strict=True)
    }


def _write_turntable(
    path: Path, views: Iterable[NormalMap], count: int, material: _Material, direction: Tensor
) -> None:
    from ..core.progress import track
    from ..io.figures import show_light
    from ..io.images import write_animation

    pictures = [show_light(material.shade(v, direction), v.mask[0]) for v in track(views, "turntable", count)]
    write_animation(path, pictures)
