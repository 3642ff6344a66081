"""Interreflected light between the visible parts of a surface, by the radiosity method."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from .normal_map import NormalMap

PATCHES = 400
"""Number of sample points that stand for the surface; set by hand, a compromise of noise and time."""
BOUNCES = 4
"""Number of bounces that are summed; set by hand."""
STEEPEST = 0.1
"""Smallest cosine between normal and view used for the surface area of a pixel; set by hand."""


class SeenSurface(NamedTuple):
    """The surface at the P foreground pixels of one view, in the camera frame.

    Attributes:
        points: (P, 3).
        normal: (P, 3), unit.
        view: (P, 3), unit, to the camera.
        area: (P, 1) area of the surface that a pixel covers, in the unit of the points squared.
    """

    points: Tensor
    normal: Tensor
    view: Tensor
    area: Tensor

    @staticmethod
    def of(seen: NormalMap) -> SeenSurface:
        """The foreground pixels of a single view, row by row."""
        inside, camera = seen.mask[0, 0], seen.camera
        height, width = inside.shape
        normal = seen.normal[0][:, inside].T
        points = camera.points(seen.depth.where(seen.mask, 1.0))[0][:, inside].T
        view = camera.view_directions((height, width))[0].to(normal).expand(3, height, width)[:, inside].T
        pixel = 2 / (height * camera.focal[0, 1]) * (points[:, 2:] if camera.is_perspective else 1)
        area = pixel**2 / (normal * view).sum(1, keepdim=True).clamp_min(STEEPEST)
        return SeenSurface(points, normal, view, area)


def light_between(
    surface: SeenSurface, albedo: Tensor, irradiance: Tensor, generator: torch.Generator, *, patches: int = PATCHES
) -> Tensor:
    """Interreflected irradiance at every pixel, from randomly chosen sample points.

    Args:
        surface: the P pixels.
        albedo: (P, C) in [0, 1].
        irradiance: (P, K) from each light.
        generator: chooses the sample points.
        patches: their number.

    Returns:
        (P, C, K) irradiance from the rest of the surface.
    """
    order = torch.randperm(len(albedo), generator=generator, device=albedo.device)
    parts = surface.points, surface.normal, surface.area, albedo, irradiance
    return bounced_light(*(part[order] for part in parts), patches=patches)[order.argsort()]


def bounced_light(
    points: Tensor, normal: Tensor, area: Tensor, albedo: Tensor, irradiance: Tensor, *, patches: int = PATCHES
) -> Tensor:
    """Irradiance from the rest of a Lambertian surface, without occlusion between two points.

    Args:
        points: (P, 3), in random order: the first are the sample points.
        normal: (P, 3), unit.
        area: (P, 1) of the surface at each point, in the unit of the points, squared.
        albedo: (P, C) in [0, 1].
        irradiance: (P, K) from each light.
        patches: number of sample points.

    Returns:
        (P, C, K).
    """
    some = slice(0, patches)
    share = area[some] * len(points) / min(patches, len(points))
    factors = form_factors(points, normal, points[some], normal[some], share)
    own = albedo[some, :, None] * irradiance[some, None]
    sent = own
    for _ in range(BOUNCES - 1):
        sent = own + albedo[some, :, None] * arriving(factors[some], sent)
    return arriving(factors, sent)


def arriving(factors: Tensor, sent: Tensor) -> Tensor:
    """Irradiance (P, C, K) at P points: form factors (P, Q) times the radiosity (Q, C, K) of Q patches."""
    return (factors @ sent.flatten(1)).reshape(-1, *sent.shape[1:])


def form_factors(points: Tensor, normal: Tensor, others: Tensor, facing: Tensor, area: Tensor) -> Tensor:
    """Form factors (P, Q) from Q patches to P points.

    ``cos cos' area / (pi distance^2 + area)``, the formula of a disc on its axis, is finite at any distance.

    Args:
        points: (P, 3).
        normal: (P, 3), unit.
        others: (Q, 3) centres of the patches.
        facing: (Q, 3) their unit normals.
        area: (Q, 1).
    """
    square = torch.cdist(points, others, compute_mode="donot_use_mm_for_euclid_dist").square()
    here = normal @ others.T - (normal * points).sum(1, keepdim=True)
    there = points @ facing.T - (facing * others).sum(1)
    cosines = here.clamp_min(0) * there.clamp_min(0) / torch.maximum(square, 1e-4 * area.T)
    share: Tensor = cosines * area.T / (math.pi * square + area.T)
    return share
