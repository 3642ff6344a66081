"""Formulas of the diffuse reflectance models: each a short function of three cosines, albedo and roughness.

Symbols as in Oren & Nayar (1994): ``ci = n.l``, ``co = n.v``, ``lv = l.v``, ``s = lv - ci co = sin(ti) sin(to)
cos(dphi)``, ``x = sigma**2``, ``rho`` the facet albedo. Every function returns ``pi f_r``: a Lambertian surface gives
its albedo. Both ``ci`` and ``co`` are positive (the caller handles the horizon), so no formula needs angles, azimuths
or a projected vector.

Albedo above 1 (a capture of unknown exposure) scales the result; light between facets is computed with the albedo
clamped to 1, above which the inter-reflection series diverges.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from .coefficients import VCAVITY_LINEAR, VCAVITY_SHAPE
from .theory import floored_sine


def lambert(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """Lambert (1760): the albedo, for all directions and any roughness."""
    # The zero term keeps every argument in the graph: gradients are 0 rather than None, as in other models.
    return rho + 0.0 * (ci + co + lv + sigma)


def _a_b(sigma: Tensor, a_constant: float) -> tuple[Tensor, Tensor]:
    """A and B of Oren & Nayar (1994), eq. 30; the paper has 0.33 or 0.57 for ``a_constant``."""
    x = sigma * sigma
    return 1 - 0.5 * (x / (x + a_constant)), 0.45 * (x / (x + 0.09))


def _classic(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor, a_constant: float) -> Tensor:
    """Oren & Nayar (1994), eq. 30, in cosines; at the kink ``s = 0`` the derivative is that of ``s < 0``."""
    a, b = _a_b(sigma, a_constant)
    return rho * torch.addcmul(a, b, (lv - ci * co).relu() / torch.maximum(ci, co))


def qualitative(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """The qualitative model, Oren & Nayar (1994), eq. 30: ``rho (A + B max(0, s) / max(ci, co))``."""
    return _classic(ci, co, lv, rho, sigma, 0.33)


def qualitative_057(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """The qualitative model with 0.57 in A, which Oren & Nayar suggest as an approximation of inter-reflection."""
    return _classic(ci, co, lv, rho, sigma, 0.57)


def fujii(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """Fujii (2012), "improved Oren-Nayar": keeps negative ``s`` and the mean inter-reflection term."""
    a, b = _a_b(sigma, 0.33)
    x, s = sigma * sigma, lv - ci * co
    bounce = 0.17 * rho.clamp_max(1) * (x / (x + 0.13))
    return rho * torch.addcmul(a + bounce, b, s.clamp_max(0) + s.relu() / torch.maximum(ci, co))


def full(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """The full model, Oren & Nayar (1994), eqs. 27-29, without azimuths; slightly negative near the horizon.

    Sines are clamped to at least 1e-6 before any division, which keeps gradients finite at the normal.
    """
    a, b = _a_b(sigma, 0.33)
    x = sigma * sigma
    c_beta, c_alpha = torch.maximum(ci, co), torch.minimum(ci, co)
    sin_a, sin_b = floored_sine(c_alpha), floored_sine(c_beta)
    alpha, beta = (sin_a / c_alpha).atan(), (sin_b / c_beta).atan()  # the derivative of acos is infinite at the normal
    s = lv - ci * co
    cos_phi = (s / (sin_a * sin_b)).clamp(-1, 1)
    back = cos_phi.clamp_max(0) * (beta * (2 / torch.pi)) ** 3 * sin_b
    c2_term = b * (s - back) / c_beta
    c3 = 0.125 * (x / (x + 0.09)) * (alpha * beta * (4 / torch.pi**2)) ** 2
    c3_term = (1 - cos_phi.abs()) * c3 * (sin_a + sin_b) / (ci + co)
    bounce = 0.17 * rho.clamp_max(1) * (x / (x + 0.13)) * (1 - cos_phi * (beta * (2 / torch.pi)) ** 2)
    return rho * (a + c2_term + c3_term + bounce)


def vcavity(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """Closed-form fit to the V-cavity theory with all bounces; smooth and reciprocal.

    ``scripts/fit/fit_vcavity.py`` writes the coefficients.
    """
    # The fit is negative only on dark surfaces rougher than 80 degrees, light and view opposite at the horizon.
    return rho * vcavity_form(ci, co, lv, rho, sigma, VCAVITY_SHAPE, VCAVITY_LINEAR).relu()


def vcavity_form(
    ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor, shape: Sequence[float], linear: Sequence[float]
) -> Tensor:
    """`vcavity` divided by the albedo, as a function of its 7 shape constants and 24 linear coefficients.

    ``u`` is masking and shadowing, one factor for each direction. ``r`` depends on the separation of light and view
    across a groove: masking grows with |tan ti - tan to| along the groove, so the natural variable is
    ``ci**2 + co**2 - 2 ci co lv``. ``y`` is 0 for a smooth surface; ``b`` is the albedo, ``l`` the sum of its later
    bounces: they multiply the light of two bounces and of all further ones. The result is a polynomial in ``u``,
    arranged for few operations (``gradients.vcavity`` differentiates the same lines).
    """
    c, beta, k0, k1, k2, kappa, turn = shape
    a, g, d = linear[:14], linear[14:19], linear[19:]
    x = sigma * sigma
    y = x / (x + c)
    b = rho.clamp_max(1)
    yy, l = y * y, y * (b / (1 - beta * b))  # noqa: E741
    q, p, h = ci * co, ci + co, 1 + lv
    s, pp = lv - q, p * p
    k = k0 + k1 * y + k2 * yy
    m, hq = 1 - k, (2 * h) * q
    mq = m * q
    u = y / (k * (k + m * (pp - 2 * q)) + mq * mq).sqrt()  # the root of (k + m ci^2) (k + m co^2)
    r = (pp + (kappa + turn * y) * (pp - hq) + 1e-12).rsqrt()
    hr, qr, pr, yp = h * r, q * r, p * r, yy * p
    zero = qr * (a[0] * hr + a[2]) + a[1] * pr + a[3] * yp + b * (g[0] + g[1] * yy + g[2] * p)
    zero = 1 + y * (zero + l * (d[0] + y * (d[1] * q + d[2] * h)))
    one = hr * (a[4] + y * (a[5] + a[6] * q + a[7] * pr)) + s * (a[8] + a[9] * s + a[10] * yp)
    one = one + y * (a[11] + b * (r * (g[3] * qr + (g[4] * h) * p))) + l * (d[3] * q)
    two = a[12] + a[13] * p + l * (d[4] * (s * s))
    return zero + u * (one + u * two)


def eon(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """Energy-preserving Oren-Nayar (Portsmouth, Kutz & Hill 2024), its r mapped from ``sigma``.

    ``r = x / (0.2859 + 1.1110 x)`` minimises the error against the V-cavity theory (``scripts/fit/fit_eon.py``).
    """
    x = sigma * sigma
    return eon_from_r(ci, co, lv, rho, x / (0.2859 + 1.1110 * x))


def eon_from_r(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, r: Tensor) -> Tensor:
    """EON with its own roughness r in [0, 1].

    The energy lost by one bounce is written as ``1 - E = r A (c1 - G)``, which avoids 0/0 at r = 0.
    """
    c1, c2 = 0.5 - 2 / (3 * torch.pi), 2 / 3 - 28 / (15 * torch.pi)
    a = 1 / (1 + c1 * r)
    s = lv - ci * co
    single = a * (1 + r * (s.clamp_max(0) + s.relu() / torch.maximum(ci, co)))
    bounce_rho = rho.clamp_max(1)
    mean_albedo = a * (1 + c2 * r)
    lost = (c1 - _eon_g(ci)).clamp_min(0) * (c1 - _eon_g(co)).clamp_min(0) * r * a / (c1 - c2)
    multiple = bounce_rho * mean_albedo / (1 - bounce_rho * (1 - mean_albedo)) * lost
    return rho * (single + multiple)


def _eon_g(cosine: Tensor) -> Tensor:
    """G(theta)/pi of the EON paper, its published polynomial in ``1 - cos``."""
    m = 1 - cosine
    return m * (0.0571085289 + m * (0.491881867 + m * (-0.332181442 + m * 0.0714429953)))
