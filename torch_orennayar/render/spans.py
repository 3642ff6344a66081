"""Coverage: the span of pixels that a face covers in each row, and the keys that it enters there."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core import torch_private
from ..core.optional import available

GRID = 256.0
"""Steps per pixel to which corners are rounded: 8 subpixel bits, as Direct3D requires of hardware."""
FACE_BITS = 26
"""Low bits of a key, for the index of the face: 67 million faces."""
DEPTH_BITS = 37
"""High bits of a key, for the depth: with those of the face they fill a non-negative int64."""
ROWS = 16
"""Largest number of rows in one piece of a face; taller faces are split. Set by hand; affects speed only."""
FRAGMENTS = 1 << 17
"""About how many covered pixels are entered per step, whole rows of faces: bounds the memory. Set by hand."""


def exporting() -> bool:
    """Whether a graph is being traced, in which everything is computed in one piece."""
    return torch.compiler.is_exporting()


def is_compiled(values: Tensor) -> bool:
    """Whether numba's code takes these values: on a CPU, where numba is installed, and where no graph is traced."""
    return values.device.type == "cpu" and not torch.compiler.is_compiling() and available("numba")


def least(t: Tensor) -> Tensor:
    """Minimum of three rows."""
    return torch.minimum(torch.minimum(t[0], t[1]), t[2])


def most(t: Tensor) -> Tensor:
    """Maximum of three rows."""
    return torch.maximum(torch.maximum(t[0], t[1]), t[2])


class Spans(NamedTuple):
    """Covered pixels of every row of N faces, (rows, N) each.

    Attributes:
        begin: first column, from the left of the face's bounding box; whole numbers.
        number: number of columns, int32; 0 where a row is not covered.
        depth: depth key at the first column, int64.
        step: increase of the depth key per column, int64.
    """

    begin: Tensor
    number: Tensor
    depth: Tensor
    step: Tensor


def cover(
    x: Tensor,
    y: Tensor,
    z: Tensor,
    row: Tensor,
    end: Tensor,
    left: Tensor,
    width: int,
    dtype: torch.dtype,
    cull: str | None,
) -> Spans:
    """The spans of N faces in rows ``row`` to ``end``, in whole numbers from the centre of pixel (``row``, ``left``).

    All products are whole numbers that ``dtype`` represents exactly, and a quotient that is not whole differs from the
    next whole number by more than its rounding error, so that every ceiling is exact.

    Args:
        x: (3, N) columns of the corners in steps.
        y: (3, N) rows of the corners in steps.
        z: (3, N) depth keys of the corners, int64.
        row: (N,) first row.
        end: (N,) row after the last one.
        left: (N,) first column of the bounding box.
        width: columns of the image.
        dtype: float32 or float64, which must hold the products.
        cull: ``"back"`` or ``"front"`` faces to leave out, or None.
    """
    x = x.to(dtype).sub_((left * GRID).add_(GRID / 2))
    y = y.to(dtype).sub_((row * GRID).add_(GRID / 2))
    dx, dy = (torch.cat((t[1:], t[:1])).sub_(t) for t in (x, y))
    area = (dx[0] * dy[1]).sub_(dy[0] * dx[1])
    rows = torch.arange(ROWS if exporting() else int((end - row).max()), dtype=dtype, device=x.device)[:, None]
    level = dy.abs().clamp_max_(1).neg_().add_(1)  # 1 for an edge parallel to the rows, which bounds no span
    crossing = ((dx * GRID)[:, None] * rows).add_((x * dy).sub_(dx * y)[:, None])
    crossing = crossing.div_((dy * GRID).add_(level)[:, None]).ceil_()
    side = dy * area
    never = 1e30
    begin = most(crossing + (side < 0).to(dtype).sub_(1).mul_(never)[:, None]).clamp_min_(0)
    stop = least(crossing.add_((side > 0).to(dtype).sub_(1).mul_(-never)[:, None]))
    stop = torch.minimum(stop, (width - left).to(dtype))
    height = (end - row).to(dtype) * (area.abs().clamp_max_(1) if cull is None else _shown(area, cull))
    number = stop.sub_(begin).clamp_min_(0).mul_((height - rows).clamp_(0, 1)).to(torch.int32)
    depth, step = _depths(x.double(), y.double(), z, begin, rows)
    return Spans(begin, number, depth, step)


