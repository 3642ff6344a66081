"""Normals of pixels that too few lights determine, continued smoothly from the pixels about them."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from .linear_systems import camera_facing

RELAXATIONS = 100
"""Steps that smooth what coarser levels filled in; set by hand."""


def fill_normals(normal: Tensor, unknown: Tensor, inside: Tensor) -> Tensor:
    """``normal`` with those of unknown pixels continued from the others: each component is as flat as it can be.

    Args:
        normal: (3, H, W).
        unknown: (H, W) bool, the pixels to fill in.
        inside: (H, W) bool, the object; nothing outside counts.

    Returns:
        (3, H, W) unit vectors inside. Without known pixels it is ``normal``.
    """
    known = inside & ~unknown
    if not bool(known.any()):
        return normal
    unknown = unknown & inside
    rows, columns = (unknown.any(axis).nonzero().flatten() for axis in (1, 0))
    # What lies farther from a gap than the gap is wide says little about it.
    reach = 1 + max(int(rows[-1] - rows[0]), int(columns[-1] - columns[0]))
    first, last = (slice(max(int(at[0]) - reach, 0), int(at[-1]) + reach + 1) for at in (rows, columns))
    window = first, last
    part, gap, object_ = normal[:, window[0], window[1]], unknown[window], inside[window].to(normal)[None]
    filled = _from_coarser((part * known[window])[None], known[window].to(normal)[None, None])[0]
    kernel = normal.new_tensor([[0, 1, 0], [1, 0, 1], [0, 1, 0]]).expand(3, 1, 3, 3)
    neighbours = F.conv2d(object_, kernel[:1], padding=1).clamp_min(1)
    for _ in range(RELAXATIONS):
        mean = F.conv2d(filled * object_, kernel, padding=1, groups=3) / neighbours
        filled = torch.where(gap, mean, filled)
    result = normal.clone()
    result[:, unknown] = camera_facing(filled[:, gap].T).T
    return result


def _from_coarser(value: Tensor, weight: Tensor) -> Tensor:
    """Weighted values (1, 3, H, W); where the weight is 0, those of a picture of half the size."""
    known = value / weight.clamp_min(1e-12)
    if bool((weight > 0).all()) or max(value.shape[2:]) == 1:
        return known
    halves = [F.avg_pool2d(part, 2, ceil_mode=True, count_include_pad=False) for part in (value, weight)]
    coarse = F.interpolate(_from_coarser(halves[0], halves[1]), value.shape[2:], mode="bilinear")
    return torch.where(weight > 0, known, coarse)
