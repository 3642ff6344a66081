"""Measure every model against the theory over roughness, albedo and angle: the table behind `simplest_model`.

    python -m scripts.fit.tabulate_errors

Writes torch_orennayar/reflectance/model_errors.json: RMS of the shading over albedo, ``pi f_r cos / rho``, against the
V-cavity theory with all bounces, for light and view cosine-weighted up to the given angle from the normal (2000 pairs,
seed 7). The error of `theory` itself is that of its quadrature, measured against one with three times the nodes. Takes
half a minute.
"""

from __future__ import annotations

import json
from pathlib import Path

import torch
from torch import Tensor

from scripts.fit.theory_reference import cosine_weighted, theory
from torch_orennayar import MODELS
from torch_orennayar.reflectance import theory as quadrature

TARGET = Path(quadrature.__file__).with_name("model_errors.json")
"""The table that the package reads."""
ROUGHNESS = (0, 5, 10, 15, 20, 25, 30, 40, 50, 60, 75, 90)
"""Degrees at which the table has rows."""
ALBEDO = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Albedos of the table."""
ANGLE = (15, 30, 45, 60, 75, 90)
"""Largest angles of light and view from the normal, degrees."""
PAIRS = 2000
"""Random pairs of light and view for each largest angle."""


def quadrature_error(sigma: Tensor) -> float:
    """RMS difference of `theory` from itself with three times the nodes, over all roughnesses, white."""
    pairs = cosine_weighted(200, 8)
    white = torch.ones(1)
    values = []
    nodes = quadrature.SLOPES, quadrature.AZIMUTHS
    for factor in (1, 3):
        quadrature.SLOPES, quadrature.AZIMUTHS = (factor * n for n in nodes)
        values.append(theory(pairs, sigma, white, f"quadrature, {factor} x").sum(-1)[..., 0] * pairs.ci)
    quadrature.SLOPES, quadrature.AZIMUTHS = nodes
    return (values[1] - values[0]).square().mean().sqrt().item()


def main() -> None:
    """Measure, write and print."""
    sigma = torch.tensor(ROUGHNESS, dtype=torch.float64).deg2rad()
    rho = torch.tensor(ALBEDO, dtype=torch.float64)
    own = quadrature_error(sigma[1:])
    errors: dict[str, Tensor] = {name: torch.zeros(len(sigma), len(rho), len(ANGLE)) for name in MODELS}
    errors["theory"][1:] = own
    for a, degrees in enumerate(ANGLE):
        pairs = cosine_weighted(PAIRS, 7, torch.tensor(degrees).deg2rad().item())
        truth = theory(pairs, sigma[1:], rho, f"angles up to {degrees} degrees").sum(-1)  # (S, N, K)
        for name in set(MODELS) - {"theory"}:
            # An albedo of 0 has no shading: its error is the limit, that of the first bounce.
            albedo = rho.clamp_min(1e-6)
            value = MODELS[name].function(
                pairs.ci[:, None], pairs.co[:, None], pairs.lv[:, None], albedo, sigma[1:, None, None]
            )
            difference = (value / albedo - truth) * pairs.ci[:, None]
            errors[name][1:, :, a] = difference.square().mean(1).sqrt().float()
    table = {
        "measured": "RMS of pi f_r cos / rho against the theory, by roughness, albedo, largest angle from the normal",
        "roughness_degrees": ROUGHNESS,
        "albedo": ALBEDO,
        "angle_degrees": ANGLE,
        "rms": {
            name: [[[float(f"{v:.2g}") for v in row] for row in s] for s in e.tolist()] for name, e in errors.items()
        },
    }
    TARGET.write_text(json.dumps(table, separators=(",", ":")) + "\n", encoding="utf-8")
    print(f"{'model':18}  RMS at 90 degrees, albedo 0.5, by roughness in degrees")
    print(f"{'':18}" + "".join(f"{s:>8}" for s in ROUGHNESS))
    for name, e in errors.items():
        print(f"{name:18}" + "".join(f"{v:8.4f}" for v in e[:, 2, -1].tolist()))


if __name__ == "__main__":
    main()
