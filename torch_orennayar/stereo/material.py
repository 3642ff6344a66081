"""What one material shows under many lights, and how that changes with normal, albedo and highlights.

Observations are (P, K): P pixels, K lights. The view is (0, 0, 1) in every pixel's own frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from ..reflectance.models import get_model, value_and_vjp


@dataclass(frozen=True)
class Material:
    """Reflectance that all pixels of an object share: a diffuse model, and lobes whose strength each pixel has.

    Attributes:
        model: a name in ``MODELS``.
        roughness: radians, for models that have one.
        minnaert_exponent: k >= 1 of Minnaert's law: the diffuse part times ``(n.l n.v)**(k - 1)``. Above 1 the surface
            darkens toward grazing light, as under glaze or varnish, whose interface reflects light there. For
            ``lambert``; 1 is Lambert itself.
        exponents: of Blinn's lobes, powers of two.
        roughness_varies: roughness differs over the object; `roughness_map.LEVELS` stand for it, not ``roughness``.
    """

    model: str = "lambert"
    roughness: float = 0.0
    minnaert_exponent: float = 1.0
    exponents: tuple[int, ...] = ()
    roughness_varies: bool = False

    @property
    def name(self) -> str:
        """The kind of material, without its numbers: a key of `Reconstruction.scores`."""
        base = "lambert with falloff" if self.minnaert_exponent != 1 else self.model
        base += " of varied roughness" if self.roughness_varies else ""
        return base + ("", " + 1 lobe", " + 2 lobes")[len(self.exponents)]

    def __str__(self) -> str:
        parts = [self.model]
        if self.model != "lambert":
            parts.append(f"roughness {math.degrees(self.roughness):.1f} degrees")
        if self.minnaert_exponent != 1:
            parts.append(f"Minnaert exponent {self.minnaert_exponent:.2f}")
        if self.exponents:
            parts.append(f"highlights of exponent {' and '.join(str(p) for p in self.exponents)}")
        return ", ".join(parts)


@dataclass(frozen=True)
class Response:
    """What pixels show and its derivatives; that by the normal is ``by_light l + by_view v + by_half h``.

    Attributes:
        value: (P, K), 0 where unlit.
        by_light: (P, K).
        by_view: (P, K) or None for 0.
        by_half: (P, K) or None for 0.
        columns: (P, K) each: the derivative by albedo, then by the strength of each lobe.
        by_roughness: (P, K), or None for 0 or where it was not asked for.
    """

    value: Tensor
    by_light: Tensor
    by_view: Tensor | None
    by_half: Tensor | None
    columns: tuple[Tensor, ...]
    by_roughness: Tensor | None = None


@dataclass(frozen=True)
class LightDirections:
    """Unit directions to K lights, the same for all pixels or each pixel's own.

    Attributes:
        light: (K, 3) distant lights, or (P, K, 3).
        half: the same shape, halfway between light and view.
    """

    light: Tensor
    half: Tensor

    @staticmethod
    def of(light: Tensor) -> LightDirections:
        """Of unit directions (K, 3) or (P, K, 3)."""
        return LightDirections(light, F.normalize(light + light.new_tensor((0.0, 0.0, 1.0)), dim=-1))

    def __len__(self) -> int:
        return self.light.shape[-2]

    def at(self, pixels: slice | Tensor) -> LightDirections:
        """Those of some pixels."""
        return self if self.light.ndim == 2 else LightDirections(self.light[pixels], self.half[pixels])

    def under(self, lights: Tensor) -> LightDirections:
        """Those to some of the lights, (K,) bool."""
        return LightDirections(self.light[..., lights, :], self.half[..., lights, :])

    def as_distant(self) -> Tensor:
        """(K, 3): of near lights the mean direction over the pixels."""
        return self.light if self.light.ndim == 2 else F.normalize(self.light.mean(0), dim=1)


def cosines(vectors: Tensor, directions: Tensor) -> Tensor:
    """Dot products of (P, 3) with (K, 3) or (P, K, 3), (P, K)."""
    return vectors @ directions.T if directions.ndim == 2 else (directions @ vectors[:, :, None])[:, :, 0]


def respond(
    material: Material,
    normal: Tensor,
    albedo: Tensor,
    lobes: Tensor,
    directions: LightDirections,
    mean: Tensor,
    *,
    by_roughness: bool = False,
) -> Response:
    """Evaluate ``material`` for P pixels whose observations were divided by their mean.

    Args:
        material: what the pixels share.
        normal: (P, 3).
        albedo: (P, 1) over ``mean``.
        lobes: (P, L) strengths over ``mean`` of ``(n.l) (n.h)**p``.
        directions: to the lights.
        mean: (P, 1) what observations were divided by: interreflection between facets depends on the albedo itself.
        by_roughness: whether to evaluate that derivative too.
    """
    raw = cosines(normal, directions.light)
    lit = raw.sign().relu()
    ci = raw.relu()
    by_sigma: Tensor | None = None
    if material.model != "lambert":
        sigma = raw.new_tensor(material.roughness)
        if by_roughness:
            sigma = sigma.expand_as(raw).contiguous()
        value, by_light, by_view, by_albedo, by_sigma = _rough(
            material.model, raw, lit, normal, albedo, directions.light, mean, sigma
        )
    elif material.minnaert_exponent != 1:
        value, by_light, by_view, by_albedo = _minnaert(material.minnaert_exponent, ci, lit, normal[:, 2:], albedo)
    else:
        value, by_light, by_view, by_albedo = albedo * ci, albedo * lit, None, ci
    columns = [by_albedo]
    by_half: Tensor | None = None
    if material.exponents:
        nh = cosines(normal, directions.half).clamp_min_(1e-6)
        slopes: Tensor | None = None
        for strength, exponent in zip(lobes.split(1, 1), material.exponents, strict=True):
            power = _power(nh, exponent)
            shining = strength * power
            column = power * ci
            columns.append(column)
            value = value + strength * column
            by_light = by_light + shining * lit
            slope = shining * exponent
            slopes = slope if slopes is None else slopes + slope
        by_half = slopes * ci / nh if slopes is not None else None
    return Response(value, by_light, by_view, by_half, tuple(columns), by_sigma if by_roughness else None)


def _minnaert(k: float, ci: Tensor, lit: Tensor, co: Tensor, albedo: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Value and derivatives of Lambert's model times ``(n.l n.v)**(k - 1)``: by light, view and albedo."""
    safe = ci.clamp_min(1e-4)
    by_albedo = safe.pow(k) * (lit * co.pow(k - 1))
    value = albedo * by_albedo
    return value, value * (k / safe), value * ((k - 1) / co), by_albedo


