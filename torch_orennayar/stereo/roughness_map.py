"""Roughness that differs over an object: levels of it, and a map on which neighbours agree."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor

from . import robust_fit
from .material import Material
from .pixel_grid import Grid
from .pixel_sample import PixelSample
from .robust_fit import PixelFit
from .solved_maps import SolvedMaps

STEP = math.radians(8)
"""Radians between levels of roughness. Set by hand: a parabola finds what lies between."""
LEVELS = tuple(STEP * k for k in range(9))
"""Roughnesses that are tried, radians, 0 to 64 degrees."""
SCALE = 0.02
"""Standard deviation, as a share of a pixel's mean, over which levels are compared: misfit beyond a few times this is a
shadow's or a highlight's, not the roughness's. Set by hand."""
RADIUS = 3
"""Rows and columns within which pixels decide on a roughness together: the smoothness that is assumed. Set by hand."""
NEAREST = 25
"""Number of pixels of a sample that decide on a roughness together. Set by hand."""


def at_levels(material: Material) -> list[Material]:
    """The material with every roughness; Lambert's for 0."""
    levels = [replace(material, roughness=level, roughness_varies=False) for level in LEVELS[1:]]
    return [Material(exponents=material.exponents), *levels]


def level_cost(fitted: PixelFit, sample: PixelSample, material: Material) -> Tensor:
    """How badly a fit explains each pixel, (P,), on a scale that all roughnesses share."""
    return robust_fit.common_cost(fitted, torch.full_like(fitted.noise, SCALE), sample, material)


def nearest(places: Tensor) -> Tensor:
    """Indices of the pixels nearest to each of P pixels at rows and columns (P, 2), itself included, (P, N)."""
    count = min(NEAREST, len(places))
    parts = [torch.cdist(part, places.float()).topk(count, largest=False).indices for part in places.float().split(512)]
    return torch.cat(parts)


def blend(maps: Sequence[SolvedMaps], costs: Tensor, grid: Grid) -> SolvedMaps:
    """One set of maps from those at every level: where the cost, averaged over neighbours, is lowest.

    Args:
        maps: of every level.
        costs: (levels, P).
        grid: where the pixels lie.
    """
    shared = grid.mean(costs.T, torch.ones_like(costs[:1].T), RADIUS)  # (P, levels)
    best = shared.argmin(1, keepdim=True).clamp(1, len(maps) - 2)
    below, here, above = (shared.gather(1, best + k) for k in (-1, 0, 1))
    curvature = (below - 2 * here + above).clamp_min(1e-12)
    level = (best + (0.5 * (below - above) / curvature).clamp(-1, 1)).clamp(0, len(maps) - 1)
    lower = level.floor().clamp_max(len(maps) - 2)
    index, share = grid.draw(lower).long(), grid.draw(level - lower)
    mixed = []
    for levels in zip(*(m.tensors() for m in maps), strict=True):
        stacked = torch.stack(levels)  # (levels, C, H, W)
        at = index[None].expand(1, *stacked.shape[1:])
        low, high = stacked.gather(0, at)[0], stacked.gather(0, at + 1)[0]
        mixed.append(torch.lerp(low, high, share.to(low)))
    blended = SolvedMaps(*mixed)
    return replace(blended, normal=F.normalize(blended.normal, dim=0))
