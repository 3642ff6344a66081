"""Interpolate normals, depth and barycentric weights: a table with one row per face, then a few products per pixel.

On a face, barycentric weights divided by depth are linear in the image (Olano & Greer 1997), so a few numbers per face
are enough. Unlike the coverage, these use the corners before rounding: a pixel centre that is covered only because of
the rounding takes the nearest point of the face.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.threads import side_by_side, worker_count
from ..geometry.mesh import unit_or_zero
from .spans import exporting, is_compiled

TILE = 1 << 15
"""Pixels per tile, so that its values stay in a processor's cache: set by hand."""
CHUNK = 1 << 14
"""Faces per step, which bounds the memory for temporaries: set by hand."""
CANCELLED = 1e-6
"""Length of an interpolated normal below which corner normals cancel and the face normal is used: set by hand."""
STEEPEST = 1e6
"""Change of a weight per pixel above which a face counts as edge-on and its centre is used: set by hand."""


class VertexAttributes(NamedTuple):
    """Vertices of B views, float64.

    Attributes:
        position: (B, V, 3) in the camera frame.
        image: (B, V, 3) homogeneous pixel coordinates x w, y w, w.
        normal: (B, V, 3) unit normals, or None for flat faces.
        as_given: whether normals are taken as they are, not turned toward the viewer.
    """

    position: Tensor
    image: Tensor
    normal: Tensor | None
    as_given: bool


class Maps(NamedTuple):
    """Values at the pixels of all views: normal (3, B, H, W), depth (B, H, W), barycentric (3, B, H, W)."""

    normal: Tensor
    depth: Tensor
    barycentric: Tensor


def interpolate(
    vertices: VertexAttributes,
    faces: Tensor,
    face: Tensor,
    size: tuple[int, int],
    *,
    perspective: bool,
    dtype: torch.dtype,
) -> Maps:
    """Interpolate the attributes of the visible face at every pixel.

    Args:
        vertices: the vertices; all tensors are differentiable.
        faces: (F, 3) int64.
        face: (B, H * W) index of the visible face; F where a pixel sees none.
        size: (H, W).
        perspective: whether the views are perspective.
        dtype: dtype of the maps.
    """
    views, count = face.shape[0], faces.shape[0]
    seen, index = _seen(face, count)
    smooth = vertices.normal is not None
    view = seen // max(count, 1)
    corner = (faces.index_select(0, seen - view * count) + (view * vertices.image.shape[1])[:, None]).T
    planes = vertices._replace(
        position=_planes(vertices.position),
        image=_planes(vertices.image),
        normal=None if vertices.normal is None else _planes(vertices.normal),
    )
    parts = [corner] if exporting() else corner.split(CHUNK, 1)
    columns = [_columns(planes, part.reshape(-1), size, perspective, dtype) for part in parts]
    columns.append(_empty_column(smooth, perspective, columns[0]))
    table = torch.cat([_transpose(c.T).T for c in columns])
    if exporting():
        hit = index < table.shape[0] - 1
        return Maps(
            *_values(table.index_select(0, index), hit, _grid(slice(0, size[0]), size, table), smooth, perspective)
        )
    shape = (views, *size)
    normal, depth, barycentric = _Tiles.apply(table, index, size, smooth, perspective)  # type: ignore[no-untyped-call]
    return Maps(normal.view(3, *shape), depth.view(shape), barycentric.view(3, *shape))


