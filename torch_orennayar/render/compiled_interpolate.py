"""`interpolate._values` and its gradients compiled by numba for CPU tensors, pixel by pixel.

Imported only where numba is installed. The arithmetic is in float64; faces, and so masks, are not decided here.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from ..core.compiled import Ints, compiled, inlined

Numbers = npt.NDArray[Any]


@inlined
def _weights(row: Numbers, x: float, y: float, planes: int) -> tuple[float, float, float, float, float]:
    """Two weights before and after they are limited to the face, and what they were divided by."""
    dx, dy = x - row[0], y - row[1]
    first = row[2 + 2 * planes] + row[2] * dx + row[2 + planes] * dy
    second = row[3 + 2 * planes] + row[3] * dx + row[3 + planes] * dy
    divisor = 1.0
    if planes == 3:
        divisor = row[10] + row[4] * dx + row[7] * dy
        first, second = first / divisor, second / divisor
    sum_or_one = max(max(first, 0.0) + max(second, 0.0), 1.0)
    return first, second, max(first, 0.0) / sum_or_one, max(second, 0.0) / sum_or_one, divisor


@inlined
def _between_corners(row: Numbers, at: int, w0: float, w1: float) -> tuple[float, float, float]:
    """The normal between those of the corners, before it is normalised."""
    return (
        row[at + 1] + w0 * row[at + 5] + w1 * row[at + 9],
        row[at + 2] + w0 * row[at + 6] + w1 * row[at + 10],
        row[at + 3] + w0 * row[at + 7] + w1 * row[at + 11],
    )


@compiled
def fill_maps(
    table: Numbers,
    index: Ints,
    begin: int,
    end: int,
    size: tuple[int, int],
    planes: int,
    width: int,
    cancelled: float,
    normal: Numbers,
    depth: Numbers,
    barycentric: Numbers,
) -> None:
    """Write the maps at some of the pixels.

    Args:
        table: (N, M) rows of faces as `interpolate._columns` makes them; the last stands for no face.
        index: (P,) row of every pixel of all views.
        begin: first pixel.
        end: behind the last.
        size: (H, W).
        planes: 3 if perspective, else 2.
        width: numbers per corner: 4 with normals, else 1.
        cancelled: length of a normal below which the face's is used.
        normal: (3, P).
        depth: (P,).
        barycentric: (3, P).
    """
    at = 2 + 3 * planes
    flat = at + 3 * width
    for p in range(begin, end):
        if index[p] == len(table) - 1:
            depth[p] = math.inf
            for axis in range(3):
                normal[axis, p] = 0.0
                barycentric[axis, p] = 0.0
            continue
        row = table[index[p]]
        _, _, w0, w1, _ = _weights(row, p % size[1] + 0.5, p // size[1] % size[0] + 0.5, planes)
        barycentric[0, p], barycentric[1, p], barycentric[2, p] = 1.0 - w0 - w1, w0, w1
        depth[p] = row[at] + w0 * row[at + width] + w1 * row[at + 2 * width]
        length, n0, n1, n2 = 0.0, 0.0, 0.0, 0.0
        if width == 4:
            n0, n1, n2 = _between_corners(row, at, w0, w1)
            length = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        if length < cancelled:  # also without normals
            for axis in range(3):
                normal[axis, p] = row[flat + axis]
        else:
            normal[0, p], normal[1, p], normal[2, p] = n0 / length, n1 / length, n2 / length


@inlined
def _unnormalised(
    row: Numbers, at: int, w0: float, w1: float, cancelled: float, g0: float, g1: float, g2: float
) -> tuple[bool, float, float, float]:
    """Gradient with respect to a normal before it is normalised, unless it is too short for that."""
    n0, n1, n2 = _between_corners(row, at, w0, w1)
    square = n0 * n0 + n1 * n1 + n2 * n2
    over = 1.0 / math.sqrt(max(square, cancelled * cancelled))
    along = (n0 * g0 + n1 * g1 + n2 * g2) * (over * over)
    return square >= cancelled * cancelled, (g0 - along * n0) * over, (g1 - along * n1) * over, (g2 - along * n2) * over


@compiled
def add_gradients(
    table: Numbers,
    index: Ints,
    begin: int,
    end: int,
    size: tuple[int, int],
    planes: int,
    width: int,
    cancelled: float,
    by_normal: Numbers,
    by_depth: Numbers,
    by_barycentric: Numbers,
    gradient: Numbers,
) -> None:
    """Add the gradients of some of the pixels to ``gradient`` (N, M); that of pixel centres, which are constant, is 0.

    Args:
        table: as in `fill_maps`, as are the others.
        index: (P,).
        begin: first pixel.
        end: behind the last.
        size: (H, W).
        planes: 2 or 3.
        width: 1 or 4.
        cancelled: length.
        by_normal: (3, P) gradient with respect to the map, as the next two.
        by_depth: (P,).
        by_barycentric: (3, P).
        gradient: (N, M), changed in place.
    """
    at = 2 + 3 * planes
    flat = at + 3 * width
    values = np.zeros(4)
    for p in range(begin, end):
        if index[p] == len(table) - 1:
            continue
        row, to = table[index[p]], gradient[index[p]]
        x, y = p % size[1] + 0.5, p // size[1] % size[0] + 0.5
        raw0, raw1, w0, w1, divisor = _weights(row, x, y, planes)
        values[0] = by_depth[p]
        n0, n1, n2 = by_normal[0, p], by_normal[1, p], by_normal[2, p]
        smooth = False
        if width == 4:
            smooth, values[1], values[2], values[3] = _unnormalised(row, at, w0, w1, cancelled, n0, n1, n2)
        if not smooth:
            values[1:] = 0.0
            to[flat] += n0
            to[flat + 1] += n1
            to[flat + 2] += n2
        g0, g1 = by_barycentric[1, p] - by_barycentric[0, p], by_barycentric[2, p] - by_barycentric[0, p]
        for j in range(width):
            g0 += values[j] * row[at + width + j]
            g1 += values[j] * row[at + 2 * width + j]
            to[at + j] += values[j]
            to[at + width + j] += w0 * values[j]
            to[at + 2 * width + j] += w1 * values[j]
        total = max(raw0, 0.0) + max(raw1, 0.0)
        if total >= 1.0:
            along = g0 * w0 + g1 * w1
            g0, g1 = (g0 - along) / total, (g1 - along) / total
        g0, g1 = (g0 if raw0 >= 0 else 0.0) / divisor, (g1 if raw1 >= 0 else 0.0) / divisor
        dx, dy = x - row[0], y - row[1]
        to[2] += g0 * dx
        to[3] += g1 * dx
        to[2 + planes] += g0 * dy
        to[3 + planes] += g1 * dy
        to[2 + 2 * planes] += g0
        to[3 + 2 * planes] += g1
        if planes == 3:
            g2 = -(g0 * raw0 + g1 * raw1)
            to[4] += g2 * dx
            to[7] += g2 * dy
            to[10] += g2
