"""Photometric stereo in a fixed number of closed-form steps, which an ONNX graph can hold.

Weighted linear least squares, repeated with the weights and the reflectance of the previous solution. No search, no
neighbours and no highlights: `photometric_stereo` is more accurate where torch is available.

Each step is a module, so that `torch.onnx.export` makes a graph of it. Inside, grey observations (P, K) are divided by
the pixel's mean; lights are (K, 3), unit, in the camera frame; the vector (P, 3) is albedo times normal over that mean.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from ..reflectance.models import ModelFunction, get_model
from ..shading.evaluate import above_horizon, facing_both
from .linear_systems import camera_facing, solve_symmetric
from .pixel_grid import Grid
from .robust_stats import ERROR_CAP, MAD_TO_SIGMA, NOISE_FLOOR, geman_mcclure, quantile, soft_in_light, soft_middle

CANDIDATES = tuple(math.radians(7.5 * k) for k in range(9))
"""Roughnesses that are tried, radians, 0 to 60 degrees. Set by hand."""
SAMPLES = 1024
"""Number of pixels on which the roughness is chosen. Set by hand."""
MARGIN = 0.98
"""Share of Lambert's error that the best roughness must stay below to be taken: the tolerance of `material_refinement`.
Set by hand."""
TURNS = 5
"""Number of times that reflectance and noise are updated, with two solutions each. Set by hand."""
PRIOR = 0.05
"""Weight of the previous solution, as a share of the weight of all lights. Set by hand."""


class Prepare(nn.Module):
    """Grey observations over their mean, and that mean."""

    def forward(self, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Of pixels (P, C, K): grey (P, K) and mean (P, 1)."""
        grey = seen.mean(1)
        level = grey.mean(1, keepdim=True).clamp_min(1e-12)
        return grey / level, level


class Begin(nn.Module):
    """The start: Lambertian least squares on the observations of middle rank."""

    def forward(self, grey: Tensor, lights: Tensor) -> tuple[Tensor, Tensor]:
        """Weights of the middle ranks, (P, K), and the vector, (P, 3)."""
        middle = soft_middle(grey)
        facing = torch.ones_like(grey[:, :1]) * grey.new_tensor((0.0, 0.0, 1.0))
        return middle, _least_squares(grey, lights, middle, torch.ones_like(grey), facing)


