"""Rasterise triangle meshes to normal maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral

import torch
from torch import Tensor, nn

from ..core.checks import check_floating
from ..core.errors import RangeError, ShapeError
from ..core.threads import small_operations
from ..core.warn import warn
from ..geometry.camera import Camera
from ..geometry.mesh import check_mesh, sum_normals, unit_or_zero, warn_of_winding
from .interpolate import VertexAttributes, interpolate
from .raster import Projected, visible_faces
from .spans import FACE_BITS

MAX_FACES = (1 << FACE_BITS) - 1
"""Largest number of faces: what the low bits of a depth key can number."""
MAX_SIDE = 1 << 14
"""Longest side of an image, pixels: larger ones exceed the ranges of depth keys and guard band."""


@dataclass(frozen=True)
class NormalMap:
    """A rendered view, in the camera frame (x right, y up, z toward the viewer).

    Attributes:
        normal: (B, 3, H, W) unit normals, 0 outside the mask; differentiable.
        mask: (B, 1, H, W) bool, the pixels that see a face.
        depth: (B, 1, H, W) distance along the optical axis, world units, infinite outside the mask; differentiable.
        face: (B, 1, H, W) int64 index of the visible face, -1 outside the mask.
        barycentric: (B, 3, H, W) perspective-correct weights of its corners, 0 outside the mask, on edges at worst
            some 1e-7 below 0 by rounding; differentiable.
        camera: the camera of the view.
    """

    normal: Tensor
    mask: Tensor
    depth: Tensor
    face: Tensor
    barycentric: Tensor
    camera: Camera

    def shade(
        self,
        layer: nn.Module,
        light: Tensor,
        *,
        albedo: Tensor | float | None = None,
        roughness: Tensor | float | None = None,
        irradiance: Tensor | float | None = None,
    ) -> Tensor:
        """Shade this view with the view directions of its camera.

        Args:
            layer: an `OrenNayar`, or a module with the same arguments.
            light: (B, 3), (B, K, 3) or maps, unit directions in the camera frame, as in `OrenNayar`.
            albedo: as in `OrenNayar`.
            roughness: radians, as in `OrenNayar`.
            irradiance: as in `OrenNayar`.

        Returns:
            (B, C, H, W), or (B, K, C, H, W) for K lights; differentiable.

        Example:
            >>> import torch, torch_orennayar as ton
            >>> vertices = torch.tensor([[-1.0, -1, 0], [3, -1, 0], [-1, 3, 0]])
            >>> seen = ton.render_normals(vertices, torch.tensor([[0, 1, 2]]), ton.Camera.orthographic(), (4, 4))
            >>> lights = torch.nn.functional.normalize(torch.rand(1, 12, 3), dim=2)
            >>> seen.shade(ton.OrenNayar("vcavity"), lights, albedo=0.8, roughness=0.5).shape
            torch.Size([1, 12, 1, 4, 4])
        """
        size = (self.normal.shape[2], self.normal.shape[3])
        view = self.camera.view_directions(size).to(self.normal) if self.camera.is_perspective else None
        images: Tensor = layer(self.normal, light, view, albedo=albedo, roughness=roughness, irradiance=irradiance)
        return images


def render_normals(
    vertices: Tensor,
    faces: Tensor,
    camera: Camera,
    size: tuple[int, int],
    *,
    smooth: bool = True,
    vertex_normals: Tensor | None = None,
    cull: str | None = None,
) -> NormalMap:
    """Rasterise a triangle mesh: normals, mask, depth, face ids and barycentric coordinates.

    Both sides of a face are drawn unless ``cull`` excludes one; the normals of a face seen from behind are turned
    toward the viewer, except given vertex normals, which are taken as they are.
    A pixel belongs to a face if its centre does, with corners rounded to 1/256 pixel; a centre on a shared edge belongs
    to exactly one of the two faces. Faces that cross the near plane of a perspective camera are clipped there. Where
    faces have equal depths, to about 1e-10 of the range of depths of the mesh, the lower index is visible; faces that
    intersect, or are closer than that, are ordered by rounding, identically in every run.

    Smooth normals need neighbouring faces that are wound alike; a warning says where they are not.

    On a CPU numba compiles what finds the visible faces and interpolates on them, where it is installed
    (``torch_orennayar[fast]``): the same faces, and the same values and gradients to rounding, sooner. Compiling takes
    about five seconds, once.

    Gradients reach vertices, vertex normals and camera through the interpolated normals, depth and barycentric
    coordinates. The visible face, and so the mask, has none: `antialias` adds the gradients of silhouettes. Second
    derivatives are supported; transforms of ``torch.func`` are not: use batches instead of ``vmap``.

    Args:
        vertices: (V, 3) or (B, V, 3), world frame; differentiable.
        faces: (F, 3) int64, corners counter-clockwise as seen from the front.
        camera: one camera or B of them; differentiable.
        size: (H, W) in pixels, up to 16,384 each.
        smooth: whether to interpolate vertex normals; otherwise every face is flat.
        vertex_normals: (V, 3), or (B, V, 3) for every mesh or camera, world frame, used if ``smooth``; differentiable.
            Default: `vertex_normals` of the mesh, weighted by Max 1999, exact on a sphere.
        cull: ``"back"`` excludes faces seen from behind, ``"front"`` those seen from the front. A closed mesh looks
            the same without its back faces and is drawn faster.

    Returns:
        A `NormalMap`.

    Raises:
        ShapeError: shapes other than these, batches that do not fit, or a size out of range.
        RangeError: a face refers to a vertex that does not exist, a vertex is not finite, or an unknown ``cull``.

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
    world = _check(vertices, faces, camera, vertex_normals, cull)
    check_size(size)
    if smooth and vertex_normals is None:
        warn_of_winding(faces)
    with small_operations():
        seen = rasterise(world, faces, camera, size, smooth=smooth, vertex_normals=vertex_normals, cull=cull)
    if camera.is_perspective and not bool(seen.mask.any()):
        _warn_of_near_plane(world, camera)
    return seen


