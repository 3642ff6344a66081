"""Roughness that differs over an object: levels of it, and a map on which neighbours agree."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor

from . import robust_fit
from .material import LightDirections, Material
from .pixel_grid import Grid
from .robust_fit import PixelFit

STEP = math.radians(8)
LEVELS = tuple(STEP * k for k in range(9))
"""Roughnesses that are tried, radians."""
SCALE = 0.02
"""Misfit beyond a few times this share of a pixel's mean is a shadow's or a highlight's, not the roughness's."""
RADIUS = 3
"""Pixels up to so many rows and columns away decide on a roughness together: the smoothness that is assumed."""
TOGETHER = 25
"""So many pixels of a sample do."""


def at_levels(material: Material) -> list[Material]:
    """The material with every roughness."""
    levels = [replace(material, roughness=level, varied=False) for level in LEVELS[1:]]
    return [Material(exponents=material.exponents), *levels]


def level_cost(fitted: PixelFit, grey: Tensor, rays: LightDirections, material: Material) -> Tensor:
    """How badly a fit explains each pixel, (P,), on a scale that all roughnesses share."""
    return robust_fit.common_cost(fitted, torch.full_like(fitted.noise, SCALE), grey, rays, material)


def nearest(places: Tensor) -> Tensor:
    """Indices of the pixels nearest to each of P pixels at (P, 2), itself included, (P, N)."""
    count = min(TOGETHER, len(places))
    parts = [torch.cdist(part, places.float()).topk(count, largest=False).indices for part in places.float().split(512)]
    return torch.cat(parts)


def blend(maps: Sequence[dict[str, Tensor]], costs: Tensor, grid: Grid) -> dict[str, Tensor]:
    """One set of maps from those at every level: where the cost, averaged over neighbours, is lowest.

    Args:
        maps: (C, H, W) each, by name, of every level.
        costs: (levels, P).
        grid: where the pixels lie.
    """
    shared = grid.mean(costs.T, torch.ones_like(costs[:1].T), RADIUS)  # (P, levels)
    best = shared.argmin(1, keepdim=True).clamp(1, len(maps) - 2)
    below, here, above = (shared.gather(1, best + k) for k in (-1, 0, 1))
    bend = (below - 2 * here + above).clamp_min(1e-12)
    place = (best + (0.5 * (below - above) / bend).clamp(-1, 1)).clamp(0, len(maps) - 1)
    lower = place.floor().clamp_max(len(maps) - 2)
    drawn, share = grid.draw(lower).long(), grid.draw(place - lower)
    mixed = {}
    for name in maps[0]:
        stacked = torch.stack([m[name] for m in maps])  # (levels, C, H, W)
        at = drawn[None].expand(1, *stacked.shape[1:])
        low, high = stacked.gather(0, at)[0], stacked.gather(0, at + 1)[0]
        mixed[name] = torch.lerp(low, high, share.to(low))
    mixed["normal"] = F.normalize(mixed["normal"], dim=0)
    return mixed
