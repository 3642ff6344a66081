"""Surfaces with exact normals, and pictures of them by the V-cavity theory, to evaluate shape from shading."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from scipy.interpolate import RectBivariateSpline
from torch import Tensor

from torch_orennayar import MODELS, Camera, load_mesh, render_normals
from torch_orennayar.geometry.mesh import normalise_mesh

Height = Callable[[Tensor, Tensor], Tensor]


@dataclass(frozen=True)
class Field:
    """A surface seen from the front.

    Attributes:
        name: of the surface or mesh.
        height: (1, H, W) pixels toward the viewer, 0 outside the mask.
        normal: (3, H, W) exact, 0 outside the mask.
        mask: (1, H, W) bool.
        contour: whether the surface turns away at the mask's edge.
    """

    name: str
    height: Tensor
    normal: Tensor
    mask: Tensor
    contour: bool


def _bumpy_ellipsoid(seed: int) -> Height:
    generator = np.random.default_rng(seed)
    waves = [(*(4 * generator.normal(size=2)), generator.uniform(0, 2 * math.pi)) for _ in range(5)]

    def height(x: Tensor, y: Tensor) -> Tensor:
        bumps = sum(0.06 * torch.sin(u * x + v * y + phase) for u, v, phase in waves)
        inside = 1 - (x / 0.95) ** 2 - (y / 0.8) ** 2
        return 0.7 * torch.where(inside > 0, inside, -1).clamp_min(-1).abs().sqrt() * (1 + bumps) * inside.sign()

    return height


def _sphere_cap(x: Tensor, y: Tensor) -> Tensor:
    inside = 0.9**2 - x * x - y * y
    return inside.abs().sqrt() * inside.sign()


def _vase(x: Tensor, y: Tensor) -> Tensor:
    width = 0.5 + 0.18 * torch.sin(4.5 * y + 0.6)
    inside = width * width * (1 - (y / 0.95) ** 8) - x * x
    return inside.abs().sqrt() * inside.sign()


def _wavy_sheet(x: Tensor, y: Tensor) -> Tensor:
    return 0.5 + 0.09 * torch.sin(5 * x + 1) * torch.cos(4 * y) + 0.05 * torch.sin(7 * y - 3 * x)


SURFACES: dict[str, tuple[Height, bool]] = {
    "sphere cap": (_sphere_cap, True),
    "vase": (_vase, True),
    "bumpy ellipsoid": (_bumpy_ellipsoid(0), True),
    "bumpier ellipsoid": (_bumpy_ellipsoid(1), True),
    "wavy sheet": (_wavy_sheet, False),
}
"""Height over the square -1.1 to 1.1 (y up), at most 0 outside the surface; whether the mask's edge is a contour."""


def make(name: str, size: int) -> Field:
    """One of `SURFACES`, its normals by automatic differentiation in float64."""
    function, contour = SURFACES[name]
    line = torch.linspace(-1.1, 1.1, 2 * size + 1, dtype=torch.float64)[1::2]
    y, x = (t.clone().requires_grad_() for t in torch.meshgrid(line.flip(0), line, indexing="ij"))
    z = function(x, y)
    slopes = torch.autograd.grad(z.sum(), (x, y))
    mask = (z > 0).detach()[None]
    normal = F.normalize(torch.stack((-slopes[0], -slopes[1], torch.ones_like(z))), dim=0)
    return Field(name, torch.where(mask, z.detach()[None] * size / 2.2, 0), normal.detach() * mask, mask, contour)


LYING = ("nefertiti",)
"""Meshes whose z axis points up."""


def from_mesh(file: Path, size: int) -> Field:
    """A mesh seen from the front; its height field is not smooth where one part hides another."""
    vertices, faces = load_mesh(file, crease=math.pi)
    if file.stem in LYING:
        x, y, z = vertices.unbind(1)
        vertices = torch.stack((x, z, -y), 1)
    seen = render_normals(normalise_mesh(vertices), faces, Camera.orthographic(0.8), (size, size))
    mask, normal = seen.mask[0], F.normalize(seen.normal[0].double(), dim=0)
    mask = mask & (normal[2:] > 0.02)
    height = torch.where(mask, (2 - seen.depth[0].double()) * size / 1.6, 0)
    return Field(file.stem, height, normal * mask, mask, True)


def light_at(degrees: float, azimuth: float = 40.0) -> Tensor:
    """A light so many degrees off the view, to the upper right by default."""
    t, a = math.radians(degrees), math.radians(azimuth)
    return torch.tensor([math.sin(t) * math.cos(a), math.sin(t) * math.sin(a), math.cos(t)])


@functools.lru_cache(maxsize=64)
def _theory_table(off_view: float, sigma: float, albedo: float) -> RectBivariateSpline:
    """Pi times the BRDF of the theory for one light, by slant of the normal and its azimuth relative to the light."""
    slant, turn = torch.linspace(0, 1.56, 48), torch.linspace(0, math.pi, 49)
    s, t = torch.meshgrid(slant, turn, indexing="ij")
    ci = (s.sin() * t.cos() * math.sin(off_view) + s.cos() * math.cos(off_view)).clamp_min(2e-3).flatten()
    rho, lv = torch.full_like(ci, albedo), torch.full_like(ci, math.cos(off_view))
    value = MODELS["theory"].function(ci, s.cos().flatten(), lv, rho, torch.full_like(ci, sigma))
    return RectBivariateSpline(slant.numpy(), turn.numpy(), value.reshape(s.shape).double().numpy())


def photograph(
    field: Field, light: Tensor, sigma: float, *, albedo: float = 0.8, noise: float = 0.01, seed: int = 0
) -> Tensor:
    """A picture (1, H, W) by the V-cavity theory, with attached shadows and noise."""
    normal = field.normal[:, field.mask[0]]
    ci = (normal * light.double()[:, None]).sum(0).clamp_min(0)
    if sigma:
        turn = (torch.atan2(normal[1], normal[0]) - torch.atan2(light[1], light[0]).double()).cos().acos()
        table = _theory_table(math.acos(min(1.0, float(light[2]))), sigma, albedo)
        value = torch.from_numpy(table.ev(normal[2].acos().clamp_max(1.56).numpy(), turn.numpy())) * ci
    else:
        value = albedo * ci
    image = torch.zeros(field.mask.shape, dtype=torch.float64)
    image[field.mask] = value
    image += noise * torch.randn(image.shape, generator=torch.Generator().manual_seed(seed))
    return (image.clamp_min(0) * field.mask).float()
