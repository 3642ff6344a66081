"""Photometric stereo in a fixed number of closed-form steps, which an ONNX graph can hold.

Weighted linear least squares, repeated with the weights and the reflectance of the previous solution. No search, no
neighbours and no highlights: `photometric_stereo` is more accurate where torch is available.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from ..reflectance.models import ModelFunction, get_model
from ..shading.evaluate import above_horizon, facing_both
from .pixel_grid import Grid
from .robust_fit import solve_symmetric, upward

CANDIDATES = tuple(math.radians(7.5 * k) for k in range(9))
"""Roughnesses that are tried."""
SAMPLES = 1024
"""Pixels that choose among them."""
MARGIN = 0.98
"""A rough surface must predict the pixels better than Lambert by this factor."""
TURNS = 5
"""Times that reflectance and noise are worked out again, with two solutions each."""
NEAR = 0.05
"""Weight of the solution before, as a share of that of all lights."""
CAP, NOISE_FLOOR = 0.15, 0.01
"""Shares of a pixel's mean: errors count up to the one, and noise is at least the other."""


class Prepare(nn.Module):
    """Pixels seen (P, C, K) as grey in units of their mean, (P, K), and that mean, (P, 1)."""

    def forward(self, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Grey decides on the normal."""
        grey = seen.mean(1)
        level = grey.mean(1, keepdim=True).clamp_min(1e-12)
        return grey / level, level


class Begin(nn.Module):
    """Weights of the middle ranks, (P, K), and albedo times normal in units of the mean, (P, 3)."""

    def forward(self, grey: Tensor, lights: Tensor) -> tuple[Tensor, Tensor]:
        """Lambert's surface, trimmed."""
        middle = middle_ranks(grey)
        facing = torch.ones_like(grey[:, :1]) * grey.new_tensor((0.0, 0.0, 1.0))
        return middle, _least_squares(grey, lights, middle, torch.ones_like(grey), facing)


class Turn(nn.Module):
    """Reflectance and noise worked out again, then two reweighted solutions."""

    def __init__(self, function: ModelFunction) -> None:
        super().__init__()
        self.function = function

    def forward(
        self, grey: Tensor, level: Tensor, lights: Tensor, roughness: Tensor, middle: Tensor, vector: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The vector (P, 3) and the weights (P, K) that gave it."""
        ratio = _ratio(self.function, vector, level, lights, roughness)
        wrong = (grey - ratio * _lambert(vector, lights)).abs().sort(1)[0]
        noise = (1.4826 * _quantile(wrong, torch.full_like(level[:1], 0.5))).clamp_min(NOISE_FLOOR)
        weight = middle
        for _ in range(2):
            weight = middle / (1 + ((grey - ratio * _lambert(vector, lights)) / (2 * noise)) ** 2) ** 2
            vector = _least_squares(grey, lights, weight, ratio, vector)
        return vector, weight


class Sample(nn.Module):
    """Some pixels with every candidate roughness: grey (N S, K), level and roughness (N S, 1)."""

    def forward(self, grey: Tensor, level: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Evenly from the whole object."""
        some = torch.arange(SAMPLES, device=grey.device) * grey.shape[0] // SAMPLES
        count = len(CANDIDATES)
        roughness = grey.new_tensor(CANDIDATES)[:, None].expand(count, SAMPLES).reshape(-1, 1)
        return grey[some].repeat(count, 1), level[some].repeat(count, 1), roughness


class Choose(nn.Module):
    """The roughness that explains the samples best, (1, 1); 0 where none is better than Lambert by a margin."""

    def __init__(self, function: ModelFunction) -> None:
        super().__init__()
        self.function = function

    def forward(self, grey: Tensor, level: Tensor, lights: Tensor, roughness: Tensor, vector: Tensor) -> Tensor:
        """Between the best candidate and its neighbours, where a parabola is lowest."""
        shown = _ratio(self.function, vector, level, lights, roughness) * _lambert(vector, lights)
        lit, count = _lit(grey), len(CANDIDATES)
        wrong = (lit * (grey - shown).abs().clamp_max(CAP)).sum(1) / lit.sum(1).clamp_min(1.0)
        score = wrong.reshape(count, SAMPLES).mean(1)
        best = score.argmin(0).clamp(1, count - 2)
        below, here, above = (score[(best + k).reshape(1)] for k in (-1, 0, 1))
        bend = (below - 2 * here + above).clamp_min(1e-9)
        found = (best + (0.5 * (below - above) / bend).clamp(-1.0, 1.0)) * CANDIDATES[1]
        return (found * (score.amin(0) < MARGIN * score[0])).reshape(1, 1)


class Finish(nn.Module):
    """Normals (P, 3) and the albedo of every channel (P, C), by weighted least squares on the shading."""

    def __init__(self, function: ModelFunction) -> None:
        super().__init__()
        self.function = function

    def forward(
        self, seen: Tensor, level: Tensor, lights: Tensor, roughness: Tensor, vector: Tensor, weight: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Grey's normal; albedo in the unit of ``seen``."""
        normal = upward(vector)
        ci, co = (normal @ lights.T)[:, None], normal[:, None, 2:]
        albedo = (vector.norm(dim=1, keepdim=True) * level)[:, :, None].expand(-1, seen.shape[1], 1)
        for _ in range(3):
            held = albedo.clamp(1e-4, 1.0)
            value = above_horizon(self.function, ci, co, lights[:, 2], held, roughness[:, :, None])
            shown = torch.where(facing_both(ci, co), value / held * ci, 0.0)
            pull = weight[:, None] * shown
            albedo = (pull * seen).sum(2, keepdim=True) / (pull * shown).sum(2, keepdim=True).clamp_min(1e-9)
        return normal, albedo[:, :, 0].clamp_min(0.0)


def solve_closed_form(images: Tensor, lights: Tensor, mask: Tensor, model: str) -> tuple[Tensor, Tensor, Tensor]:
    """What the graph computes: ``images`` (K, C, H, W), ``lights`` (K, 3), ``mask`` (1, H, W) in, maps out."""
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
    """What is seen over what Lambert would show, (P, K)."""
    normal = upward(vector)
    albedo = (vector.norm(dim=1, keepdim=True) * level).clamp(1e-4, 1.0)
    ci, co = normal @ lights.T, normal[:, 2:]
    value = above_horizon(function, ci, co, lights[:, 2][None], albedo, roughness)
    return torch.where(facing_both(ci, co), value / albedo, 1.0).clamp(0.1, 10.0)


def _lambert(vector: Tensor, lights: Tensor) -> Tensor:
    """Lambert's shading, (P, K)."""
    return (vector @ lights.T).clamp_min(0.0)


def _least_squares(grey: Tensor, lights: Tensor, weight: Tensor, ratio: Tensor, near: Tensor) -> Tensor:
    """The vector b with ``grey = ratio (l.b)`` in the weighted mean, (P, 3), not far from ``near``.

    The pull to ``near`` is what keeps pixels that too few lights reach from being anything; where the lights
    suffice it dies out from one solution to the next.
    """
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    products = torch.stack([lights[:, i] * lights[:, j] for i, j in pairs], 1)
    pull = weight * ratio
    xx, xy, xz, yy, yz, zz = ((pull * ratio) @ products).split(1, dim=1)
    hold = NEAR * (xx + yy + zz) + 1e-9
    rows = ((xx + hold, xy, xz), (xy, yy + hold, yz), (xz, yz, zz + hold))
    x, y, z = ((pull * grey) @ lights + hold * near).split(1, dim=1)
    return torch.cat(solve_symmetric(rows, (x, y, z)), 1)


def _lit(grey: Tensor) -> Tensor:
    """1 where a light reaches a pixel, 0 in shadow, without a step between."""
    bright = _quantile(grey.sort(1)[0], torch.full_like(grey[:1, :1], 0.9)).clamp_min(1e-9)
    return ((grey / bright - 0.06) / 0.04).clamp(0.0, 1.0)


def middle_ranks(grey: Tensor) -> Tensor:
    """1 for the middle ranks, less the further outside and 0 in shadow; with few lights all of them are needed."""
    ordered = grey.sort(1)[0]
    count = torch.ones_like(grey[:1]).sum(1, keepdim=True)
    cut = 0.2 * ((count - 6) / 6).clamp(0.0, 1.0)
    low, high = _quantile(ordered, cut), _quantile(ordered, 1 - cut)
    outside = torch.maximum(low - grey, grey - high).clamp_min(0.0)
    return (1 - outside / (0.1 * (high - low)).clamp_min(1e-6)).clamp(0.0, 1.0) * _lit(grey)


def _quantile(ordered: Tensor, share: Tensor) -> Tensor:
    """Between the two nearest ranks, (P, 1); ``share`` is (1, 1)."""
    last = torch.ones_like(ordered[:1]).sum(1, keepdim=True) - 1
    place = share * last
    low = place.floor()
    high = torch.minimum(low + 1, last)
    count = ordered.shape[0]
    below, above = (ordered.gather(1, rank.long().expand(count, 1)) for rank in (low, high))
    return below + (place - low) * (above - below)
