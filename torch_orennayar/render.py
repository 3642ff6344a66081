"""Rasterise triangle meshes to normal maps."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from ._checks import check_floating
from .camera import Camera
from .errors import RangeError, ShapeError

FRAGMENTS = 2_000_000
"""Pixel candidates tested at once: bounds the memory of the search for visible faces."""


@dataclass(frozen=True)
class NormalMap:
    """What the rasteriser saw, camera frame (x right, y up, z toward the viewer).

    Attributes:
        normal: (B, 3, H, W) unit, 0 outside the mask; differentiable.
        mask: (B, 1, H, W) bool.
        depth: (B, 1, H, W) distance along the viewing axis, infinite outside the mask; differentiable.
        face: (B, 1, H, W) int64 index of the visible face, -1 outside the mask.
        barycentric: (B, 3, H, W) perspective-correct weights of its corners, 0 outside; differentiable.
    """

    normal: Tensor
    mask: Tensor
    depth: Tensor
    face: Tensor
    barycentric: Tensor


def render_normals(
    vertices: Tensor,
    faces: Tensor,
    camera: Camera,
    size: tuple[int, int],
    *,
    smooth: bool = True,
    vertex_normals: Tensor | None = None,
) -> NormalMap:
    """Rasterise a triangle mesh: normals, mask, depth, face ids and barycentric coordinates.

    Both sides of a face are drawn; the normals of a face seen from behind are turned to the viewer,
    except given vertex normals, which are taken as they are.
    A pixel belongs to a face if its centre does; centres on a shared edge belong to exactly one of the
    two faces. Faces that cross the near plane of a perspective camera are cut there. Edge functions are
    homogeneous and evaluated in float64.

    Gradients reach vertices, vertex normals and camera through normals, depth and barycentrics of the
    interior; which face a pixel shows, and so the mask, has none.

    Args:
        vertices: (V, 3) or (B, V, 3), world frame.
        faces: (F, 3) int64.
        camera: one camera or B of them.
        size: (H, W) in pixels.
        smooth: interpolate vertex normals; else every face is flat.
        vertex_normals: (V, 3) or (B, V, 3), world frame, used where ``smooth``; default: weighted by
            Max 1999, exact on a sphere.

    Returns:
        A `NormalMap`.

    Raises:
        ShapeError: shapes other than these, batches that do not fit, or a size below 1.
        RangeError: a face names a vertex that does not exist, or a vertex is not finite.

    Source:
        Olano & Greer 1997 (homogeneous edge functions); Max 1999, "Weights for computing vertex normals
        from facet normals".

    Example:
        >>> import torch, torch_orennayar as ton
        >>> vertices = torch.tensor([[-1.0, -1, 0], [3, -1, 0], [-1, 3, 0]])
        >>> seen = ton.render_normals(vertices, torch.tensor([[0, 1, 2]]), ton.Camera.orthographic(), (4, 4))
        >>> seen.normal[0, :, 0, 0].tolist(), bool(seen.mask.all()), seen.depth[0, 0, 0, 0].item()
        ([0.0, 0.0, 1.0], True, 2.0)
    """
    world = _check(vertices, faces, camera, vertex_normals)
    batch = max(len(world), len(camera.eye))
    height, width = size
    positions = camera.to_camera_frame(world.double()).expand(batch, -1, -1)
    image = camera.to_image(positions, size)
    with torch.no_grad():
        near = camera.near if camera.is_perspective else -torch.inf
        face = torch.stack(
            [_visible_faces(i, -p[:, 2], faces, size, near) for i, p in zip(image, positions, strict=True)]
        )
    taken = vertex_normals is not None
    if vertex_normals is None:
        vertex_normals = _max_normals(world.double(), faces) if smooth else world
    turned = vertex_normals.double().reshape(-1, *vertex_normals.shape[-2:]) @ camera.rotation.to(positions).transpose(
        1, 2
    )
    hit_batch, hit_pixel = (face >= 0).nonzero(as_tuple=True)
    corner = faces[face[hit_batch, hit_pixel]]  # (hits, 3)

    def gather(values: Tensor) -> Tensor:
        return values.expand(batch, -1, -1)[hit_batch[:, None], corner]  # (hits, 3, ...)

    centre = torch.stack((hit_pixel % width + 0.5, hit_pixel // width + 0.5, torch.ones_like(hit_pixel)), 1)
    edge = (_edges(gather(image)) * centre[:, None]).sum(2)  # (hits, 3)
    weight = edge / edge.sum(1, keepdim=True)
    corners = gather(positions)
    flat = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat = F.normalize(flat, dim=1, eps=1e-300)
    toward = -flat * corners[:, 0] if camera.is_perspective else flat * flat.new_tensor((0.0, 0.0, 1.0))
    side = torch.where(toward.sum(1, keepdim=True) < 0, -1.0, 1.0)
    flat = flat * side
    normal = flat
    if smooth:
        blended = (gather(turned) * weight[:, :, None]).sum(1) * (1.0 if taken else side)
        length = blended.norm(dim=1, keepdim=True)
        normal = torch.where(length > 1e-9, blended / length.clamp_min(1e-9), flat)
    depth = -(corners[:, :, 2] * weight).sum(1, keepdim=True)

    def canvas(values: Tensor, empty: float) -> Tensor:
        flat_map = values.new_full((batch, height * width, values.shape[1]), empty)
        flat_map = flat_map.index_put((hit_batch, hit_pixel), values)
        return flat_map.transpose(1, 2).reshape(batch, -1, height, width).to(world.dtype)

    return NormalMap(
        normal=canvas(normal, 0.0),
        mask=(face >= 0).reshape(batch, 1, height, width),
        depth=canvas(depth, torch.inf),
        face=face.reshape(batch, 1, height, width),
        barycentric=canvas(weight, 0.0),
    )


def _check(vertices: Tensor, faces: Tensor, camera: Camera, vertex_normals: Tensor | None) -> Tensor:
    """Shapes and values; vertices as (B, V, 3)."""
    check_floating(vertices=vertices, vertex_normals=vertices if vertex_normals is None else vertex_normals)
    if vertices.ndim not in (2, 3) or vertices.shape[-1] != 3:
        raise ShapeError("vertices", expected="(V, 3) or (B, V, 3)", got=str(tuple(vertices.shape)), mend="reshape")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype != torch.int64:
        raise ShapeError(
            "faces", expected="(F, 3) int64", got=f"{tuple(faces.shape)} {faces.dtype}", mend="triangulate; .long()"
        )
    world = vertices if vertices.ndim == 3 else vertices[None]
    if len(world) != len(camera.eye) and 1 not in (len(world), len(camera.eye)):
        raise ShapeError(
            "vertices, camera",
            expected="equal batch sizes, or 1",
            got=f"{len(world)} and {len(camera.eye)}",
            mend="repeat one of them",
        )
    if vertex_normals is not None and vertex_normals.shape not in (world.shape, world.shape[1:]):
        raise ShapeError(
            "vertex_normals",
            expected=f"one per vertex, {tuple(world.shape[1:])}",
            got=str(tuple(vertex_normals.shape)),
            mend="leave it out to have them computed",
        )
    if not len(world):
        raise ShapeError("vertices", expected="at least one mesh", got="an empty batch", mend="skip the call")
    for name, value in (("vertices", world), ("vertex_normals", vertex_normals)):
        if value is not None and not bool(value.detach().isfinite().all()):
            raise RangeError(name, expected="finite numbers", got="NaN or infinity", mend="clean the mesh")
    if faces.numel() and not (int(faces.min()) >= 0 and int(faces.max()) < world.shape[1]):
        raise RangeError(
            "faces",
            expected=f"indices from 0 to {world.shape[1] - 1}",
            got=f"{int(faces.min())} to {int(faces.max())}",
            mend="remove those faces (OBJ files count from 1)",
        )
    return world


def _max_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """Vertex normals (B, V, 3): every corner's edge cross product over the squared lengths of its edges."""
    corner = vertices[:, faces]  # (B, F, 3, 3)
    after = corner.roll(-1, 2) - corner
    before = corner.roll(1, 2) - corner
    lengths = after.square().sum(-1, keepdim=True) * before.square().sum(-1, keepdim=True)
    whole = lengths > 0
    parts = torch.linalg.cross(after, before) * (whole / torch.where(whole, lengths, 1))
    index = faces.flatten()[None, :, None].expand(len(vertices), -1, 3)
    return torch.zeros_like(vertices).scatter_add(1, index, parts.flatten(1, 2))


