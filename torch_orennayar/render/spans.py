"""The pixels that faces cover, row by row, and the keys that they give them."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core import torch_private

GRID = 256.0
"""Steps per pixel."""
FACE_BITS = 26
DEPTH_BITS = 37
ROWS = 16
"""Rows of a face in one piece."""
FRAGMENTS = 1 << 17
"""Covered pixels at once, give or take a row."""


def exporting() -> bool:
    """Whether a graph is being traced: then everything is one piece."""
    return torch.compiler.is_exporting()


def least(t: Tensor) -> Tensor:
    """Smallest of three rows."""
    return torch.minimum(torch.minimum(t[0], t[1]), t[2])


def most(t: Tensor) -> Tensor:
    """Largest of three rows."""
    return torch.maximum(torch.maximum(t[0], t[1]), t[2])


class Spans(NamedTuple):
    """Covered columns of every row of N faces: begin from the face's own left, number, depth there and its step."""

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
    """Rows ``row`` to ``end`` of N faces, reckoned from the centre of pixel (``row``, ``left``): whole numbers.

    The products stay below the whole numbers that ``dtype`` holds, and a quotient that is not whole differs from the
    next whole number by more than rounding: so every ceiling is exact.
    """
    x = x.to(dtype).sub_((left * GRID).add_(GRID / 2))
    y = y.to(dtype).sub_((row * GRID).add_(GRID / 2))
    dx, dy = (torch.cat((t[1:], t[:1])).sub_(t) for t in (x, y))
    area = (dx[0] * dy[1]).sub_(dy[0] * dx[1])
    rows = torch.arange(ROWS if exporting() else int((end - row).max()), dtype=dtype, device=x.device)[:, None]
    level = dy.abs().clamp_max_(1).neg_().add_(1)  # 1 for an edge along the row, which bounds nothing
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
    """Depth at the column ``begin`` of every row, within the face's own range, and its step to the right."""
    x1, x2, y1, y2 = x[1] - x[0], x[2] - x[0], y[1] - y[0], y[2] - y[0]
    z1, z2 = (z[1] - z[0]).double(), (z[2] - z[0]).double()
    area = x1 * y2 - y1 * x2
    inverse = torch.ones_like(area).div_(area + (area == 0))  # a quotient: runtimes approximate reciprocals
    along = (z1 * y2).sub_(z2 * y1).mul_(inverse)
    down = (z2 * x1).sub_(z1 * x2).mul_(inverse)
    depth = ((down * GRID) * rows).add_((along * GRID) * begin).sub_((along * x[0]).add_(down * y[0]))
    low, high = torch.minimum(z1, z2).clamp_max_(0), torch.maximum(z1, z2).clamp_min_(0)
    depth = torch.minimum(torch.maximum(depth, low), high).round_().long().add_(z[0])
    return depth, (along * GRID).round_().clamp_(-(2.0**DEPTH_BITS), 2.0**DEPTH_BITS).long()


def _shown(area: Tensor, cull: str) -> Tensor:
    """1 for faces that are not left out; seen from the front, corners run clockwise in rows and columns."""
    return (area if cull == "front" else -area).clamp(0, 1)


def enter(best: Tensor, spans: Spans, start: Tensor, face: Tensor, width: int) -> None:
    """Give the pixels of all spans their keys, and keep each pixel's smallest."""
    rows = spans.begin.shape[0]
    row = torch.arange(rows, device=best.device)[:, None]
    first = spans.begin.long().add_(row * width).add_(start).reshape(-1)
    number = spans.number.reshape(-1)
    total = number.cumsum(0, dtype=torch.int64)
    before = total - number
    # Pixel and key of fragment k are first + (k - before) and key + step (k - before): sums of a product with k.
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
    """Parts of tensors along their first axis; a graph takes them whole."""
    return [tensors] if exporting() else zip(*(t.split(sizes) for t in tensors), strict=True)


def _parts(total: Tensor) -> list[int]:
    """Numbers of rows, whose pixels add up to ``total``, such that each part has about FRAGMENTS of them."""
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
    """0 ``number[0]`` times, 1 ``number[1]`` times and so on; ``before`` counts those of earlier entries."""
    if not exporting():
        return torch.repeat_interleave(number)
    count: Any = number.sum(dtype=torch.int64).item()  # as sums of marks: what has a form in ONNX
    torch_private.assume(count >= 0)
    marks = torch.zeros(count + 1, dtype=torch.int64).scatter_add(0, before, torch.ones_like(before))
    return marks.cumsum(0)[:count] - 1
