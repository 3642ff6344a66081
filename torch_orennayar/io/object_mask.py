"""Find the object in photographs that come without a mask: what is far brighter than its surroundings."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from ..core.findings import Finding
from ..core.optional import require
from ..geometry.primitives import Ball

Bools = npt.NDArray[np.bool_]

# All of these were set by hand, on objects before black cloth and on a table; tests/io/test_object_mask.py compares the
# masks that are found with those that were given.
STOPS = 10
"""Range of brightness below the brightest that is looked at, in factors of two."""
SEPARATION = 3.0
"""Factors of two between the mean brightness of object and background, at least; on a lit table it is 1 to 2.5."""
LARGEST_BORDER = 0.3
"""Share of the picture's border that the object may cover."""
SMALLEST_PART, LARGEST_HOLE = 0.05, 0.02
"""Areas over the largest part's: smaller parts are no object, and smaller holes are dark paint or deep shade."""
BALL_MARGIN = 1.1
"""Of the radius of a calibration ball, which is left out: its outline is blurred, and it throws light."""


class FoundMask(NamedTuple):
    """What `find_object` found.

    Attributes:
        inside: (1, H, W) bool.
        finding: what the mask was taken from.
    """

    inside: Tensor
    finding: Finding


def find_object(images: Tensor) -> FoundMask:
    """The mask of an object before a dark background, or the whole picture where there is no such background.

    Args:
        images: (K, C, H, W) linear light.

    Raises:
        MissingPackageError: OpenCV is not installed.
    """
    inside = torch.from_numpy(_bright_parts(images))[None]
    border = torch.cat((inside[0, 0], inside[0, -1], inside[0, :, 0], inside[0, :, -1])).float().mean().item()
    if not bool(inside.any()) or border > LARGEST_BORDER:
        text = "no mask, and no dark background: every pixel is taken as the object."
        return FoundMask(torch.ones_like(inside), Finding(text, "no-mask"))
    share = inside.float().mean().item()
    text = f"no mask: the object was found before its dark background, {share:.0%} of the picture"
    if len(images) == 1:
        text += ", without a side that the light does not reach"
    return FoundMask(inside, Finding(f"{text}; --mask whole (mask='whole') takes every pixel.", "mask-found", share))


def disc(ball: Ball, size: tuple[int, int]) -> Tensor:
    """Pixels (1, H, W) of a ball and what its blurred edge reaches."""
    return Ball(ball.x, ball.y, BALL_MARGIN * ball.radius).normals(size)[1]


def _bright_parts(images: Tensor) -> Bools:
    """(H, W), empty where bright and dark are not far apart."""
    require("cv2")
    import cv2

    bright = _second_brightest(images).cpu().numpy()
    bright = cv2.medianBlur(bright, 5) if min(bright.shape) > 5 else bright
    least = max(float(np.quantile(bright, 0.995)), 1e-12) / 2**STOPS
    stops = np.log2(np.clip(bright / least, 1, 2**STOPS))
    levels = (stops * (255 / STOPS)).astype(np.uint8)
    threshold, _ = cv2.threshold(levels, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    inside = levels > threshold
    if not inside.any() or inside.all() or stops[inside].mean() - stops[~inside].mean() < SEPARATION:
        return np.zeros_like(inside)
    return _large_parts(inside)


def _second_brightest(images: Tensor) -> Tensor:
    """(H, W) of the second brightest light, or of the only one: a single highlight or reflection is no object.

    Photographs are looked at one after the other, for memory.
    """
    first = second = images[0].float().mean(0)
    for k in range(1, len(images)):
        grey = images[k].float().mean(0)
        second = torch.minimum(first, grey) if k == 1 else torch.maximum(second, torch.minimum(first, grey))
        first = torch.maximum(first, grey)
    return second


def _large_parts(inside: Bools) -> Bools:
    """Without small parts, and with small holes filled."""
    require("cv2")
    import cv2

    _, labels, parts, _ = cv2.connectedComponentsWithStats(inside.astype(np.uint8))
    areas = parts[:, cv2.CC_STAT_AREA]
    largest = areas[1:].max()
    keep = np.asarray(areas >= SMALLEST_PART * largest)
    keep[0] = False
    kept = keep[labels]
    _, labels, holes, _ = cv2.connectedComponentsWithStats((~kept).astype(np.uint8), connectivity=4)
    small = np.asarray(holes[:, cv2.CC_STAT_AREA] <= LARGEST_HOLE * largest)
    small[0] = False
    small[np.unique(np.concatenate((labels[0], labels[-1], labels[:, 0], labels[:, -1])))] = False  # outside
    return np.asarray(kept | small[labels])