def _edges(corner: Tensor) -> Tensor:
    """Homogeneous edge functions (F, 3, 3) of triangles (F, 3, 3); row i is opposite corner i.

    Written as single products so that an edge seen from its other side is negated to the last bit:
    that makes neighbours agree on every pixel between them.
    """
    a, b = corner.roll(-1, 1), corner.roll(-2, 1)
    (ax, ay, aw), (bx, by, bw) = a.unbind(2), b.unbind(2)
    return torch.stack((ay * bw - aw * by, aw * bx - ax * bw, ax * by - ay * bx), 2)


def _visible_faces(image: Tensor, depth: Tensor, faces: Tensor, size: tuple[int, int], near: float) -> Tensor:
    """Index of the nearest face at every pixel, (H * W,), -1 for none; ties go to the lower index."""
    height, width = size
    best = torch.full((height * width,), torch.iinfo(torch.int64).max, dtype=torch.int64, device=image.device)
    corner, corner_depth = image[faces], depth[faces]
    edge = _edges(corner)
    area = (edge[:, 0] * corner[:, 0]).sum(1)
    edge = edge * torch.where(area < 0, -1.0, 1.0)[:, None, None]
    low, high = _bounds(corner, corner_depth, size, near)
    extent = (high - low).clamp_min(0)
    count = torch.where(area != 0, extent[:, 0] * extent[:, 1], 0)
    drawn = count.nonzero().flatten()
    edge, area, low, extent, count, z = (t[drawn] for t in (edge, area.abs(), low, extent, count, corner_depth))
    # Centres on an edge belong to the side whose inward normal points right, or down if it is vertical.
    owns_edge = (edge[:, :, 0] > 0) | ((edge[:, :, 0] == 0) & (edge[:, :, 1] > 0))
    total = count.cumsum(0)
    fragments = int(total[-1]) if len(drawn) else 0
    for begin in range(0, fragments, FRAGMENTS):
        fragment = torch.arange(begin, min(begin + FRAGMENTS, fragments), device=image.device)
        local = torch.searchsorted(total, fragment, right=True)
        offset = fragment - (total - count)[local]
        x = low[local, 0] + offset % extent[local, 0]
        y = low[local, 1] + offset // extent[local, 0]
        e = edge[local]
        value = (e[:, :, 0] * (x + 0.5)[:, None] + e[:, :, 1] * (y + 0.5)[:, None]) + e[:, :, 2]
        inside = ((value > 0) | ((value == 0) & owns_edge[local])).all(1)
        local, x, y, value = local[inside], x[inside], y[inside], value[inside]
        weight = value / value.sum(1, keepdim=True)
        distance = (weight * z[local]).sum(1)
        seen = distance >= near
        key = (_ordered_bits(distance[seen]) << 32) | drawn[local[seen]]
        best.scatter_reduce_(0, y[seen] * width + x[seen], key, "amin")
    return torch.where(best == torch.iinfo(torch.int64).max, -1, best & 0xFFFFFFFF)


