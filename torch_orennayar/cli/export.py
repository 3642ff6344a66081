"""``orennayar export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from ..core.files import check_output
from ..core.progress import say
from .options import Azimuth, ClosedForm, Elevation, FieldOfView, make_camera

Graph = Literal["shading", "renderer", "shaded_mesh", "stereo", "integration"]
ExportModel = Literal[ClosedForm, "network"]
"""`MODELS` that a graph can hold: not `theory`, which is a quadrature; and the network of photometric stereo."""


def export(
    path: Annotated[Path, typer.Argument(help="The .onnx file to write.")] = Path("out/shading.onnx"),
    graph: Annotated[Graph, typer.Option(help="What to export.")] = "shading",
    model: Annotated[ExportModel, typer.Option(help="Reflectance model; network: only for stereo.")] = "vcavity",
    per_pixel_directions: Annotated[
        bool, typer.Option("--per-pixel", help="Light and view are maps, one direction per pixel.")
    ] = False,
    checked: Annotated[
        bool, typer.Option("--checked", help="Also say where a shading graph's inputs are valid.")
    ] = False,
    portable: Annotated[
        bool, typer.Option("--portable", help="Shading in operators that phones and browsers have.")
    ] = False,
    view_inputs: Annotated[
        bool, typer.Option("--view-inputs", help="A renderer takes camera and size as inputs: one file for all views.")
    ] = False,
    half: Annotated[bool, typer.Option("--half", help="Inputs and outputs in float16.")] = False,
    size: Annotated[
        int | None,
        typer.Option(
            help="Height and width in pixels of a renderer, default 512, or of portable shading, default any.",
            min=1,
            max=4096,
        ),
    ] = None,
    azimuth: Azimuth = 0.0,
    elevation: Elevation = 0.0,
    fov: FieldOfView = None,
) -> None:
    """Write an ONNX graph and verify it; the last three options are a renderer's view of the unit sphere."""
    import torch

    from ..export.api import export_onnx

    check_output(path.parent)
    drawn = graph in ("renderer", "shaded_mesh")
    side = size or (512 if drawn else None)
    say("exporting and verifying")
    export_onnx(
        graph,
        path,
        model=model,
        per_pixel_directions=per_pixel_directions,
        checked=checked,
        portable=portable,
        view_inputs=view_inputs,
        camera=make_camera(azimuth, elevation, fov) if drawn or azimuth or elevation or fov else None,
        size=(side, side) if side else None,
        dtype=torch.float16 if half else torch.float32,
    )
    typer.echo(f"{path}: {path.stat().st_size / 1000:.0f} kB, equal to torch at every size tried")
