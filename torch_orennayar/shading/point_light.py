"""Near point lights."""

from __future__ import annotations

import math

from torch import Tensor

from ..core.checks import check_axis, check_broadcast, check_floating, check_range
from .inputs import axis_from_end, result_dtype
from .precision import cast, working_dtype
from .vectors import inverse_length


def point_light(points: Tensor, position: Tensor, intensity: Tensor | float, *, dim: int = 1) -> tuple[Tensor, Tensor]:
    """Direction to a near point source and its irradiance at every point, by the inverse-square law.

    Differentiable in all arguments; at the source itself (zero distance) and at points that are not
    finite (background) both results and their gradients are 0.

    Args:
        points: surface points in the camera frame, 3 along ``dim``, e.g. (B, 3, H, W).
        position: the source, 3 along ``dim``, e.g. (B, 3, 1, 1).
        intensity: irradiance at unit distance, >= 0, in the unit of ``irradiance=``; 1 or C along ``dim``.
        dim: the axis of x, y, z in the broadcast shape.

    Returns:
        ``(light, irradiance)`` for `oren_nayar`: unit directions to the source, 3 along ``dim``, and
        irradiance on a plane facing the source, 1 or C along ``dim``.

    Raises:
        ShapeError: 3 is not found along ``dim``.
        RangeError: negative intensity.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> points = torch.zeros(1, 3, 1, 1)
        >>> light, irradiance = ton.point_light(points, torch.tensor([0.0, 0.0, 2.0]).reshape(1, 3, 1, 1), 1.0)
        >>> light.flatten().tolist(), irradiance.item()
        ([0.0, 0.0, 1.0], 0.25)
    """
    check_floating(points=points, position=position)
    axis = axis_from_end(dim, points, position)
    check_axis("points", points, axis, (3,))
    check_axis("position", position, axis, (3,))
    check_range("intensity", intensity, 0.0, math.inf, "intensity is never negative")
    dtype = result_dtype(*(t for t in (points, position, intensity) if isinstance(t, Tensor)))
    here, there = (cast(t, working_dtype(dtype)).nan_to_num(0.0, 0.0, 0.0) for t in (points, position))
    known = (points.isfinite() & position.isfinite()).all(axis, keepdim=True)
    offset = (there - here) * known
    inverse = inverse_length(offset, axis)
    check_broadcast(axis, points=points, position=position, intensity=intensity)
    return (offset * inverse).to(dtype), (intensity * (inverse * inverse)).to(dtype)
