"""Analytic derivatives of the reflectance models, in fewer operations than autograd needs.

Each function takes a model's arguments and ``weight``, the gradient with respect to its value. It returns the value and
the vector-Jacobian product: for each argument the weight times the derivative, not yet summed over broadcast axes, None
for 0. The layer's backward pass uses them (``shading/tiled.py``); the formulas are in ``formulas.py``, and
``tests/reflectance/test_gradients.py`` compares the two. At the kinks of a formula the derivative is:

- light and view at one angle from the normal (``ci = co``): the mean of both sides;
- light and view at right angles about the normal (``s = 0``) in the classic form: that of the side without the term;
- albedo exactly 1: that of the side below 1, where inter-reflection depends on the albedo.

``addcmul`` and ``add`` with ``alpha`` fuse products and sums, which halves the passes over memory.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, add, addcmul

from .coefficients import VCAVITY_LINEAR, VCAVITY_SHAPE

Partials = tuple[Tensor | None, Tensor | None, Tensor | None, Tensor | None, Tensor | None]
"""Weight times the derivatives by ``ci, co, lv, rho, sigma``; None for 0."""


_COEFFICIENTS = VCAVITY_LINEAR[:14], VCAVITY_LINEAR[14:19], VCAVITY_LINEAR[19:]
"""``a``, ``g`` and ``d`` of `formulas.vcavity_form`: coefficients without albedo, with ``b`` and with ``l``."""


def lambert(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor, weight: Tensor) -> tuple[Tensor, Partials]:
    """Derivatives of `formulas.lambert`."""
    return rho, (None, None, None, weight, None)


def qualitative(
    ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor, weight: Tensor
) -> tuple[Tensor, Partials]:
    """Derivatives of `formulas.qualitative`."""
    return _classic(ci, co, lv, rho, sigma, weight, 0.33)


def qualitative_057(
    ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor, weight: Tensor
) -> tuple[Tensor, Partials]:
    """Derivatives of `formulas.qualitative_057`."""
    return _classic(ci, co, lv, rho, sigma, weight, 0.57)


def _classic(
    ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor, weight: Tensor, a_constant: float
) -> tuple[Tensor, Partials]:
    """Derivatives of ``rho (A + B t)`` with ``t = max(0, s) / max(ci, co)``."""
    x = sigma * sigma
    over_a, over_b = (x + a_constant).reciprocal(), (x + 0.09).reciprocal()
    b = 0.45 * (x * over_b)
    a = 1 - 0.5 * (x * over_a)
    s = addcmul(lv, ci, co, value=-1)
    over = torch.maximum(ci, co).reciprocal()
    t = s.relu() * over
    whole = addcmul(a, b, t)
    inner = weight * rho
    by_s = inner * b * over
    by_largest = by_s * t
    by_s = _where_positive(by_s, s)
    larger = _larger(ci, co)
    by_ci = addcmul(by_largest * larger, by_s, co).neg()
    by_co = addcmul(addcmul(by_largest, by_largest, larger, value=-1), by_s, ci).neg()
    by_x = addcmul((0.45 * 0.09) * (over_b * over_b) * t, over_a, over_a, value=-0.5 * a_constant)
    return rho * whole, (by_ci, by_co, by_s, weight * whole, 2 * (inner * sigma) * by_x)


def fujii(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor, weight: Tensor) -> tuple[Tensor, Partials]:
    """Derivatives of `formulas.fujii`: ``rho (A + C b + B t)`` with ``t = min(0, s) + max(0, s) / max(ci, co)``."""
    x = sigma * sigma
    over_a, over_b, over_c = (x + 0.33).reciprocal(), (x + 0.09).reciprocal(), (x + 0.13).reciprocal()
    b, c = 0.45 * (x * over_b), 0.17 * (x * over_c)
    a = 1 - 0.5 * (x * over_a)
    s = addcmul(lv, ci, co, value=-1)
    over = torch.maximum(ci, co).reciprocal()
    above = s.relu() * over
    t = s.clamp_max(0) + above
    bounce = rho.clamp_max(1)
    whole = addcmul(addcmul(a, c, bounce), b, t)
    inner = weight * rho
    by_t = inner * b
    by_s = by_t + _where_positive(by_t * (over - 1), s)
    by_largest = by_t * above * over
    larger = _larger(ci, co)
    by_ci = addcmul(by_largest * larger, by_s, co).neg()
    by_co = addcmul(addcmul(by_largest, by_largest, larger, value=-1), by_s, ci).neg()
    by_x = addcmul((0.45 * 0.09) * (over_b * over_b) * t, over_a, over_a, value=-0.5 * 0.33)
    by_x = addcmul(by_x, over_c * over_c, bounce, value=0.17 * 0.13)
    by_rho = addcmul(weight * whole, inner * c, _below_one(rho))
    return rho * whole, (by_ci, by_co, by_s, by_rho, 2 * (inner * sigma) * by_x)


class _Terms(NamedTuple):
    """What the polynomial of `formulas.vcavity_form` consists of, by the names there; or gradients with respect to it.

    ``qd`` is ``d[3] q``, and ``o`` is ``g[3] qr + g[4] h p``.
    """

    y: Tensor
    yy: Tensor
    b: Tensor
    l: Tensor  # noqa: E741
    q: Tensor
    p: Tensor
    h: Tensor
    s: Tensor
    u: Tensor
    r: Tensor
    hr: Tensor
    qr: Tensor
    pr: Tensor
    yp: Tensor
    qd: Tensor
    o: Tensor


def vcavity(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor, weight: Tensor) -> tuple[Tensor, Partials]:
    """Derivatives of `formulas.vcavity`: through the lines of `formulas.vcavity_form`, then in reverse."""
    c, beta, k0, k1, k2, kappa, turn = VCAVITY_SHAPE
    _, g, d = _COEFFICIENTS
    x = sigma * sigma
    over_x = (x + c).reciprocal()
    y = x * over_x
    b = rho.clamp_max(1)
    over_b = (1 - beta * b).reciprocal()
    bounces = b * over_b
    yy, l = y * y, y * bounces  # noqa: E741
    q, p, h = ci * co, ci + co, 1 + lv
    s, pp = lv - q, p * p
    k = add(k0 + k1 * y, yy, alpha=k2)
    m, hq = 1 - k, h * q
    mq, e = m * q, add(pp, q, alpha=-2)
    whole_k = addcmul(k, m, e)
    over_u = addcmul(mq * mq, k, whole_k).rsqrt()
    u = y * over_u
    turned, apart = kappa + turn * y, add(pp, hq, alpha=-2)
    r = (addcmul(pp, turned, apart) + 1e-12).rsqrt()
    hr, qr, pr, yp, qd = h * r, q * r, p * r, yy * p, d[3] * q
    o = add(g[3] * qr, h * p, alpha=g[4])
    terms = _Terms(y, yy, b, l, q, p, h, s, u, r, hr, qr, pr, yp, qd, o)
    total, by_factor, by = _vcavity_polynomial(terms, rho, weight)

    by_qr = by.qr.add_(by.o, alpha=g[3])
    by_b = by.b.addcmul_(by.l * y, over_b * over_b)
    by_root = by.r.addcmul_(by.hr, h).addcmul_(by_qr, q).addcmul_(by.pr, p).mul_(-0.5 * (r * r * r))
    by_apart = by_root * turned
    by_under = (by.u * u).mul_(-0.5 * (over_u * over_u))
    by_whole_k = by_under * k
    by_mq = 2 * (by_under * mq)
    by_e = by_whole_k * m
    by_k = (by_under * whole_k).add_(by_whole_k).addcmul_(by_mq, q, value=-1).addcmul_(by_whole_k, e, value=-1)
    by_pp = by_e + by_apart + by_root
    by_yy = by.yy.addcmul_(by.yp, p).add_(by_k, alpha=k2)
    by_y = by.y.addcmul_(by.u, over_u).add_(by_k, alpha=k1).addcmul_(by_root, apart, value=turn)
    by_y.addcmul_(by.l, bounces).addcmul_(by_yy, y, value=2)
    by_q = by.q.addcmul_(by_mq, m).addcmul_(by_qr, r).add_(by.qd, alpha=d[3])
    by_q.addcmul_(by_apart, h, value=-2).add_(by_e, alpha=-2).sub_(by.s)
    by_p = by.p.addcmul_(by.yp, yy).addcmul_(by.pr, r).addcmul_(by_pp, p, value=2).addcmul_(by.o, h, value=g[4])
    by_h = by.h.addcmul_(by.hr, r).addcmul_(by_apart, q, value=-2).addcmul_(by.o, p, value=g[4])
    by_rho = by_factor.addcmul_(by_b, _below_one(rho))
    by_sigma = by_y.mul_(sigma * ((2 * c) * (over_x * over_x)))
    return rho * total.relu(), (addcmul(by_p, by_q, co), addcmul(by_p, by_q, ci), by.s.add_(by_h), by_rho, by_sigma)


def _vcavity_polynomial(terms: _Terms, rho: Tensor, weight: Tensor) -> tuple[Tensor, Tensor, _Terms]:
    """Value of the form, and gradients where it is positive: with respect to the factor ``rho`` and to each term."""
    a, g, d = _COEFFICIENTS
    y, yy, b, l, q, p, h, s, u, r, hr, qr, pr, yp, qd, o = terms  # noqa: E741
    z1 = a[2] + a[0] * hr
    z2 = add(g[0] + g[1] * yy, p, alpha=g[2])
    z3 = add(d[1] * q, h, alpha=d[2])
    z4 = d[0] + y * z3
    z = addcmul(addcmul(addcmul(add(a[1] * pr, yp, alpha=a[3]), qr, z1), b, z2), l, z4)
    o1 = add(a[5] + a[6] * q, pr, alpha=a[7])
    o2 = a[4] + y * o1
    o3 = add(a[8] + a[9] * s, yp, alpha=a[10])
    o5 = r * o
    o6 = a[11] + b * o5
    one = addcmul(addcmul(addcmul(l * qd, hr, o2), s, o3), y, o6)
    ss = s * s
    two = addcmul(a[12] + a[13] * p, l, ss, value=d[4])
    outer = u * two
    total = addcmul(1 + y * z, u, one + outer)
    weight = _where_positive(weight, total)

    # g0, g1 and g2 are the gradients with respect to y z, one and two.
    g0 = weight * rho
    g1 = g0 * u
    g2 = g1 * u
    gz = g0 * y
    by_z4 = gz * l
    by_z3 = by_z4 * y
    by_o1 = g1 * hr
    by_y = (g0 * z).addcmul_(g1, o6).addcmul_(by_o1, o1).addcmul_(by_z4, z3)
    by_o1 *= y
    by_o6 = g1 * y
    by_o5 = by_o6 * b
    by_z2 = gz * b
    by = _Terms(
        y=by_y,
        yy=g[1] * by_z2,
        b=(by_o6 * o5).addcmul_(gz, z2),
        l=(gz * z4).addcmul_(g1, q, value=d[3]).addcmul_(g2, ss, value=d[4]),
        q=(d[1] * by_z3).add_(by_o1, alpha=a[6]),
        p=(a[13] * g2).add_(by_z2, alpha=g[2]),
        h=d[2] * by_z3,
        s=(g1 * o3).addcmul_(g1, s, value=a[9]).addcmul_(g2 * l, s, value=2 * d[4]),
        u=(g0 * one).addcmul_(g0, outer, value=2),
        r=by_o5 * o,
        hr=(g1 * o2).addcmul_(gz, qr, value=a[0]),
        qr=gz * z1,
        pr=(a[7] * by_o1).add_(gz, alpha=a[1]),
        yp=(a[3] * gz).addcmul_(g1, s, value=a[10]),
        qd=g1 * l,
        o=by_o5 * r,
    )
    return total, weight * total, by


def _where_positive(gradient: Tensor, x: Tensor) -> Tensor:
    """``gradient`` where ``x`` is positive, else 0; ``torch.where`` takes twenty times as long on a processor."""
    passed: Tensor = torch.ops.aten.threshold_backward(gradient, x, 0)
    return passed


def _larger(ci: Tensor, co: Tensor) -> Tensor:
    """1 where ``ci`` is the larger, 0 where it is the smaller, 1/2 where they are equal."""
    return 0.5 + 0.5 * (ci - co).sign()


def _below_one(rho: Tensor) -> Tensor:
    """1 where the albedo is at most 1, else 0: the derivative of the albedo clamped to 1."""
    return 1 - (rho - 1).sign().relu()
