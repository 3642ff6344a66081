"""How well each model fits measured materials, and which is the simplest that suffices for each.

Every material (pairs of directions with f_r in 1/sr, RGB) is fitted by every model with one roughness and an albedo
per channel, in shading ``pi f_r cos``; the error is the RMS difference over the RMS of the material. A model is
sufficient for a material if its error is at most 5 % above the best model's; the cheapest such one is the simplest.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from truth import from_angles

from torch_orennayar import MODELS
from torch_orennayar.progress import track

ROUGHNESS = torch.arange(0, 61, 2.5, dtype=torch.float64).deg2rad()
SUFFICIENT = 1.05


def fit_materials(file: Path) -> dict[str, dict[str, object]]:
    """Per model: median error, error per material with its roughness, number of materials it is simplest for."""
    table = np.load(file)
    pairs = from_angles(*(torch.from_numpy(table[k]).double() for k in ("theta_i", "theta_o", "phi")))
    target = torch.from_numpy(table["f"]).double() * torch.pi * pairs.ci[:, None]  # (M, N, C)
    names = [str(n) for n in table["name"]]
    # Light between facets depends on the albedo: the hemispherical mean of the material, one number each.
    errors: dict[str, Tensor] = {}
    best_sigma: dict[str, Tensor] = {}
    albedo = (target.mean((1, 2)) / pairs.ci.mean()).clamp(0, 1)
    for name in track([n for n in MODELS if n != "theory"], "materials"):
        candidates = []
        for sigma in ROUGHNESS:
            value = MODELS[name].function(
                pairs.ci, pairs.co, pairs.lv, albedo[:, None].clamp_min(1e-6), sigma
            )  # (M, N)
            shape = (value * pairs.ci)[..., None]
            scale = (target * shape).sum(1, keepdim=True) / shape.square().sum(1, keepdim=True)
            left = target - scale * shape
            candidates.append((left.square().sum((1, 2)) / target.square().sum((1, 2))).sqrt())
        least = torch.stack(candidates).min(0)
        errors[name], best_sigma[name] = least.values, ROUGHNESS[least.indices].rad2deg()
    every = torch.stack(list(errors.values()))
    enough = every <= SUFFICIENT * every.min(0).values
    cheapest = sorted(range(len(errors)), key=lambda i: MODELS[list(errors)[i]].cost or float("inf"))
    rank = torch.stack([enough[i] for i in cheapest]).float().argmax(0)
    return {
        name: {
            "median": errors[name].median().item(),
            "simplest for": int((rank == cheapest.index(i)).sum()),
            "materials": {
                m: [round(float(e), 4), float(s)] for m, e, s in zip(names, errors[name], best_sigma[name], strict=True)
            },
        }
        for i, name in enumerate(errors)
    }
