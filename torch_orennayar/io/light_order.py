"""Whether lights that were paired with photographs by order belong to another order of their names."""

from __future__ import annotations

import math
from collections.abc import Sequence

from torch import Tensor

from ..core.findings import Finding
from ..core.warn import warn
from ..stereo.calibrate import own_intensities
from ..stereo.material_refinement import MIN_LIGHTS_HELD_OUT
from .encoding_choice import prediction_error

CLEARLY = 0.9
"""Share of the error in natural order below which that in alphabetical order must lie to be told. Set by hand: of seven
real captures .13 to .87 where their lights were listed alphabetically, 1.12 to 6.2 where they were listed as taken."""


def doubt_order(images: Tensor, lights: Tensor, inside: Tensor, names: Sequence[str]) -> tuple[Finding, ...]:
    """A finding, and a warning, where lights listed in alphabetical order explain the photographs far better.

    Photographs without names in the light file are taken in natural order, 1, 2, 10; programs list them as 1, 10, 2.

    Args:
        images: (K, C, H, W) linear light.
        lights: (K, 3) unit directions, in the order of their file.
        inside: (1, H, W) bool, the object.
        names: of the photographs, in natural order.
    """
    alphabetical = sorted(names)
    line = [alphabetical.index(name) for name in names]
    if line == list(range(len(names))) or len(names) < MIN_LIGHTS_HELD_OUT:
        return ()
    natural, other = (_error(images, order, inside) for order in (lights, lights[line]))
    if not other < CLEARLY * natural:
        return ()
    text = (
        f"the light file names no photographs, and its lines agree far better with their alphabetical order "
        f"({', '.join(alphabetical[:3])} ...) than with the natural one ({', '.join(names[:3])} ...), which was taken: "
        "put the names into the light file."
    )
    warn(text)
    return (Finding(text, "lights-out-of-order", other / natural),)


def _error(images: Tensor, lights: Tensor, inside: Tensor) -> float:
    """Error on lights left out, whatever the lights' brightness; infinite where nothing explains the photographs."""
    error = prediction_error(images, lights, inside[0], own_intensities(images, lights, inside))
    return error if error is not None and math.isfinite(error) else math.inf
