"""Whether photographs that do not say how they are encoded hold sRGB values or linear light: which predicts better."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.findings import Finding
from ..stereo import robust_fit
from ..stereo.material import Material
from ..stereo.material_refinement import MIN_LIGHTS_HELD_OUT, capped_error
from ..stereo.material_selection import hold_out
from ..stereo.pixel_sample import PixelSample, draw_places
from ..stereo.robust_stats import in_light, mean_brightness
from .srgb import linear_to_srgb

PIXELS, STEPS = 600, 8
"""Pixels that are compared, drawn with seed 0, and steps of their fits; set by hand, for a fraction of a second."""
MATERIALS = (Material(), Material(exponents=(16,)), Material(minnaert_exponent=1.1, exponents=(16,)))
"""What the surface may be; the best of these counts for each encoding. Set by hand."""
CLEARLY = 0.7
"""Share of the error as sRGB below which the error as linear light must lie for photographs to be read so. Set by hand:
.5 to .65 on photographs that are known to be linear, .8 and more on those known to be sRGB, near lamps among them."""


def choose_encoding(images: Tensor, lights: Tensor, intensities: Tensor, inside: Tensor) -> tuple[bool, list[Finding]]:
    """Whether photographs that were read as sRGB are rather linear light.

    Args:
        images: (K, 3, H, W) decoded from sRGB, divided by the intensities.
        lights: (K, 3) unit directions.
        intensities: (K, 3).
        inside: (H, W) bool, the object.

    Returns:
        The choice, and a finding with the error on lights left out for either encoding; nothing with few lights.
    """
    held_out = _hold_out(lights)
    if held_out is None:
        return False, []
    decoded = _some(images, inside)
    encoded = linear_to_srgb(decoded[..., None] * intensities[:, :, None, None])[..., 0] / intensities[:, :, None]
    srgb, linear = (_error(values, lights, held_out) for values in (decoded, encoded))
    is_linear = linear < CLEARLY * srgb
    usual = "" if is_linear or linear >= srgb else f", not below {CLEARLY:.0%} of it, so the usual encoding stays"
    text = (
        f"the files do not state an encoding: read as {'linear light' if is_linear else 'sRGB'}; lights left out "
        f"are predicted with an error of {linear:.3f} as linear light and {srgb:.3f} as sRGB{usual}."
    )
    return is_linear, [Finding(text, "encoding-chosen", linear / max(srgb, 1e-9))]


def prediction_error(images: Tensor, lights: Tensor, inside: Tensor, brightness: Tensor | None) -> float | None:
    """Error on lights left out of images (K, C, H, W) divided by ``brightness`` (K, 1); None with few lights."""
    held_out = _hold_out(lights)
    if held_out is None:
        return None
    values = _some(images, inside)
    return _error(values if brightness is None else values / brightness[:, :, None], lights, held_out)


def _hold_out(lights: Tensor) -> tuple[Tensor, Tensor] | None:
    return hold_out(lights, 0) if len(lights) >= MIN_LIGHTS_HELD_OUT else None


def _some(images: Tensor, inside: Tensor) -> Tensor:
    """Samples (K, C, P) of some pixels inside."""
    return images.flatten(2)[:, :, draw_places(inside, PIXELS, 0)].float()


def _error(values: Tensor, lights: Tensor, held_out: tuple[Tensor, Tensor]) -> float:
    """Error on lights that were left out, of the best material, for samples (K, 3, P)."""
    pixels = values.shape[2]
    sample = PixelSample.gather(values[:, :, None], lights, torch.arange(pixels))
    mean, lit = mean_brightness(sample.grey), in_light(sample.grey)
    errors = []
    for material in MATERIALS:
        error = 0.0
        for out in held_out:
            shown = sample.under(~out)
            start = robust_fit.fit(shown, Material(), used="middle", steps=STEPS)
            fitted = robust_fit.fit(shown, material, start=start, steps=STEPS)
            predicted = robust_fit.predict(fitted, sample.directions.under(out), material)
            error += capped_error(sample.grey[:, out], predicted, mean, lit[:, out]) / len(held_out)
        errors.append(error)
    return min(errors)
