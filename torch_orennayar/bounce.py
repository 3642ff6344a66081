"""Light that the parts of a surface which a camera sees send to each other."""

from __future__ import annotations

import math

import torch
from torch import Tensor

PATCHES = 400
"""Of the surface, between which light goes to and fro."""
BOUNCES = 4


def bounced_light(points: Tensor, normal: Tensor, area: Tensor, albedo: Tensor, irradiance: Tensor) -> Tensor:
    """Irradiance that arrives from the rest of a Lambertian surface; what stands between two points is not asked.

    Args:
        points: (P, 3), in random order: the first `PATCHES` stand for all.
        normal: (P, 3), unit.
        area: (P, 1) of the surface at each point, in the unit of the points, squared.
        albedo: (P, C) in [0, 1].
        irradiance: (P, K) from each light.

    Returns:
        (P, C, K).
    """
    some = slice(0, PATCHES)
    share = area[some] * len(points) / min(PATCHES, len(points))
    factors = form_factors(points, normal, points[some], normal[some], share)
    own = albedo[some, :, None] * irradiance[some, None]
    sent = own
    for _ in range(BOUNCES - 1):
        sent = own + albedo[some, :, None] * arriving(factors[some], sent)
    return arriving(factors, sent)


def arriving(factors: Tensor, sent: Tensor) -> Tensor:
    """(P, Q) times (Q, C, K)."""
    return (factors @ sent.flatten(1)).reshape(-1, *sent.shape[1:])


def form_factors(points: Tensor, normal: Tensor, others: Tensor, facing: Tensor, area: Tensor) -> Tensor:
    """Share (P, Q) of what each patch sends that arrives, as from discs: finite at any distance."""
    square = torch.cdist(points, others, compute_mode="donot_use_mm_for_euclid_dist").square()
    here = normal @ others.T - (normal * points).sum(1, keepdim=True)
    there = points @ facing.T - (facing * others).sum(1)
    cosines = here.clamp_min(0) * there.clamp_min(0) / torch.maximum(square, 1e-4 * area.T)
    share: Tensor = cosines * area.T / (math.pi * square + area.T)
    return share
