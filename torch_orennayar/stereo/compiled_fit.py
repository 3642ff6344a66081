"""`gauss_newton` compiled by numba for float32 on processors; imported only where numba is installed.

The same steps, pixel by pixel; only sums over the lights round differently. What a pixel gets depends on its own
numbers alone, not on the pixels and threads beside it. Compiled code is kept on disk beside this file, or in numba's
cache folder; the first use of all takes some seconds.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from ..core.compiled import Floats, Ints, compiled
from .compiled_response import ALBEDO, BY_HALF, BY_LIGHT, BY_VIEW, FIRST, RESIDUAL, VALUE, WEIGHT, respond
from .gauss_newton import DAMPING, LOBE_RIDGE, MAX_TILT, NEIGHBOUR_WEIGHT, Estimate, Quality
from .linear_systems import LEAST_PIVOT, MIN_NORMAL_Z
from .material import LightDirections, Material
from .robust_stats import CUTOFF, MAD_TO_SIGMA, NOISE_FLOOR, median_rank

MODELS = ("lambert", "vcavity")
"""Models that are compiled."""
UNUSED = np.float32(1e9)
"""What takes the place of the residual of an observation that does not count: above all others."""


def compiled_gauss_newton(
    seen: Tensor,
    selected: Tensor,
    mean: Tensor,
    directions: LightDirections,
    material: Material,
    start: Estimate,
    steps: int,
    prior: Tensor | None,
) -> tuple[Estimate, Quality]:
    """`gauss_newton.gauss_newton` for float32 on a processor, and a model of `MODELS`."""
    light, half = (d.reshape(-1, *d.shape[-2:]).mT.contiguous().numpy() for d in (directions.light, directions.half))
    found = Estimate(*(part.clone(memory_format=torch.contiguous_format) for part in start))
    quality = Quality(*(seen.new_empty(len(seen), 1) for _ in range(3)))
    rough = material.model != "lambert"
    _fit_pixels(
        seen.contiguous().numpy(), selected.contiguous().numpy(), median_rank(selected)[:, 0].numpy(),
        mean.contiguous().numpy(), light, half,
        np.float32(material.roughness if rough else material.minnaert_exponent), rough,
        np.array([exponent.bit_length() - 1 for exponent in material.exponents], np.int64), steps,
        (prior if prior is not None else seen.new_empty(0, 3)).contiguous().numpy(),
        found.normal.numpy(), found.albedo.numpy(), found.lobes.numpy(),
        quality.noise.numpy(), quality.residual.numpy(), quality.spread.numpy(),
    )  # fmt: skip
    return found, quality


@compiled
def _fit_pixels(
    seen: Floats,
    selected: Floats,
    rank: Ints,
    mean: Floats,
    light: Floats,
    half: Floats,
    number: np.float32,
    rough: bool,
    squarings: Ints,
    steps: int,
    prior: Floats,
    normal: Floats,
    albedo: Floats,
    lobes: Floats,
    noise: Floats,
    missed: Floats,
    spread: Floats,
) -> None:
    """Improve ``normal``, ``albedo`` and ``lobes`` in place and write the three measures of quality.

    Args:
        seen: (P, K) observations over ``mean``.
        selected: (P, K).
        rank: (P,) rank of the median of a pixel's residuals.
        mean: (P, 1).
        light: (1 or P, 3, K).
        half: the same shape.
        number: the roughness, or the exponent of Minnaert's law.
        rough: whether it is a roughness.
        squarings: (L,) logarithms to base 2 of the lobes' exponents.
        steps: number of them.
        prior: (P, 3), or (0, 3) for none.
        normal: (P, 3).
        albedo: (P, 1).
        lobes: (P, L).
        noise: (P, 1).
        missed: (P, 1) mean absolute residual.
        spread: (P, 1).
    """
    count = len(squarings)
    size = 3 + count
    table = np.empty((ALBEDO + 1 + count, seen.shape[1]), np.float32)
    tangents = np.empty((2, 3), np.float32)
    curvature, matrix = np.empty((size, size), np.float32), np.empty((size, size), np.float32)
    system, right = np.empty((size, size), np.float32), np.empty(size, np.float32)
    step, target = np.empty(size, np.float32), np.empty(size, np.float32)
    for p in range(len(seen)):
        at = p if len(light) > 1 else 0
        level = np.float32(0.1)
        for _ in range(steps):
            respond(table, normal[p], albedo[p, 0], lobes[p], light[at], half[at], mean[p, 0], number, rough, squarings)
            level = _noise(table, seen[p], selected[p], rank[p], level)
            _set_tangents(tangents, normal[p])
            _weigh(table, selected[p], level)
            _fill_jacobian(table, tangents, light[at], half[at], count)
            _normal_equations(table, curvature, right)
            _regularise(matrix, curvature, right, lobes[p], np.float32(1e-9 * seen.shape[1]))
            if len(prior):
                _pull(matrix, right, tangents, normal[p], prior[p], level)
            _nonnegative_step(matrix, right, lobes[p], system, target, step)
            _tilt(normal[p], tangents, step)
            albedo[p, 0] = max(albedo[p, 0] + step[2], np.float32(1e-6))
            for i in range(count):
                lobes[p, i] = max(lobes[p, i] + step[3 + i], np.float32(0))
        respond(table, normal[p], albedo[p, 0], lobes[p], light[at], half[at], mean[p, 0], number, rough, squarings)
        level = _noise(table, seen[p], selected[p], rank[p], level)
        noise[p, 0] = level
        missed[p, 0] = np.abs(table[RESIDUAL]).sum() / np.float32(seen.shape[1])
        spread[p, 0] = level * _unit_spread(curvature, system, target, step)


@compiled
def _noise(table: Floats, seen: Floats, selected: Floats, rank: int, guess: np.float32) -> np.float32:
    """Write the residuals; `robust_stats.noise_level` of them, sought about a guess."""
    magnitude = table[WEIGHT]
    for k in range(len(seen)):
        residual = seen[k] - table[VALUE, k]
        table[RESIDUAL, k] = residual
        magnitude[k] = abs(residual) if selected[k] > 0 else UNUSED
    noise: np.float32 = max(np.float32(MAD_TO_SIGMA) * _ranked(magnitude, rank, guess), np.float32(NOISE_FLOOR))
    return noise


@compiled
def _ranked(values: Floats, rank: int, guess: np.float32) -> np.float32:
    """The value of that rank among values that are not negative, by halving an interval about a guess above 0."""
    low, high, middle = np.float32(-1), np.float32(np.inf), guess
    for _ in range(100):  # far fewer, unless values are not numbers
        below = np.float32(0)
        for k in range(len(values)):
            below += np.float32(1) if values[k] <= middle else np.float32(0)
        if below > rank:
            high = middle
        else:
            low = middle
        middle = np.float32(0.5) * (low + high) if high < UNUSED else np.float32(2) * middle
        if below == rank + 1 or not low < middle < high:
            break
    largest: np.float32 = np.float32(0)
    for k in range(len(values)):
        value = values[k] if values[k] <= high else np.float32(0)
        largest = value if value > largest else largest
    return largest


@compiled
def _weigh(table: Floats, selected: Floats, noise: np.float32) -> None:
    """`robust_stats.geman_mcclure`."""
    over = np.float32(1) / (np.float32(CUTOFF) * noise)
    for k in range(len(selected)):
        share = table[RESIDUAL, k] * over
        root = np.float32(1) / (np.float32(1) + share * share)
        table[WEIGHT, k] = selected[k] * (root * root)


@compiled
def _set_tangents(tangents: Floats, normal: Floats) -> None:
    """`linear_systems.tangent_vectors`."""
    x, y, z = normal[0], normal[1], normal[2]
    over = np.float32(1) / max(math.sqrt(x * x + z * z), np.float32(1e-12))
    a, c = z * over, -x * over
    tangents[0, 0], tangents[0, 1], tangents[0, 2] = a, np.float32(0), c
    tangents[1, 0], tangents[1, 1], tangents[1, 2] = y * c, z * a - x * c, -y * a


@compiled
def _fill_jacobian(table: Floats, tangents: Floats, light: Floats, half: Floats, count: int) -> None:
    """`gauss_newton.fill_jacobian`: the derivatives by two tangent angles."""
    for i in range(2):
        x, y, z = tangents[i, 0], tangents[i, 1], tangents[i, 2]
        for k in range(table.shape[1]):
            column = (light[0, k] * x + light[1, k] * y + light[2, k] * z) * table[BY_LIGHT, k]
            table[FIRST + i, k] = column + table[BY_VIEW, k] * z
        if count:
            for k in range(table.shape[1]):
                table[FIRST + i, k] += (half[0, k] * x + half[1, k] * y + half[2, k] * z) * table[BY_HALF, k]


@compiled
def _normal_equations(table: Floats, matrix: Floats, right: Floats) -> None:
    """`gauss_newton._normal_equations`: the matrix's upper triangle, and the right side."""
    for i in range(len(right)):
        for k in range(table.shape[1]):
            table[VALUE, k] = table[WEIGHT, k] * table[FIRST + i, k]
        for j in range(i, len(right)):
            matrix[i, j] = _dot(table[VALUE], table[FIRST + j])
        right[i] = _dot(table[VALUE], table[RESIDUAL])


