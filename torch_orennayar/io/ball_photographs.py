"""Lights from a mirror ball: in photographs of its own, or beside the object."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..core.defaults import independent_of_defaults
from ..core.errors import CaptureError, FileError
from ..core.findings import Finding
from ..core.optional import require
from ..geometry.primitives import Ball
from ..stereo.calibrate import find_ball, light_directions
from ..stereo.mirror_ball import find_mirror_ball
from .masks import find_mask, read_mask
from .optics import View
from .photographs import list_photographs, read_photographs

LARGEST_SHARE_OF_MASK = 0.5
"""Of the mask's area that a ball found beside the object may cover: more, and the ball is the object."""
SHOWN_RADIUS = 160
"""Pixels of the ball's radius in the picture of what was found."""
DARK_EXPONENT = 1 / 3
"""Of the brightness in that picture: a mirror ball is nearly black beside its highlights."""
BALL_RED, HIGHLIGHT_GREEN = (1.0, 0.2, 0.2), (0.2, 1.0, 0.3)
"""RGB of the outline and of the highlights drawn over it."""


class BallLights(NamedTuple):
    """What a mirror ball told.

    Attributes:
        directions: (K, 3) unit directions to the lights.
        ball: its outline in the photographs.
        picture: (3, h, w) the ball under all lights, its outline and the highlights drawn, for people.
        finding: where it was found.
    """

    directions: Tensor
    ball: Ball
    picture: Tensor
    finding: Finding


def lights_of_ball(images: Tensor, ball: Ball | None, where: str = "") -> BallLights:
    """Light directions from photographs (K, 3, H, W) of a mirror ball, found unless its outline is given.

    Args:
        images: linear light.
        ball: the outline, or None.
        where: said in the finding, as " in FOLDER".

    Raises:
        CaptureError: no ball, or a photograph without a highlight on it.
    """
    how = "marked" if ball is not None else "found"
    ball = ball if ball is not None else find_mirror_ball(images)
    directions = light_directions(images, ball)
    place = f"column {ball.x:.1f}, row {ball.y:.1f}, radius {ball.radius:.1f} pixels"
    text = f"lights from the highlights of a mirror ball {how}{where} at {place}."
    return BallLights(directions, ball, _draw(images, ball, directions), Finding(text, "lights-from-ball", ball.radius))


def seen_off_axis(found: BallLights, view: View) -> BallLights:
    """Lights of a ball that a camera sees from the side, beside an object that it looks at."""
    angle, high = (math.degrees(radians) for radians in (view.off_axis(found.ball), view.fov_y))
    text = (
        f"{str(found.finding).rstrip('.')}, as a camera sees it from {angle:.1f} degrees off its axis "
        f"(photographs {high:.1f} degrees high)."
    )
    finding = Finding(text, found.finding.code, found.finding.value)
    return found._replace(directions=view.mirrored(found.directions, found.ball), finding=finding)


def lights_of_ball_beside(images: Tensor, mask: Tensor | None) -> BallLights | None:
    """As `lights_of_ball`, of a ball that happens to be in a capture's photographs; None where none is seen.

    Args:
        images: (K, 3, H, W) linear light.
        mask: (1, H, W) bool of the object, or None.
    """
    try:
        found = lights_of_ball(images, None)
    except CaptureError:
        return None
    if mask is not None:
        disc = found.ball.normals((images.shape[2], images.shape[3]))[1]
        if int((disc & mask).sum()) > LARGEST_SHARE_OF_MASK * int(mask.sum()):
            return None
    return found


