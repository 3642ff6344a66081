"""Clip triangles at planes, so that the remaining pieces can be projected to pixels exactly."""

from __future__ import annotations

import torch
from torch import Tensor

GUARD = float(1 << 16) - 1
"""Largest coordinate in pixels after clipping: 2^16 pixels are 2^24 steps, the end of the whole numbers of float32."""


def clip(corners: Tensor, owner: Tensor, near: float | None) -> tuple[Tensor, Tensor]:
    """Clip triangles at the near plane and at the guard band around the image.

    An edge that two triangles share is cut at the same point, to the last bit, in both.

    Args:
        corners: (N, 3, 4) float64: homogeneous pixel coordinates x w, y w, w, and depth.
        owner: (N,) labels that the pieces inherit.
        near: depth of the near plane, or None for orthographic views.

    Returns:
        Corners (M, 3, 4) and owners (M,) of the pieces.
    """
    if near is not None:
        corners, owner = _cut(corners, owner, corners[:, :, 3] - near)
    for axis in (0, 1):
        for sign in (1.0, -1.0):
            corners, owner = _cut(corners, owner, GUARD * corners[:, :, 2] - sign * corners[:, :, axis])
    return corners, owner


def _cut(corners: Tensor, owner: Tensor, distance: Tensor) -> tuple[Tensor, Tensor]:
    """Keep the parts of the triangles whose ``distance``, (N, 3) at the corners, is at least 0."""
    inside = distance >= 0
    count = inside.sum(1)
    whole, tip, stump = ((count == k).nonzero().flatten() for k in (3, 1, 2))
    # A tip keeps one corner, a stump loses one; that corner is put first.
    a, b, c, from_a, from_b, from_c = _lead(corners[tip], distance[tip], inside[tip])
    tips = torch.stack((a, _cross(a, b, from_a, from_b), _cross(a, c, from_a, from_c)), 1)
    a, b, c, from_a, from_b, from_c = _lead(corners[stump], distance[stump], ~inside[stump])
    p, q = _cross(b, a, from_b, from_a), _cross(c, a, from_c, from_a)
    pieces = (corners[whole], tips, torch.stack((p, b, c), 1), torch.stack((p, c, q), 1))
    return torch.cat(pieces), torch.cat((owner[whole], owner[tip], owner[stump], owner[stump]))


def _lead(corners: Tensor, distance: Tensor, first: Tensor) -> tuple[Tensor, ...]:
    """The corners and their distances, rotated so that the corner marked in ``first`` comes first."""
    order = (first.to(torch.int64).argmax(1, keepdim=True) + torch.arange(3, device=first.device)) % 3
    turned = corners.gather(1, order[:, :, None].expand(-1, -1, 4))
    return (*turned.unbind(1), *distance.gather(1, order)[:, :, None].unbind(1))


def _cross(kept: Tensor, lost: Tensor, distance_kept: Tensor, distance_lost: Tensor) -> Tensor:
    """Where the edge meets the plane, always computed from the corner that is kept: the same in both triangles."""
    return kept + (lost - kept) * (distance_kept / (distance_kept - distance_lost))