def _warn_of_near_plane(world: Tensor, camera: Camera) -> None:
    """Say why a picture is empty where the near plane cuts all of a mesh away."""
    depth = -camera.to_camera_frame(world.detach().double())[..., 2]
    if depth.numel() and bool((depth < camera.near).all()) and bool((depth > 0).any()):
        warn(
            f"nothing is drawn: all of the mesh lies before near={camera.near:g}, at depths up to "
            f"{depth.max().item():.3g}; make the camera with a smaller near="
        )


def rasterise(
    world: Tensor,
    faces: Tensor,
    camera: Camera,
    size: tuple[int, int],
    *,
    smooth: bool = True,
    vertex_normals: Tensor | None = None,
    cull: str | None = None,
) -> NormalMap:
    """`render_normals` of vertices (B, V, 3) without checks, as it is traced into a graph."""
    height, width = size
    batch = max(world.shape[0], len(camera.eye))
    corners = camera.to_camera_frame(world.double()).expand(batch, -1, -1)
    image = camera.to_image(corners, size)
    with torch.no_grad():
        x, y, w = image.detach().unbind(2)
        projected = Projected(x, y, w, -corners.detach()[:, :, 2])
        face = visible_faces(projected, faces, size, camera.near if camera.is_perspective else None, cull)
    normals = None
    if smooth:
        normals = _unit_normals(world, faces, vertex_normals, camera).expand(batch, -1, -1)
    maps = interpolate(
        VertexAttributes(corners, image, normals, vertex_normals is not None),
        faces,
        face,
        size,
        perspective=camera.is_perspective,
        dtype=torch.promote_types(world.dtype, torch.float32),
    )
    hit = (face < faces.shape[0]).view(batch, 1, height, width)
    return NormalMap(
        normal=maps.normal.view(3, batch, height, width).transpose(0, 1).to(world.dtype),
        mask=hit,
        depth=maps.depth.view(batch, 1, height, width).to(world.dtype),
        face=(face - (face == faces.shape[0]).to(torch.int64) * (faces.shape[0] + 1)).view(batch, 1, height, width),
        barycentric=maps.barycentric.view(3, batch, height, width).transpose(0, 1).to(world.dtype),
        camera=camera,
    )


def _unit_normals(world: Tensor, faces: Tensor, given: Tensor | None, camera: Camera) -> Tensor:
    """Vertex normals (B, V, 3) in the camera frame, float64; zero normals remain zero."""
    if given is None:
        normals = sum_normals(world.double(), faces)
    else:
        normals = unit_or_zero(given.double().reshape(-1, *given.shape[-2:]), 2)
    return normals @ camera.rotation.to(normals).transpose(1, 2)


def check_size(size: object) -> None:
    """Check for (H, W), two whole numbers in the range of the exact arithmetic."""
    given = list(size) if isinstance(size, Sequence) else []
    sides = [int(n) for n in given if isinstance(n, Integral)]
    if len(given) != 2 or len(sides) != 2 or not all(1 <= n <= MAX_SIDE for n in sides):
        raise ShapeError("size", expected=f"(H, W), each from 1 to {MAX_SIDE}", got=repr(size), mend="give pixels")


def _check(vertices: Tensor, faces: Tensor, camera: Camera, vertex_normals: Tensor | None, cull: str | None) -> Tensor:
    """Check shapes and values, and return the vertices as (B, V, 3)."""
    check_floating(vertices=vertices, vertex_normals=vertices if vertex_normals is None else vertex_normals)
    check_mesh(vertices, faces)
    world = vertices if vertices.ndim == 3 else vertices[None]
    if len(world) != len(camera.eye) and 1 not in (len(world), len(camera.eye)):
        raise ShapeError(
            "vertices, camera",
            expected="equal batch sizes, or 1",
            got=f"{len(world)} and {len(camera.eye)}",
            mend="repeat one of them",
        )
    views = max(len(world), len(camera.eye))
    fits = (world.shape, world.shape[1:], (views, *world.shape[1:]))
    if vertex_normals is not None and tuple(vertex_normals.shape) not in fits:
        raise ShapeError(
            "vertex_normals",
            expected=f"one per vertex, {tuple(world.shape[1:])}, or for each of the {views} views",
            got=str(tuple(vertex_normals.shape)),
            mend="leave it out to have them computed",
        )
    if not len(world):
        raise ShapeError("vertices", expected="at least one mesh", got="an empty batch", mend="skip the call")
    for name, value in (("vertices", world), ("vertex_normals", vertex_normals)):
        if value is not None and not bool(value.detach().isfinite().all()):
            raise RangeError(name, expected="finite numbers", got="NaN or infinity", mend="clean the mesh")
    if len(faces) > MAX_FACES:
        raise RangeError("faces", expected=f"at most {MAX_FACES}", got=str(len(faces)), mend="render the mesh in parts")
    if cull not in (None, "back", "front"):
        raise RangeError("cull", expected="None, 'back' or 'front'", got=repr(cull), mend="choose one")
    return world