def _seen(face: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """The visible faces as view * F + face, and each pixel's index among them: their number if it sees none."""
    if exporting():
        return torch.arange(count), face.flatten()
    views = face.shape[0]
    own = face + torch.arange(views, device=face.device)[:, None] * (count + 1)
    flag = torch.zeros(views, count + 1, dtype=torch.int32, device=face.device)
    flag.view(-1).index_fill_(0, own.flatten(), 1)
    flag[:, -1] = 0
    seen = flag[:, :-1].flatten().nonzero().flatten()
    place = flag.flatten().cumsum(0, dtype=torch.int64).sub_(1).view(views, -1)
    place[:, -1] = seen.shape[0]
    return seen, place.flatten().index_select(0, own.flatten())


def _planes(values: Tensor) -> Tensor:
    """Bring (B, V, 3) to (3, B V)."""
    return values.reshape(-1, 3).T.contiguous()


def _columns(
    planes: VertexAttributes, corner: Tensor, size: tuple[int, int], perspective: bool, dtype: torch.dtype
) -> Tensor:
    """One column of the table per face.

    Args:
        planes: the vertices of all views, (3, B V).
        corner: (3 T,) the first, then the second, then the third corners of T faces among them.
        size: (H, W).
        perspective: whether the views are perspective.
        dtype: dtype of the table.

    Returns:
        (K, T): x and y of a pixel centre near the face; derivative by x, derivative by y, and value at that centre of
        two weights (divided by w, with 1 / w as a third, if perspective); depth, then the normal unless faces are
        flat, at the first corner; their differences from the first to the second and to the third corner; the face
        normal.
    """

    def gather(plane: Tensor) -> Tensor:
        return plane.index_select(1, corner).view(3, 3, -1)  # component, corner, face

    image, position = gather(planes.image), gather(planes.position)
    near = _pixel_near(image, size)
    # Relative to that centre and to the largest w, numbers are of the order of a pixel, for which ``dtype`` suffices.
    x, y, w = image / image[2].detach().abs().amax(0).clamp_min(1e-300)
    local = torch.stack((x - near[0] * w, y - near[1] * w, w)).to(dtype)
    edge = torch.stack([_cross(local[:, (k + 1) % 3], local[:, (k + 2) % 3]) for k in range(3)], 1)
    volume = (edge[:, 0] * local[:, 0]).sum(0)
    thin = ~(edge[:2].abs().amax((0, 1)) < STEEPEST * volume.abs())
    inverse = torch.where(thin, 0.0, 1 / torch.where(thin, 1.0, volume))
    weight = edge[:, 1:] * inverse
    if perspective:
        weight = torch.cat((weight, edge.sum(1, keepdim=True) * inverse), 1)
    middle = weight.new_tensor((1 / 3, 1 / 3, 1.0)[: weight.shape[1]])[:, None]
    value = torch.where(thin, middle, weight[2])
    side = 1 - 2 * (volume > 0).to(dtype)  # corners are counter-clockwise from the front, and rows go down
    edges = position[:, 1] - position[:, 0], position[:, 2] - position[:, 0]
    flat = unit_or_zero(_cross(*edges), 0).to(dtype) * side
    values = -position[2:]
    if planes.normal is not None:
        normal = gather(planes.normal)
        values = torch.cat((values, normal if planes.as_given else normal * side))
    first = values[:, 0]
    rest = (first, values[:, 1] - first, values[:, 2] - first)
    return torch.cat((near.to(dtype), weight[0], weight[1], value, *(t.to(dtype) for t in rest), flat))


def _pixel_near(image: Tensor, size: tuple[int, int]) -> Tensor:
    """A pixel centre (2, N) of the image close to every face, relative to which its coordinates are small."""
    ahead = image[2] > 0
    place = image[:2] / torch.where(ahead, image[2], 1.0)
    inside = torch.where(ahead, place, torch.inf).detach().amin(1).floor() + 0.5
    column, row = inside.clamp_min(0.5)
    return torch.stack((column.clamp_max(size[1] - 0.5), row.clamp_max(size[0] - 0.5)))


def _empty_column(smooth: bool, perspective: bool, like: Tensor) -> Tensor:
    """The column for pixels that see no face: all divisors are 1."""
    rows = [0.0] * (10 if perspective else 8) + [1.0] * perspective
    rows += [1.0, 0.0, 0.0, 1.0] + [0.0] * 8 if smooth else [1.0, 0.0, 0.0]
    return like.new_tensor([*rows, 0.0, 0.0, 0.0])[:, None]


def _cross(a: Tensor, b: Tensor) -> Tensor:
    """Cross product of planes (3, N)."""
    return torch.stack((a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]))


def _grid(rows: slice, size: tuple[int, int], like: Tensor) -> tuple[Tensor, Tensor]:
    """Coordinates of pixel centres: columns (W,) and ``rows`` (R, 1), which are numbered through all views."""
    height, width = size
    x = torch.arange(width, device=like.device, dtype=like.dtype) + 0.5
    y = torch.arange(rows.start, rows.stop, device=like.device)
    if not exporting():  # a graph has one view
        y = y % height
    return x, (y.to(like.dtype) + 0.5)[:, None]


