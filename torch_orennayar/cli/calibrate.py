"""``orennayar calibrate``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from ..core.files import check_output
from .options import EncodingOption, LightFile, MaskFile, Output, parse_vector

if TYPE_CHECKING:
    from torch import Tensor

    from ..geometry.primitives import Ball

Kind = Literal["chrome", "grey", "own"]
Circle = Annotated[
    str | None,
    typer.Option("--ball", "--circle", metavar="X,Y,RADIUS", help="The ball: column, row, radius in pixels."),
]


def calibrate(
    kind: Annotated[
        Kind,
        typer.Argument(help="chrome: directions from a mirror ball; grey, own: intensities from a grey ball, itself."),
    ],
    folder: Annotated[Path, typer.Argument(help="Photographs, one per light; for grey and own with a light file.")],
    output: Output = Path("out"),
    lights: LightFile = None,
    mask: MaskFile = None,
    circle: Circle = None,
    encoding: EncodingOption = "auto",
) -> None:
    """Find lights: directions from a chrome ball, intensities from a grey ball or from a capture itself."""
    from ..geometry.primitives import Ball
    from ..io.ball_photographs import load_ball
    from ..io.capture import load_capture
    from ..io.light_files import DIRECTIONS_FILE, INTENSITIES_FILE, write_lights
    from ..stereo.calibrate import ball_intensities, light_directions, own_intensities

    check_output(output)
    given = None if circle is None else Ball(*parse_vector("--ball", circle))
    if kind == "chrome":
        images, shape = load_ball(folder, mask=mask, encoding=encoding)
        values, name = light_directions(images, _find(given, images, shape, mirror=True)), DIRECTIONS_FILE
    else:
        capture = load_capture(folder, lights=lights, mask=mask, encoding=encoding)
        images, name = capture.images * capture.intensities[:, :, None, None], INTENSITIES_FILE
        if kind == "own":
            values = own_intensities(images, capture.lights, capture.mask)
        else:
            values = ball_intensities(images, capture.lights, _find(given, images, capture.mask))
    write_lights(output, name, values)
    typer.echo(f"{len(values)} lights; wrote {output / name}")


def _find(given: Ball | None, images: Tensor, mask: Tensor | None, *, mirror: bool = False) -> Ball:
    """The ball as given, from its mask unless that is the whole image, or from the images; its place is printed."""
    from ..stereo.calibrate import find_ball, find_circle
    from ..stereo.mirror_ball import find_mirror_ball

    if given is not None:
        ball = given
    elif mask is not None and not bool(mask.all()):
        ball = find_ball(mask)
    else:
        ball = find_mirror_ball(images) if mirror else find_circle(images)
    typer.echo(f"ball at column {ball.x:.1f}, row {ball.y:.1f}, radius {ball.radius:.1f} pixels")
    return ball
