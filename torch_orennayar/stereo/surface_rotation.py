"""The rotation that makes a field of normals that of a surface: one whose slopes come from one height.

Around any square the slopes of a height add up to nothing. What two opposite sides contribute, and what the other two
do, must cancel (integrability, Yuille & Snow 1997). Squares of several sizes are taken: noise of single pixels averages
out along their sides, and edges of the object lie across few of them.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from .robust_stats import MAD_TO_SIGMA

SIDES = (4, 8, 16)
"""Pixels along the sides of the squares, on photographs reduced to some thousand pixels; set by hand."""
LEAST_FACING = 0.1
"""Cosine to the view below which slopes are too steep to count; set by hand."""
LEAST_SCALE = 0.03
"""Least difference, as a share of what opposite sides contribute, that counts as noise; set by hand."""
STEPS = 10
"""Newton steps at most, each with the squares' noise of the one before; set by hand."""
MAX_STEP, HALVINGS, SETTLED = 0.1, 5, 1e-3
"""Radians of a step at most, times that it is halved, and radians of the last one; set by hand."""
DIFFERENCE = 0.02
"""Radians over which the curvature of the misfit is taken; set by hand."""
LEAST_STIFFNESS = 1.0
"""1 / radians**2 that is known of a rotation at least; set by hand."""


def rotation_to_surface(normal: Tensor, inside: Tensor) -> tuple[Tensor, Tensor]:
    """The rotation after which normals are most nearly those of a surface, and how well it is determined.

    It is searched near the identity. Where no square lies inside it is the identity.

    Args:
        normal: (P, 3) unit, float64.
        inside: (H, W) bool, where these lie.

    Returns:
        A rotation (3, 3), applied from the right, and the inverse covariance of its axis times angle (3, 3), 1 /
        radians**2, for squares that do not overlap.
    """
    rotation = torch.eye(3, dtype=normal.dtype)
    stiffness = LEAST_STIFFNESS * rotation
    for _ in range(STEPS):
        turned = normal @ rotation
        scales = _scales(turned, inside)
        slope, stiffness = _slope(turned, inside, scales), _stiffness(turned, inside, scales)
        step = -torch.linalg.solve(stiffness, slope)
        step = _shortened(turned, inside, scales, step * min(1.0, MAX_STEP / max(float(step.norm()), 1e-12)))
        rotation = rotation @ _rotation(step)
        if float(step.norm()) < SETTLED:
            break
    return rotation, stiffness


def _shortened(normal: Tensor, inside: Tensor, scales: list[float], step: Tensor) -> Tensor:
    """The step, halved until the misfit falls; 0 where it does not."""
    here = float(_misfit(normal, inside, scales))
    for _ in range(HALVINGS):
        if float(_misfit(normal @ _rotation(step), inside, scales)) < here:
            return step
        step = step / 2
    return torch.zeros_like(step)


def _slope(normal: Tensor, inside: Tensor, scales: list[float], turn: Tensor | None = None) -> Tensor:
    """Derivative of the misfit by a further turn, (3,), after ``turn``."""
    start = normal.new_zeros(3) if turn is None else turn
    with torch.enable_grad():
        moved = start.clone().requires_grad_(True)
        cost = _misfit(normal @ _rotation(moved), inside, scales)
        if not cost.requires_grad:
            return torch.zeros_like(start)
        (slope,) = torch.autograd.grad(cost, moved)
    return slope


def _stiffness(normal: Tensor, inside: Tensor, scales: list[float]) -> Tensor:
    """Curvature of the misfit by central differences, made positive."""
    steps = DIFFERENCE * torch.eye(3, dtype=normal.dtype)
    rows = [_slope(normal, inside, scales, step) - _slope(normal, inside, scales, -step) for step in steps]
    curvature = torch.stack(rows) / (2 * DIFFERENCE)
    values, vectors = torch.linalg.eigh((curvature + curvature.T) / 2)
    stiffness: Tensor = vectors @ values.clamp_min(LEAST_STIFFNESS).diag() @ vectors.T
    return stiffness


def _scales(normal: Tensor, inside: Tensor) -> list[float]:
    """Noise of the squares of each size."""
    scales = []
    for side in SIDES:
        gap = _gaps(normal.detach(), inside, side).abs()
        scales.append(MAD_TO_SIGMA * float(gap.median()) + LEAST_SCALE if len(gap) else 1.0)
    return scales


def _misfit(normal: Tensor, inside: Tensor, scales: list[float]) -> Tensor:
    """Robust cost of the squares of all sizes, each size as if they did not overlap."""
    cost = normal.new_zeros(())
    for side, scale in zip(SIDES, scales, strict=True):
        gap = _gaps(normal, inside, side)
        if len(gap):
            square = gap.square()
            count = len(normal) / (side**2 * len(SIDES))
            cost = cost + 0.5 * count * (square / (square + scale**2)).mean()
    return cost


def _gaps(normal: Tensor, inside: Tensor, side: int) -> Tensor:
    """How far the sides of squares are from cancelling, over what they contribute, (S,)."""
    places = inside.flatten().nonzero().flatten()
    field = normal.new_zeros(3, inside.numel()).index_copy(1, places, normal.T).view(3, *inside.shape)
    facing = inside & (field[2] > LEAST_FACING).detach()
    right, up = (-field[axis] / field[2].clamp_min(LEAST_FACING) * facing for axis in (0, 1))
    if min(inside.shape) <= side:
        return normal.new_zeros(0)
    rows, columns = _sums(right, side), _sums(up.T, side).T
    whole_row = _sums(facing.to(normal), side) > side - 0.5
    whole_column = (_sums(facing.T.to(normal), side) > side - 0.5).T
    whole = whole_row[:-side] & whole_row[side:] & whole_column[:, :-side] & whole_column[:, side:]
    across = (rows[:-side] - rows[side:])[whole] / side
    along = (columns[:, side:] - columns[:, :-side])[whole] / side
    size = across.square() + along.square()
    return (across - along) / (size + size.detach().median()).sqrt() if len(size) else size


def _sums(values: Tensor, side: int) -> Tensor:
    """Integrals (H, W - side) along rows from every pixel to the one ``side`` further, by the trapezoidal rule."""
    total = F.pad(values.cumsum(1), (1, 0))
    return total[:, side + 1 :] - total[:, : -side - 1] - 0.5 * (values[:, :-side] + values[:, side:])


def _rotation(turn: Tensor) -> Tensor:
    """The rotation about an axis by the angle that is its length (Rodrigues)."""
    zero = torch.zeros_like(turn[0])
    x, y, z = turn.unbind()
    cross = torch.stack((torch.stack((zero, -z, y)), torch.stack((z, zero, -x)), torch.stack((-y, x, zero))))
    rotation: Tensor = torch.linalg.matrix_exp(cross)
    return rotation
