"""First lights and normals from photographs alone: what each says of the other, in alternation.

The object's inflated outline gives normals to begin with. What is found is right but for a linear ambiguity: any
invertible 3 x 3 matrix between lights and normals explains Lambertian photographs as well.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..core.progress import track
from ..geometry.height_field import silhouette_normals
from .linear_systems import solve_symmetric
from .robust_fit import CHUNK
from .robust_stats import (
    BRIGHT,
    MIDDLE_RANKS,
    SHADOW,
    ascending,
    between_ranks,
    geman_mcclure,
    mean_brightness,
    median_rank,
    noise_level,
)

ROUNDS = 6
"""Alternations between lights and normals; set by hand."""
REWEIGHTINGS = 4
"""Of each robust regression; set by hand."""
BRIGHTEST_LEFT_OUT = 0.85
"""Quantile of a photograph's pixels above which they are highlights or spoiled by them; set by hand."""
LEAST_FACING = 0.1
"""Cosine to the view by which the brightness of the outline's normals is divided at least; set by hand."""


def factor(grey: Tensor, inside: Tensor) -> Tensor:
    """Directions to the lights times their brightness, (K, 3), up to a linear map.

    Args:
        grey: (P, K) float64.
        inside: (H, W) bool, where the pixels lie; its edge is taken as the object's outline.
    """
    seen = Observations.of(grey)
    outline = silhouette_normals(inside[None])[:, inside].T.to(grey)
    lights = seen.regress_lights(outline * (grey.mean(1, keepdim=True) / outline[:, 2:].clamp_min(LEAST_FACING)))
    for _ in track(range(ROUNDS), "finding lights", ROUNDS):
        lights = seen.regress_lights(seen.regress_normals(lights))
    return lights


class Observations(NamedTuple):
    """Grey observations and those of them that count.

    Attributes:
        grey: (P, K) float64.
        middle: (P, K) 1 for observations of a pixel that are of middle rank and in light.
        dim: (P, K) 1 for pixels of a photograph that are in light and not among its brightest.
    """

    grey: Tensor
    middle: Tensor
    dim: Tensor

    @staticmethod
    def of(grey: Tensor) -> Observations:
        """Which of them count does not depend on lights and normals."""
        bright = ascending(grey.T.contiguous())[:, min(int(BRIGHTEST_LEFT_OUT * len(grey)), len(grey) - 1)]
        level = ascending(grey)[:, min(int(BRIGHT * grey.shape[1]), grey.shape[1] - 1), None]
        dim = ((grey <= bright) & (grey > SHADOW * level)).to(grey)
        return Observations(grey, between_ranks(grey, *MIDDLE_RANKS), dim)

    def regress_lights(self, scaled: Tensor) -> Tensor:
        """Lights (K, 3) times their brightness, from albedo times normals (P, 3)."""
        return _regress(self.grey.T.contiguous(), self.dim.T.contiguous(), scaled)

    def regress_normals(self, lights: Tensor) -> Tensor:
        """Albedo times normals (P, 3), from lights (K, 3) times their brightness."""
        return _regress(self.grey, self.middle, lights)


def _regress(seen: Tensor, used: Tensor, vectors: Tensor) -> Tensor:
    """Robust solutions (N, 3) of ``seen = solution @ vectors.T``, N rows in parts that fit in cache."""
    rows = max(1, CHUNK // seen.shape[1])
    parts = zip(seen.split(rows), used.split(rows), strict=True)
    return torch.cat([_regress_rows(some, some_used, vectors) for some, some_used in parts])


def _regress_rows(seen: Tensor, used: Tensor, vectors: Tensor) -> Tensor:
    outer, weight, rank = (vectors[:, :, None] * vectors[:, None]).flatten(1), used, median_rank(used)
    mean = mean_brightness(seen)
    solution = seen.new_zeros(len(seen), 3)
    for _ in range(REWEIGHTINGS):
        matrix = (weight @ outer).T.view(3, 3, -1)
        ridge = 1e-6 * (matrix[0, 0] + matrix[1, 1] + matrix[2, 2]).clamp_min(1e-12)
        rows = [[matrix[i, j] + ridge if i == j else matrix[i, j] for j in range(3)] for i in range(3)]
        solution = torch.stack(solve_symmetric(rows, list(((weight * seen) @ vectors).T)), 1)
        residual = seen - solution @ vectors.T
        weight = geman_mcclure(used, residual, mean * noise_level(residual / mean, used, rank))
    return solution