@compiled
def _dot(a: Floats, b: Floats) -> np.float32:
    total: np.float32 = np.float32(0)
    for k in range(len(a)):
        total += a[k] * b[k]
    return total


@compiled
def _solve(matrix: Floats, right: Floats, rows: Floats, target: Floats, solution: Floats) -> None:
    """`linear_systems.solve_symmetric` of one system; ``rows`` and ``target`` are overwritten."""
    size = len(right)
    rows[:] = matrix
    target[:] = right
    for i in range(size):
        pivot = rows[i, i]
        inverse = np.float32(1) / pivot if pivot > np.float32(LEAST_PIVOT) * matrix[i, i] else np.float32(0)
        for j in range(i + 1, size):
            factor = rows[i, j] * inverse
            for k in range(j, size):
                rows[j, k] -= factor * rows[i, k]
            target[j] -= factor * target[i]
        rows[i, i] = inverse
    for i in range(size - 1, -1, -1):
        total = target[i]
        for k in range(i + 1, size):
            total -= rows[i, k] * solution[k]
        solution[i] = total * rows[i, i]


@compiled
def _regularise(matrix: Floats, curvature: Floats, right: Floats, lobes: Floats, ridge: np.float32) -> None:
    """Write the matrix of a damped step, in which lobes are drawn to 0."""
    matrix[:] = curvature
    for i in range(len(right)):
        matrix[i, i] = matrix[i, i] * np.float32(1 + DAMPING) + ridge
    for i in range(len(lobes)):
        matrix[3 + i, 3 + i] += np.float32(LOBE_RIDGE)
        right[3 + i] -= np.float32(LOBE_RIDGE) * lobes[i]


