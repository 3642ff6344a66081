"""Whether photographs contradict the light directions that were given: lines in another order, another light file."""

from __future__ import annotations

from torch import Tensor

from ..core.findings import Finding
from ..core.warn import warn
from .light_factors import Observations
from .material_refinement import capped_error
from .pixel_sample import PixelSample
from .robust_stats import in_light, mean_brightness

MIN_LIGHTS = 5
"""Photographs; any three lights explain three, and free ones explain four of anything. Set by hand."""
PIXELS, ROUNDS = 1000, 6
"""Pixels that are looked at, and alternations between normals and free lights; set by hand, for some hundredths of a
second."""
MISSED, BETTER = 0.06, 0.65
"""Error of a matt surface under the lights given, as a share of the pixels' means, from which they are doubted, and the
share of it that free lights must leave at most. Set by hand: of 92 captures, photographed, rendered and made up, those
above the first have .82 and more; with shifted, reversed or shuffled lights 57 of 64 lie beyond both, with two lights
exchanged fewer."""


def check_directions_fit(sample: PixelSample) -> list[Finding]:
    """A finding, and a warning, where other lights explain the photographs far better than those given.

    Free lights, directions and brightness, have the same rank: what they leave is no fault of the lights, so that
    shadows, highlights and rough surfaces do not count.

    Args:
        sample: pixels under distant lights.
    """
    if len(sample.directions) < MIN_LIGHTS or not len(sample):
        return []
    grey = sample.grey[:PIXELS].double()
    seen, lights = Observations.of(grey), sample.directions.light.double()
    normals = seen.regress_normals(lights)
    given = _error(grey, normals, lights)
    if given < MISSED:
        return []
    for _ in range(ROUNDS):
        lights = seen.regress_lights(normals)
        normals = seen.regress_normals(lights)
    free = _error(grey, normals, lights)
    if not free < BETTER * given:
        return []
    text = (
        f"the photographs contradict the light directions: others explain them far better (error {free:.3f} against "
        f"{given:.3f}). Are they in another order, of another capture, or measured badly? refine_lights=True "
        "(--refine-lights) seeks better ones."
    )
    warn(text)
    return [Finding(text, "lights-contradicted", free / given)]


def _error(grey: Tensor, normals: Tensor, lights: Tensor) -> float:
    return capped_error(grey, (normals @ lights.T).clamp_min(0), mean_brightness(grey), in_light(grey))
