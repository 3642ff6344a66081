"""How well each model fits measured materials, alone and with a highlight, and which is the simplest that suffices.

Every material (pairs of directions with f_r in 1/sr, RGB) is fitted by every model with one roughness, an albedo per
channel and, for the second figure, one GGX lobe of one width with a strength per channel; in shading ``pi f_r cos``.
The error is the RMS difference over the RMS of the material. With the lobe, a model is sufficient for a material if its
error is at most 5 % above the best model's; the cheapest such one is the simplest.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from scripts.fit.theory_reference import from_angles
from torch_orennayar import MODELS, microfacet
from torch_orennayar.core.progress import track

ROUGHNESS = torch.arange(0, 61, 2.5, dtype=torch.float64).deg2rad()
"""Radians that are tried."""
WIDTH = (0.05, 0.1, 0.2, 0.35, 0.6, 1.0)
"""Widths of the GGX lobe that are tried."""
SUFFICIENT = 1.05
"""A model suffices for a material if its error is at most this many times the best model's."""


@dataclass(frozen=True)
class MaterialFit:
    """How one model fits the measured materials.

    Attributes:
        median: of the relative RMS errors without a lobe.
        median_with_lobe: the same with a lobe.
        simplest_for: materials for which this is the simplest sufficient model.
        materials: by name, error without and with the lobe, and roughness in degrees.
    """

    median: float
    median_with_lobe: float
    simplest_for: tuple[str, ...]
    materials: dict[str, list[float]]


def remaining_error(target: Tensor, diffuse: Tensor, lobe: Tensor) -> Tensor:
    """Relative RMS (M,) of the best non-negative mix of diffuse (M, N) and lobe (N,) for target (M, N, C)."""
    a, b, c = diffuse.square().sum(1, keepdim=True), (diffuse * lobe).sum(1, keepdim=True), lobe.square().sum()
    d, e = (target * diffuse[..., None]).sum(1), (target * lobe[:, None]).sum(1)
    span = (a * c - b * b).clamp_min(1e-12)
    x, y = (d * c - e * b) / span, (e * a - d * b) / span
    x, y = torch.where(y < 0, d / a, x), y.clamp_min(0)
    x, y = x.clamp_min(0), torch.where(x < 0, e / c.clamp_min(1e-12), y)
    whole = target.square().sum(1)
    left = whole - 2 * (x * d + y * e) + x * x * a + 2 * x * y * b + y * y * c
    return (left.clamp_min(0).sum(1) / whole.sum(1)).sqrt()


def fit_materials(file: Path) -> dict[str, MaterialFit]:
    """The fits of every model to the materials of a file."""
    table = np.load(file)
    pairs = from_angles(*(torch.from_numpy(table[k]).double() for k in ("theta_i", "theta_o", "phi")))
    target = torch.from_numpy(table["f"]).double() * torch.pi * pairs.ci[:, None]  # (M, N, C)
    # Light between facets depends on the albedo, which is taken as the hemispherical mean of each material.
    albedo = (target.mean((1, 2)) / pairs.ci.mean()).clamp(1e-6, 1)[:, None]
    lobes = [microfacet(pairs.ci, pairs.co, pairs.lv, width) * pairs.ci for width in WIDTH]
    alone: dict[str, Tensor] = {}
    shiny: dict[str, Tensor] = {}
    rough: dict[str, Tensor] = {}
    for name in track([n for n in MODELS if n != "theory"], "materials"):
        flat, mixed = [], []
        for sigma in ROUGHNESS:
            diffuse = (MODELS[name].function(pairs.ci, pairs.co, pairs.lv, albedo, sigma) * pairs.ci).expand(
                len(target), -1
            )
            share = (target * diffuse[..., None]).sum(1).square() / diffuse.square().sum(1, keepdim=True)
            flat.append((1 - share.sum(1) / target.square().sum((1, 2))).clamp_min(0).sqrt())
            mixed.append(torch.stack([remaining_error(target, diffuse, lobe) for lobe in lobes]).amin(0))
        alone[name] = torch.stack(flat).amin(0)
        least = torch.stack(mixed).min(0)
        shiny[name], rough[name] = least.values, ROUGHNESS[least.indices].rad2deg()
    every = torch.stack(list(shiny.values()))
    cheap = sorted(range(len(every)), key=lambda i: MODELS[list(shiny)[i]].cost or float("inf"))
    simplest = (every <= SUFFICIENT * every.amin(0))[cheap].float().argmax(0)
    names = [str(m) for m in table["name"]]
    return {
        name: MaterialFit(
            median=alone[name].median().item(),
            median_with_lobe=shiny[name].median().item(),
            simplest_for=tuple(m for m, k in zip(names, simplest.tolist(), strict=True) if cheap[k] == i),
            materials={
                m: [round(v, 4) for v in row]
                for m, *row in zip(names, alone[name].tolist(), shiny[name].tolist(), rough[name].tolist(), strict=True)
            },
        )
        for i, name in enumerate(shiny)
    }