def _values(
    rows: Tensor, hit: Tensor, grid: tuple[Tensor, Tensor], smooth: bool, perspective: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """Normal (3, R, W), depth (R, W) and barycentric weights (3, R, W) from the table's row for every pixel."""
    x, y = grid
    planes, width = 3 if perspective else 2, 4 if smooth else 1
    position, attributes, flat = rows.split((2 + 3 * planes, 3 * width, 3), 1)
    shape = (-1, y.shape[0], x.shape[0])
    near, along, down, value = _transpose(position).view(shape).split((2, planes, planes, planes))
    first, second, third = _transpose(attributes).view(shape).split(width)
    seen = hit.view(y.shape[0], x.shape[0]).to(rows.dtype)
    weight = torch.addcmul(torch.addcmul(value, along, x - near[0]), down, y - near[1])
    if perspective:
        weight = weight[:2] / weight[2]
    weight = weight.clamp_min(0)
    weight = weight / (weight[0] + weight[1]).clamp_min(1)
    values = torch.addcmul(torch.addcmul(first, weight[0], second), weight[1], third)
    barycentric = torch.stack((seen - weight[0] - weight[1], weight[0], weight[1]))
    depth = values[0] / seen  # infinite where no face is seen
    if not smooth:
        return _transpose(flat).view(shape), depth, barycentric
    length = _square(values[1:])
    lost = length < CANCELLED**2
    normal = values[1:] * (length.clamp_min(CANCELLED**2).rsqrt() * seen)
    if exporting() or bool(lost.any()):
        normal = torch.where(lost, _transpose(flat).view(shape), normal)
    return normal, depth, barycentric


def _transpose(rows: Tensor) -> Tensor:
    """Bring (N, K) with small K to contiguous (K, N) by a product with the identity, which is faster than a copy."""
    if exporting():
        return rows.T
    return torch.mm(torch.eye(rows.shape[1], dtype=rows.dtype, device=rows.device), rows.T)


def _square(a: Tensor) -> Tensor:
    """Squared length of planes (3, ...)."""
    return a[0] * a[0] + a[1] * a[1] + a[2] * a[2]


class _Tiles(torch.autograd.Function):
    """`_values` in tiles of rows that fit in cache; saves its inputs only for the backward pass."""

    @staticmethod
    def forward(
        ctx: Any, table: Tensor, index: Tensor, size: tuple[int, int], smooth: bool, perspective: bool
    ) -> tuple[Tensor, ...]:
        ctx.save_for_backward(table, index)
        ctx.options = (size, smooth, perspective)
        rows = index.shape[0] // size[1]
        normal, depth, barycentric = (table.new_empty(k, rows, size[1]) for k in (3, 1, 3))
        if is_compiled(table):
            from .compiled_interpolate import fill_maps

            _run_compiled(fill_maps, table, index, ctx.options, TILE, (normal, depth[0], barycentric))
            return normal, depth[0], barycentric
        space = table.new_empty(min(max(TILE, size[1]), index.shape[0]), table.shape[1])
        for part in _tiles(rows, size[1]):
            here = index[part.start * size[1] : part.stop * size[1]]
            found = torch.index_select(table, 0, here, out=space[: len(here)])
            values = _values(found, here < len(table) - 1, _grid(part, size, table), smooth, perspective)
            normal[:, part], depth[0, part], barycentric[:, part] = values
        return normal, depth[0], barycentric

    @staticmethod
    def backward(ctx: Any, *arriving: Tensor) -> tuple[Tensor | None, ...]:
        table, index = ctx.saved_tensors
        size, smooth, perspective = ctx.options
        rows = index.shape[0] // size[1]
        if torch.is_grad_enabled():  # second derivatives: plain operations, in one piece
            hit, grid = index < len(table) - 1, _grid(slice(0, rows), size, table)
            values = _values(table.index_select(0, index), hit, grid, smooth, perspective)
            (whole,) = torch.autograd.grad(values, table, arriving, create_graph=True)
            return whole, None, None, None, None
        gradient = torch.zeros_like(table)
        if is_compiled(table):
            from .compiled_interpolate import add_gradients

            # Views side by side, as no two of them share a row of the table.
            _run_compiled(add_gradients, table, index, ctx.options, size[0] * size[1], arriving, gradient)
            return gradient, None, None, None, None
        for part in _tiles(rows, size[1]):
            here = index[part.start * size[1] : part.stop * size[1]]
            found = table.index_select(0, here).requires_grad_()
            with torch.enable_grad():
                values = _values(found, here < len(table) - 1, _grid(part, size, table), smooth, perspective)
            given = [arriving[0][:, part], arriving[1][part], arriving[2][:, part]]
            gradient.index_add_(0, here, torch.autograd.grad(values, found, given)[0])
        return gradient, None, None, None, None


def _run_compiled(
    kernel: Callable[..., None],
    table: Tensor,
    index: Tensor,
    options: tuple[tuple[int, int], bool, bool],
    step: int,
    maps: Sequence[Tensor],
    *others: Tensor,
) -> None:
    """Call compiled code for so many pixels at a time, side by side.

    Args:
        kernel: a function of `compiled_interpolate`.
        table: as in `_Tiles`, as are the next two.
        index: row of every pixel.
        options: size, smooth, perspective.
        step: number of pixels.
        maps: normal, depth and barycentric weights, or gradients with respect to them.
        others: what else the function takes.
    """
    size, smooth, perspective = options
    rows, where, count = table.detach().numpy(), index.numpy(), len(index)
    numbers = (size, 3 if perspective else 2, 4 if smooth else 1, CANCELLED)
    arrays = [*(t.flatten(-2).contiguous().numpy() for t in maps), *(t.numpy() for t in others)]

    def work(first: int) -> None:
        kernel(rows, where, first, min(first + step, count), *numbers, *arrays)

    side_by_side(work, range(0, count, step), workers=worker_count())


def _tiles(rows: int, width: int) -> list[slice]:
    """Whole rows of about `TILE` pixels together."""
    step = max(1, TILE // width)
    return [slice(r, min(r + step, rows)) for r in range(0, rows, step)]
