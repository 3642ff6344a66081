"""What a solver must know of the lights before it starts: directions and brightness, given, found or refined."""

from __future__ import annotations

from typing import Literal, NamedTuple

from torch import Tensor

from ..core.checks import check_mask
from ..core.errors import RangeError, ShapeError
from ..core.findings import Finding
from .calibrate import own_intensities, unequal_brightness
from .capture_checks import find_valid
from .light_refinement import refine_lights
from .pixel_sample import PixelSample
from .unknown_lights import find_lights

Intensities = Literal["equal", "unknown"]
"""What is known of the brightness of lights: that it is the same, or that images were divided by it; or nothing."""


class LightKnowledge(NamedTuple):
    """Lights, and images that are divided by their brightness.

    Attributes:
        images: (K, C, H, W).
        lights: (K, 3) or (K, 3, H, W).
        intensities: (K, C) or (K, 1) that the images were divided by; None where that is 1.
        valid: the samples that count, as they were before; None where all do.
        findings: on what was found.
    """

    images: Tensor
    lights: Tensor
    intensities: Tensor | None
    valid: Tensor | None
    findings: tuple[Finding, ...]


def know_lights(
    images: Tensor,
    lights: Tensor | None,
    mask: Tensor | None,
    *,
    intensities: Intensities | Tensor,
    refine: bool,
    valid: Tensor | None,
    seed: int,
) -> LightKnowledge:
    """Find what is not given, and divide the images by the lights' brightness.

    Args:
        images: (K, C, H, W).
        lights: as for `photometric_stereo`.
        mask: (1, H, W) bool or None.
        intensities: ``"equal"``, ``"unknown"``, or (K,), (K, 1) or (K, C).
        refine: whether lights that are given are to be checked against the photographs.
        valid: as for `photometric_stereo`.
        seed: of the pixels from which the brightness of given lights is found.
    """
    inside = check_mask(mask, images)
    valid = find_valid(images, inside[0], valid)  # division moves the value of full scale
    divisor: Tensor | None = None
    findings: tuple[Finding, ...] = ()
    if isinstance(intensities, Tensor):
        divisor = _check_intensities(intensities, images)
    elif intensities not in ("equal", "unknown"):
        raise RangeError(
            "intensities", expected="'equal', 'unknown' or a tensor", got=repr(intensities), mend="choose one"
        )
    elif intensities == "unknown" and lights is not None:
        if lights.ndim != 2:
            raise ShapeError(
                "lights",
                expected="(K, 3) where intensities are not known",
                got=str(tuple(lights.shape)),
                mend="give them",
            )
        divisor = own_intensities(images, lights, inside, seed=seed)
        text = f"brightness of the lights found from the photographs, {divisor.min():.2f} to {divisor.max():.2f}."
        findings = (Finding(text, "intensities-from-capture"),)
    if divisor is not None:
        images = images / divisor.to(images)[:, :, None, None]
    if lights is None:
        unknown = isinstance(intensities, str) and intensities == "unknown"
        found = find_lights(images, inside, intensities="unknown" if unknown else "equal", valid=valid)
        lights, findings = found.directions.to(images), found.findings
        brightness = found.brightness[:, None].to(images)
        images = images / brightness[:, :, None, None]
        divisor = brightness if divisor is None else divisor.to(images) * brightness
    elif refine:
        if lights.ndim != 2:
            raise ShapeError(
                "lights", expected="(K, 3) to refine", got=str(tuple(lights.shape)), mend="leave refine_lights out"
            )
        found = refine_lights(images, lights, inside, valid)
        lights, findings = found.directions.to(images), (*findings, *found.findings)
    return LightKnowledge(images, lights, divisor, valid, findings)


def doubt_brightness(sample: PixelSample) -> list[Finding]:
    """A finding where pixels say that lights taken as equally bright are not."""
    found = unequal_brightness(sample)
    if found is None:
        return []
    spread = 100 * float(found.log().std())
    text = (
        f"the photographs say that the lights' brightness differs, by {spread:.0f} %: from {found.min():.2f} to "
        f'{found.max():.2f} of the mean; intensities="unknown" (--own-intensities) divides by it.'
    )
    return [Finding(text, "lights-unequal", spread)]


def _check_intensities(intensities: Tensor, images: Tensor) -> Tensor:
    """One positive number per light, or per light and channel, as (K, 1) or (K, C)."""
    value = intensities[:, None] if intensities.ndim == 1 else intensities
    count, channels = images.shape[:2]
    if tuple(value.shape) not in ((count, 1), (count, channels)):
        raise ShapeError(
            "intensities",
            expected=f"({count},) or ({count}, {channels})",
            got=str(tuple(intensities.shape)),
            mend="give one number per light, or one per light and channel",
        )
    if not bool((value > 0).all() and value.isfinite().all()):
        raise RangeError(
            "intensities", expected="> 0", got=f"{float(value.min())}", mend="leave out lights that are off"
        )
    return value
