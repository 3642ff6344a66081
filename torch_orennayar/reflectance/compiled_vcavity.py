"""The model ``vcavity`` and its derivatives for one direction, compiled by numba; imported only where it is installed.

`gradients.vcavity` is the definition; these are the same operations without the gradient with respect to roughness,
number by number instead of tensor by tensor (tests/reflectance/test_compiled_vcavity.py).
"""

from __future__ import annotations

import math

import numpy as np

from ..core.compiled import inlined
from .coefficients import VCAVITY_LINEAR, VCAVITY_SHAPE

_C, _BETA, _K0, _K1, _K2, _KAPPA, _TURN = (np.float32(v) for v in VCAVITY_SHAPE)
_A = tuple(np.float32(v) for v in VCAVITY_LINEAR[:14])
_G = tuple(np.float32(v) for v in VCAVITY_LINEAR[14:19])
_D = tuple(np.float32(v) for v in VCAVITY_LINEAR[19:])
_HALF, _ONE, _TWO, _TINY = np.float32(0.5), np.float32(1), np.float32(2), np.float32(1e-12)


@inlined
def vcavity(
    ci: np.float32, co: np.float32, lv: np.float32, rho: np.float32, sigma: np.float32
) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Value of `formulas.vcavity`, and its derivatives by ``ci``, ``co`` and ``rho``; arguments as there."""
    x = sigma * sigma
    y = x / (x + _C)
    yy = y * y
    b = min(rho, _ONE)
    over_b = _ONE / (_ONE - _BETA * b)
    l = y * (b * over_b)  # noqa: E741
    k = _K0 + _K1 * y + _K2 * yy
    m = _ONE - k
    turned = _KAPPA + _TURN * y
    q, p, h = ci * co, ci + co, _ONE + lv
    s, pp, mq = lv - q, p * p, m * q
    e = pp - _TWO * q
    whole_k = k + m * e
    over_u = _ONE / math.sqrt(mq * mq + k * whole_k)
    u = y * over_u
    apart = pp - _TWO * (h * q)
    r = _ONE / math.sqrt(pp + turned * apart + _TINY)
    hr, qr, pr, yp, qd, ss = h * r, q * r, p * r, yy * p, _D[3] * q, s * s
    o = _G[3] * qr + _G[4] * (h * p)

    z1 = _A[2] + _A[0] * hr
    z2 = _G[0] + _G[1] * yy + _G[2] * p
    z3 = _D[1] * q + _D[2] * h
    z4 = _D[0] + y * z3
    z = _A[1] * pr + _A[3] * yp + qr * z1 + b * z2 + l * z4
    o1 = _A[5] + _A[6] * q + _A[7] * pr
    o2 = _A[4] + y * o1
    o3 = _A[8] + _A[9] * s + _A[10] * yp
    o5 = r * o
    o6 = _A[11] + b * o5
    one = l * qd + hr * o2 + s * o3 + y * o6
    two = _A[12] + _A[13] * p + _D[4] * (l * ss)
    total = _ONE + y * z + u * (one + u * two)

    positive = np.float32(total > 0)
    g0 = positive * rho
    g1 = g0 * u
    g2, gz = g1 * u, g0 * y
    by_o1, by_o5 = g1 * hr * y, g1 * y * b
    by_o = by_o5 * r
    by_qr = gz * z1 + _G[3] * by_o
    by_l = gz * z4 + _D[3] * (g1 * q) + _D[4] * (g2 * ss)
    by_b = g1 * y * o5 + gz * z2 + by_l * y * (over_b * over_b)
    by_pr = _A[7] * by_o1 + _A[1] * gz
    by_root = by_o5 * o + (g1 * o2 + _A[0] * (gz * qr)) * h + by_qr * q + by_pr * p
    by_root *= -_HALF * (r * r * r)
    by_apart = by_root * turned
    by_under = -_HALF * (over_u * over_u) * (g0 * one + _TWO * (g1 * two)) * u
    by_mq, by_e = _TWO * (by_under * mq), by_under * k * m
    by_s = g1 * (o3 + _A[9] * s) + _TWO * _D[4] * (g2 * l * s)
    by_q = _D[1] * (gz * l * y) + _A[6] * by_o1 + by_mq * m + by_qr * r + _D[3] * (g1 * l)
    by_q -= _TWO * (by_apart * h + by_e) + by_s
    by_p = _A[13] * g2 + _G[2] * (gz * b) + (_A[3] * gz + _A[10] * (g1 * s)) * yy + by_pr * r
    by_p += _TWO * ((by_e + by_apart + by_root) * p) + _G[4] * (by_o * h)
    by_rho = positive * total + by_b * np.float32(rho <= 1)
    return g0 * total, by_p + by_q * co, by_p + by_q * ci, by_rho
