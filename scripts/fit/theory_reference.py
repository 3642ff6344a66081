"""Random directions and the V-cavity theory at them; shared by the scripts that fit and measure models."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_orennayar.core.progress import track
from torch_orennayar.reflectance.theory import reflectance_by_bounces


@dataclass(frozen=True)
class Directions:
    """Pairs of light and view as cosines (N,), float64.

    Attributes:
        ci: between normal and light.
        co: between normal and view.
        lv: between light and view.
    """

    ci: Tensor
    co: Tensor
    lv: Tensor

    def __len__(self) -> int:
        return len(self.ci)


def from_angles(theta_i: Tensor, theta_o: Tensor, phi: Tensor) -> Directions:
    """Pairs from zenith angles and the azimuth between them."""
    ci, co = theta_i.cos(), theta_o.cos()
    return Directions(ci, co, ci * co + theta_i.sin() * theta_o.sin() * phi.cos())


def cosine_weighted(count: int, seed: int, largest: float = math.pi / 2) -> Directions:
    """Light and view, each cosine-weighted up to ``largest`` from the normal, as over the pixels of a convex object."""
    draw = torch.Generator().manual_seed(seed)
    theta_i, theta_o = (
        (torch.rand(2, count, generator=draw, dtype=torch.float64).sqrt() * math.sin(largest))
        .clamp_max(1 - 1e-6)
        .asin()
    )
    return from_angles(theta_i, theta_o, math.pi * torch.rand(count, generator=draw, dtype=torch.float64))


def grazing(count: int, seed: int) -> Directions:
    """Retro-reflection at grazing angles: both directions 45 to 89 degrees from the normal, near each other."""
    draw = torch.Generator().manual_seed(seed)
    theta_i = math.radians(45) + math.radians(44) * torch.rand(count, generator=draw, dtype=torch.float64)
    theta_o = theta_i + 0.1 * torch.randn(count, generator=draw, dtype=torch.float64)
    phi = (0.3 * torch.randn(count, generator=draw, dtype=torch.float64)).abs()
    return from_angles(theta_i, theta_o.clamp(0, math.radians(89.5)), phi)


def horizon(count: int, seed: int) -> Directions:
    """Both directions 0.005 to 2 degrees above the horizon, at any azimuth."""
    draw = torch.Generator().manual_seed(seed)
    height = 10 ** (-4 + 2.5 * torch.rand(2, count, generator=draw, dtype=torch.float64))
    theta_i, theta_o = math.pi / 2 - height
    return from_angles(theta_i, theta_o, math.pi * torch.rand(count, generator=draw, dtype=torch.float64))


def join(*parts: Directions) -> Directions:
    """All pairs in one set."""
    return Directions(*(torch.cat([getattr(p, name) for p in parts]) for name in ("ci", "co", "lv")))


def theory(directions: Directions, sigma: Tensor, rho: Tensor, what: str) -> Tensor:
    """``pi f_r / rho`` of the V-cavity theory by bounces, (S, N, K, 3), for S roughnesses, N directions, K albedos."""
    rows = [
        reflectance_by_bounces(
            directions.ci,
            directions.co,
            directions.lv,
            s.expand(len(directions)),
            rho.double().expand(len(directions), -1),
        )
        for s in track(sigma.double(), what)
    ]
    return torch.stack(rows)
