"""Fit the map from slope-angle roughness (sigma) to the roughness r of the EON model.

    python -m scripts.fit.fit_eon

The roughness r of EON is not an angle. The map r = x / (a + b x), x = sigma**2, is fitted by least squares so that the
shading of `eon` is nearest to the V-cavity theory with all bounces, over roughness 5 to 90 degrees and cosine-weighted
directions (1000, seed 1). The error is printed on other directions (2000, seed 2). Takes half a minute.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from scipy.optimize import least_squares
from torch import Tensor

from scripts.fit.theory_reference import Directions, cosine_weighted, theory
from torch_orennayar.reflectance import formulas as reflectance

ALBEDO = torch.tensor([0.2, 0.5, 0.9], dtype=torch.float64)
"""Albedos of the fit."""
ROUGHNESS = torch.arange(5, 91, 5, dtype=torch.float64)
"""Roughness of the fit in degrees."""


def error(parameters: npt.NDArray[np.float64], pairs: Directions, truth: Tensor) -> Tensor:
    """Difference from the theory in shading over albedo, (S, N, K)."""
    x = ROUGHNESS.deg2rad()[:, None, None] ** 2
    a, b = parameters.tolist()
    r = x / (a + b * x)
    ci, co, lv = (c[:, None] for c in (pairs.ci, pairs.co, pairs.lv))
    return (reflectance.eon_from_r(ci, co, lv, ALBEDO, r) / ALBEDO - truth) * ci


def main() -> None:
    """Fit on one sample of directions, report on another."""
    train, test = cosine_weighted(1000, 1), cosine_weighted(2000, 2)
    truths = [theory(pairs, ROUGHNESS.deg2rad(), ALBEDO, "theory").sum(-1) for pairs in (train, test)]

    def residuals(parameters: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        return np.asarray(error(parameters, train, truths[0]).flatten())

    fit = least_squares(residuals, x0=[0.3, 1.1])
    print(f"r = x / ({fit.x[0]:.4f} + {fit.x[1]:.4f} x)")
    for degrees, value in zip(ROUGHNESS, error(fit.x, test, truths[1]).square().mean((1, 2)).sqrt(), strict=True):
        print(f"sigma {degrees:2.0f} deg: RMS against the theory {value:.4f}")


if __name__ == "__main__":
    main()
