"""Checks of a capture before it is solved: shapes, lights that determine normals, pixels that lights reach."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.checks import check_mask
from ..core.errors import CaptureError, RangeError, ShapeError
from ..core.findings import Finding
from ..core.warn import warn
from .material import LightDirections
from .material_selection import MAX_CONDITION, condition
from .pixel_sample import gather_grey
from .robust_stats import MISSING, SHADOW
from .row_bands import band_height

FULL_SCALE = 1.0
"""Value of a sample at full scale, in the unit of images that no intensities divide."""
CLIPPED_SHARE = 1e-3
"""Share of samples at `FULL_SCALE` from which they are taken as clipped, as single pixels reach it by chance; set by
hand."""
WARN_CONDITION = 10
"""Condition number of light directions above which a warning is issued. Set by hand."""


def check_shapes(images: Tensor, lights: Tensor, mask: Tensor | None) -> Tensor:
    """Check that shapes fit together; return the mask as (H, W) bool."""
    if images.ndim != 4 or 0 in images.shape:
        raise ShapeError("images", expected="(K, C, H, W)", got=str(tuple(images.shape)), mend="stack the images")
    size = tuple(images.shape[-2:])
    wanted = (len(images), 3)
    if tuple(lights.shape) not in (wanted, (*wanted, *size)):
        raise ShapeError(
            "lights", expected=f"{wanted} or {(*wanted, *size)}", got=str(tuple(lights.shape)), mend="one per image"
        )
    return check_mask(mask, images)[0]


def find_valid(images: Tensor, inside: Tensor, valid: Tensor | None) -> Tensor | None:
    """Which samples count, (K, 1, H, W) bool; None where all do.

    Without ``valid``, samples of exactly 1 are at full scale where nothing is brighter and many are.

    Raises:
        ShapeError: ``valid`` of another shape or dtype.
    """
    if valid is not None:
        shape = (len(images), 1, *images.shape[2:])
        if tuple(valid.shape) not in (shape, tuple(images.shape)) or valid.dtype != torch.bool:
            raise ShapeError(
                "valid",
                expected=f"{shape} or {tuple(images.shape)} bool",
                got=f"{tuple(valid.shape)} {valid.dtype}",
                mend="give one value per sample; True counts",
            )
        return None if bool(valid.all()) else valid.all(1, keepdim=True)
    if float(images.amax()) != FULL_SCALE:
        return None
    below = (images < FULL_SCALE).all(1, keepdim=True)
    clipped = (~below[:, 0, inside]).float().mean()
    return below if clipped >= CLIPPED_SHARE else None


def leave_out(images: Tensor, valid: Tensor | None, inside: Tensor) -> tuple[Tensor, list[Finding]]:
    """The images with `MISSING` where samples do not count, and how many those are."""
    if valid is None:
        return images, []
    share = 100 * (~valid[:, 0, inside]).float().mean().item()
    if not share:
        return images, []
    text = f"{share:.2g} % of the samples are at full scale, so not measured, and were left out: expose shorter."
    return torch.where(valid, images, MISSING), [Finding(text, "clipped-samples", share)]


def check_directions(directions: LightDirections) -> list[Finding]:
    """Refuse lights that do not determine normals; findings on those that hardly do, which are also warnings."""
    lights = directions.as_distant()
    behind = int((lights[:, 2] <= 0).sum())
    if 2 * behind > len(lights):
        raise CaptureError(
            "lights",
            expected="most lights on the camera's side (z > 0: x right, y up, z toward the camera)",
            got=f"{behind} of {len(lights)} behind the object",
            mend="use swap_opencv_frame if they are in OpenCV's frame",
        )
    if len(lights) < 3:
        raise CaptureError("lights", expected="at least 3", got=str(len(lights)), mend="photograph under more lights")
    spanned = condition(lights)
    if spanned > MAX_CONDITION:
        raise CaptureError(
            "lights",
            expected=f"directions that span space (condition number up to {MAX_CONDITION})",
            got=f"{spanned:.3g}" if spanned < 1e6 else "directions in one plane",
            mend="photograph under lights from more directions",
        )
    if spanned <= WARN_CONDITION:
        return []
    found = Finding(
        f"lights lie close together (condition number {spanned:.1f}): noise is amplified.",
        "lights-close-together",
        spanned,
    )
    warn(found)
    return [found]


def find_dark_pixels(images: Tensor, inside: Tensor) -> Tensor:
    """Where fewer than three observations are clearly above zero, (H, W) bool.

    Raises:
        RangeError: values inside the mask that are not finite.
        CaptureError: no other pixels.
    """
    rows = band_height(len(images), inside)
    dark = torch.zeros_like(inside)
    broken = 0
    for top in range(0, len(inside), rows):
        part = inside[top : top + rows]
        grey = gather_grey(images[:, :, top : top + rows], part.flatten())
        broken += int((~grey.isfinite()).any(1).sum())
        level = SHADOW * grey.amax(1, keepdim=True)
        dark[top : top + rows][part] = (grey > level.clamp_min(0)).sum(1) < 3
    if broken:
        raise RangeError(
            "images",
            expected="finite values inside the mask",
            got=f"NaN or infinity in {broken} pixels",
            mend="take those pixels out of the mask",
        )
    if bool((dark == inside).all()):
        raise CaptureError(
            "images",
            expected="pixels that at least 3 lights reach",
            got="none inside the mask",
            mend="check exposure, mask and the order of the lights",
        )
    return dark