class Turn(nn.Module):
    """One update of reflectance and noise, then two reweighted solutions."""

    def __init__(self, function: ModelFunction) -> None:
        super().__init__()
        self.function = function

    def forward(
        self, grey: Tensor, level: Tensor, lights: Tensor, roughness: Tensor, middle: Tensor, vector: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The new vector (P, 3) and the weights (P, K) that gave it; ``roughness`` is (P, 1)."""
        ratio = _ratio(self.function, vector, level, lights, roughness)
        missed = (grey - ratio * _lambert(vector, lights)).abs().sort(1)[0]
        noise = (MAD_TO_SIGMA * quantile(missed, torch.full_like(level[:1], 0.5))).clamp_min(NOISE_FLOOR)
        weight = middle
        for _ in range(2):
            weight = geman_mcclure(middle, grey - ratio * _lambert(vector, lights), noise)
            vector = _least_squares(grey, lights, weight, ratio, vector)
        return vector, weight


class Sample(nn.Module):
    """Some pixels, evenly from the whole object, each with every candidate roughness."""

    def forward(self, grey: Tensor, level: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Grey (N S, K), mean and roughness (N S, 1) of S pixels under N candidates."""
        some = torch.arange(SAMPLES, device=grey.device) * grey.shape[0] // SAMPLES
        count = len(CANDIDATES)
        roughness = grey.new_tensor(CANDIDATES)[:, None].expand(count, SAMPLES).reshape(-1, 1)
        return grey[some].repeat(count, 1), level[some].repeat(count, 1), roughness


class Choose(nn.Module):
    """The roughness that explains the samples best; 0 where none is better than Lambert by a margin."""

    def __init__(self, function: ModelFunction) -> None:
        super().__init__()
        self.function = function

    def forward(self, grey: Tensor, level: Tensor, lights: Tensor, roughness: Tensor, vector: Tensor) -> Tensor:
        """Of what `Sample` made and its solutions: the lowest point of a parabola around the best candidate, (1, 1)."""
        shown = _ratio(self.function, vector, level, lights, roughness) * _lambert(vector, lights)
        lit, count = soft_in_light(grey), len(CANDIDATES)
        error = (lit * (grey - shown).abs().clamp_max(ERROR_CAP)).sum(1) / lit.sum(1).clamp_min(1.0)
        score = error.reshape(count, SAMPLES).mean(1)
        best = score.argmin(0).clamp(1, count - 2)
        below, here, above = (score[(best + k).reshape(1)] for k in (-1, 0, 1))
        curvature = (below - 2 * here + above).clamp_min(1e-9)
        found = (best + (0.5 * (below - above) / curvature).clamp(-1.0, 1.0)) * CANDIDATES[1]
        return (found * (score.amin(0) < MARGIN * score[0])).reshape(1, 1)


class Finish(nn.Module):
    """Normals, and the albedo of every channel by weighted least squares on the shading."""

    def __init__(self, function: ModelFunction) -> None:
        super().__init__()
        self.function = function

    def forward(
        self, seen: Tensor, level: Tensor, lights: Tensor, roughness: Tensor, vector: Tensor, weight: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Grey's normal (P, 3); albedo (P, C) in the unit of ``seen`` (P, C, K)."""
        normal = camera_facing(vector)
        ci, co = (normal @ lights.T)[:, None], normal[:, None, 2:]
        albedo = (vector.norm(dim=1, keepdim=True) * level)[:, :, None].expand(-1, seen.shape[1], 1)
        for _ in range(3):  # fixed-point steps: interreflection between facets depends on the albedo
            rho = albedo.clamp(1e-4, 1.0)
            value = above_horizon(self.function, ci, co, lights[:, 2], rho, roughness[:, :, None])
            shown = torch.where(facing_both(ci, co), value / rho * ci, 0.0)
            weighted = weight[:, None] * shown
            albedo = (weighted * seen).sum(2, keepdim=True) / (weighted * shown).sum(2, keepdim=True).clamp_min(1e-9)
        return normal, albedo[:, :, 0].clamp_min(0.0)


def solve_closed_form(images: Tensor, lights: Tensor, mask: Tensor, model: str) -> tuple[Tensor, Tensor, Tensor]:
    """What the graph computes, in torch.

    Args:
        images: (K, C, H, W).
        lights: (K, 3) unit, camera frame.
        mask: (1, H, W) bool.
        model: a name in ``MODELS``.

    Returns:
        Normals (3, H, W), albedo (C, H, W) and roughness (1, H, W), radians; 0 outside the mask.
    """
    inside, function = mask[0], get_model(model).function

    def solve(grey: Tensor, level: Tensor, roughness: Tensor) -> tuple[Tensor, Tensor]:
        middle, vector = Begin()(grey, lights)
        weight = middle
        for _ in range(TURNS):
            vector, weight = Turn(function)(grey, level, lights, roughness, middle, vector)
        return vector, weight

    seen = images[:, :, inside].permute(2, 1, 0)
    grey, level = Prepare()(seen)
    roughness = torch.zeros_like(level)
    if model != "lambert":
        few, few_level, tried = Sample()(grey, level)
        vector, _ = solve(few, few_level, tried)
        roughness = roughness + Choose(function)(few, few_level, lights, tried, vector)
    vector, weight = solve(grey, level, roughness)
    found = *Finish(function)(seen, level, lights, roughness, vector, weight), roughness
    normal, albedo, roughness = (Grid(inside).draw(values) for values in found)
    return normal, albedo, roughness


def _ratio(function: ModelFunction, vector: Tensor, level: Tensor, lights: Tensor, roughness: Tensor) -> Tensor:
    """Shading of the model over Lambert's, (P, K)."""
    normal = camera_facing(vector)
    albedo = (vector.norm(dim=1, keepdim=True) * level).clamp(1e-4, 1.0)
    ci, co = normal @ lights.T, normal[:, 2:]
    value = above_horizon(function, ci, co, lights[:, 2][None], albedo, roughness)
    return torch.where(facing_both(ci, co), value / albedo, 1.0).clamp(0.1, 10.0)


def _lambert(vector: Tensor, lights: Tensor) -> Tensor:
    """Lambert's shading, (P, K)."""
    return (vector @ lights.T).clamp_min(0.0)


def _least_squares(grey: Tensor, lights: Tensor, weight: Tensor, ratio: Tensor, previous: Tensor) -> Tensor:
    """The vector b with ``grey = ratio (l.b)`` in the weighted mean, (P, 3), with ``previous`` as a prior.

    The prior determines pixels that too few lights reach; where the lights suffice its influence dies out from one
    solution to the next.
    """
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    products = torch.stack([lights[:, i] * lights[:, j] for i, j in pairs], 1)
    weighted = weight * ratio
    xx, xy, xz, yy, yz, zz = ((weighted * ratio) @ products).split(1, dim=1)
    prior = PRIOR * (xx + yy + zz) + 1e-9
    rows = ((xx + prior, xy, xz), (xy, yy + prior, yz), (xz, yz, zz + prior))
    x, y, z = ((weighted * grey) @ lights + prior * previous).split(1, dim=1)
    return torch.cat(solve_symmetric(rows, (x, y, z)), 1)
