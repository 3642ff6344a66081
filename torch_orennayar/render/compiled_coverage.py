"""The coverage of `raster` and `spans` compiled by numba for CPU tensors: the same whole numbers, face by face.

Imported only where numba is installed. Every operation on whole numbers is exact in both, and those on depths round in
the same order, so that the keys are equal to the last bit (tests/render/test_compiled.py). Compiled code is
kept on disk beside this file, or in numba's cache folder; the first use of all takes some seconds.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from ..core.compiled import Floats, Ints
from .spans import DEPTH_BITS, FACE_BITS, GRID, ROWS

STEPS = int(GRID)
"""Steps per pixel to which corners are rounded."""
HIGHEST = 2.0**DEPTH_BITS
"""Largest change of a depth key per column."""


@numba.njit(cache=True, nogil=True)
def enter_faces(
    best: Ints,
    x: Floats,
    y: Floats,
    z: Ints,
    corners: Ints,
    faces: Ints,
    views: Ints,
    height: int,
    width: int,
    shown: int,
    low: int,
    high: int,
) -> None:
    """Enter faces into the keys of some rows, which keep the smallest key of each pixel.

    Args:
        best: (pixels of all views,), changed in place.
        x: columns of the points in steps, whole numbers, or NaN where a face must be clipped first.
        y: rows of the points in steps.
        z: depth keys of the points.
        corners: (3, T) points of each face.
        faces: (T,) index of each face in the mesh.
        views: (T,) view of each face.
        height: rows of a view.
        width: columns of a view.
        shown: 1 or -1 for faces of that sign of area alone, 0 for both.
        low: first row, counted through all views.
        high: behind the last.
    """
    half = STEPS // 2
    px, py, pz = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3, np.int64)
    for t in range(corners.shape[1]):
        above, below = low - views[t] * height, high - views[t] * height  # in the face's view
        if above >= height or below <= 0:
            continue
        a, b, c = corners[0, t], corners[1, t], corners[2, t]
        if not (math.isfinite(x[a] + x[b] + x[c]) and math.isfinite(y[a] + y[b] + y[c])):
            continue
        px[0], px[1], px[2] = int(x[a]), int(x[b]), int(x[c])
        py[0], py[1], py[2] = int(y[a]), int(y[b]), int(y[c])
        first = max(0, (py.min() + half - 1) // STEPS)
        last = min(height, (py.max() + half - 1) // STEPS)
        left = max(0, (px.min() + half - 1) // STEPS)
        right = min(width, (px.max() + half - 1) // STEPS)
        area = (px[1] - px[0]) * (py[2] - py[1]) - (py[1] - py[0]) * (px[2] - px[1])
        if (
            first >= min(last, below)
            or last <= above
            or left >= right
            or area == 0
            or (shown != 0 and (area > 0) != (shown > 0))
        ):
            continue
        pz[0], pz[1], pz[2] = z[a], z[b], z[c]
        for k in range(3):
            px[k] -= left * STEPS + half
        for row in range(first, last, ROWS):  # in pieces, as depths are rounded relative to the first row of each
            _enter_piece(
                best, px, py, pz, area, row, min(row + ROWS, last), left, width,
                views[t] * height * width, faces[t], above, below,
            )  # fmt: skip


@numba.njit(cache=True, nogil=True)
def _enter_piece(
    best: Ints,
    px: Ints,
    rows: Ints,
    pz: Ints,
    area: int,
    first: int,
    last: int,
    left: int,
    width: int,
    start: int,
    face: int,
    above: int,
    below: int,
) -> None:
    """Enter the rows ``first`` to ``last`` of a face that lie from ``above`` to ``below``, columns from ``left``."""
    py = rows - (first * STEPS + STEPS // 2)
    x1, x2, y1, y2 = float(px[1] - px[0]), float(px[2] - px[0]), float(py[1] - py[0]), float(py[2] - py[0])
    z1, z2 = float(pz[1] - pz[0]), float(pz[2] - pz[0])
    inverse = 1.0 / (x1 * y2 - y1 * x2)
    along, down = (z1 * y2 - z2 * y1) * inverse, (z2 * x1 - z1 * x2) * inverse
    base = along * px[0] + down * py[0]
    lowest, highest = min(z1, z2, 0.0), max(z1, z2, 0.0)
    step = int(min(max(np.rint(along * GRID), -HIGHEST), HIGHEST)) << FACE_BITS
    for row in range(max(above - first, 0), min(last, below) - first):
        begin, stop = 0, width - left
        for k in range(3):
            n = (k + 1) % 3
            dx, dy = px[n] - px[k], py[n] - py[k]
            if dy == 0:
                continue
            divided, divisor = dx * STEPS * row + px[k] * dy - dx * py[k], dy * STEPS
            crossing = -((-divided) // divisor)  # rounded up
            if (dy > 0) == (area > 0):
                stop = min(stop, crossing)
            else:
                begin = max(begin, crossing)
        if begin >= stop:
            continue
        depth = ((down * GRID) * row + (along * GRID) * begin) - base
        key = ((int(np.rint(min(max(depth, lowest), highest))) + pz[0]) << FACE_BITS) + face
        place = start + (first + row) * width + left + begin
        for _ in range(stop - begin):
            if key < best[place]:
                best[place] = key
            key += step
            place += 1
