"""The visible face of every pixel: watertight rasterisation in exact fixed-point arithmetic.

Corners are rounded to 1/256 pixel. In every row of pixel centres an edge then has one whole number, the first column
whose centre is not left of it, which is the same for both of its faces; a face covers the columns between the numbers
of its edges. So adjacent faces leave no gap and share no pixel: centres on a left or top edge are inside, on a right or
bottom edge outside.

Every covered pixel of a face has a key, with the depth in the high bits and the face index in the low bits; the
smallest key is visible.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from ..core.threads import side_by_side, worker_count
from .clipping import GUARD, clip
from .spans import DEPTH_BITS, FACE_BITS, GRID, ROWS, cover, enter, exporting, is_compiled, least, most, repeat, split

MARGIN = 1 << 14
"""Depth keys reserved at both ends of their range, for interpolated depths that rounding moves beyond the corners."""
EMPTY = (1 << 63) - 1
"""The key of a pixel without a face: the largest int64."""
EXACT_32 = float(1 << 23)
"""Area in steps squared up to which a face's bounding box is exact in float32, whose whole numbers end at 2^24; larger
faces take float64."""
CHUNK = 1 << 15
"""Faces per step, which bounds the memory for temporaries: set by hand."""
BLOCK = 8
"""Height and width in pixels of the tiles in which hidden faces are detected: set by hand."""


class Projected(NamedTuple):
    """Vertices of all views, (B, V) float64 each: homogeneous pixel coordinates x w, y w, w, and depth."""

    x: Tensor
    y: Tensor
    w: Tensor
    depth: Tensor


class _Corners(NamedTuple):
    """Points rounded to the grid: x and y in steps, NaN where faces must be clipped first; z the depth as a key."""

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
        near: depth of the near plane, or None for orthographic views.
        cull: ``"back"`` or ``"front"`` faces to leave out, or None.

    Returns:
        (B, H * W) int64; F where a pixel sees no face.
    """
    if not exporting() and not faces.shape[0]:
        return torch.zeros(points.x.shape[0], size[0] * size[1], dtype=torch.int64, device=faces.device)
    shown = _nearest(points, faces, size, near, cull, _depth_scale(points, faces, near)) & ((1 << FACE_BITS) - 1)
    return shown.clamp_max(faces.shape[0])


def nearest_depths(points: Projected, faces: Tensor, size: tuple[int, int]) -> Tensor:
    """Depth of the nearest face at every pixel of orthographic views, (B, H * W) float64; infinite where none is.

    Args:
        points: projected vertices.
        faces: (F, 3) int64, at least one.
        size: (H, W).
    """
    low, factor = _depth_scale(points, faces, None)
    best = _nearest(points, faces, size, None, None, (low, factor))
    depth = low + ((best >> FACE_BITS) - MARGIN) / factor.clamp_min(1e-300)  # a factor of 0: all depths are ``low``
    return torch.where(best == EMPTY, torch.inf, torch.where(factor > 0, depth, low))


def _nearest(
    points: Projected,
    faces: Tensor,
    size: tuple[int, int],
    near: float | None,
    cull: str | None,
    scale: tuple[Tensor, Tensor],
) -> Tensor:
    """The smallest key of every pixel, (B, H * W)."""
    views, count = points.x.shape
    best = torch.full((views * size[0] * size[1],), EMPTY, device=faces.device)
    if exporting():  # as a constant it would be stored in the file
        best = (faces[0, 0] * 0 + EMPTY).expand(best.shape[0]).clone()
    snapped = _snap(points, near, scale)
    whole = not exporting() and not bool(snapped.x.isnan().any())
    for corner, face, view in _chunks(faces, views, count):
        if not exporting():
            _draw(best, _Faces(snapped, corner, face, view), size, cull)
        if not whole:
            _draw_cut(best, points, snapped, (corner, face, view), size, near, scale, cull)
    return best.reshape(views, -1)


