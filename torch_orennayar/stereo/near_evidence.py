"""Whether photographs that are solved as under distant lights were taken under near ones, which bend the surface.

A near light shines on every pixel from another direction and from another distance. What that changes is not all what
another normal would change, so that it shows in the misfit.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.findings import Finding
from ..core.warn import warn
from . import robust_fit
from .material import LightDirections, Material
from .material_refinement import capped_error
from .pixel_sample import PixelSample
from .robust_stats import in_light, mean_brightness

MIN_LIGHTS = 8
"""Photographs; with fewer little is left over from normal and albedo. Set by hand."""
PIXELS, STEPS = 250, 6
"""Pixels that are compared, and steps of their fits; set by hand, for some hundredths of a second."""
DISTANCES = (4.0, 2.0)
"""Distances of the lights that are tried, in sizes of the object; set by hand."""
BETTER = 0.8
"""Share of the error under distant lights that near ones must reach. Set by hand: .45 on a table under lamps at 2.7
times its size, .95 and more under distant lights, photographed and rendered."""


def check_distant_lights(sample: PixelSample, inside: Tensor) -> list[Finding]:
    """A finding, and a warning, where lights at a few sizes of the object explain the photographs much better.

    Args:
        sample: pixels under distant lights.
        inside: (H, W) bool, the object.
    """
    light = sample.directions.light
    if len(light) < MIN_LIGHTS:
        return []
    some = sample[:PIXELS]
    row, column = inside.nonzero().to(light).unbind(1)
    across, down = some.rows_and_columns().to(light).flip(1).unbind(1)
    size = float(torch.maximum(row.amax() - row.amin(), column.amax() - column.amin()) + 1)
    middle = (row.amax() + row.amin()) / 2, (column.amax() + column.amin()) / 2
    place = torch.stack((across - middle[1], middle[0] - down, torch.zeros_like(down)), 1) / size
    distant = _error(some)
    errors = {}
    for distance in DISTANCES:
        toward = distance * light - place[:, None]
        length = toward.norm(dim=2)
        near = LightDirections.of(toward / length[:, :, None])
        errors[distance] = _error(PixelSample(some.grey * (length / distance) ** 2, near, some.places, some.width))
    best = min(errors, key=errors.__getitem__)
    if errors[best] >= BETTER * distant:
        return []
    text = (
        f"lights at about {best:g} times the object's size explain the photographs better than distant ones (error "
        f"{errors[best]:.3f} against {distant:.3f}): the surface found is bent; give their positions (--positions, "
        "near_light_stereo)."
    )
    warn(text)
    return [Finding(text, "lights-near", best)]


def _error(sample: PixelSample) -> float:
    fitted = robust_fit.fit(sample, Material(), used="middle", steps=STEPS)
    shown = robust_fit.predict(fitted, sample.directions, Material())
    return capped_error(sample.grey, shown, mean_brightness(sample.grey), in_light(sample.grey))
