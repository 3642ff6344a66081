"""Light that the parts of a surface which a camera sees send to each other."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from .normal_map import NormalMap

PATCHES = 400
"""Of the surface, between which light goes to and fro."""
BOUNCES = 4
STEEPEST = 0.1
"""Least cosine to the view with which a pixel's surface is reckoned."""


class SeenSurface(NamedTuple):
    """What the P pixels of one view see, in the camera frame.

    Attributes:
        points: (P, 3).
        normal: (P, 3), unit.
        view: (P, 3), unit, to the camera.
        area: (P, 1) of the surface in a pixel.
    """

    points: Tensor
    normal: Tensor
    view: Tensor
    area: Tensor

    @staticmethod
    def of(seen: NormalMap) -> SeenSurface:
        """The pixels of one view that see something, row by row."""
        inside, camera = seen.mask[0, 0], seen.camera
        height, width = inside.shape
        normal = seen.normal[0][:, inside].T
        points = camera.points(seen.depth.where(seen.mask, 1.0))[0][:, inside].T
        view = camera.view_directions((height, width))[0].expand(3, height, width)[:, inside].T
        pixel = 2 / (height * camera.focal[0, 1]) * (points[:, 2:] if camera.is_perspective else 1)
        area = pixel**2 / (normal * view).sum(1, keepdim=True).clamp_min(STEEPEST)
        return SeenSurface(points, normal, view, area)


def light_between(surface: SeenSurface, albedo: Tensor, irradiance: Tensor, generator: torch.Generator) -> Tensor:
    """Irradiance (P, C, K) that pixels of albedo (P, C) receive from each other, where (P, K) comes from the lights."""
    order = torch.randperm(len(albedo), generator=generator, device=albedo.device)
    parts = surface.points, surface.normal, surface.area, albedo, irradiance
    return bounced_light(*(part[order] for part in parts))[order.argsort()]


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
