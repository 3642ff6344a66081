"""Read and write mesh files."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..core.checks import check_tensors
from ..core.errors import FileError, RangeError, ShapeError
from ..core.files import atomic_path
from ..core.findings import Finding
from ..core.optional import require
from ..core.warn import warn
from .mesh import check_faces
from .mesh_gltf import readable_gltf
from .mesh_obj import read_obj
from .mesh_off import read_off
from .mesh_ply import read_ply
from .mesh_polygons import MeshFormatError, Polygons, Triangles, triangulate
from .mesh_repair import drop_twins, merge_points, orient, split_at_edges, turned_faces
from .mesh_stl import cut_stl

MAX_FACES = 50_000_000
"""Largest number of triangles that `load_mesh` accepts: set by hand, 1.2 GB of indices."""
FAR = 8.0
"""Distance from the origin, in diagonals of the mesh, from which it is moved there: float32 would round positions to
1e-6 of the diagonal, which shows in the normals of triangles of a thousandth of it."""
_READERS: dict[str, Callable[[bytes], Polygons]] = {".obj": read_obj, ".ply": read_ply, ".off": read_off}
"""Formats that hold polygons."""
_OTHERS = (".stl", ".glb", ".gltf")
"""Formats of triangles, which trimesh reads."""


class Mesh(tuple[Tensor, Tensor]):
    """``(vertices, faces)`` of a file, with what was done to them.

    Attributes:
        offset: (3,) float64, added to ``vertices`` gives the file's coordinates; 0 unless they lie far from the origin.
        report: what the file states that changes the surface, and what was mended, as `Finding` objects.

    Example:
        >>> import pathlib, tempfile, torch, torch_orennayar as ton
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "triangle.ply"
        >>> ton.save_mesh(path, torch.eye(3), torch.tensor([[0, 1, 2]]))
        >>> mesh = ton.load_mesh(path)
        >>> mesh.vertices.shape, mesh.faces.tolist(), mesh.report
        (torch.Size([3, 3]), [[0, 1, 2]], ())
    """

    offset: Tensor
    report: tuple[Finding, ...]

    def __new__(cls, vertices: Tensor, faces: Tensor, offset: Tensor, report: tuple[Finding, ...]) -> Mesh:
        """A mesh, which unpacks as ``vertices, faces``."""
        made = super().__new__(cls, (vertices, faces))
        made.offset, made.report = offset, report
        return made

    @property
    def vertices(self) -> Tensor:
        """(V, 3) float32."""
        return self[0]

    @property
    def faces(self) -> Tensor:
        """(F, 3) int64."""
        return self[1]


def load_mesh(path: str | os.PathLike[str], *, crease: float | None = None) -> Mesh:
    """Read a triangle mesh (OBJ, PLY, STL, GLB, glTF, OFF); the parts of a scene are joined, polygons triangulated.

    Vertices at the same position are merged, so that smooth normals are continuous across texture seams; a face that
    lies twice, often once in each direction, is kept once; faces that are wound against their neighbours are turned.
    Where the surface has a sharp edge its vertices are repeated, so that `vertex_normals` do not run across it.

    Args:
        path: the file.
        crease: angle between two faces, radians, from which their edge is sharp; ``math.pi`` makes all smooth. Default:
            the edges that the file states, where its normals or smoothing groups differ; without either all is smooth.

    Returns:
        A `Mesh`, which unpacks as ``(vertices, faces)``: (V, 3) float32 and (F, 3) int64. A mesh far from the origin,
        such as one in map coordinates, is moved there in float64 before it is rounded; ``offset`` says by how much.

    Raises:
        FileError: the file is missing, damaged, of an unknown format, has no faces, or needs an extension that is not
            known.
        RangeError: a vertex is not finite, or ``crease`` out of range.

    Example:
        >>> import tempfile, pathlib, torch, torch_orennayar as ton
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "triangle.ply"
        >>> ton.save_mesh(path, torch.eye(3), torch.tensor([[0, 1, 2]]))
        >>> vertices, faces = ton.load_mesh(path)
        >>> vertices.shape, faces.tolist()
        (torch.Size([3, 3]), [[0, 1, 2]])
    """
    if crease is not None and not 0 <= crease <= math.pi:
        raise RangeError("crease", expected="radians from 0 to π", got=str(crease), mend="use math.radians of degrees")
    require("scipy")
    file = Path(path)
    try:
        mesh = _read(file)
    except MeshFormatError as error:
        raise FileError(str(file), expected=error.expected, got=error.got, mend=error.mend) from error
    if not np.isfinite(mesh.points).all():
        raise RangeError(str(file), expected="finite vertices", got="NaN or infinity", mend="clean the mesh")
    if not 0 < len(mesh.faces) <= MAX_FACES:
        raise FileError(
            str(file), expected=f"1 to {MAX_FACES} triangles", got=str(len(mesh.faces)), mend="export a surface mesh"
        )
    mesh, twins = drop_twins(merge_points(mesh))
    mesh, turned, two_sided = orient(mesh)
    mesh = split_at_edges(mesh, crease)
    report = list(_describe(twins, turned, two_sided))
    low, high = mesh.points.min(0), mesh.points.max(0)
    offset = np.zeros(3)
    if np.abs((low + high) / 2).max() > FAR * np.linalg.norm(high - low) > 0:
        offset = (low + high) / 2
        text = f"the mesh lies far from the origin: {offset.tolist()} was subtracted from its coordinates."
        report.append(Finding(text, "mesh-moved", float(np.linalg.norm(offset))))
        warn(f"{file}: {text} Add `offset` of the result to come back.")
    return Mesh(
        torch.from_numpy((mesh.points - offset).astype(np.float32)),
        torch.from_numpy(np.ascontiguousarray(mesh.faces, np.int64)),
        torch.from_numpy(offset),
        tuple(report),
    )


def orient_faces(faces: Tensor) -> Tensor:
    """Turn faces over so that neighbours are wound alike, as the larger part of each connected piece is.

    Args:
        faces: (F, 3) int64; not differentiable. Neighbours share two vertices: merge equal ones before.

    Returns:
        (F, 3) int64. The faces of a surface with one side only, such as a Möbius strip, stay as they are.

    Raises:
        ShapeError: no (F, 3) int64 tensor.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> ton.orient_faces(torch.tensor([[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 4, 5]])).tolist()
        [[0, 1, 2], [1, 3, 2], [2, 3, 4], [5, 4, 3]]
    """
    check_faces(faces, int(faces.max()) + 1 if faces.numel() else 1)
    if not len(faces):
        return faces
    turn = torch.from_numpy(turned_faces(faces.cpu().numpy())[0]).to(faces.device)
    return torch.where(turn[:, None], faces.flip(1), faces)


def _describe(twins: int, turned: int, two_sided: bool) -> list[Finding]:
    """What was mended."""
    report = []
    if twins:
        text = f"{twins} faces lay twice between the same vertices and were dropped."
        report.append(Finding(text, "faces-twice", twins))
    if turned:
        text = f"{turned} faces were wound against their neighbours and were turned over."
        report.append(Finding(text, "faces-turned", turned))
    if not two_sided:
        text = "the surface has one side only, like a Möbius strip: its faces cannot be wound alike."
        report.append(Finding(text, "one-sided"))
    return report


def _read(file: Path) -> Triangles:
    """The triangles of a file, as it states them."""
    suffix = file.suffix.lower()
    if not file.is_file():
        raise MeshFormatError("nothing there", "a mesh file", "check the name")
    if suffix not in (*_READERS, *_OTHERS):
        raise MeshFormatError(
            file.suffix or "no suffix", "an OBJ, PLY, STL, GLB, glTF or OFF file", "export it as one of them"
        )
    try:
        data = file.read_bytes()
    except OSError as error:
        raise MeshFormatError(str(error), "a readable file", "check its permissions") from error
    if suffix in _READERS:
        return triangulate(_READERS[suffix](data))
    if suffix == ".stl":
        return _read_with_trimesh(file, cut_stl(data), with_normals=False)
    return _read_with_trimesh(file, *readable_gltf(data))


def _read_with_trimesh(file: Path, data: bytes, with_normals: bool) -> Triangles:
    require("trimesh")
    import trimesh

    kind = file.suffix.lower()[1:]
    resolver = trimesh.resolvers.FilePathResolver(str(file)) if kind == "gltf" else None
    try:
        mesh = trimesh.load_mesh(io.BytesIO(data), file_type=kind, resolver=resolver, process=False)
        points, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
        normals = np.asarray(mesh.vertex_normals, np.float64)[faces] if with_normals and len(faces) else None
    except Exception as error:  # trimesh and its parsers raise many types of exception for damaged files
        raise MeshFormatError(f"{type(error).__name__}: {error}") from error
    if faces.ndim != 2 or faces.shape[1:] != (3,):
        return Triangles(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    if len(faces) and (faces.min() < 0 or faces.max() >= len(points)):
        raise MeshFormatError(f"a face with the corner {faces.max()}", f"corners from 0 to {len(points) - 1}")
    return Triangles(points, faces, normals)


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

    Example:
        >>> import pathlib, tempfile, torch, torch_orennayar as ton
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "triangle.glb"
        >>> ton.save_mesh(path, torch.eye(3), torch.tensor([[0, 1, 2]]), colors=torch.eye(3))
        >>> path.exists()
        True
    """
    require("trimesh")
    import trimesh

    check_tensors(vertices=vertices, faces=faces, colors=colors)
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
