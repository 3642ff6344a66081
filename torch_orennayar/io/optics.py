"""The angle of view of photographs, and from where a camera sees what is not in their middle."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.optional import require
from ..geometry.primitives import Ball
from .encoding import EXIF_FOLDER
from .picture import ROTATIONS
from .region import Region

_EXIF_ORIENTATION, _EXIF_FOCAL_LENGTH, _EXIF_WIDTH, _EXIF_HEIGHT = 0x0112, 0xA405, 0xA002, 0xA003
"""Numbers of Exif 2.32: Orientation, FocalLengthIn35mmFilm, PixelXDimension, PixelYDimension."""
FILM_DIAGONAL = math.hypot(36, 24)
"""Of the film, 36 x 24 mm, that FocalLengthIn35mmFilm refers to, in mm."""
OUTLINE = 64
"""Points of a ball's outline through which its cone of rays is laid; set by hand."""
SAME_SHAPE = 0.02
"""Relative difference of the aspect ratio up to which a file has the shape that its camera gave it; else it was cut,
and does not show the camera's angle of view. Set by hand."""


def stated_field_of_view(file: Path) -> float | None:
    """The vertical angle of view of an upright photograph by its Exif data, radians; None where they do not say."""
    require("PIL")
    import PIL.Image

    try:
        with PIL.Image.open(file) as picture:
            exif = picture.getexif()
            stated, (width, height) = exif.get_ifd(EXIF_FOLDER), picture.size
            turns, _ = ROTATIONS.get(exif.get(_EXIF_ORIENTATION, 1), ROTATIONS[1])
        focal = float(stated.get(_EXIF_FOCAL_LENGTH) or 0)
        taken = float(stated.get(_EXIF_WIDTH) or width), float(stated.get(_EXIF_HEIGHT) or height)
    except Exception:  # Pillow raises many kinds for headers it does not know; damage is found while decoding
        return None
    if not (focal > 0 and min(taken) > 0) or abs(width / height / (taken[0] / taken[1]) - 1) > SAME_SHAPE:
        return None
    upright = width if turns % 2 else height
    return 2 * math.atan(FILM_DIAGONAL / 2 / focal * upright / math.hypot(width, height))


class View(NamedTuple):
    """Rays through the pixels of a region of photographs that a camera without distortion took.

    Attributes:
        region: of the photographs.
        size: height and width of the whole photographs.
        fov_y: their vertical angle of view, radians.
    """

    region: Region
    size: tuple[int, int]
    fov_y: float

    def rays(self, column: Tensor, row: Tensor) -> Tensor:
        """Unit directions (N, 3) from the camera through pixels (N,) of the region."""
        x, y = self.region.to_whole(column, row)
        slope = 2 * math.tan(self.fov_y / 2) / self.size[0]
        across, up = slope * (x - (self.size[1] - 1) / 2), slope * ((self.size[0] - 1) / 2 - y)
        return F.normalize(torch.stack((across, up, -torch.ones_like(up)), 1), dim=1)

    def off_axis(self, ball: Ball) -> float:
        """The angle, radians, between the camera's axis and the line of sight to a ball."""
        return float(self.rays(*torch.tensor([[ball.x], [ball.y]], dtype=torch.float64))[0, 2].neg().acos())

    def mirrored(self, directions: Tensor, ball: Ball) -> Tensor:
        """Where lights are that a mirror ball shows where it would show these, were it seen along the axis.

        Args:
            directions: (K, 3) unit directions to the lights, were the view orthographic.
            ball: the outline that they were found with.

        Returns:
            (K, 3) unit directions.
        """
        outline = self.rays(*self._ellipse(ball))
        axis = torch.linalg.lstsq(outline, torch.ones(OUTLINE, 1, dtype=torch.float64)).solution[:, 0]
        toward, cosine = F.normalize(axis, dim=0), 1 / axis.norm()  # rays of the outline: toward . ray = cosine
        half = F.normalize(directions.double() + directions.new_tensor((0.0, 0, 1)).double(), dim=1)
        ray = self.rays(ball.x + ball.radius * half[:, 0], ball.y - ball.radius * half[:, 1])
        along = ray @ toward  # of a ball at distance 1, whose radius is the sine of its outline's angle
        point = ray * (along - (along**2 - cosine**2).clamp_min(0).sqrt())[:, None]
        normal = F.normalize(point - toward, dim=1)
        return (ray - 2 * (ray * normal).sum(1, keepdim=True) * normal).to(directions)

    def _ellipse(self, ball: Ball) -> tuple[Tensor, Tensor]:
        """Columns and rows (N,) of the outline of a ball: an ellipse, longer outwards, of the area of the circle."""
        turn = torch.arange(OUTLINE, dtype=torch.float64) * (2 * math.pi / OUTLINE)
        stretched = 1 / math.sqrt(math.cos(self.off_axis(ball)))
        away, aside = ball.radius * stretched * turn.cos(), ball.radius / stretched * turn.sin()
        x, y, _ = self.rays(*torch.tensor([[ball.x], [ball.y]], dtype=torch.float64))[0].tolist()
        length = math.hypot(x, y)
        c, s = (x / length, -y / length) if length > 0 else (1.0, 0.0)  # outwards in the picture, down
        return ball.x + c * away - s * aside, ball.y + s * away + c * aside
