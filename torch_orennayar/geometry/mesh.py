"""Read and write meshes through trimesh; vertex normals; meshes from depth maps."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..core.checks import check_floating
from ..core.errors import FileError, RangeError, ShapeError
from ..core.files import atomic_path, utf8_path
from ..core.optional import require
from .camera import Camera

MAX_FACES = 50_000_000
"""Largest number of triangles that `load_mesh` accepts: set by hand, 1.2 GB of indices."""
CHUNK = 1 << 14
"""Faces per step of `sum_normals`, which bounds the memory for temporaries: set by hand, 2.4 MB of corners."""


def load_mesh(path: str | os.PathLike[str]) -> tuple[Tensor, Tensor]:
    """Read a triangle mesh (OBJ, PLY, STL, GLB, OFF); the meshes of a scene are joined, polygons triangulated.

    Args:
        path: the file.

    Returns:
        ``(vertices, faces)``: (V, 3) float32 and (F, 3) int64. Vertices at the same position are merged, so
        that smooth normals are continuous across texture seams.

    Raises:
        FileError: the file is missing, damaged, of an unknown format, or has no faces.
        RangeError: a vertex is not finite.

    Example:
        >>> import tempfile, pathlib, torch, torch_orennayar as ton
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "triangle.ply"
        >>> ton.save_mesh(path, torch.eye(3), torch.tensor([[0, 1, 2]]))
        >>> vertices, faces = ton.load_mesh(path)
        >>> vertices.shape, faces.tolist()
        (torch.Size([3, 3]), [[0, 1, 2]])
    """
    require("trimesh")
    import trimesh

    file = Path(path)
    if not file.is_file():
        raise FileError(str(file), expected="a mesh file", got="nothing there", mend="check the name")
    try:
        with utf8_path(file) as named:
            mesh = trimesh.load_mesh(named, process=False)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    except Exception as error:  # trimesh and its parsers raise many types of exception for damaged files
        raise FileError(
            str(file),
            expected="a triangle mesh (OBJ, PLY, STL, GLB, OFF)",
            got=f"{type(error).__name__}: {error}",
            mend="export it again",
        ) from error
    if faces.ndim != 2 or not len(faces) or len(faces) > MAX_FACES:
        raise FileError(
            str(file), expected=f"1 to {MAX_FACES} triangles", got=str(len(faces)), mend="export a surface mesh"
        )
    if not np.isfinite(vertices).all():
        raise RangeError(str(file), expected="finite vertices", got="NaN or infinity", mend="clean the mesh")
    return torch.from_numpy(vertices.astype(np.float32)), torch.from_numpy(faces.astype(np.int64))


def save_mesh(path: str | os.PathLike[str], vertices: Tensor, faces: Tensor, colors: Tensor | None = None) -> None:
    """Write a mesh; the suffix determines the format (.ply, .obj, .glb, .stl, .off).

    Args:
        path: the file; it is written completely or not at all.
        vertices: (V, 3).
        faces: (F, 3) int64.
        colors: (V, 3) in [0, 1], sRGB, as vertex colours, or None.

    Raises:
        FileError: unknown suffix, or the file cannot be written.
        ShapeError: other shapes.
    """
    require("trimesh")
    import trimesh

    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise ShapeError(
            "vertices, faces",
            expected="(V, 3) and (F, 3)",
            got=f"{tuple(vertices.shape)} and {tuple(faces.shape)}",
            mend="reshape",
        )
    file = Path(path)
    paint = None if colors is None else (colors.clamp(0, 1) * 255).round().byte().cpu().numpy()
    mesh = trimesh.Trimesh(vertices.detach().cpu().numpy(), faces.cpu().numpy(), vertex_colors=paint, process=False)
    with atomic_path(file) as temporary:
        try:
            mesh.export(temporary)
        except (ValueError, KeyError) as error:
            raise FileError(
                str(file), expected="a .ply, .obj, .glb, .stl or .off name", got=file.suffix, mend="rename it"
            ) from error


def vertex_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """Unit vertex normals from the adjacent faces, weighted so that they are exact on a sphere.

    Args:
        vertices: (V, 3) or (B, V, 3); differentiable.
        faces: (F, 3) int64, corners counter-clockwise as seen from outside.

    Returns:
        The shape of ``vertices``; 0 where a vertex has no face, or only faces without area.

    Raises:
        ShapeError: shapes other than these, or vertices that are not floating-point.
        RangeError: a face refers to a vertex that does not exist.

    Source:
        Max 1999, "Weights for computing vertex normals from facet normals": the weight of a corner is the sine of
        its angle over the product of the lengths of its edges.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> ton.vertex_normals(torch.eye(3), torch.tensor([[0, 1, 2]]))[0].tolist()
        [0.5773502588272095, 0.5773502588272095, 0.5773502588272095]
    """
    check_mesh(vertices, faces)
    return sum_normals(vertices if vertices.ndim == 3 else vertices[None], faces).reshape(vertices.shape)


def sum_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """`vertex_normals` of (B, V, 3) without checks."""
    points = vertices.double().transpose(1, 2).contiguous()  # (B, 3, V)
    total = torch.zeros_like(points)
    for part in [faces] if torch.compiler.is_exporting() else faces.split(CHUNK):
        index = part.T.reshape(-1)
        corner = points.index_select(2, index).view(points.shape[0], 3, 3, -1)
        edge = torch.cat((corner[:, :, 1:], corner[:, :, :1]), 2) - corner
        area = torch.linalg.cross(edge[:, :, 0], edge[:, :, 1], dim=1)
        length = edge.square().sum(1)  # squared lengths of the edges that start at corners 0, 1, 2
        product = length * torch.cat((length[:, 2:], length[:, :2]), 1)
        weight = (product > 0) / torch.where(product > 0, product, 1)
        parts = (area[:, :, None] * weight[:, None]).flatten(2)
        total = total.scatter_add_(2, index.expand(points.shape[0], 3, -1), parts)
    return unit_or_zero(total, 1).transpose(1, 2).to(vertices.dtype)


def check_mesh(vertices: Tensor, faces: Tensor) -> None:
    """Check for floating-point vertices (V, 3) or (B, V, 3), and triangles between them."""
    check_floating(vertices=vertices)
    if vertices.ndim not in (2, 3) or vertices.shape[-1] != 3:
        raise ShapeError("vertices", expected="(V, 3) or (B, V, 3)", got=str(tuple(vertices.shape)), mend="reshape")
    check_faces(faces, vertices.shape[-2])


def check_faces(faces: object, vertices: int) -> None:
    """Check for triangles, (F, 3) int64, whose indices are below the number of ``vertices``."""
    if not isinstance(faces, Tensor) or faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype != torch.int64:
        kind = f"{tuple(faces.shape)} {faces.dtype}" if isinstance(faces, Tensor) else type(faces).__name__
        raise ShapeError(
            "faces", expected="(F, 3) int64 tensor", got=kind, mend="triangulate; torch.as_tensor; .long()"
        )
    if faces.numel():
        low, high = (int(t) for t in torch.aminmax(faces))
        if low < 0 or high >= vertices:
            raise RangeError(
                "faces",
                expected=f"indices from 0 to {vertices - 1}",
                got=f"{low} to {high}",
                mend="remove those faces (OBJ files count from 1)",
            )


def unit_or_zero(vectors: Tensor, dim: int) -> Tensor:
    """Normalise vectors along ``dim``; those of length 0 remain 0, with gradient 0."""
    square = vectors.square().sum(dim, keepdim=True)
    there = (square > 0).to(vectors)
    return vectors * (there / (square + (1 - there)).sqrt())


def normalise_mesh(vertices: Tensor) -> Tensor:
    """Centre a mesh at the origin and scale it into the unit sphere, by its bounding box.

    Args:
        vertices: (V, 3), V at least 1; differentiable.

    Returns:
        (V, 3): the corners of the bounding box lie on the unit sphere.

    Raises:
        ShapeError: another shape, or vertices that are not floating-point.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> ton.normalise_mesh(torch.tensor([[0.0, 0, 0], [0, 0, 4]])).tolist()
        [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]
    """
    check_floating(vertices=vertices)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not len(vertices):
        raise ShapeError("vertices", expected="(V, 3)", got=str(tuple(vertices.shape)), mend="give one mesh")
    low, high = vertices.amin(0), vertices.amax(0)
    radius: Tensor = (high - low).norm() / 2
    return (vertices - (low + high) / 2) / radius.clamp_min(1e-12)


def depth_to_mesh(depth: Tensor, mask: Tensor, camera: Camera | None = None) -> tuple[Tensor, Tensor, Tensor]:
    """Triangulate a depth map: a vertex per pixel, two triangles between every four neighbouring pixels.

    Args:
        depth: (1, H, W): without a camera the height toward the viewer in pixels, as `integrate_normals`
            returns; with one the distance along its optical axis.
        mask: (1, H, W) bool.
        camera: the camera of the depth map, or None.

    Returns:
        ``(vertices, faces, pixels)``: (V, 3) float32 in the camera frame, (F, 3) int64, and (V,) the flat index of
        the pixel of every vertex.

    Raises:
        ShapeError: shapes other than these.
    """
    if depth.ndim != 3 or depth.shape[0] != 1 or mask.shape != depth.shape:
        raise ShapeError(
            "depth, mask", expected="(1, H, W) both", got=f"{tuple(depth.shape)}, {tuple(mask.shape)}", mend="reshape"
        )
    height, width = depth.shape[1:]
    if camera is None:
        row, column = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        points = torch.stack((column - (width - 1) / 2, (height - 1) / 2 - row, depth[0].cpu()))
    else:
        points = camera.points(depth[None])[0].cpu()
    inside = mask[0].cpu()
    index = torch.full((height, width), -1)
    index[inside] = torch.arange(int(inside.sum()))
    quad = torch.stack((index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]), -1)
    quad = quad[(quad >= 0).all(-1)]
    faces = torch.cat((quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]))
    return points[:, inside].T.float().contiguous(), faces, inside.flatten().nonzero().flatten()
