"""Which face every pixel sees: watertight by exact fixed-point arithmetic.

Corners are rounded to 1/256 pixel. On every row of pixel centres an edge then has one whole number, the first column
whose centre is not left of it, which comes out the same from both of its sides; a face covers the columns between the
numbers of its edges. So neighbours leave no gap and share no pixel, and no fill rule is needed: centres on a left or
top edge are inside, on a right or bottom edge outside.

Every covered pixel makes a key, depth before face index, and the smallest key wins.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import torch
from torch import Tensor

from .clipping import GUARD, clip

GRID = 256.0
"""Steps per pixel."""
FACE_BITS = 26
DEPTH_BITS = 37
MARGIN = 1 << 14
"""Room for rounding at both ends of the range of depths."""
EMPTY = (1 << 63) - 1
"""The key of a pixel that sees nothing."""
ROWS = 16
"""Rows of a face in one piece."""
EXACT_32 = float(1 << 23)
"""Faces whose bounding box has no more steps squared than this are exact in float32; others take float64."""
CHUNK = 1 << 15
"""Faces at once."""
FRAGMENTS = 1 << 17
"""Covered pixels at once, give or take a row."""


class Projected(NamedTuple):
    """Vertices of all views: homogeneous pixel coordinates and depth, (B, V) float64 each."""

    x: Tensor
    y: Tensor
    w: Tensor
    depth: Tensor


class _Corners(NamedTuple):
    """Snapped corners of a list of points: x and y in steps, NaN where a face must be cut first; depth as a key."""

    x: Tensor
    y: Tensor
    z: Tensor


def visible_faces(
    points: Projected, faces: Tensor, size: tuple[int, int], near: float | None, cull: str | None
) -> Tensor:
    """Index of the nearest face at every pixel.

    Args:
        points: projected vertices.
        faces: (F, 3) int64.
        size: (H, W).
        near: smallest depth that is seen, or None: orthographic.
        cull: ``"back"`` or ``"front"`` faces to leave out, or None.

    Returns:
        (B, H * W) int64; F where nothing is seen.
    """
    views, count = points.x.shape
    height, width = size
    best = torch.full((views * height * width,), EMPTY, device=faces.device)
    if exporting() or faces.shape[0]:
        if exporting():  # not a constant, or the file would hold it
            best = (faces[0, 0] * 0 + EMPTY).expand(best.shape[0]).clone()
        scale = _depth_scale(points, faces, near)
        snapped = _snap(points, near, scale)
        for corner, face, view in _chunks(faces, views, count):
            _draw_all(best, points, snapped, (corner, face, view), size, near, scale, cull)
    shown = best.reshape(views, -1) & ((1 << FACE_BITS) - 1)
    return shown.clamp_max(faces.shape[0])


def exporting() -> bool:
    """Whether a graph is being traced: then everything is one piece."""
    return torch.compiler.is_exporting()


def _chunks(faces: Tensor, views: int, vertices: int) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Corners (3, T) among the vertices of all views, face and view of up to CHUNK faces at a time."""
    planes, every = faces.T.contiguous(), torch.arange(faces.shape[0], device=faces.device)
    if exporting():
        yield planes, every, torch.zeros_like(every)
        return
    together = max(1, CHUNK // faces.shape[0])
    for first in range(0, views, together):
        group = torch.arange(first, min(first + together, views), device=faces.device)
        for corner, face in zip(planes.split(CHUNK, 1), every.split(CHUNK), strict=True):
            corners = (corner[:, None] + (group * vertices)[:, None]).flatten(1)
            yield corners, face.repeat(len(group)), group.repeat_interleave(face.shape[0])


def _depth_scale(points: Projected, faces: Tensor, near: float | None) -> tuple[Tensor, Tensor]:
    """Offset and factor, per view (B, 1), that spread the depths of the faces over the bits of a key."""
    order = _order(points.depth, near)[:, faces.reshape(-1)]
    low, high = order.amin(1, keepdim=True), order.amax(1, keepdim=True)
    steps = float((1 << DEPTH_BITS) - 2 * MARGIN)
    extent = high - low
    return low, steps * (extent > 0) / (extent + (extent <= 0))


def _order(depth: Tensor, near: float | None) -> Tensor:
    """What is linear on a face in the image and grows with depth."""
    return depth if near is None else torch.full_like(depth, -1.0) / depth.clamp_min(near)


def _snap(points: Projected, near: float | None, scale: tuple[Tensor, Tensor]) -> _Corners:
    """Vertices of all views, flattened."""
    w = points.w if near is None else torch.where(points.depth >= near, points.w, torch.nan)
    x, y = points.x / w, points.y / w
    fits = (x.abs() <= GUARD) & (y.abs() <= GUARD)
    x, y = (torch.where(fits, (t * GRID).round(), torch.nan).float().reshape(-1) for t in (x, y))
    return _Corners(x, y, _depth_key(_order(points.depth, near), scale).reshape(-1))


def _depth_key(order: Tensor, scale: tuple[Tensor, Tensor]) -> Tensor:
    return ((order - scale[0]) * scale[1]).round().long() + MARGIN


def _draw_all(
    best: Tensor,
    points: Projected,
    snapped: _Corners,
    chunk: tuple[Tensor, Tensor, Tensor],
    size: tuple[int, int],
    near: float | None,
    scale: tuple[Tensor, Tensor],
    cull: str | None,
) -> None:
    """Draw a chunk of faces; those with a corner behind the near plane or far outside the image are cut first."""
    corner, face, view = chunk
    area = size[0] * size[1]
    broken = snapped.x[corner].isnan().any(0)
    if not exporting():
        _draw(best, snapped, corner, face, view * area, size, cull)
        if not bool(broken.any()):
            return
    owner = broken.nonzero().reshape(-1)
    index = corner.index_select(1, owner).T  # (N, 3)
    corners, owner = clip(torch.stack([p.reshape(-1)[index] for p in points], 2), owner, near)
    x, y, w, depth = corners.unbind(2)
    low, factor = (s.reshape(-1)[view[owner]][:, None] for s in scale)
    pieces = _Corners(
        (x / w * GRID).round().float().reshape(-1),
        (y / w * GRID).round().float().reshape(-1),
        _depth_key(_order(depth, near), (low, factor)).reshape(-1),
    )
    corner_of_piece = torch.arange(pieces.x.shape[0], device=best.device).reshape(-1, 3).T
    face_of_piece, view_of_piece = face[owner], view[owner]
    if exporting():  # pieces behind the whole ones: one list makes a graph half as large
        pieces = _Corners(*(torch.cat(pair) for pair in zip(snapped, pieces, strict=True)))
        corner_of_piece = torch.cat((corner, corner_of_piece + snapped.x.shape[0]), 1)
        face_of_piece, view_of_piece = torch.cat((face, face_of_piece)), torch.cat((view, view_of_piece))
    _draw(best, pieces, corner_of_piece, face_of_piece, view_of_piece * area, size, cull)


def _least(t: Tensor) -> Tensor:
    return torch.minimum(torch.minimum(t[0], t[1]), t[2])


def _most(t: Tensor) -> Tensor:
    return torch.maximum(torch.maximum(t[0], t[1]), t[2])


def _draw(
    best: Tensor,
    points: _Corners,
    corner: Tensor,
    face: Tensor,
    place: Tensor,
    size: tuple[int, int],
    cull: str | None,
) -> None:
    """Enter faces, ``corner`` (3, T) of ``points``, into the keys of pictures that begin at ``place`` (T,)."""
    height, width = size
    x, y = (t.index_select(0, corner.reshape(-1)).view(3, -1) for t in (points.x, points.y))
    x_low, x_high, y_low, y_high = _least(x), _most(x), _least(y), _most(y)
    first, last, left, right = ((t + 127).mul_(1 / GRID).floor_() for t in (y_low, y_high, x_low, x_high))
    first, left, last, right = first.clamp_min_(0), left.clamp_min_(0), last.clamp_max_(height), right.clamp_max_(width)
    drawn = (last > first).logical_and_(right > left)
    exact = x_high.sub_(x_low).add_(GRID).mul_(y_high.sub_(y_low).add_(GRID)) <= EXACT_32
    exact = exact.logical_and_(last - first <= ROWS)
    if cull and not exporting():  # the others are found by their exact area below
        turn = 1.0 if cull == "back" else -1.0
        area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
        drawn &= (area * turn < 0) | ~exact
    kinds = ((drawn & exact, torch.float32), (drawn & ~exact, torch.float64))
    for chosen, dtype in ((drawn, torch.float64),) if exporting() else kinds:
        index = chosen.nonzero().reshape(-1)
        if not exporting() and not index.shape[0]:
            continue
        row, end = first.index_select(0, index), last.index_select(0, index)
        if dtype is torch.float64:
            pieces = ((end - row + (ROWS - 1)) / ROWS).floor().long()
            before = pieces.cumsum(0) - pieces
            which = _repeat(pieces, before)
            part = torch.arange(which.shape[0], device=best.device) - before.index_select(0, which)
            index, row, end = (t.index_select(0, which) for t in (index, row, end))
            row = row + part * ROWS
            end = torch.minimum(end, row + ROWS)
        for one, begin, stop in _split(CHUNK, index, row, end):
            own = left.index_select(0, one)
            x_here, y_here = (t.index_select(1, one) for t in (x, y))
            z = points.z.index_select(0, corner.index_select(1, one).reshape(-1)).view(3, -1)
            spans = _spans(x_here, y_here, z, begin, stop, own, width, dtype, cull)
            start = place.index_select(0, one) + (begin * width + own).long()
            _enter(best, spans, start, face.index_select(0, one), width)


class _Spans(NamedTuple):
    """Covered columns of every row of N faces: begin from the face's own left, number, depth there and its step."""

    begin: Tensor
    number: Tensor
    depth: Tensor
    step: Tensor


def _spans(
    x: Tensor,
    y: Tensor,
    z: Tensor,
    row: Tensor,
    end: Tensor,
    left: Tensor,
    width: int,
    dtype: torch.dtype,
    cull: str | None,
) -> _Spans:
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
    begin = _most(crossing + (side < 0).to(dtype).sub_(1).mul_(never)[:, None]).clamp_min_(0)
    stop = _least(crossing.add_((side > 0).to(dtype).sub_(1).mul_(-never)[:, None]))
    stop = torch.minimum(stop, (width - left).to(dtype))
    height = (end - row).to(dtype) * (area.abs().clamp_max_(1) if cull is None else _shown(area, cull))
    number = stop.sub_(begin).clamp_min_(0).mul_((height - rows).clamp_(0, 1)).to(torch.int32)
    depth, step = _depths(x.double(), y.double(), z, begin, rows)
    return _Spans(begin, number, depth, step)


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


def _enter(best: Tensor, spans: _Spans, start: Tensor, face: Tensor, width: int) -> None:
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
    for count, done, own_step, own_key, own_first in _split(_parts(total), number, before, step, key, first):
        begin = 0 if exporting() else int(done[0])
        which = _repeat(count, done - begin)
        k = torch.arange(begin, begin + which.shape[0], device=best.device)
        values = own_step.index_select(0, which).mul_(k).add_(own_key.index_select(0, which))
        best.scatter_reduce_(0, k.add_(own_first.index_select(0, which)), values, "amin")


def _split(sizes: int | list[int], *tensors: Tensor) -> Iterable[tuple[Tensor, ...]]:
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


def _repeat(number: Tensor, before: Tensor) -> Tensor:
    """0 ``number[0]`` times, 1 ``number[1]`` times and so on; ``before`` counts those of earlier entries."""
    if not exporting():
        return torch.repeat_interleave(number)
    count: Any = number.sum(dtype=torch.int64).item()  # as sums of marks: what has a form in ONNX
    torch._check(count >= 0)
    marks = torch.zeros(count + 1, dtype=torch.int64).scatter_add(0, before, torch.ones_like(before))
    return marks.cumsum(0)[:count] - 1