def _rough(
    model: str, raw: Tensor, lit: Tensor, normal: Tensor, albedo: Tensor, lights: Tensor, mean: Tensor, sigma: Tensor
) -> tuple[Tensor, Tensor, Tensor | None, Tensor, Tensor | None]:
    """Value and derivatives of a model with roughness: by light, view, albedo and roughness."""
    ci = torch.maximum(raw * lit, 1 - lit).clamp_min(1e-4)
    co, rho = (t.expand_as(ci).contiguous() for t in (normal[:, 2:], albedo * mean))
    f, (d_ci, d_co, _, d_rho, d_sigma) = value_and_vjp(get_model(model), (ci, co, lights[..., 2], rho, sigma), lit)
    f = f * lit / mean
    by_light = f if d_ci is None else torch.addcmul(f, ci, d_ci / mean)
    return (
        f * ci,
        by_light,
        None if d_co is None else ci * d_co / mean,
        torch.zeros_like(ci) if d_rho is None else ci * d_rho,
        None if d_sigma is None else ci * d_sigma / mean,
    )


def _power(base: Tensor, exponent: int) -> Tensor:
    """``base**exponent`` of a power of two: squaring is many times faster than a general power."""
    for _ in range(exponent.bit_length() - 1):
        base = base * base
    return base
