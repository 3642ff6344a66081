"""Albedo and highlights of every channel of pixels whose normals are fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from .gauss_newton import LOBE_RIDGE
from .linear_systems import solve_symmetric
from .material import Material, respond
from .pixel_sample import PixelSample
from .robust_fit import PixelFit, predict, weights
from .robust_stats import Used, mean_brightness, median_rank, noise_level, select

LEAST_ALBEDO = 1e-12
"""Albedo of black pixels, over their mean observation, so that nothing is divided by 0."""
STEPS_UNDER = 5
"""Reweighted steps of a fit under given normals; set by hand."""
ALBEDO_STEPS = 4
"""Fixed-point steps that settle an albedo on which interreflection between facets depends; set by hand."""


def fit_channels(
    fitted: PixelFit, sample: PixelSample, channels: Tensor, material: Material, used: Used
) -> tuple[Tensor, Tensor]:
    """Albedo (P, C) and lobes' strengths (P, L, C) of every channel (P, K, C) under the fitted normals and weights."""
    mean = mean_brightness(sample.grey)
    weight = weights(fitted, sample.grey, predict(fitted, sample.directions, material), used)
    albedos, strengths = [], []
    for channel in (channels / mean[:, :, None]).unbind(2):
        albedo, lobes = (fitted.albedo / mean).clamp_min(LEAST_ALBEDO), fitted.lobes / mean
        for _ in range(1 if material.model == "lambert" else ALBEDO_STEPS):
            response = respond(material, fitted.normal, albedo, lobes, sample.directions, mean)
            shapes = response.columns[1:]
            diffuse = (response.value - _highlights(lobes, shapes)) / albedo
            if shapes:
                lobes = _lobe_strengths(diffuse, shapes, channel, weight)
            left = channel - _highlights(lobes, shapes)
            albedo = (weight * diffuse * left).sum(1, keepdim=True)
            albedo = (albedo / (weight * diffuse * diffuse).sum(1, keepdim=True).clamp_min(LEAST_ALBEDO)).clamp_min(
                LEAST_ALBEDO
            )
        albedos.append(albedo * mean)
        strengths.append(lobes * mean)
    return torch.cat(albedos, 1), torch.stack(strengths, 2)


def fit_under(normal: Tensor, sample: PixelSample, material: Material, used: Used) -> PixelFit:
    """The fit of albedo and highlights under given normals (P, 3); its spread is infinite."""
    grey, mean = sample.grey, mean_brightness(sample.grey)
    selected = select(grey, used)
    rank, infinite = median_rank(selected), torch.full_like(mean, torch.inf)
    fitted = PixelFit(normal, mean, grey.new_zeros(len(grey), len(material.exponents)), infinite, mean, infinite)
    for _ in range(STEPS_UNDER):
        albedo, lobes = fit_channels(fitted, sample, grey[:, :, None], material, used)
        fitted = replace(fitted, albedo=albedo, lobes=lobes[:, :, 0])
        missed = grey - predict(fitted, sample.directions, material)
        noise = noise_level(missed / mean, selected, rank)
        fitted = replace(fitted, noise=noise, residual=missed.abs().mean(1, keepdim=True))
    return fitted


def _lobe_strengths(diffuse: Tensor, shapes: Sequence[Tensor], channel: Tensor, weight: Tensor) -> Tensor:
    """Strengths (P, L) of lobes beside a diffuse part, by weighted least squares."""
    columns = torch.stack((diffuse, *shapes), 1)
    products = torch.bmm(columns * weight[:, None], torch.cat((columns, channel[:, None]), 1).mT)
    rows = [list(row.unbind(0)) for row in products.permute(1, 2, 0)]
    for axis in range(1, len(rows)):
        rows[axis][axis] = rows[axis][axis] + LOBE_RIDGE
    parts = solve_symmetric([row[:-1] for row in rows], [row[-1] for row in rows])
    return torch.stack(parts[1:], 1).clamp_min(0)


def _highlights(lobes: Tensor, shapes: Sequence[Tensor]) -> Tensor | float:
    """What lobes (P, L) add to the observations."""
    return sum(strength[:, None] * shape for strength, shape in zip(lobes.unbind(1), shapes, strict=True))