def lights_of_ball_folder(folder: Path, names: Sequence[str], encoding: str, ball: Ball | None) -> BallLights:
    """Light directions from a folder of photographs of a mirror ball under the lights of photographs ``names``.

    They are paired by name where every name has its photograph of the ball, and else by order.

    Raises:
        FileError: the folder cannot be read, or has more or fewer photographs.
        CaptureError: no ball, or a photograph without a highlight.
    """
    files, mask_file = _ball_files(folder, None)
    stems = {file.stem.lower(): file for file in files}
    paired = all(Path(name).stem.lower() in stems for name in names)
    if paired:
        files = [stems[Path(name).stem.lower()] for name in names]
    if len(files) != len(names):
        known = {Path(name).stem.lower() for name in names}
        odd = [f.name for f in files if f.stem.lower() not in known][:4]
        raise FileError(
            str(folder),
            expected=f"{len(names)} photographs, one per light",
            got=f"{len(files)}" + (f", {', '.join(odd)} among them" if odd and len(odd) < len(files) else ""),
            mend="give one photograph of the ball per image, of the same name or in the same order",
        )
    images = read_photographs(files, encoding, torch.ones(len(files), 3)).images
    if ball is None and mask_file is not None:
        ball = find_ball(read_mask(mask_file, (images.shape[2], images.shape[3]))[0])
    by_order = "" if paired else f", paired by order, {files[0].name} with {names[0]} and so on,"
    return lights_of_ball(images, ball, f" in {folder.name}{by_order}")


@independent_of_defaults
def load_ball(
    path: str | os.PathLike[str], *, mask: str | os.PathLike[str] | None = None, encoding: str = "auto"
) -> tuple[Tensor, Tensor | None]:
    """Read photographs of a calibration ball whose lights are not known.

    Args:
        path: a folder; ``mask.png`` in it is the ball's mask, white on the ball.
        mask: a mask outside the folder.
        encoding: as in `load_capture`.

    Returns:
        Images (K, 3, H, W) in linear light, and the mask (1, H, W) bool or None.

    Raises:
        FileError: as `load_capture`.
    """
    files, mask_file = _ball_files(Path(path), None if mask is None else Path(mask))
    images = read_photographs(files, encoding, torch.ones(len(files), 3)).images
    if mask_file is None:
        return images, None
    inside, _ = read_mask(mask_file, (images.shape[2], images.shape[3]))
    return images, inside


def _ball_files(folder: Path, mask: Path | None) -> tuple[list[Path], Path | None]:
    """The photographs of a ball in ``folder``, and the mask of the ball: the given one, or one that lies there."""
    if not folder.is_dir():
        raise FileError(str(folder), expected="a folder of photographs", got="no folder", mend="check the name")
    mask_file = mask or find_mask(folder)
    return list_photographs(folder, () if mask_file is None else (mask_file,)), mask_file


def _draw(images: Tensor, ball: Ball, directions: Tensor) -> Tensor:
    """The ball's neighbourhood in the brightest picture, with its outline and where each light is mirrored."""
    require("cv2")
    import cv2

    height, width = images.shape[2:]
    half = 1.3 * ball.radius
    left, top = max(int(ball.x - half), 0), max(int(ball.y - half), 0)
    right, bottom = min(int(ball.x + half) + 2, width), min(int(ball.y + half) + 2, height)
    part = images[:, :, top:bottom, left:right].float()
    bright = part.amax(0)
    shown = (bright / bright.max().clamp_min(1e-12)) ** DARK_EXPONENT
    zoom = SHOWN_RADIUS / ball.radius
    picture = np.ascontiguousarray(shown.permute(1, 2, 0).numpy())
    picture = cv2.resize(picture, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_AREA if zoom < 1 else cv2.INTER_CUBIC)

    def place(x: float, y: float) -> tuple[int, int]:
        return round((x - left + 0.5) * zoom), round((y - top + 0.5) * zoom)

    cv2.circle(picture, place(ball.x, ball.y), SHOWN_RADIUS, BALL_RED, 1, cv2.LINE_AA)
    toward_half = torch.nn.functional.normalize(directions.double() + directions.new_tensor((0.0, 0, 1)), dim=1)
    for x, y, _ in toward_half.tolist():
        at = place(ball.x + x * ball.radius, ball.y - y * ball.radius)
        cv2.circle(picture, at, 5, HIGHLIGHT_GREEN, 1, cv2.LINE_AA)
    return torch.from_numpy(picture).permute(2, 0, 1).clamp(0, 1)
