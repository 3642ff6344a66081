"""The rotation that makes a field of normals that of a surface: one whose slopes come from one height."""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

BLUR = 2
"""Half width of the box that normals are averaged over, pixels: single pixels hold more noise than bending. Set by
hand."""
STEP = 2
"""Pixels on either side over which the change of a normal is measured; set by hand."""
LEAST_BEND = 0.02
"""Change of a normal per pixel below which a pixel says little of the rotation; set by hand."""
SCALE = 0.15
"""Integrability over bending at which a pixel counts as an edge of the object; set by hand."""


class SmoothNormals(NamedTuple):
    """Pixels away from the outline.

    Attributes:
        normal: (P, 3) averaged.
        right: (P, 3) its change per pixel to the right.
        up: (P, 3) the same upward.
    """

    normal: Tensor
    right: Tensor
    up: Tensor

    @staticmethod
    def of(normal: Tensor, inside: Tensor) -> SmoothNormals:
        """Of unit normals (P, 3) of the pixels in ``inside`` (H, W) bool."""
        field = normal.new_zeros(3, *inside.shape)
        field[:, inside] = normal.T
        box = normal.new_full((1, 1, 2 * BLUR + 1, 2 * BLUR + 1), 1 / (2 * BLUR + 1) ** 2)
        whole = F.conv2d(inside.to(normal)[None, None], box, padding=BLUR)[0, 0] > 0.999
        field = F.conv2d(field[:, None], box, padding=BLUR)[:, 0]
        height, width = inside.shape
        rows, columns = slice(STEP, height - STEP), slice(STEP, width - STEP)
        early, late = slice(0, -2 * STEP), slice(2 * STEP, None)
        sides = ((rows, late), (rows, early), (early, columns), (late, columns))
        kept = whole[rows, columns].clone()
        for side in sides:
            kept &= whole[side]
        right, left, above, below = (field[:, side[0], side[1]][:, kept] for side in sides)
        middle = field[:, rows, columns][:, kept]
        return SmoothNormals(middle.T, (right - left).T / (2 * STEP), (above - below).T / (2 * STEP))


def rotation_to_surface(field: SmoothNormals) -> Tensor:
    """The rotation (3, 3), applied from the right, after which the normals are most nearly those of a surface.

    It is searched near the identity, by the integrability of Yuille & Snow 1997 over the bending of each pixel; edges
    count little. Without pixels it is the identity.
    """
    turn = torch.zeros(3, dtype=field.normal.dtype, requires_grad=True)
    if not len(field.normal):
        return torch.eye(3, dtype=field.normal.dtype)
    optimiser = torch.optim.LBFGS([turn], lr=0.5, max_iter=60, line_search_fn="strong_wolfe")

    @torch.enable_grad()
    def misfit() -> Tensor:
        optimiser.zero_grad()
        square = _curl(field, _rotation(turn)).square()
        cost = (square / (square + SCALE**2)).mean()
        cost.backward()
        return cost

    optimiser.step(misfit)
    return _rotation(turn.detach())


def _curl(field: SmoothNormals, rotation: Tensor) -> Tensor:
    """How far the turned normals are from those of a surface, over how much they bend, (P,)."""
    normal, right, up = (part @ rotation for part in field)
    first = normal[:, 2] * up[:, 0] - normal[:, 0] * up[:, 2]
    second = normal[:, 2] * right[:, 1] - normal[:, 1] * right[:, 2]
    bend = (right.square().sum(1) + up.square().sum(1)).sqrt()
    return (first - second) / (bend + LEAST_BEND)


def _rotation(turn: Tensor) -> Tensor:
    """The rotation about an axis by the angle that is its length (Rodrigues)."""
    zero = torch.zeros_like(turn[0])
    x, y, z = turn.unbind()
    cross = torch.stack((torch.stack((zero, -z, y)), torch.stack((z, zero, -x)), torch.stack((-y, x, zero))))
    rotation: Tensor = torch.linalg.matrix_exp(cross)
    return rotation
