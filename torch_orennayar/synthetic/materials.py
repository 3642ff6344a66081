"""Random materials: a rough diffuse part, perhaps under glaze, with highlights and sheen.

Ranges of widths and strengths were set by hand; what they rest on is said at `Ingredients`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from ..reflectance.models import get_model
from ..reflectance.specular import microfacet
from .draw import Draw
from .ingredients import Ingredients


def transmitted(cosine: Tensor, index: Tensor | float) -> Tensor:
    """Fresnel transmittance of a smooth dielectric, unpolarised, by the cosine outside and the refractive index."""
    cosine = cosine.clamp_min(1e-6)
    inside = (index**2 - 1 + cosine * cosine).sqrt() / index  # exact for an index of 1
    s = (cosine - index * inside) / (cosine + index * inside)
    p = (inside - index * cosine) / (inside + index * cosine)
    return 1 - (s * s + p * p) / 2


class Lobe(NamedTuple):
    """A microfacet lobe of P materials, (P, 1) each: GGX width, reflectance at normal incidence, and strength."""

    width: Tensor
    facing_reflectance: Tensor
    strength: Tensor


@dataclass(frozen=True)
class Materials:
    """P materials; every tensor is (P, 1).

    Attributes:
        albedo: of the diffuse part.
        roughness: radians, of the diffuse part.
        index: refractive index of the interface above it; 1 for none.
        retro: 1 where Burley's diffuse factor applies, otherwise 0.
        burley_roughness: roughness in Burley's diffuse factor.
        falloff: power of ``n.l n.v`` that multiplies the diffuse part; 0 for none.
        diffuse_weight: of the diffuse part.
        lobes: specular lobes.
        sheen: strength of the sheen.
    """

    albedo: Tensor
    roughness: Tensor
    index: Tensor
    retro: Tensor
    burley_roughness: Tensor
    falloff: Tensor
    diffuse_weight: Tensor
    lobes: tuple[Lobe, ...]
    sheen: Tensor

    def reflect(self, ci: Tensor, co: Tensor, lv: Tensor) -> Tensor:
        """``pi f_r`` (P, K) by positive cosines (P, K): ``n.l``, ``n.v`` and ``l.v``."""
        value = get_model("vcavity").function(ci, co, lv, self.albedo, self.roughness)
        return value * self.diffuse_weight * self.diffuse_factor(ci, co, lv) + self.highlights(ci, co, lv)

    def diffuse_factor(self, ci: Tensor, co: Tensor, lv: Tensor) -> Tensor:
        """By what glaze, retro-reflection and falloff multiply the diffuse part, (P, K)."""
        grazing = 2 * self.burley_roughness * _squared_lh(lv) - 0.5  # F_D90 - 1 of Burley 2012
        burley = (1 + grazing * (1 - ci) ** 5) * (1 + grazing * (1 - co) ** 5)
        value = (1 + self.retro * (burley - 1)) * (ci * co).clamp_min(1e-3) ** self.falloff
        return value * transmitted(ci, self.index) * transmitted(co, self.index)

    def highlights(self, ci: Tensor, co: Tensor, lv: Tensor) -> Tensor:
        """``pi f_r`` (P, K) of the specular lobes and the sheen."""
        value = self.sheen * (1 - _squared_lh(lv).sqrt()) ** 5
        for lobe in self.lobes:
            value = value + lobe.strength * microfacet(ci, co, lv, lobe.width, lobe.facing_reflectance)
        return value


def _squared_lh(lv: Tensor) -> Tensor:
    """``(l.h)^2`` of the half vector h, by ``l.v``."""
    return ((1 + lv) / 2).clamp_min(0)


def draw_materials(draw: Draw, pixels: int, mix: Ingredients) -> Materials:
    """A material for each of P pixels."""
    one = (pixels, 1)
    glossy = draw.bernoulli(mix.glossy, *one)
    metal = draw.bernoulli(mix.metal, *one) * glossy
    lobes = []
    for share in (1.0, mix.second_lobe):
        width = draw.uniform(*one, low=0.12, high=0.95) ** 2
        facing = draw.log_uniform(*one, low=0.02, high=0.2)
        facing = torch.where(metal > 0, draw.uniform(*one, low=0.2, high=0.9), facing)
        strength = glossy * draw.bernoulli(share, *one) * draw.uniform(*one, low=0.4, high=1.6)
        lobes.append(Lobe(width, facing, strength))
    return Materials(
        albedo=draw.log_uniform(*one, low=0.03, high=0.95),
        roughness=draw.uniform(*one, high=mix.roughest) * draw.bernoulli(mix.rough, *one),
        index=1 + draw.uniform(*one, low=0.3, high=0.8) * draw.bernoulli(mix.glazed, *one),
        retro=draw.bernoulli(mix.retro, *one),
        burley_roughness=draw.uniform(*one, high=1.2),
        falloff=draw.uniform(*one, low=-0.1, high=0.3) * draw.bernoulli(mix.falloff, *one),
        diffuse_weight=1 - metal * draw.uniform(*one, low=0.6, high=1.0),
        lobes=tuple(lobes),
        sheen=draw.bernoulli(mix.sheen, *one) * draw.uniform(*one, high=0.15),
    )
