"""What several commands share: their options, the choices that help and completion list, vectors of three numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from ..core.errors import RangeError

if TYPE_CHECKING:
    from torch import Tensor

    from ..geometry.camera import Camera

# `MODELS` itself would make `orennayar --help` wait for torch; tests/cli/test_help.py compares them.
ClosedForm = Literal["lambert", "qualitative", "qualitative-0.57", "fujii", "full", "vcavity", "eon"]
ModelName = Literal[ClosedForm, "theory"]
StereoModel = Literal["auto", ModelName, "network"]
ShapeModel = Literal["auto", ModelName]
Encoding = Literal["auto", "linear", "srgb"]

Output = Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")]
Seed = Annotated[int, typer.Option(help="Seed of everything drawn at random.", min=0, max=2**63 - 1)]
LightFile = Annotated[Path | None, typer.Option(help="Light file outside the folder.")]
ChromeFolder = Annotated[Path | None, typer.Option(help="Folder of a chrome ball under the same lights.")]
Report = Annotated[bool, typer.Option(" /--no-report", help="Write no figures and no report.html.", show_default=False)]
MaskFile = Annotated[Path | None, typer.Option(help="Mask image outside the folder; white is the object.")]
MaskChoice = Annotated[
    Path | None,
    typer.Option(metavar="FILE|whole", help="Mask image outside the folder; white is the object. whole: every pixel."),
]
BallOutline = Annotated[
    str | None,
    typer.Option("--ball", metavar="X,Y,RADIUS", help="A mirror ball in the photographs: column, row, radius."),
]
Crop = Annotated[
    str | None, typer.Option(metavar="LEFT,TOP,WIDTH,HEIGHT", help="The part of the photographs to use, in pixels.")
]
Scale = Annotated[float, typer.Option(help="Factor of the photographs' size, for quicker results.", min=0.01, max=1)]
EncodingOption = Annotated[Encoding, typer.Option(help="Encoding of the images; auto: 8-bit files are sRGB.")]
Azimuth = Annotated[float, typer.Option(help="Degrees by which the camera moves to the right.", min=-360, max=360)]
Elevation = Annotated[float, typer.Option(help="Degrees by which it rises.", min=-89, max=89)]
FieldOfView = Annotated[float | None, typer.Option(help="Vertical view in degrees; default: none.", min=1, max=170)]
LIGHT_HELP = "Direction to the light, of any length: right, up, toward the viewer; its place from the object will do."
Light = Annotated[str, typer.Option(metavar="X,Y,Z", help=LIGHT_HELP)]

VECTORS = {"--light": 3, "--circle": 3, "--ball": 3, "--crop": 4}
"""Options that take several numbers, and how many, with commas or with spaces between them."""
FRAME_RADIUS = 1.05
"""Radius of the sphere that a view shows whole; meshes are scaled into the unit sphere, 5 % is margin."""


def join_vectors(arguments: Sequence[str]) -> list[str]:
    """Command-line words with every vector as one word: ``--light 0 0 1`` becomes ``--light=0,0,1``.

    Example:
        >>> from torch_orennayar.cli.options import join_vectors
        >>> join_vectors(["photo.png", "--light", "-0.3", "0.4", "0.86", "-o", "out"])
        ['photo.png', '--light=-0.3,0.4,0.86', '-o', 'out']
    """
    joined: list[str] = []
    rest = list(arguments)
    while rest:
        option, equals, first = rest.pop(0).partition("=")
        if option not in VECTORS:
            joined.append(option + equals + first)
            continue
        words = first.rstrip(",").split(",") if equals else []
        while rest and len(words) < VECTORS[option] and _is_number(rest[0].rstrip(",")):
            words.append(rest.pop(0).rstrip(","))
        if not words and rest:
            words.append(rest.pop(0))
        joined.append(f"{option}={','.join(words)}" if words else option)
    return joined


def parse_vector(option: str, text: str, example: str = "0.3,0.4,0.86") -> list[float]:
    """As many finite numbers from ``X,Y,Z`` as the option takes.

    Raises:
        RangeError: anything else.
    """
    words = text.split(",")
    if len(words) != VECTORS[option] or not all(_is_number(word) for word in words):
        expected = f"{['three', 'four'][VECTORS[option] - 3]} numbers"
        raise RangeError(option, expected=expected, got=repr(text), mend=f"write for example {option} {example}")
    return [float(word) for word in words]


def parse_direction(option: str, text: str) -> Tensor:
    """A unit vector (3,) from ``X,Y,Z``.

    Raises:
        RangeError: not three finite numbers, or all zero.
    """
    import torch

    direction = torch.tensor(parse_vector(option, text))
    if not bool(direction.norm() > 0):
        raise RangeError(option, expected="a direction", got=text, mend="give three numbers, not all zero")
    return torch.nn.functional.normalize(direction, dim=0)


def make_camera(azimuth: float, elevation: float, fov: float | None) -> Camera:
    """A camera that shows the unit sphere from a direction in degrees."""
    from ..geometry.camera import Camera

    a, e = math.radians(azimuth), math.radians(elevation)
    toward = (math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e))
    if fov is None:
        return Camera.orthographic(FRAME_RADIUS, eye=tuple(2 * x for x in toward))
    distance = FRAME_RADIUS / math.sin(math.radians(fov) / 2)
    return Camera.perspective(math.radians(fov), eye=tuple(distance * x for x in toward))


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False
