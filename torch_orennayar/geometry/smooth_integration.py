"""Depth from normals by a fixed number of multigrid steps, which an ONNX graph can hold.

Least squares on the slopes between neighbouring pixels, without depth discontinuities: `integrate_normals` finds those,
and is more accurate where torch is available. Conjugate gradients, preconditioned by one cycle of multigrid whose
coarse pixels are 2 x 2 fine ones.

Each step is a module, so that `torch.onnx.export` makes a graph of it. Edges are (2, H, W): from a pixel to its right
neighbour and to the one below; maps are (1, H, W).
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

LEVELS = 9
"""Grids of the multigrid cycle, each half as high and wide as the one before: 1 pixel is left of 256."""
STEPS = 20
"""Steps of conjugate gradients. Set by hand: after them the heights of smooth surfaces of 512 pixels do not change."""
LEAST_FACING = 0.04
"""Least sum of two normals' z that is divided by: a slope of 89 degrees, as in `integrate_normals`."""
DAMPING = 0.7
"""Share of a Jacobi step that smooths; set by hand."""
OVERSHOOT = 1.7
"""Factor on what a coarse grid finds, because steps between its pixels are too stiff; set by hand, below 2."""
TINY = 1e-12
"""Least number that is divided by."""


class Begin(nn.Module):
    """The equations, and their right-hand side."""

    def forward(self, normal: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        """Of normals (3, H, W) and a mask (1, H, W) bool: weights of edges, and what is to be explained.

        Heights are toward the viewer, in pixels. Normals that are not finite count as outside the mask.
        """
        sound = mask & normal.isfinite().all(0, keepdim=True)
        inside = sound.to(normal.dtype)
        x, y, z = torch.where(sound, normal, 0.0).split(1)
        right, below = z + _next(z, 2), z + _next(z, 1)
        facing = torch.cat((right * _next(inside, 2), below * _next(inside, 1))) * inside
        steep = torch.cat((right, below)).clamp_min(LEAST_FACING)
        slope = torch.cat((-(x + _next(x, 2)), y + _next(y, 1))) / steep
        weight = facing.clamp_min(0).square()
        return weight, _gather(weight * slope)


class Coarsen(nn.Module):
    """The next grid."""

    def forward(self, weight: Tensor) -> Tensor:
        """Weights between blocks of 2 x 2 pixels: sums of those of the edges that cross from one to the next."""
        even = _even(weight)
        right, below = even[:1, :, 1::2], even[1:, 1::2]
        return torch.cat((right[:, ::2] + right[:, 1::2], below[:, :, ::2] + below[:, :, 1::2]))


class Smooth(nn.Module):
    """A damped Jacobi step from 0."""

    def forward(self, weight: Tensor, residual: Tensor) -> tuple[Tensor, Tensor]:
        """Heights, and the residual that is left of them in blocks of 2 x 2 pixels."""
        depth = _relax(weight, residual)
        even = _even(residual - _apply(weight, depth))
        rows = even[:, ::2] + even[:, 1::2]
        return depth, rows[:, :, ::2] + rows[:, :, 1::2]


class Spread(nn.Module):
    """What the next grid found, on a grid."""

    def forward(self, coarse: Tensor) -> Tensor:
        """Every value of (1, h, w) on its 2 x 2 pixels, times `OVERSHOOT`: (1, 2 h, 2 w)."""
        tall = torch.stack((coarse, coarse), 2).flatten(1, 2)
        return OVERSHOOT * torch.stack((tall, tall), 3).flatten(2, 3)


class Correct(nn.Module):
    """What the next grid found added, then a damped Jacobi step."""

    def forward(self, weight: Tensor, residual: Tensor, depth: Tensor, found: Tensor) -> Tensor:
        """The better heights of a grid; all maps are (1, H, W)."""
        depth = depth + found
        return depth + _relax(weight, residual - _apply(weight, depth))


class Advance(nn.Module):
    """One step of preconditioned conjugate gradients."""

    def forward(
        self, weight: Tensor, depth: Tensor, residual: Tensor, direction: Tensor, before: Tensor, guess: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Depth, residual and direction after the step, and the product (1, 1, 1) that the next one divides by."""
        product = (residual * guess).sum().reshape(1, 1, 1)
        direction = guess + direction * (product / before)
        response = _apply(weight, direction)
        length = product / (direction * response).sum().clamp_min(TINY)
        return depth + length * direction, residual - length * response, direction, product.clamp_min(TINY)


class Centre(nn.Module):
    """Heights with mean 0 over the mask, and 0 outside."""

    def forward(self, depth: Tensor, mask: Tensor) -> Tensor:
        """Of heights (1, H, W) and a mask (1, H, W) bool."""
        inside = mask.to(depth.dtype)
        return (depth - (depth * inside).sum() / inside.sum().clamp_min(1.0)) * inside


def integrate_smooth(normal: Tensor, mask: Tensor) -> Tensor:
    """What the graph computes, in torch: heights (1, H, W) in pixels, 0 outside the mask, mean 0 over it."""
    weight, residual = Begin()(normal, mask)
    weights = [weight]
    while len(weights) < LEVELS:
        weights.append(Coarsen()(weights[-1]))
    depth, direction, before = torch.zeros_like(residual), torch.zeros_like(residual), residual.new_ones(1, 1, 1)
    for _ in range(STEPS):
        guess = _cycle(weights, residual)
        depth, residual, direction, before = Advance()(weight, depth, residual, direction, before, guess)
    heights: Tensor = Centre()(depth, mask)
    return heights


def _cycle(weights: list[Tensor], residual: Tensor) -> Tensor:
    """An approximate solution: smooth, correct on the next grids, smooth again."""
    depth: Tensor
    depth, left = Smooth()(weights[0], residual)
    if len(weights) > 1:
        found = Spread()(_cycle(weights[1:], left))[:, : depth.shape[1], : depth.shape[2]]
        depth = Correct()(weights[0], residual, depth, found)
    return depth


def _next(values: Tensor, axis: int) -> Tensor:
    """The value of the next pixel along ``axis``, 0 behind the last."""
    return F.pad(values[:, :, 1:], (0, 1)) if axis == 2 else F.pad(values[:, 1:], (0, 0, 0, 1))


def _gather(flow: Tensor) -> Tensor:
    """What arrives at every pixel less what leaves it, (1, H, W), of flows along the edges."""
    right, below = flow[:1], flow[1:]
    return F.pad(right[:, :, :-1], (1, 0)) - right + F.pad(below[:, :-1], (0, 0, 1, 0)) - below


def _apply(weight: Tensor, depth: Tensor) -> Tensor:
    """The matrix of the equations times heights."""
    rise = torch.cat((_next(depth, 2) - depth, _next(depth, 1) - depth))
    return _gather(weight * rise)


def _diagonal(weight: Tensor) -> Tensor:
    """The diagonal of that matrix."""
    right, below = weight[:1], weight[1:]
    return right + F.pad(right[:, :, :-1], (1, 0)) + below + F.pad(below[:, :-1], (0, 0, 1, 0))


def _relax(weight: Tensor, residual: Tensor) -> Tensor:
    """A damped Jacobi step; 0 where a pixel has no edge."""
    diagonal = _diagonal(weight)
    return residual * (DAMPING * (diagonal > 0).to(residual.dtype) / diagonal.clamp_min(TINY))


def _even(values: Tensor) -> Tensor:
    """Rows and columns of zeros added so that both numbers are even."""
    return F.pad(values, (0, values.shape[2] % 2, 0, values.shape[1] % 2))
