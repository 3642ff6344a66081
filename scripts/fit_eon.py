"""Fit the map from slope-angle roughness (sigma) to the roughness r of the EON model.

    python scripts/fit_eon.py

EON's r is no angle. The map r = x / (a + b x), x = sigma**2, is chosen so that `eon` comes nearest
to `vcavity` (the fit to the theory with all bounces) in shading, over directions of its own drawing.
"""

from __future__ import annotations

import math

import torch
from scipy.optimize import least_squares

from torch_orennayar import reflectance

ALBEDOS = (0.2, 0.5, 0.9)
SIGMAS_DEGREES = range(5, 91, 5)


def random_directions(count: int, generator: torch.Generator) -> torch.Tensor:
    """Cosine-weighted directions above the surface, (count, 3)."""
    cosine = torch.rand(count, generator=generator).sqrt()
    phi = 2 * torch.pi * torch.rand(count, generator=generator)
    sine = (1 - cosine**2).sqrt()
    return torch.stack((sine * phi.cos(), sine * phi.sin(), cosine), -1)


def main() -> None:
    """Fit on one sample of directions, report on another."""
    torch.set_default_dtype(torch.float64)
    generator = torch.Generator().manual_seed(0)
    rho = torch.tensor(ALBEDOS)[:, None, None]
    sigma = torch.tensor([math.radians(s) for s in SIGMAS_DEGREES])[:, None]

    def error(parameters: list[float], light: torch.Tensor, view: torch.Tensor) -> torch.Tensor:
        ci, co, lv = light[:, 2], view[:, 2], (light * view).sum(-1)
        r = sigma**2 / (parameters[0] + parameters[1] * sigma**2)
        difference = reflectance.eon_from_r(ci, co, lv, rho, r) - reflectance.vcavity(ci, co, lv, rho, sigma)
        return difference * ci / rho

    train = random_directions(2000, generator), random_directions(2000, generator)
    test = random_directions(20000, generator), random_directions(20000, generator)
    fit = least_squares(lambda p: error(p, *train).flatten().numpy(), x0=[0.3, 1.1])
    rms = error(fit.x, *test).square().mean((0, 2)).sqrt()
    print(f"r = x / ({fit.x[0]:.4f} + {fit.x[1]:.4f} x)")
    for degrees, value in zip(SIGMAS_DEGREES, rms, strict=True):
        print(f"sigma {degrees:2d} deg: RMS against vcavity {value:.4f}")


if __name__ == "__main__":
    main()
