"""Gradients at occlusion edges: blend pixels across a silhouette by its position between their centres.

The rasteriser decides every pixel by its centre, so a mask does not change while an edge moves between two centres.
Here each edge of the mesh that can occlude is followed through the rows or columns that it crosses; where it passes
between a pixel of its surface and one of something farther away, the values of the two are blended. The sum of a mask
is then the area of the shape, and has the gradient of an area.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..core.checks import check_floating
from ..core.errors import RangeError, ShapeError
from ..geometry.mesh import check_faces, check_mesh
from .normal_map import NormalMap


def face_neighbours(faces: Tensor) -> Tensor:
    """The neighbouring face across every edge.

    Args:
        faces: (F, 3) int64.

    Returns:
        (F, 3) int64: the face across the edge from corner k to corner k + 1, or -1 where there is none, more than one,
        or one of the opposite orientation.

    Raises:
        ShapeError: another shape or type.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> ton.face_neighbours(torch.tensor([[0, 1, 2], [2, 1, 3]])).tolist()
        [[-1, 1, -1], [0, -1, -1]]
    """
    check_faces(faces, 1 << 31)  # so that two indices fit in one int64 key
    begin, end = faces.reshape(-1), faces.roll(-1, 1).reshape(-1)
    key = torch.minimum(begin, end) * (1 << 31) + torch.maximum(begin, end)
    key, order = key.sort(stable=True)
    same = torch.zeros(len(key) + 1, dtype=torch.bool, device=faces.device)
    same[1:-1] = key[1:] == key[:-1]  # same[i]: entry i has the edge of entry i - 1
    pair = same.clone()  # the second of exactly two
    pair[1:] &= ~same[:-1]
    pair[:-1] &= ~same[1:]
    second = pair[:-1].nonzero().flatten()
    one, other = order[second - 1], order[second]
    one, other = (t[begin[one] == end[other]] for t in (one, other))
    result = torch.full_like(begin, -1)
    result[one], result[other] = other // 3, one // 3
    return result.reshape(faces.shape)


def antialias(
    maps: Tensor, seen: NormalMap, vertices: Tensor, faces: Tensor, *, neighbours: Tensor | None = None
) -> Tensor:
    """Blend maps across silhouettes, which gives masks, normals and images gradients where the surface ends.

    A pixel into which the surface of its neighbour extends takes up to half of the neighbour's value, by linear
    coverage between the two centres; other pixels do not change. Edges that are more vertical than horizontal act
    between pixels of a row, others between pixels of a column. Blended normals are not of unit length. Two kinds of
    edges are not blended: those with a corner before the near plane, and those where a steep open surface ends just in
    front of what is behind it, which cannot be distinguished from seams.

    Args:
        maps: (B, C, H, W), such as ``seen.mask.float()``, ``seen.normal`` or shaded images; differentiable.
        seen: the result of `render_normals`.
        vertices: (V, 3) or (B, V, 3), the vertices that were rendered; differentiable, as is ``seen.camera``.
        faces: (F, 3) int64, the faces that were rendered, consistently oriented.
        neighbours: `face_neighbours` of ``faces``, which need not be computed again in a loop.

    Returns:
        (B, C, H, W), the blended maps.

    Raises:
        ShapeError: maps of another size than ``seen`` or not floating-point (use ``.float()`` for a mask), or vertices
            or neighbours of another mesh.
        RangeError: faces of another mesh.

    Source:
        After the idea of Laine et al. 2020, "Modular primitives for high-performance differentiable rendering"
        (section 3.6), but along edges instead of pixels, so that faces smaller than a pixel are included.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> corners = [[-0.8, -0.5, 0], [0.6, -0.5, 0], [0.6, 0.5, 0], [-0.8, 0.5, 0]]
        >>> vertices = torch.tensor(corners, requires_grad=True)
        >>> faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
        >>> seen = ton.render_normals(vertices, faces, ton.Camera.orthographic(), (10, 10))
        >>> mask = ton.antialias(seen.mask.float(), seen, vertices, faces)
        >>> round(mask.sum().item(), 3), int(seen.mask.sum())  # 7 times 5 pixels
        (35.0, 35)
        >>> round(torch.autograd.grad(mask.sum(), vertices)[0][:, 0].sum().item(), 3) + 0  # moving keeps the area
        0.0
    """
    batch, _, height, width = seen.normal.shape
    _check(maps, seen, vertices, faces, neighbours)
    if neighbours is None:
        neighbours = face_neighbours(faces)
    world = (vertices if vertices.ndim == 3 else vertices[None]).double()
    corners = seen.camera.to_camera_frame(world).expand(batch, -1, -1)
    image = seen.camera.to_image(corners, (height, width))
    edges = _occluding(image.detach(), corners.detach(), faces, neighbours, seen)
    result = maps
    for axis in (0, 1):  # the second pass blends the result of the first, so that no value leaves the range of the maps
        inner, outer, share = _crossings(edges, image, corners, seen, axis)
        flat = result.transpose(0, 1).reshape(maps.shape[1], -1)
        change = flat[:, outer] - flat[:, inner]
        gain, loss = (share - 0.5).relu(), (0.5 - share).clamp_min(0)  # at exactly 0.5 only clamp_min has a gradient
        moved = torch.zeros_like(flat).index_add(1, outer, -change * gain.to(maps))
        moved = moved.index_add(1, inner, change * loss.to(maps))
        result = result + moved.reshape(maps.shape[1], batch, height, width).transpose(0, 1)
    return result


def _check(maps: Tensor, seen: NormalMap, vertices: Tensor, faces: Tensor, neighbours: Tensor | None) -> None:
    """Check that all arguments of `antialias` belong to one view."""
    batch, _, height, width = seen.normal.shape
    check_floating(maps=maps)
    check_mesh(vertices, faces)
    if maps.ndim != 4 or len(maps) != batch or maps.shape[2:] != (height, width):
        expected = f"({batch}, C, {height}, {width})"
        raise ShapeError("maps", expected=expected, got=str(tuple(maps.shape)), mend="give maps of the same view")
    if vertices.ndim == 3 and len(vertices) not in (1, batch):
        expected = f"(V, 3) or ({batch}, V, 3)"
        raise ShapeError("vertices", expected=expected, got=str(tuple(vertices.shape)), mend="those of the view")
    if int(seen.face.max()) >= len(faces):
        got = f"{len(faces)} faces, of which number {int(seen.face.max())} is seen"
        raise RangeError("faces", expected="the faces of the view", got=got, mend="give the mesh that was rendered")
    if neighbours is not None and neighbours.shape != faces.shape:
        got = str(tuple(neighbours.shape))
        raise ShapeError("neighbours", expected=str(tuple(faces.shape)), got=got, mend="face_neighbours(faces)")


class _Edges(NamedTuple):
    """Edges that can occlude, (E,) each.

    Attributes:
        view: index of the view.
        begin: index of the first vertex.
        end: index of the second vertex.
        beside: index of the third vertex of the adjacent face, which tells the side of the surface.
        border: whether the mesh ends at the edge.
    """

    view: Tensor
    begin: Tensor
    end: Tensor
    beside: Tensor
    border: Tensor


def _occluding(image: Tensor, corners: Tensor, faces: Tensor, neighbours: Tensor, seen: NormalMap) -> _Edges:
    """Edges between a face seen from the front and one seen from behind, and edges of a single face."""
    a, b, c = (image[:, faces[:, k]] for k in range(3))
    volume = (a * torch.linalg.cross(b, c)).sum(2)  # (B, F), 0 for a face seen edge-on
    border = neighbours < 0
    turned = (volume < 0)[:, neighbours.clamp_min(0)] != (volume < 0)[:, :, None]
    own = torch.arange(len(faces), device=faces.device)[:, None]
    view, face, side = (border | (turned & (own < neighbours))).nonzero().unbind(1)
    begin, end, beside = (faces[face, (side + k) % 3] for k in range(3))
    across, ends = neighbours[face, side], border[face, side]
    # Of the two faces, the one with the larger area in the image tells on which side of the edge the surface is.
    wider = ~ends & (volume[view, across].abs() > volume[view, face].abs())
    beside = torch.where(wider, faces[across].sum(1) - begin - end, beside)
    ahead = torch.where(wider, volume[view, across], volume[view, face]) != 0
    if seen.camera.is_perspective:
        depth = -corners[:, :, 2]
        ahead &= (depth[view, begin] > seen.camera.near) & (depth[view, end] > seen.camera.near)
    return _Edges(*(t[ahead] for t in (view, begin, end, beside, ends)))


def _crossings(
    edges: _Edges, image: Tensor, corners: Tensor, seen: NormalMap, axis: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Pairs of neighbouring pixels of a row (``axis`` 0) or column (1) with a silhouette between their centres.

    Returns:
        Flat indices of the inner and the outer pixel, (N,) each, and the position of the silhouette between them,
        (N,) from 0 at the inner to 1 at the outer centre; differentiable.
    """
    _, _, height, width = seen.normal.shape
    across, along = (width, height) if axis == 0 else (height, width)  # pixels per line, and lines
    begin, end, beside = (image[edges.view, corner] for corner in edges[1:4])
    begin, end = begin[:, :2] / begin[:, 2:], end[:, :2] / end[:, 2:]
    steep = (end - begin).detach().abs()
    takes = (steep[:, 1 - axis] >= steep[:, axis]) if axis == 0 else (steep[:, 1 - axis] > steep[:, axis])
    low, high = torch.minimum(begin, end)[:, 1 - axis].detach(), torch.maximum(begin, end)[:, 1 - axis].detach()
    first, last = ((t - 0.5).ceil().clamp(0, along) for t in (low, high))
    number = ((last - first) * takes).long()
    edge = torch.repeat_interleave(number)
    line = first[edge].long() + torch.arange(len(edge), device=edge.device) - (number.cumsum(0) - number)[edge]
    p, q = begin[edge], end[edge]
    part = (line + 0.5 - p[:, 1 - axis]) / (q[:, 1 - axis] - p[:, 1 - axis])
    place = p[:, axis] + part * (q[:, axis] - p[:, axis])
    # The surface is on the side of its third corner: before or after the crossing.
    third = beside[edge, :2].detach() / beside[edge, 2:].detach().abs().clamp_min(1e-300)
    slope = ((q - p)[:, axis] / (q - p)[:, 1 - axis]).detach()
    before = third[:, axis] < p[:, axis].detach() + slope * (third[:, 1 - axis] - p[:, 1 - axis].detach())
    pixel = (place.detach() - 0.5).floor().long()
    inner, outer = torch.where(before, pixel, pixel + 1), torch.where(before, pixel + 1, pixel)
    share = (place - 0.5 - inner) * torch.where(before, 1.0, -1.0)
    fits = (pixel >= 0) & (pixel + 1 < across)
    view = edges.view[edge]
    inner, outer = (
        (view * height + (line if axis == 0 else t.clamp(0, across - 1))) * width
        + (t.clamp(0, across - 1) if axis == 0 else line)
        for t in (inner, outer)
    )
    keep = fits & _occludes(edges, edge, part.detach(), corners.detach(), inner, outer, seen)
    keep = keep.nonzero().flatten()
    keep = keep[_outermost(inner[keep] * 2 + before[keep], share[keep].detach())]
    return inner[keep], outer[keep], share[keep]


