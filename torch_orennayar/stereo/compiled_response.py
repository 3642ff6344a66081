"""`material.respond` of one pixel compiled by numba; imported only where it is installed.

Every function fills rows of a table (N, K) for the pixel's K lights.
"""

from __future__ import annotations

import math

import numpy as np

from ..core.compiled import Floats, Ints, compiled, inlined
from ..reflectance.compiled_vcavity import vcavity

VALUE, BY_LIGHT, BY_VIEW, BY_HALF, RESIDUAL, WEIGHT, CI, NH, FIRST, SECOND, ALBEDO = range(11)
"""Rows of a pixel's table, of K numbers each; those of lobes follow that of the albedo."""


@compiled
def respond(
    table: Floats,
    normal: Floats,
    albedo: np.float32,
    lobes: Floats,
    light: Floats,
    half: Floats,
    mean: np.float32,
    number: np.float32,
    rough: bool,
    squarings: Ints,
) -> None:
    """`material.respond` of one pixel."""
    x, y, z = normal[0], normal[1], normal[2]
    if rough:
        _respond_rough(table, light, x, y, z, albedo, mean, number)
    elif number != 1:
        _respond_minnaert(table, light, x, y, z, albedo, number)
    else:
        for k in range(table.shape[1]):
            raw = light[0, k] * x + light[1, k] * y + light[2, k] * z
            ci = max(raw, np.float32(0))
            table[CI, k] = ci
            table[ALBEDO, k] = ci
            table[VALUE, k] = albedo * ci
            table[BY_LIGHT, k] = albedo * np.float32(raw > 0)
            table[BY_VIEW, k] = 0
    for k in range(table.shape[1]):
        table[BY_HALF, k] = 0
    if not len(squarings):
        return
    for k in range(table.shape[1]):
        table[NH, k] = max(half[0, k] * x + half[1, k] * y + half[2, k] * z, np.float32(1e-6))
    for i in range(len(squarings)):
        _add_lobe(table, ALBEDO + 1 + i, lobes[i], squarings[i])
    for k in range(table.shape[1]):
        table[BY_HALF, k] *= table[CI, k] / table[NH, k]


@compiled
def _respond_rough(
    table: Floats,
    light: Floats,
    x: np.float32,
    y: np.float32,
    z: np.float32,
    albedo: np.float32,
    mean: np.float32,
    sigma: np.float32,
) -> None:
    """`material._rough` of one pixel."""
    over = np.float32(1) / mean
    for k in range(table.shape[1]):
        raw = light[0, k] * x + light[1, k] * y + light[2, k] * z
        lit = np.float32(raw > 0)
        ci = max(raw if raw > 0 else np.float32(1), np.float32(1e-4))
        value, by_ci, by_co, by_rho = vcavity(ci, z, light[2, k], albedo * mean, sigma)
        value *= lit * over
        table[CI, k] = max(raw, np.float32(0))
        table[VALUE, k] = value * ci
        table[BY_LIGHT, k] = value + ci * by_ci * lit * over
        table[BY_VIEW, k] = ci * by_co * lit * over
        table[ALBEDO, k] = ci * by_rho * lit


@compiled
def _respond_minnaert(
    table: Floats, light: Floats, x: np.float32, y: np.float32, z: np.float32, albedo: np.float32, exponent: np.float32
) -> None:
    """`material._minnaert` of one pixel."""
    by_view = z ** (exponent - np.float32(1))
    for k in range(table.shape[1]):
        raw = light[0, k] * x + light[1, k] * y + light[2, k] * z
        lit = np.float32(raw > 0)
        safe = max(raw, np.float32(1e-4))
        column = safe * _power(safe, exponent - np.float32(1)) * lit * by_view
        value = albedo * column
        table[CI, k] = max(raw, np.float32(0))
        table[ALBEDO, k] = column
        table[VALUE, k] = value
        table[BY_LIGHT, k] = value * exponent / safe
        table[BY_VIEW, k] = value * (exponent - np.float32(1)) / z


@inlined
def _power(base: np.float32, exponent: np.float32) -> np.float32:
    """``base**exponent`` for a base in [1e-4, 1] and an exponent below 1, in operations that are vectorised.

    The logarithm of the base's 32nd root is a short series, and so is the 16th root of the exponential function.
    """
    root = math.sqrt(math.sqrt(math.sqrt(math.sqrt(math.sqrt(base)))))  # 0.75 to 1
    s = (root - np.float32(1)) / (root + np.float32(1))
    ss = s * s
    logarithm = s * (np.float32(2) + ss * (np.float32(2 / 3) + ss * (np.float32(2 / 5) + ss * np.float32(2 / 7))))
    a = (np.float32(2) * exponent) * logarithm  # -0.58 to 0
    sixth = np.float32(1 / 120) + a * (np.float32(1 / 720) + a * np.float32(1 / 5040))
    series = np.float32(1) + a * (
        np.float32(1) + a * (np.float32(1 / 2) + a * (np.float32(1 / 6) + a * (np.float32(1 / 24) + a * sixth)))
    )
    series *= series
    series *= series
    series *= series
    power: np.float32 = series * series
    return power


@compiled
def _add_lobe(table: Floats, row: int, strength: np.float32, squarings: int) -> None:
    """Add a lobe to the value and the derivatives, and write its own derivative."""
    for k in range(table.shape[1]):
        table[row, k] = table[NH, k]
    for _ in range(squarings):
        for k in range(table.shape[1]):
            table[row, k] *= table[row, k]
    exponent = np.float32(2**squarings)
    for k in range(table.shape[1]):
        power = table[row, k]
        column, shining = power * table[CI, k], strength * power
        table[row, k] = column
        table[VALUE, k] += strength * column
        table[BY_LIGHT, k] += shining * np.float32(table[CI, k] > 0)
        table[BY_HALF, k] += shining * exponent
