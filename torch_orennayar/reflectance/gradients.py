"""Gradients of reflectance models by hand: in few operations, without the branches of autograd.

Each function takes a model's arguments and ``weight``, the gradient that arrives at its value, and returns the value
and what goes on to each argument: weight times the derivative, not yet summed over broadcast axes, None for 0. They are
what the layer's backward runs on (`evaluation`); the formulas themselves are in `reflectance`, and
``tests/reflectance/test_gradients.py`` holds one against the other. Where a formula has a kink, both sides count alike:

- light and view at one angle from the normal (``ci = co``): the mean of both sides;
- light and view at right angles about the normal (``s = 0``) in the classic form: the side without the term;
- albedo exactly 1: inter-reflection counts as below 1.

Products and sums are fused by ``addcmul`` and by ``add`` with ``alpha``, half as many passes over memory.
"""

from __future__ import annotations

import torch
from torch import Tensor, add, addcmul

from .coefficients import VCAVITY_LINEAR, VCAVITY_SHAPE

Partials = tuple[Tensor | None, Tensor | None, Tensor | None, Tensor | None, Tensor | None]


def lambert(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor, weight: Tensor) -> tuple[Tensor, Partials]:
    """Of `reflectance.lambert`."""
    return rho, (None, None, None, weight, None)


def qualitative(
    ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor, weight: Tensor
) -> tuple[Tensor, Partials]:
    """Of `reflectance.qualitative`."""
    return _classic(ci, co, lv, rho, sigma, weight, 0.33)


def qualitative_057(
    ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor, weight: Tensor
) -> tuple[Tensor, Partials]:
    """Of `reflectance.qualitative_057`."""
    return _classic(ci, co, lv, rho, sigma, weight, 0.57)


def _classic(
    ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor, weight: Tensor, a_constant: float
) -> tuple[Tensor, Partials]:
    """Of `reflectance._classic`: ``rho (A + B t)`` with ``t = max(0, s) / max(ci, co)``."""
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
    ahead = _ahead(ci, co)
    by_ci = addcmul(by_largest * ahead, by_s, co).neg()
    by_co = addcmul(addcmul(by_largest, by_largest, ahead, value=-1), by_s, ci).neg()
    by_x = addcmul((0.45 * 0.09) * (over_b * over_b) * t, over_a, over_a, value=-0.5 * a_constant)
    return rho * whole, (by_ci, by_co, by_s, weight * whole, 2 * (inner * sigma) * by_x)


def fujii(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor, weight: Tensor) -> tuple[Tensor, Partials]:
    """Of `reflectance.fujii`: ``rho (A + C b + B t)`` with ``t = min(0, s) + max(0, s) / max(ci, co)``."""
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
    ahead = _ahead(ci, co)
    by_ci = addcmul(by_largest * ahead, by_s, co).neg()
    by_co = addcmul(addcmul(by_largest, by_largest, ahead, value=-1), by_s, ci).neg()
    by_x = addcmul((0.45 * 0.09) * (over_b * over_b) * t, over_a, over_a, value=-0.5 * 0.33)
    by_x = addcmul(by_x, over_c * over_c, bounce, value=0.17 * 0.13)
    by_rho = addcmul(weight * whole, inner * c, _below_one(rho))
    return rho * whole, (by_ci, by_co, by_s, by_rho, 2 * (inner * sigma) * by_x)