def _occludes(
    edges: _Edges, edge: Tensor, part: Tensor, corners: Tensor, inner: Tensor, outer: Tensor, seen: NormalMap
) -> Tensor:
    """Whether the inner pixel shows the surface and the outer one something behind the edge."""
    depth = -corners[:, :, 2]
    begin, end = depth[edges.view, edges.begin][edge], depth[edges.view, edges.end][edge]
    if seen.camera.is_perspective:
        there = 1 / (1 / begin + part * (1 / end - 1 / begin))
    else:
        there = begin + part * (end - begin)
    inside, outside = (seen.depth.detach().double().flatten()[pixel] for pixel in (inner, outer))
    # At a seam within a surface, both pixels are about as deep as the edge.
    slack = torch.where(edges.border[edge], 2 * (inside - there).abs(), 0.0) + 1e-6 * there.abs()
    return inside.isfinite() & (outside > inside) & (outside > there + slack)


def _outermost(pair: Tensor, share: Tensor) -> Tensor:
    """Indices of the outermost crossing between any two pixels."""
    order = share.argsort(descending=True, stable=True)
    order = order[pair[order].argsort(stable=True)]
    first = torch.ones(len(order), dtype=torch.bool, device=pair.device)
    first[1:] = pair[order][1:] != pair[order][:-1]
    return order[first]
