"""Specular lobes: functions of the three cosines, to be added to a diffuse model.

All return ``pi f_r`` like the diffuse models, so ``(diffuse + strength * lobe) * ci`` is the shading. All are
reciprocal, and 0 where light or view is below the surface. They are not members of ``MODELS``.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ..core.checks import check_floating, check_range

_EXPONENT_HINT = "higher is sharper; 10 to 100 are usual"


def phong(ci: Tensor, co: Tensor, lv: Tensor, exponent: Tensor | float) -> Tensor:
    """Phong's lobe about the mirror direction, ``(n + 2) / 2 max(0, r.v)^n`` with ``r.v = 2 ci co - lv``.

    The factor (Lafortune & Willems 1994) keeps the energy at or below 1; without it, the lobe is the cosine
    power of Phong (1975).

    Args:
        ci: cosine between normal and light.
        co: cosine between normal and view.
        lv: cosine between light and view; the three broadcast, and all are differentiable.
        exponent: n >= 1, higher is sharper; broadcasts, differentiable.

    Returns:
        ``pi f_r`` of the lobe, in the broadcast shape.

    Raises:
        RangeError: exponent below 1.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> one = torch.tensor(1.0)
        >>> ton.phong(one, one, one, 30.0).item()
        16.0
    """
    check_floating(ci=ci, co=co, lv=lv)
    check_range("exponent", exponent, 1.0, math.inf, _EXPONENT_HINT)
    return _above(ci, co) * ((exponent + 2) / 2) * _power(2 * ci * co - lv, exponent)


def blinn_phong(ci: Tensor, co: Tensor, lv: Tensor, exponent: Tensor | float) -> Tensor:
    """Blinn's lobe about the half vector, ``(n + 8) / 8 max(0, n.h)^n`` with ``n.h = (ci + co) / |l + v|``.

    The factor is the usual normalisation of the cosine-weighted lobe; without it, the lobe is the cosine power of
    Blinn (1977).

    Args:
        ci: cosine between normal and light.
        co: cosine between normal and view.
        lv: cosine between light and view; the three broadcast, and all are differentiable.
        exponent: n >= 1, higher is sharper; about four times Phong's for the same width. Broadcasts,
            differentiable.

    Returns:
        ``pi f_r`` of the lobe, in the broadcast shape.

    Raises:
        RangeError: exponent below 1.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> one = torch.tensor(1.0)
        >>> ton.blinn_phong(one, one, one, 32.0).item()
        5.0
    """
    check_floating(ci=ci, co=co, lv=lv)
    check_range("exponent", exponent, 1.0, math.inf, _EXPONENT_HINT)
    return _above(ci, co) * ((exponent + 8) / 8) * _power(_half(ci, co, lv), exponent)


def microfacet(ci: Tensor, co: Tensor, lv: Tensor, width: Tensor | float, reflectance: Tensor | float = 0.04) -> Tensor:
    """Torrance-Sparrow reflection from mirror facets: GGX slopes, height-correlated Smith masking, Schlick's Fresnel.

    Args:
        ci: cosine between normal and light.
        co: cosine between normal and view.
        lv: cosine between light and view; the three broadcast, and all are differentiable.
        width: GGX's alpha in [0.001, 1], the slope of the facets; not the roughness of the diffuse models.
            Broadcasts, differentiable.
        reflectance: Fresnel reflectance at normal incidence in [0, 1], 0.04 for most plastics and paints.
            Broadcasts, differentiable.

    Returns:
        ``pi f_r`` of the lobe, in the broadcast shape.

    Raises:
        RangeError: width or reflectance out of range.

    Source: Torrance & Sparrow 1967; Walter et al. 2007 (GGX); Heitz 2014 (masking); Schlick 1994.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> one = torch.tensor(1.0)
        >>> round(ton.microfacet(one, one, one, 0.5).item(), 6)
        0.04
    """
    check_floating(ci=ci, co=co, lv=lv)
    check_range("width", width, 0.001, 1.0, "it is GGX's alpha, not an angle")
    check_range("reflectance", reflectance, 0.0, 1.0, "it is a share of the light; 0.04 is usual")
    above = _above(ci, co)
    ci, co = torch.where(above, ci, 1), torch.where(above, co, 1)
    square = width * width
    half = _half(ci, co, lv)
    # pi D = square / (1 - (1 - square) half^2)^2, with 1 - half^2 factored to avoid cancellation at the peak.
    slope = (1 - half) * (1 + half) + square * half * half
    # Twice this is 4 ci co / G of Smith, height-correlated; it is positive while both are above the surface.
    masking = ci * (square + (1 - square) * co * co).sqrt() + co * (square + (1 - square) * ci * ci).sqrt()
    fresnel = reflectance + (1 - reflectance) * (1 - _light_half(lv)).clamp_min(0) ** 5
    return above * fresnel * square / (slope * slope) / (2 * masking)


def _above(ci: Tensor, co: Tensor) -> Tensor:
    """Whether light and view are above the surface."""
    return (ci > 0) & (co > 0)


def _power(base: Tensor, exponent: Tensor | float) -> Tensor:
    """``max(0, base) ** exponent`` with finite gradients in both arguments."""
    positive = base > 0
    return torch.where(positive, base, 1) ** exponent * positive


def _half(ci: Tensor, co: Tensor, lv: Tensor) -> Tensor:
    """``n.h``, clamped where light and view are opposite and have no half vector."""
    return ((ci + co) / (2 * (1 + lv).clamp_min(1e-6)).sqrt()).clamp_max(1)


def _light_half(lv: Tensor) -> Tensor:
    """``l.h`` by the half-angle formula."""
    return ((1 + lv).clamp_min(1e-6) / 2).sqrt()