def vcavity(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor, weight: Tensor) -> tuple[Tensor, Partials]:
    """Of `reflectance.vcavity`: through the lines of `reflectance.vcavity_form` and back."""
    c, beta, k0, k1, k2, kappa, turn = VCAVITY_SHAPE
    a, g, d = VCAVITY_LINEAR[:14], VCAVITY_LINEAR[14:19], VCAVITY_LINEAR[19:]
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
    hr, qr, pr, yp, hp = h * r, q * r, p * r, yy * p, h * p
    z1 = a[2] + a[0] * hr
    z2 = add(g[0] + g[1] * yy, p, alpha=g[2])
    z3 = add(d[1] * q, h, alpha=d[2])
    z4 = d[0] + y * z3
    z = addcmul(addcmul(addcmul(add(a[1] * pr, yp, alpha=a[3]), qr, z1), b, z2), l, z4)
    o1 = add(a[5] + a[6] * q, pr, alpha=a[7])
    o2 = a[4] + y * o1
    o3 = add(a[8] + a[9] * s, yp, alpha=a[10])
    o4 = add(g[3] * qr, hp, alpha=g[4])
    o5 = r * o4
    o6 = a[11] + b * o5
    one = addcmul(addcmul(addcmul(l * (d[3] * q), hr, o2), s, o3), y, o6)
    ss = s * s
    two = addcmul(a[12] + a[13] * p, l, ss, value=d[4])
    outer = u * two
    total = addcmul(1 + y * z, u, one + outer)
    weight = _where_positive(weight, total)

    # Back. `by_x` is what arrives at x; g0, g1, g2 what arrives at y z, one and two. All have the weight's shape.
    g0 = weight * rho
    g1 = g0 * u
    g2 = g1 * u
    gz, gl = g0 * y, g1 * l
    by_z4 = gz * l
    by_z3 = by_z4 * y
    by_o1 = g1 * hr
    by_y = (g0 * z).addcmul_(g1, o6).addcmul_(by_o1, o1).addcmul_(by_z4, z3)
    by_o1 *= y
    by_o6 = g1 * y
    by_o5 = by_o6 * b
    by_o4 = by_o5 * r
    by_z2 = gz * b
    by_yp = (a[3] * gz).addcmul_(g1, s, value=a[10])
    by_s = (g1 * o3).addcmul_(g1, s, value=a[9]).addcmul_(g2 * l, s, value=2 * d[4])
    by_l = (gz * z4).addcmul_(g1, q, value=d[3]).addcmul_(g2, ss, value=d[4])
    by_hr = (g1 * o2).addcmul_(gz, qr, value=a[0])
    by_qr = (gz * z1).add_(by_o4, alpha=g[3])
    by_pr = (a[7] * by_o1).add_(gz, alpha=a[1])
    by_b = (by_o6 * o5).addcmul_(gz, z2).addcmul_(by_l * y, over_b * over_b)
    by_root = (by_o5 * o4).addcmul_(by_hr, h).addcmul_(by_qr, q).addcmul_(by_pr, p).mul_(-0.5 * (r * r * r))
    by_apart = by_root * turned
    by_u = (g0 * one).addcmul_(g0, outer, value=2)
    by_under = (by_u * u).mul_(-0.5 * (over_u * over_u))
    by_whole_k = by_under * k
    by_mq = 2 * (by_under * mq)
    by_e = by_whole_k * m
    by_k = (by_under * whole_k).add_(by_whole_k).addcmul_(by_mq, q, value=-1).addcmul_(by_whole_k, e, value=-1)
    by_pp = by_e + by_apart + by_root
    by_yy = (g[1] * by_z2).addcmul_(by_yp, p).add_(by_k, alpha=k2)
    by_y.addcmul_(by_u, over_u).add_(by_k, alpha=k1).addcmul_(by_root, apart, value=turn)
    by_y.addcmul_(by_l, bounces).addcmul_(by_yy, y, value=2)
    by_q = (d[1] * by_z3).add_(by_o1, alpha=a[6]).addcmul_(by_mq, m).addcmul_(by_qr, r).add_(gl, alpha=d[3])
    by_q.addcmul_(by_apart, h, value=-2).add_(by_e, alpha=-2).sub_(by_s)
    by_p = (a[13] * g2).add_(by_z2, alpha=g[2]).addcmul_(by_yp, yy).addcmul_(by_pr, r)
    by_p.addcmul_(by_pp, p, value=2).addcmul_(by_o4, h, value=g[4])
    by_h = (d[2] * by_z3).addcmul_(by_hr, r).addcmul_(by_apart, q, value=-2).addcmul_(by_o4, p, value=g[4])
    by_rho = (weight * total).addcmul_(by_b, _below_one(rho))
    by_sigma = by_y.mul_(sigma * ((2 * c) * (over_x * over_x)))
    return rho * total.relu(), (addcmul(by_p, by_q, co), addcmul(by_p, by_q, ci), by_s.add_(by_h), by_rho, by_sigma)


def _where_positive(gradient: Tensor, x: Tensor) -> Tensor:
    """``gradient`` where ``x`` is positive, else 0, as relu's own backward: a selection costs twenty times as much."""
    passed: Tensor = torch.ops.aten.threshold_backward(gradient, x, 0)
    return passed


def _ahead(ci: Tensor, co: Tensor) -> Tensor:
    """1 where ``ci`` is the larger, 0 where it is the smaller, 1/2 where they are equal."""
    return 0.5 + 0.5 * (ci - co).sign()


def _below_one(rho: Tensor) -> Tensor:
    """1 where albedo is at most 1, up to which inter-reflection follows it, else 0."""
    return 1 - (rho - 1).sign().relu()
