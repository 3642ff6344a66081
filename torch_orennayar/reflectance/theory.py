"""The V-cavity theory by numerical quadrature: the reference for the closed forms. Slow.

The surface consists of long symmetric grooves with Lambertian walls (Oren & Nayar 1994). A wall with normal a at
angle ``t`` from n faces the wall with normal ``a' = 2 <a,n> n - a``; ``t`` has density exp(-t^2 / 2 sigma^2)
per solid angle, of unit integral over the macroscopic area. Lengths on a wall are measured from the
valley, 1 at the ridge: light and view reach a wall from ``shadow`` and ``mask`` upward.

The direct light and the first inter-reflection are the paper's integrals (Hottel's crossed strings).
Further bounces solve the radiosity equation of the groove, with its kernel projected on
Legendre polynomials; ``T`` is the operator that maps the radiosity of one wall to the irradiance of the other,
so bounces 2, 3, ... are ``rho^2 T^2 + rho^3 T^3 + ... = rho^2 T^2 (1 - rho T)^-1``.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from ..core.checks import broadcast_shape

SLOPES, AZIMUTHS, MODES = 32, 96, 8
"""Nodes over the slope and azimuth of the walls, and number of polynomials along a wall; set by hand. Three times the
nodes differ by 5e-5 RMS (``scripts/fit/tabulate_errors.py``, ``quadrature_error``)."""
EXCHANGE_NODES = 16
"""Gauss-Legendre nodes for the moments of the radiosity kernel; set by hand."""
_REACH = 5.5
"""Slope, in standard deviations, at which the density is truncated: exp(-5.5^2 / 2) is 3e-7."""
_CHUNK = 48
"""Directions per step, which bounds the memory for temporaries; set by hand."""


def theory(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """The V-cavity theory with all bounces by quadrature in float64, about 2,000 values per second.

    Sines are clamped to at least 1e-6 before any division, which keeps gradients finite at the normal.
    """
    shape = broadcast_shape(ci.shape, co.shape, lv.shape, rho.shape, sigma.shape)
    i, o, between, albedo, spread = (t.expand(shape).reshape(-1).double() for t in (ci, co, lv, rho, sigma))
    result = reflectance_by_bounces(i, o, between, spread, albedo.clamp(0, 1)[:, None]).sum(-1)[:, 0]
    return (albedo * result).reshape(shape).to(torch.promote_types(ci.dtype, rho.dtype))


def reflectance_by_bounces(ci: Tensor, co: Tensor, lv: Tensor, sigma: Tensor, rho: Tensor) -> Tensor:
    """``pi f_r / rho`` by bounces, for N pairs of directions and K albedos each.

    Args:
        ci: (N,) cosines between normal and light.
        co: (N,) cosines between normal and view.
        lv: (N,) cosines between light and view.
        sigma: (N,) roughness in radians.
        rho: (N, K) albedos in [0, 1].

    Returns:
        (N, K, 3): direct light, first inter-reflection, and the sum of all further ones.
    """
    if not ci.numel():
        return rho.new_zeros(*rho.shape, 3) + 0 * (ci + co + lv + sigma)[:, None, None]
    parts = []
    for chunk in zip(*(t.split(_CHUNK) for t in (ci, co, lv, sigma, rho)), strict=True):
        if torch.is_grad_enabled() and any(t.requires_grad for t in chunk):
            parts.append(checkpoint(_integrate, *chunk, use_reentrant=False, preserve_rng_state=False))
        else:
            parts.append(_integrate(*chunk))
    return torch.cat(parts)


def floored_sine(cosine: Tensor) -> Tensor:
    """The sine of an angle in [0, pi/2] from its cosine, clamped to at least 1e-6 so that its derivative is finite."""
    return ((1 - cosine) * (1 + cosine)).clamp_min(1e-12).sqrt()


@cache
def gauss_legendre(count: int) -> tuple[Tensor, Tensor]:
    """Gauss-Legendre nodes and weights on [0, 1], float64."""
    node, weight = np.polynomial.legendre.leggauss(count)
    with torch.inference_mode(False):  # the cached tensors may be used outside of it
        return torch.from_numpy((node + 1) / 2), torch.from_numpy(weight / 2)


@cache
def legendre_coefficients(modes: int) -> tuple[Tensor, Tensor]:
    """Coefficients of the orthonormal Legendre polynomials on [0, 1] and of their integrals from x to 1."""
    rows = np.zeros((modes, modes))
    integrals = np.zeros((modes, modes + 1))
    for k in range(modes):
        polynomial = np.polynomial.Legendre.basis(k, domain=[0, 1]).convert(kind=np.polynomial.Polynomial)
        coefficients = polynomial.coef * math.sqrt(2 * k + 1)
        rows[k, : k + 1] = coefficients
        whole = np.concatenate(([0.0], coefficients / np.arange(1, k + 2)))
        integrals[k, : k + 2] = -whole
        integrals[k, 0] += whole.sum()
    with torch.inference_mode(False):
        return torch.from_numpy(rows), torch.from_numpy(integrals)


def _exchange(slope: Tensor) -> Tensor:
    """``T`` for walls of the given slope, (..., MODES, MODES): the irradiance of a wall by the radiosity of the other.

    The kernel is homogeneous, so moments of x^i y^j are ``(k_i + k_j) / (i + j + 1)`` with
    ``k_j`` the integral of t^j K(1, t), here over the angle under which a point sees the other wall.
    """
    node, weight = (t.to(slope) for t in gauss_legendre(EXCHANGE_NODES))
    angle = slope[..., None] * node
    seen = (slope[..., None] + angle).sin()
    ratio = (slope[..., None] - angle).sin() / seen.clamp_min(1e-30)
    power = torch.arange(1, MODES + 1, device=slope.device)
    k = 0.5 * slope[..., None] * (_powers(ratio, MODES)[..., 1:] * (seen * weight)[..., None]).sum(-2)
    moments = (k[..., :, None] + k[..., None, :]) / (power[:, None] + power[None, :] - 1)
    basis = legendre_coefficients(MODES)[0].to(slope)
    return basis @ moments @ basis.T


def _integrate(ci: Tensor, co: Tensor, lv: Tensor, sigma: Tensor, rho: Tensor) -> Tensor:
    """One chunk of `reflectance_by_bounces`; the axes of its intermediate results are direction, slope, azimuth."""
    node, weight = (t.to(ci) for t in gauss_legendre(SLOPES))
    reach = (_REACH * sigma).clamp_max(math.pi / 2)[:, None]
    slope = reach * node
    cosine, sine = slope.cos(), slope.sin()
    density = weight * torch.exp(-0.5 * (slope / sigma.clamp_min(1e-12)[:, None]) ** 2) * (sine + (sigma == 0)[:, None])
    density = density / density.sum(1, keepdim=True) / AZIMUTHS

    sin_i, sin_o = floored_sine(ci), floored_sine(co)
    # Azimuths are relative to the bisector of light and view, so that exchanging the two mirrors the nodes.
    cos_phi = ((lv - ci * co) / (sin_i * sin_o)).clamp(-1, 1)
    cos_half, sin_half = (((1 + sign * cos_phi) / 2).clamp_min(1e-12).sqrt() for sign in (1, -1))
    azimuth = (torch.arange(AZIMUTHS, device=ci.device) + 0.5).to(ci) * (2 * math.pi / AZIMUTHS)
    along, beside = cos_half[:, None] * azimuth.cos(), sin_half[:, None] * azimuth.sin()

    up_i, up_o = (c[:, None, None] * cosine[..., None] for c in (ci, co))
    across_i = (sin_i[:, None] * (along + beside))[:, None] * sine[..., None]
    across_o = (sin_o[:, None] * (along - beside))[:, None] * sine[..., None]
    near, far, seen = up_i + across_i, up_i - across_i, up_o + across_o  # <l,a>, <l,a'>, <v,a>

    tall = 2 * cosine[..., None]
    shadow, shadow_far = (_hidden(tall * ci[:, None, None], d) for d in (near, far))
    mask = _hidden(tall * co[:, None, None], seen)
    near, far, seen = near.clamp_min(0), far.clamp_min(0), seen.clamp_min(0)
    flux = density[..., None] * seen / (cosine[..., None] * (ci * co)[:, None, None])

    direct = (flux * near * (1 - torch.maximum(shadow, mask))).sum((1, 2))
    turn = (2 * slope).cos()[..., None]
    strings = _string(1.0, mask, turn) + _string(shadow_far, 1.0, turn) - _string(shadow_far, mask, turn)
    second = (flux * far * (strings - cosine[..., None])).sum((1, 2))

    lit, lit_far, visible = (_lit_moments(t) for t in (shadow, shadow_far, mask))
    visible = visible * flux[..., None]
    even = visible.mT @ (lit * near[..., None])  # direction, slope, mode, mode
    odd = visible.mT @ (lit_far * far[..., None])
    t = _exchange(slope)[:, :, None]
    square = t @ t
    identity = torch.eye(MODES, dtype=ci.dtype, device=ci.device)
    # rho^2 T^2 (1 - rho^2 T^2)^-1 for paths that return to the wall, rho^3 T^3 (...)^-1 for the others.
    r = rho[:, None, :, None, None]
    again = torch.linalg.solve(identity - r * r * square, r * r * square)
    later = (again * even[:, :, None]).sum((1, 3, 4)) + (r * (t @ again) * odd[:, :, None]).sum((1, 3, 4))
    return torch.stack((direct[:, None].expand_as(later), rho * second[:, None], later), -1)


def _hidden(height: Tensor, projection: Tensor) -> Tensor:
    """The share of a wall, from the valley up, that the opposite wall hides; 0 where the wall faces away."""
    return (1 - height / torch.where(projection > 0, projection, 1)).clamp_min(0) * (projection > 0)


def _string(x: Tensor | float, y: Tensor | float, turn: Tensor) -> Tensor:
    """Half the distance between the points x and y of opposite walls."""
    square = x * x + y * y + 2 * x * y * turn
    return 0.5 * square.clamp_min(1e-40).sqrt()


def _lit_moments(start: Tensor) -> Tensor:
    """Integrals of the polynomials from ``start`` to 1, (..., MODES)."""
    return _powers(start, MODES) @ legendre_coefficients(MODES)[1].to(start).T


def _powers(x: Tensor, highest: int) -> Tensor:
    """Powers 0 to ``highest`` of x along a new last axis, by products: ``**`` has no second derivative at 0."""
    powers = [torch.ones_like(x)]
    for _ in range(highest):
        powers.append(powers[-1] * x)
    return torch.stack(powers, -1)
