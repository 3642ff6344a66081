"""Roughness as an angle and as a slope, and its range."""

from __future__ import annotations

import math

from torch import Tensor

from ..core.checks import check_range

MAX_ROUGHNESS = math.pi / 2 + 1e-6
"""Largest roughness accepted, radians: a right angle, with room for the rounding of float32."""


def slope_from_roughness(roughness: Tensor) -> Tensor:
    """Convert roughness to the standard deviation of the elevation gradient (rise over run): ``tan``.

    Oren and Nayar's roughness is the standard deviation of the facets' slope *angle*; some texts use that of
    the elevation *gradient* instead. The two differ by a third of the cube, so they agree for small values.
    The tangent maps the facets one standard deviation from flat to the same facets. Moments of the gradient
    cannot define the conversion: for a normal distribution of angles they do not exist.

    Args:
        roughness: radians in [0, pi/2), any shape, differentiable.

    Returns:
        Standard deviation of the gradient, a ratio without unit.

    Raises:
        RangeError: roughness out of range.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> round(ton.slope_from_roughness(torch.tensor(0.1)).item(), 4)
        0.1003
    """
    check_range("roughness", roughness, 0.0, math.pi / 2 - 1e-6, "it is in radians, below pi/2")
    return roughness.tan()


def roughness_from_slope(slope: Tensor) -> Tensor:
    """Convert the standard deviation of the elevation gradient (rise over run) to roughness: ``atan``.

    The inverse of `slope_from_roughness`, which defines the conversion.

    Args:
        slope: >= 0, rise over run, any shape, differentiable.

    Returns:
        Standard deviation of the slope angle, radians in [0, pi/2).

    Raises:
        RangeError: a negative slope.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> round(ton.roughness_from_slope(torch.tensor(0.5)).item(), 4)
        0.4636
    """
    check_range("slope", slope, 0.0, math.inf, "it is a standard deviation")
    return slope.atan()