def _chunks(faces: Tensor, views: int, vertices: int) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Up to `CHUNK` faces at a time: corners (3, T) among the vertices of all views, face index and view."""
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
    """Offset and factor per view, (B, 1), that map the depths of the faces to the range of depth keys."""
    order = _order(points.depth, near).index_select(1, faces.reshape(-1))
    low, high = order.amin(1, keepdim=True), order.amax(1, keepdim=True)
    steps = float((1 << DEPTH_BITS) - 2 * MARGIN)
    extent = high - low
    return low, steps * (extent > 0) / (extent + (extent <= 0))


def _order(depth: Tensor, near: float | None) -> Tensor:
    """A quantity that is linear on a face in the image and increases with depth: depth itself, or -1 / depth."""
    return depth if near is None else torch.full_like(depth, -1.0) / depth.clamp_min(near)


def _snap(points: Projected, near: float | None, scale: tuple[Tensor, Tensor]) -> _Corners:
    """Round the vertices of all views, flattened, to the grid."""
    w = points.w if near is None else torch.where(points.depth >= near, points.w, torch.nan)
    x, y = points.x / w, points.y / w
    fits = (x.abs() <= GUARD) & (y.abs() <= GUARD)
    x, y = (torch.where(fits, (t * GRID).round(), torch.nan).float().reshape(-1) for t in (x, y))
    return _Corners(x, y, _depth_key(_order(points.depth, near), scale).reshape(-1))


def _depth_key(order: Tensor, scale: tuple[Tensor, Tensor]) -> Tensor:
    return ((order - scale[0]) * scale[1]).round().long() + MARGIN


def _draw_cut(
    best: Tensor,
    points: Projected,
    snapped: _Corners,
    chunk: tuple[Tensor, Tensor, Tensor],
    size: tuple[int, int],
    near: float | None,
    scale: tuple[Tensor, Tensor],
    cull: str | None,
) -> None:
    """Clip and draw the faces of a chunk that have a corner behind the near plane or outside the guard band."""
    corner, face, view = chunk
    owner = snapped.x[corner].isnan().any(0).nonzero().reshape(-1)
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
    if exporting():  # together with the faces that need no clipping: one list makes a graph half as large
        pieces = _Corners(*(torch.cat(pair) for pair in zip(snapped, pieces, strict=True)))
        corner_of_piece = torch.cat((corner, corner_of_piece + snapped.x.shape[0]), 1)
        face_of_piece, view_of_piece = torch.cat((face, face_of_piece)), torch.cat((view, view_of_piece))
    _draw(best, _Faces(pieces, corner_of_piece, face_of_piece, view_of_piece), size, cull)


class _Faces(NamedTuple):
    """A list of faces: corners (3, T) among the points, and of each face its index in the mesh and its view."""

    points: _Corners
    corner: Tensor
    face: Tensor
    view: Tensor


class _Boxes(NamedTuple):
    """Bounding boxes in the image: rows ``first`` to ``last`` and columns ``left`` to ``right``, ends excluded."""

    first: Tensor
    last: Tensor
    left: Tensor
    right: Tensor


def _draw(best: Tensor, faces: _Faces, size: tuple[int, int], cull: str | None) -> None:
    """Enter faces into the keys ``best`` of all views."""
    if is_compiled(best):
        _enter_compiled(best, faces, size, cull)
        return
    x, y = (t.index_select(0, faces.corner.reshape(-1)).view(3, -1) for t in (faces.points.x, faces.points.y))
    x_low, x_high, y_low, y_high = least(x), most(x), least(y), most(y)
    first, last, left, right = ((t + 127).mul_(1 / GRID).floor_() for t in (y_low, y_high, x_low, x_high))
    boxes = _Boxes(first.clamp_min_(0), last.clamp_max_(size[0]), left.clamp_min_(0), right.clamp_max_(size[1]))
    drawn = (last > first).logical_and_(right > left)
    if exporting():
        _fill(best, faces, boxes, (x, y), drawn.nonzero().reshape(-1), size, torch.float64, cull)
        return
    exact = x_high.sub_(x_low).add_(GRID).mul_(y_high.sub_(y_low).add_(GRID)) <= EXACT_32
    exact = exact.logical_and_(last - first <= ROWS)
    # Exact for small faces. The sign for large ones is found exactly in `cover`; here it only sorts them.
    area = (x[1] - x[0]).mul_(y[2] - y[0]).sub_((y[1] - y[0]).mul_(x[2] - x[0]))
    front = area < 0
    if cull == "back":
        groups = [drawn.logical_and_(front | ~exact)]
    elif cull == "front":
        groups = [drawn.logical_and_(~front | ~exact)]
    else:
        groups = [drawn & front, drawn & ~front]
    for number, group in enumerate(groups):
        chosen = group.nonzero().reshape(-1)
        if number:
            chosen = chosen[~_hidden(best, faces, boxes, chosen, size)]
        small = exact.index_select(0, chosen)
        for index, dtype in ((chosen[small], torch.float32), (chosen[~small], torch.float64)):
            if len(index):
                _fill(best, faces, boxes, (x, y), index, size, dtype, cull)


def _enter_compiled(best: Tensor, faces: _Faces, size: tuple[int, int], cull: str | None) -> None:
    """`_draw` by compiled code, bands of rows side by side."""
    from .compiled_coverage import enter_faces

    keys, shown = best.numpy(), {None: 0, "front": 1, "back": -1}[cull]
    x, y, z = (part.numpy() for part in faces.points)
    corner, face, view = (part.contiguous().numpy() for part in (faces.corner, faces.face, faces.view))
    first, last = (int(t) for t in torch.aminmax(faces.view)) if len(face) else (0, -1)
    low, high, workers = first * size[0], (last + 1) * size[0], worker_count()
    band = max(1, -(-(high - low) // workers))

    def work(row: int) -> None:
        enter_faces(keys, x, y, z, corner, face, view, *size, shown, row, min(row + band, high))

    side_by_side(work, range(low, high, band), workers=workers)


def _hidden(best: Tensor, faces: _Faces, boxes: _Boxes, chosen: Tensor, size: tuple[int, int]) -> Tensor:
    """Which of the faces ``chosen`` lie behind everything drawn so far around their boxes, and can be skipped.

    Compares the nearest corner with the farthest pixel of 2 x 2 tiles, so only faces that fit into these are detected.
    """
    low, high = (int(t) for t in torch.aminmax(faces.view)) if len(chosen) else (0, 0)
    rows, columns = -(-size[0] // BLOCK), -(-size[1] // BLOCK)
    pictures = best.view(-1, *size)[low : high + 1]
    pictures = torch.nn.functional.pad(pictures, (0, columns * BLOCK - size[1], 0, rows * BLOCK - size[0]))
    far = pictures.view(-1, rows, BLOCK, columns * BLOCK).amax(2).view(-1, rows, columns, BLOCK).amax(3)
    far = torch.nn.functional.pad(far, (0, 1, 0, 1))
    first, last, left, right = (t.index_select(0, chosen) for t in boxes)
    fits = (last - first <= BLOCK) & (right - left <= BLOCK)
    row, column = (first * (1 / BLOCK)).long(), (left * (1 / BLOCK)).long()
    corner = ((faces.view.index_select(0, chosen) - low) * (rows + 1) + row) * (columns + 1) + column
    around = [far.view(-1).index_select(0, corner + k) for k in (0, 1, columns + 1, columns + 2)]
    farthest = torch.maximum(torch.maximum(around[0], around[1]), torch.maximum(around[2], around[3]))
    depth = faces.points.z.index_select(0, faces.corner.index_select(1, chosen).reshape(-1)).view(3, -1)
    return (least(depth) * (1 << FACE_BITS) > farthest) & fits


def _fill(
    best: Tensor,
    faces: _Faces,
    boxes: _Boxes,
    places: tuple[Tensor, Tensor],
    index: Tensor,
    size: tuple[int, int],
    dtype: torch.dtype,
    cull: str | None,
) -> None:
    """Enter the faces ``index``; ``places`` are the corners' x and y, (3, T), whose products ``dtype`` must hold."""
    row, end = boxes.first.index_select(0, index), boxes.last.index_select(0, index)
    if dtype is torch.float64:  # only these may have more than ROWS rows
        pieces = ((end - row + (ROWS - 1)) / ROWS).floor().long()
        before = pieces.cumsum(0) - pieces
        which = repeat(pieces, before)
        part = torch.arange(which.shape[0], device=best.device) - before.index_select(0, which)
        index, row, end = (t.index_select(0, which) for t in (index, row, end))
        row = row + part * ROWS
        end = torch.minimum(end, row + ROWS)
    for one, begin, stop in split(CHUNK, index, row, end):
        own = boxes.left.index_select(0, one)
        x, y = (t.index_select(1, one) for t in places)
        z = faces.points.z.index_select(0, faces.corner.index_select(1, one).reshape(-1)).view(3, -1)
        spans = cover(x, y, z, begin, stop, own, size[1], dtype, cull)
        start = faces.view.index_select(0, one) * (size[0] * size[1]) + (begin * size[1] + own).long()
        enter(best, spans, start, faces.face.index_select(0, one), size[1])
