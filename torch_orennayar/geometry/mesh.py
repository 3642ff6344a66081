"""Vertex normals, checks of meshes, and meshes from depth maps."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.utils.weak import WeakIdKeyDictionary

from ..core.checks import check_floating
from ..core.errors import RangeError, ShapeError
from ..core.warn import warn

CHUNK = 1 << 14
"""Faces per step of `sum_normals`, which bounds the memory for temporaries: set by hand, 2.4 MB of corners."""
OPPOSED_SHARE = 0.01
"""Share of edges at which two faces disagree from which `warn_of_winding` speaks: set by hand; scans hold a few."""
_WINDING_SEEN = WeakIdKeyDictionary()
"""Tensors of faces whose winding was looked at, with their version."""


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


def warn_of_winding(faces: Tensor) -> None:
    """Warn, once for a tensor, where neighbouring faces are wound against each other, so that their normals cancel."""
    if not faces.numel() or _WINDING_SEEN.get(faces) == faces._version:
        return
    _WINDING_SEEN[faces] = faces._version
    start, end = faces.reshape(-1), faces.roll(-1, 1).reshape(-1)
    key, order = (torch.minimum(start, end) * (int(faces.max()) + 1) + torch.maximum(start, end)).sort()
    same = torch.nn.functional.pad(key[1:] == key[:-1], (1, 1))  # whether an edge follows one of the same points
    pair = same[1:-1] & ~same[:-2] & ~same[2:]  # exactly two faces
    first, second = order[:-1][pair], order[1:][pair]
    opposed = int((start[first] == start[second]).sum())
    if opposed > OPPOSED_SHARE * max(len(first), 1):
        warn(
            f"faces: {opposed} of {len(first)} edges lie between faces that are wound against each other, which spoils "
            "smooth normals; use load_mesh, or orient_faces(faces), or smooth=False"
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


def depth_to_mesh(depth: Tensor, mask: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Triangulate a depth map: a vertex per pixel, two triangles between every four neighbouring pixels.

    Args:
        depth: (1, H, W) height toward the viewer in pixels, as `integrate_normals` returns.
        mask: (1, H, W) bool.

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
    row, column = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    points = torch.stack((column - (width - 1) / 2, (height - 1) / 2 - row, depth[0].cpu()))
    inside = mask[0].cpu()
    index = torch.full((height, width), -1)
    index[inside] = torch.arange(int(inside.sum()))
    quad = torch.stack((index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]), -1)
    quad = quad[(quad >= 0).all(-1)]
    faces = torch.cat((quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]))
    return points[:, inside].T.float().contiguous(), faces, inside.flatten().nonzero().flatten()
