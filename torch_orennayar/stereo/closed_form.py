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

from ..reflectance.models import get_model
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
REFITS = 3
"""Fixed-point steps of the albedo, because light between facets depends on it. Set by hand."""
ALBEDOS = (1e-4, 1.0)
"""Albedo with which a model is evaluated: away from 0, by which its value is divided, up to a white facet."""
SYSTEMATIC = 0.3
"""Share of a pixel's residual variance that its lights have in common, because the model, not the sensor, errs: it does
not average out. Set by hand, between made noise (0) and photographs (about 1)."""
UNDETERMINED = 1e-5
"""Share of all lights' weight that a direction has at least in the standard error, so that what no light determines
gets a large one. Set by hand."""
PRIOR = 0.05
"""Weight of the previous solution, as a share of the weight of all lights. Set by hand."""


class Clean(nn.Module):
    """What an app may feed without knowing: samples that are not finite count as dark, lights get unit length."""

    def forward(self, seen: Tensor, lights: Tensor) -> tuple[Tensor, Tensor]:
        """Of pixels (P, C, K) and lights (K, 3), the same."""
        length = lights.square().sum(1, keepdim=True).sqrt().clamp_min(1e-12)
        return torch.where(seen.isfinite(), seen, 0.0), lights / length


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


class Angles(nn.Module):
    """What a reflectance model needs to know, in four axes: pixels, channels, 1, lights."""

    def forward(self, vector: Tensor, level: Tensor, lights: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Normals (P, 3); cosines normal-light (P, 1, 1, K), normal-view and light-view; albedo (P, 1, 1, 1)."""
        normal = camera_facing(vector)
        ci, co = normal @ lights.T, normal[:, 2:]
        albedo = (vector.norm(dim=1, keepdim=True) * level).clamp(*ALBEDOS)
        cosines = ci[:, None, None], co[:, :, None, None], lights[None, None, None, :, 2]
        return normal, *cosines, albedo[:, :, None, None]


class Update(nn.Module):
    """One update of reflectance and noise, then two reweighted solutions."""

    def forward(
        self,
        grey: Tensor,
        lights: Tensor,
        middle: Tensor,
        vector: Tensor,
        ci: Tensor,
        co: Tensor,
        albedo: Tensor,
        value: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """The new vector (P, 3) and the weights (P, K) that gave it; ``value`` is the model's, (P, 1, 1, K)."""
        ratio = _ratio(ci, co, albedo, value)
        missed = (grey - ratio * _lambert(vector, lights)).abs().sort(1)[0]
        noise = (MAD_TO_SIGMA * quantile(missed, torch.full_like(grey[:1, :1], 0.5))).clamp_min(NOISE_FLOOR)
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

    def forward(
        self, grey: Tensor, lights: Tensor, vector: Tensor, ci: Tensor, co: Tensor, albedo: Tensor, value: Tensor
    ) -> Tensor:
        """Of what `Sample` made and its solutions: the lowest point of a parabola around the best candidate, (1, 1)."""
        shown = _ratio(ci, co, albedo, value) * _lambert(vector, lights)
        lit, count = soft_in_light(grey), len(CANDIDATES)
        error = (lit * (grey - shown).abs().clamp_max(ERROR_CAP)).sum(1) / lit.sum(1).clamp_min(1.0)
        score = error.reshape(count, SAMPLES).mean(1)
        best = score.argmin(0).clamp(1, count - 2)
        below, here, above = (score[(best + k).reshape(1)] for k in (-1, 0, 1))
        curvature = (below - 2 * here + above).clamp_min(1e-9)
        found = (best + (0.5 * (below - above) / curvature).clamp(-1.0, 1.0)) * CANDIDATES[1]
        return (found * (score.amin(0) < MARGIN * score[0])).reshape(1, 1)


class Refit(nn.Module):
    """The albedo of every channel by weighted least squares on the shading that the last albedo gave."""

    def forward(
        self, seen: Tensor, weight: Tensor, ci: Tensor, co: Tensor, albedo: Tensor, value: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Albedo (P, C) in the unit of ``seen`` (P, C, K), and the one to evaluate the model with, (P, C, 1, 1)."""
        shown = torch.where(facing_both(ci, co), value / albedo * ci, 0.0)[:, :, 0]
        weighted = weight[:, None] * shown
        found = (weighted * seen).sum(2) / (weighted * shown).sum(2).clamp_min(1e-9)
        return found.clamp_min(0.0), found[:, :, None, None].clamp(*ALBEDOS)


class Expect(nn.Module):
    """The standard error of the normal, from the residuals and from how well the lights determine it."""

    def forward(
        self,
        grey: Tensor,
        lights: Tensor,
        vector: Tensor,
        weight: Tensor,
        ci: Tensor,
        co: Tensor,
        albedo: Tensor,
        value: Tensor,
    ) -> Tensor:
        """Radians, (P, 1): the covariance of weighted least squares across the normal; a right angle at most."""
        ratio = _ratio(ci, co, albedo, value)
        missed = grey - ratio * _lambert(vector, lights)
        free = (weight.sum(1, keepdim=True) - lights.shape[1]).clamp_min(1.0)
        noise = (weight * missed.square()).sum(1, keepdim=True) / free * (1 + SYSTEMATIC * free)
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = _normal_matrix(lights, weight * ratio * ratio)
        least = UNDETERMINED * (xx + yy + zz)
        rows = ((xx + least, xy, xz), (xy, yy + least, yz), (xz, yz, zz + least))
        one, zero = torch.ones_like(noise), torch.zeros_like(noise)
        units = ((one, zero, zero), (zero, one, zero), (zero, zero, one))
        inverse = torch.stack([torch.cat(solve_symmetric(rows, unit), 1) for unit in units], 1)  # (P, 3, 3)
        length = vector.norm(dim=1, keepdim=True).clamp_min(1e-9)
        along = vector / length
        trace = inverse[:, 0, :1] + inverse[:, 1, 1:2] + inverse[:, 2, 2:]
        across = trace - (along[:, :, None] * inverse * along[:, None]).sum((1, 2))[:, None]
        variance: Tensor = noise.clamp_min(NOISE_FLOOR**2) * across.clamp_min(0.0)
        return variance.sqrt().div(length).clamp_max(math.pi / 2)


def solve_closed_form(
    images: Tensor, lights: Tensor, mask: Tensor, model: str
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """What the graph computes, in torch.

    Args:
        images: (K, C, H, W).
        lights: (K, 3) unit, camera frame.
        mask: (1, H, W) bool.
        model: a name in ``MODELS``.

    Returns:
        Normals (3, H, W), albedo (C, H, W), roughness (1, H, W), radians, and the standard error of the normal
        (1, H, W), radians; 0 outside the mask.
    """
    inside, function = mask[0], get_model(model).function

    def evaluate(angles: tuple[Tensor, Tensor, Tensor, Tensor], roughness: Tensor) -> Tensor:
        return above_horizon(function, *angles, roughness[:, :, None, None])

    def solve(grey: Tensor, level: Tensor, roughness: Tensor) -> tuple[Tensor, Tensor]:
        middle, vector = Begin()(grey, lights)
        weight = middle
        for _ in range(TURNS):
            _, ci, co, lv, albedo = Angles()(vector, level, lights)
            value = evaluate((ci, co, lv, albedo), roughness)
            vector, weight = Update()(grey, lights, middle, vector, ci, co, albedo, value)
        return vector, weight

    seen, lights = Clean()(images[:, :, inside].permute(2, 1, 0), lights)
    grey, level = Prepare()(seen)
    roughness = torch.zeros_like(level)
    if model != "lambert":
        few, few_level, tried = Sample()(grey, level)
        vector, _ = solve(few, few_level, tried)
        _, ci, co, lv, albedo = Angles()(vector, few_level, lights)
        value = evaluate((ci, co, lv, albedo), tried)
        roughness = roughness + Choose()(few, lights, vector, ci, co, albedo, value)
    vector, weight = solve(grey, level, roughness)
    normal, ci, co, lv, albedo = Angles()(vector, level, lights)
    paint, value = level, evaluate((ci, co, lv, albedo), roughness)
    error = Expect()(grey, lights, vector, weight, ci, co, albedo, value)
    for step in range(REFITS):
        if step:
            value = evaluate((ci, co, lv, albedo), roughness)
        paint, albedo = Refit()(seen, weight, ci, co, albedo, value)
    maps = [Grid(inside).draw(values) for values in (normal, paint, roughness, error)]
    return maps[0], maps[1], maps[2], maps[3]


def _ratio(ci: Tensor, co: Tensor, albedo: Tensor, value: Tensor) -> Tensor:
    """Shading of the model over Lambert's, (P, K), from what `Angles` returns and the model's value."""
    return torch.where(facing_both(ci, co), value / albedo, 1.0).clamp(0.1, 10.0)[:, 0, 0]


def _lambert(vector: Tensor, lights: Tensor) -> Tensor:
    """Lambert's shading, (P, K)."""
    return (vector @ lights.T).clamp_min(0.0)


def _least_squares(grey: Tensor, lights: Tensor, weight: Tensor, ratio: Tensor, previous: Tensor) -> Tensor:
    """The vector b with ``grey = ratio (l.b)`` in the weighted mean, (P, 3), with ``previous`` as a prior.

    The prior determines pixels that too few lights reach; where the lights suffice its influence dies out from one
    solution to the next.
    """
    weighted = weight * ratio
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = _normal_matrix(lights, weighted * ratio)
    prior = PRIOR * (xx + yy + zz)
    rows = ((xx + prior, xy, xz), (xy, yy + prior, yz), (xz, yz, zz + prior))
    x, y, z = ((weighted * grey) @ lights + prior * previous).split(1, dim=1)
    return torch.cat(solve_symmetric(rows, (x, y, z)), 1)


def _normal_matrix(lights: Tensor, weight: Tensor) -> tuple[tuple[Tensor, Tensor, Tensor], ...]:
    """Rows of the 3 x 3 matrices of the normal equations, (P, 1) each."""
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    products = torch.stack([lights[:, i] * lights[:, j] for i, j in pairs], 1)
    xx, xy, xz, yy, yz, zz = (weight @ products).split(1, dim=1)
    xx, yy, zz = xx + 1e-9, yy + 1e-9, zz + 1e-9
    return (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)
