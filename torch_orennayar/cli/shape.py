"""``orennayar shape``."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from ..core.files import check_output
from .options import LIGHT_HELP, EncodingOption, MaskChoice, Output, ShapeModel, parse_direction


def shape(
    image: Annotated[Path, typer.Argument(help="One photograph of an object under one light.")],
    light: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help=f"{LIGHT_HELP} Default: sought, in the outline.")
    ] = None,
    output: Output = Path("out"),
    roughness: Annotated[
        float | None, typer.Option(help="Roughness in degrees, 0 to 90; default: estimated.", min=0, max=90)
    ] = None,
    albedo: Annotated[float | None, typer.Option(help="Albedo; default: estimated.", min=0)] = None,
    ambient: Annotated[
        float | None,
        typer.Option(
            help="Ambient light as a share of the light; default: estimated with an outline, else 0.", min=0, max=1
        ),
    ] = None,
    mask: MaskChoice = None,
    model: Annotated[ShapeModel, typer.Option(help="Reflectance model; auto chooses.")] = "auto",
    contour: Annotated[
        bool, typer.Option(help="Whether the mask's edge is an occluding contour, where the surface turns away.")
    ] = True,
    encoding: EncodingOption = "auto",
) -> None:
    """One photograph under one light in; depth, normals and a mesh out.

    The object is found before a dark background where no mask is given, and the light in its outline.
    """
    from ..io.photograph import load_photograph
    from ..io.results import RECONSTRUCTION_FILES, write_reconstruction
    from ..shape.solver import shape_from_shading

    check_output(output, RECONSTRUCTION_FILES)
    direction = None if light is None else parse_direction("--light", light)
    loaded = load_photograph(image, direction, mask="whole" if str(mask) == "whole" else mask, encoding=encoding)
    outlined = "no-mask" not in {note.code for note in loaded.notes}
    begun = time.perf_counter()
    found = shape_from_shading(
        loaded.images[0],
        direction,
        loaded.mask,
        albedo=albedo,
        roughness=None if roughness is None else math.radians(roughness),
        ambient=ambient if outlined else ambient or 0.0,
        model=model,
        contour=contour and outlined,
    )
    seconds = time.perf_counter() - begun
    loaded = loaded if found.lights is None else replace(loaded, lights=found.lights)
    written = write_reconstruction(output, found, loaded, title=image.stem, seconds=seconds)
    for sentence in written.numbers["report"]:
        typer.echo(sentence)
    typer.echo(f"{seconds:.1f} s solving; open {output / 'report.html'}")