def _depths(x: Tensor, y: Tensor, z: Tensor, begin: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
    """Depth key at the column ``begin`` of every row, clamped to the range of the corners, and its step per column."""
    x1, x2, y1, y2 = x[1] - x[0], x[2] - x[0], y[1] - y[0], y[2] - y[0]
    z1, z2 = (z[1] - z[0]).double(), (z[2] - z[0]).double()
    area = x1 * y2 - y1 * x2
    inverse = torch.ones_like(area).div_(area + (area == 0))  # a division, since runtimes approximate reciprocals
    along = (z1 * y2).sub_(z2 * y1).mul_(inverse)
    down = (z2 * x1).sub_(z1 * x2).mul_(inverse)
    depth = ((down * GRID) * rows).add_((along * GRID) * begin).sub_((along * x[0]).add_(down * y[0]))
    low, high = torch.minimum(z1, z2).clamp_max_(0), torch.maximum(z1, z2).clamp_min_(0)
    depth = torch.minimum(torch.maximum(depth, low), high).round_().long().add_(z[0])
    return depth, (along * GRID).round_().clamp_(-(2.0**DEPTH_BITS), 2.0**DEPTH_BITS).long()


def _shown(area: Tensor, cull: str) -> Tensor:
    """1 for faces that are not culled; seen from the front, corners are clockwise in rows and columns."""
    return (area if cull == "front" else -area).clamp(0, 1)


def enter(best: Tensor, spans: Spans, start: Tensor, face: Tensor, width: int) -> None:
    """Enter the keys of all spans into ``best``, which keeps the smallest key of each pixel.

    Args:
        best: (pixels of all views,) int64, changed in place.
        spans: coverage of N faces.
        start: (N,) index in ``best`` of the first row and left column of each face.
        face: (N,) index of each face in the mesh.
        width: columns of the image.
    """
    rows = spans.begin.shape[0]
    row = torch.arange(rows, device=best.device)[:, None]
    first = spans.begin.long().add_(row * width).add_(start).reshape(-1)
    number = spans.number.reshape(-1)
    total = number.cumsum(0, dtype=torch.int64)
    before = total - number
    # Fragment k has pixel first + (k - before) and key + step (k - before); the terms with ``before`` are added first.
    step = spans.step * (1 << FACE_BITS)
    key = (spans.depth * (1 << FACE_BITS)).add_(face).sub_(before.view(rows, -1) * step).reshape(-1)
    step = step.expand(rows, -1).reshape(-1)
    first = first - before
    for count, done, own_step, own_key, own_first in split(_parts(total), number, before, step, key, first):
        begin = 0 if exporting() else int(done[0])
        which = repeat(count, done - begin)
        k = torch.arange(begin, begin + which.shape[0], device=best.device)
        values = own_step.index_select(0, which).mul_(k).add_(own_key.index_select(0, which))
        best.scatter_reduce_(0, k.add_(own_first.index_select(0, which)), values, "amin")


def split(sizes: int | list[int], *tensors: Tensor) -> Iterable[tuple[Tensor, ...]]:
    """Split tensors along their first axis; in a graph they stay whole."""
    return [tensors] if exporting() else zip(*(t.split(sizes) for t in tensors), strict=True)


def _parts(total: Tensor) -> list[int]:
    """Numbers of rows per part, so that each part has about `FRAGMENTS` pixels; ``total`` is their running sum."""
    rows = total.shape[0]
    if exporting() or not rows:
        return [rows]
    count = int(total[-1])
    if count <= FRAGMENTS:
        return [rows]
    cuts = torch.searchsorted(total, torch.arange(FRAGMENTS, count, FRAGMENTS, device=total.device)) + 1
    edges = sorted({0, *cuts.tolist(), rows})
    return [b - a for a, b in pairwise(edges)]


def repeat(number: Tensor, before: Tensor) -> Tensor:
    """0 repeated ``number[0]`` times, 1 ``number[1]`` times and so on; ``before`` is the exclusive running sum."""
    if not exporting():
        return torch.repeat_interleave(number)
    # ONNX has no repeat_interleave: the running sum of marks gives the same.
    count: Any = number.sum(dtype=torch.int64).item()
    torch_private.assume(count >= 0)
    marks = torch.zeros(count + 1, dtype=torch.int64).scatter_add(0, before, torch.ones_like(before))
    return marks.cumsum(0)[:count] - 1
