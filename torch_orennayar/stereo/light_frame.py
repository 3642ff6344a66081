"""Whether light directions are in the camera's frame: with y or x the wrong way round, bumps lean the wrong way."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ..core.findings import Finding
from ..core.optional import available
from ..core.warn import warn
from ..geometry.height_field import silhouette_normals
from .pixel_sample import gather_reduced
from .robust_stats import MISSING

PIXELS = 4000
"""Pixels, about, of the reduced photographs that are looked at; set by hand, for milliseconds."""
TILT = 0.3
"""Least slant to the side of the outline's normals that say where left and right, up and down are; set by hand."""
LEAST = 30
"""Pixels with such normals, all of whose samples were measured, that are enough; set by hand."""
OPPOSED = 0.5
"""Correlation of normals with the outline's beyond which an axis agrees, or is turned round; set by hand."""
TURNED, HALF_TURN = 60.0, 150.0
"""Degrees between normals and outline, around the view, from which the lights' frame is turned, and from which a hollow
would show the same. Set by hand."""


def check_light_frame(images: Tensor, lights: Tensor, inside: Tensor) -> list[Finding]:
    """Warn where normals oppose the object's outline along an axis of the picture, lie across it, or are turned.

    Args:
        images: (K, C, H, W) linear light.
        lights: (K, 3) unit directions.
        inside: (H, W) bool, the object.

    Returns:
        A finding where the frame is another; nothing where the outline does not tell, or pyamg is not installed.
    """
    border = torch.cat((inside[0], inside[-1], inside[:, 0], inside[:, -1]))
    if bool(border.any()) or not available("pyamg", "scipy"):  # the outline may be the picture's, not the object's
        return []
    grey, small = gather_reduced(images, inside, PIXELS)
    if not len(grey):
        return []
    normal = grey @ torch.linalg.pinv(lights.double().cpu()).T
    outline = silhouette_normals(small[None])[:, small].T.to(normal)
    measured = (grey != MISSING).all(1)
    side = (outline[:, :2].norm(dim=1) > TILT) & measured
    if int(side.sum()) < LEAST:
        return []
    agree = [[_correlation(normal[side, i], outline[side, j]) for j in (0, 1)] for i in (0, 1)]
    found = _turned(agree)
    if found is None:
        return []
    warn(found[0])
    return [Finding(found[0], "lights-mirrored", found[1])]


def _turned(agree: list[list[float]]) -> tuple[str, float] | None:
    """What is wrong with the frame by how x and y of normals agree with the outline's, and the correlation."""
    (across, x_with_y), (y_with_x, up) = agree
    for turned, kept, name, way in ((up, across, "y", "down"), (across, up, "x", "left")):
        if turned < -OPPOSED and kept > OPPOSED:
            return (
                f"the surface leans against its outline along {name}: the light directions seem to have {name} "
                f"pointing {way}; turn the sign of their {name} (x right, y up, z toward the camera).",
                turned,
            )
    angle = math.degrees(math.atan2(x_with_y - y_with_x, across + up))  # by which the outline is turned from normals
    alike = math.hypot(across + up, x_with_y - y_with_x) / 2
    if alike > OPPOSED and abs(angle) > TURNED:
        hollow = "it is a hollow, or " if abs(angle) > HALF_TURN else ""
        return (
            f"the surface leans against its outline: {hollow}the light directions seem to be turned by about "
            f"{abs(angle):.0f} degrees around the view (x right, y up, z toward the camera).",
            math.cos(math.radians(angle)) * alike,
        )
    if max(abs(across), abs(up)) < OPPOSED < min(abs(x_with_y), abs(y_with_x)):
        return (
            "the surface leans along y where its outline leans along x: the light directions seem to have x and y "
            "exchanged (x right, y up, z toward the camera).",
            x_with_y,
        )
    return None


def _correlation(one: Tensor, other: Tensor) -> float:
    return float((one * other).sum() / (one.norm() * other.norm()).clamp_min(1e-12))
