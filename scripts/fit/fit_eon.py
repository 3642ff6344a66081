"""Fit the map from slope-angle roughness (sigma) to the roughness r of the EON model.

    python -m scripts.fit.fit_eon

EON's r is no angle. The map r = x / (a + b x), x = sigma**2, is chosen so that `eon` comes nearest in shading to the
V-cavity theory with all bounces, over roughness 5 to 90 degrees and cosine-weighted directions (1000, seed 1); reported
on others (2000, seed 2). Half a minute.
"""

from __future__ import annotations

import torch
from scipy.optimize import least_squares
from torch import Tensor

from scripts.fit.theory_reference import Directions, cosine_weighted, theory
from torch_orennayar.reflectance import formulas as reflectance

ALBEDO = torch.tensor([0.2, 0.5, 0.9], dtype=torch.float64)
ROUGHNESS = torch.arange(5, 91, 5, dtype=torch.float64)


def error(parameters: list[float], pairs: Directions, truth: Tensor) -> Tensor:
    """Difference in shading over albedo, (S, N, K)."""
    x = ROUGHNESS.deg2rad()[:, None, None] ** 2
    r = x / (parameters[0] + parameters[1] * x)
    ci, co, lv = (c[:, None] for c in (pairs.ci, pairs.co, pairs.lv))
    return (reflectance.eon_from_r(ci, co, lv, ALBEDO, r) / ALBEDO - truth) * ci


def main() -> None:
    """Fit on one sample of directions, report on another."""
    train, test = cosine_weighted(1000, 1), cosine_weighted(2000, 2)
    truths = [theory(pairs, ROUGHNESS.deg2rad(), ALBEDO, "theory").sum(-1) for pairs in (train, test)]
    fit = least_squares(lambda p: error(p, train, truths[0]).flatten().numpy(), x0=[0.3, 1.1])
    print(f"r = x / ({fit.x[0]:.4f} + {fit.x[1]:.4f} x)")
    for degrees, value in zip(ROUGHNESS, error(fit.x, test, truths[1]).square().mean((1, 2)).sqrt(), strict=True):
        print(f"sigma {degrees:2.0f} deg: RMS against the theory {value:.4f}")


if __name__ == "__main__":
    main()