@compiled
def _pull(matrix: Floats, right: Floats, tangents: Floats, normal: Floats, prior: Floats, noise: np.float32) -> None:
    """Draw a normal to its neighbours' by what the pixel's noise is above the floor."""
    weight = np.float32(NEIGHBOUR_WEIGHT) * (noise * noise - np.float32(NOISE_FLOOR**2))
    for i in range(2):
        matrix[i, i] += weight
        for axis in range(3):
            right[i] += weight * (prior[axis] - normal[axis]) * tangents[i, axis]


@compiled
def _nonnegative_step(matrix: Floats, right: Floats, lobes: Floats, rows: Floats, target: Floats, step: Floats) -> None:
    """`gauss_newton._nonnegative_step`."""
    _solve(matrix, right, rows, target, step)
    stopped = False
    for i in range(len(lobes)):
        at = 3 + i
        if lobes[i] + step[at] < 0:
            penalty = np.float32(1e4) * matrix[at, at]
            right[at] = -penalty * lobes[i]
            matrix[at, at] += penalty
            stopped = True
    if stopped:
        _solve(matrix, right, rows, target, step)


@compiled
def _tilt(normal: Floats, tangents: Floats, step: Floats) -> None:
    """`gauss_newton.tilted`, in place."""
    limit = np.float32(MAX_TILT)
    share = limit / max(math.sqrt(step[0] * step[0] + step[1] * step[1]), limit)
    for axis in range(3):
        normal[axis] += share * (step[0] * tangents[0, axis] + step[1] * tangents[1, axis])
    _normalize(normal)
    normal[2] = max(normal[2], np.float32(MIN_NORMAL_Z))
    _normalize(normal)


@compiled
def _normalize(vector: Floats) -> None:
    square = vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]
    over = np.float32(1) / math.sqrt(max(square, np.float32(1e-36)))
    for axis in range(3):
        vector[axis] *= over


@compiled
def _unit_spread(curvature: Floats, rows: Floats, target: Floats, solution: Floats) -> np.float32:
    """`gauss_newton._unit_spread`."""
    trace = np.float32(0)
    basis = np.zeros(len(target), np.float32)
    for axis in range(2):
        basis[axis] = 1
        _solve(curvature, basis, rows, target, solution)
        trace += solution[axis]
        basis[axis] = 0
    spread: np.float32 = np.float32(math.sqrt(trace)) if trace > 0 else np.float32(np.inf)
    return spread