def _ordered_bits(values: Tensor) -> Tensor:
    """float32 bit patterns as integers in the order of the values."""
    bits = values.float().view(torch.int32)
    return (bits ^ ((bits >> 31) & 0x7FFFFFFF)).long()


def _bounds(corner: Tensor, depth: Tensor, size: tuple[int, int], near: float) -> tuple[Tensor, Tensor]:
    """Pixel ranges [low, high) (F, 2) whose centres a triangle can hold, its part behind the near plane cut off."""
    ahead = depth >= near
    follower, follower_depth = corner.roll(-1, 1), depth.roll(-1, 1)
    crossing = ahead != ahead.roll(-1, 1)
    share = torch.where(crossing, (near - depth) / torch.where(crossing, follower_depth - depth, 1), 0)
    cut = corner + share[:, :, None] * (follower - corner)
    point = torch.cat((corner, cut), 1)
    valid = torch.cat((ahead, crossing), 1)
    place = point[:, :, :2] / torch.where(valid, point[:, :, 2], 1)[:, :, None]
    limit = place.new_tensor((size[1], size[0]))
    least = torch.where(valid[:, :, None], place, torch.inf).amin(1).nan_to_num(posinf=1e9).clamp(-1.0, 1e9)
    most = torch.where(valid[:, :, None], place, -torch.inf).amax(1).nan_to_num(neginf=-1e9).clamp(-1e9, 1e9)
    # One pixel of slack on each side absorbs the rounding of the division; the edge functions decide.
    low = torch.minimum((least - 1.5).ceil().clamp_min(0), limit)
    high = torch.minimum((most + 1.5).floor(), limit).clamp_min(0)
    return low.long(), high.long()
