"""Mend the triangles of files: repeated points, faces that lie twice or are turned over; find the sharp edges."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..core.optional import require
from .mesh_polygons import Floats, Integers, Triangles

MERGE_DISTANCE = 1e-7
"""Points nearer than this share of the diagonal of the mesh are one: float32's relative precision."""
SAME_NORMAL = math.cos(math.radians(2))
"""Stated normals nearer than 2 degrees are the same: text files round them to two or three digits."""


def merge_points(mesh: Triangles) -> Triangles:
    """Join the points that lie at the same position, and drop those that no face uses; the order stays."""
    used = np.zeros(len(mesh.points), bool)
    used[mesh.faces.reshape(-1)] = True
    index = np.cumsum(used) - 1
    points, faces = mesh.points[used], index[mesh.faces]
    low, high = points.min(0), points.max(0)
    size = float(np.linalg.norm(high - low)) or 1.0
    first, same = _unique_rows(np.round((points - low) / (size * MERGE_DISTANCE)).astype(np.int64))
    return mesh._replace(points=points[first], faces=same[faces])


def drop_twins(mesh: Triangles) -> tuple[Triangles, int]:
    """Keep the first of the faces between the same three points, whichever way round; how many were dropped."""
    first, _ = _unique_rows(np.sort(mesh.faces, axis=1))
    dropped = len(mesh.faces) - len(first)
    return (mesh if not dropped else _choose(mesh, first)), dropped


def turned_faces(faces: Integers) -> tuple[npt.NDArray[np.bool_], bool]:
    """Which faces (F, 3) to turn over so that neighbours agree, as the larger part of each connected piece is wound.

    Returns:
        (F,) bool, and whether all neighbours agree then: those of a Möbius strip cannot, and its faces stay.
    """
    require("scipy")
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    pairs, count = _neighbours(faces), len(faces)
    if not pairs.opposed.any():
        return np.zeros(count, bool), True
    # Two nodes per face, as it is and turned over: a way from one to the other shows that a piece has one side only.
    start = np.concatenate((pairs.first // 3, pairs.first // 3 + count))
    other = pairs.second // 3 + count * pairs.opposed
    end = np.concatenate((other, (other + count) % (2 * count)))
    graph = coo_matrix((np.ones(len(start), np.int8), (start, end)), (2 * count, 2 * count))
    label = connected_components(graph, directed=False)[1]
    kept, turned = label[:count], label[count:]
    piece, side = np.minimum(kept, turned), kept > turned
    majority = np.bincount(piece, np.where(side, 1, -1), minlength=2 * count)[piece] > 0
    one_sided = kept == turned
    return (side ^ majority) & ~one_sided, not bool(one_sided.any())


def orient(mesh: Triangles) -> tuple[Triangles, int, bool]:
    """Turn the `turned_faces`; how many they are, and whether all neighbours agree then."""
    turn, agreed = turned_faces(mesh.faces)
    normals = mesh.normals
    if normals is not None:
        normals = np.where(turn[:, None, None], normals[:, ::-1], normals)
    faces = np.where(turn[:, None], mesh.faces[:, ::-1], mesh.faces)
    return mesh._replace(faces=faces, normals=normals), int(turn.sum()), agreed


def split_at_edges(mesh: Triangles, crease: float | None) -> Triangles:
    """Repeat the points of the edges where the surface bends sharply, so that normals do not run across them.

    Args:
        mesh: points joined, faces oriented.
        crease: the angle between the normals of two faces above which their edge is sharp, radians, π for none; None
            for the edges that the file states: where the normals or the smoothing groups of two faces differ.
    """
    require("scipy")
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    if crease == math.pi or (crease is None and mesh.normals is None and mesh.groups is None):
        return mesh
    pairs = _neighbours(mesh.faces)
    one, two = pairs.first, pairs.second
    point = mesh.faces.reshape(-1)
    meets = np.where(point[one] == point[two], two, _next_corner(two))  # of the second face, where the first's begins
    leaves = np.where(point[one] == point[two], _next_corner(two), two)
    if crease is not None:
        corner = mesh.points[mesh.faces]
        normal = _unit(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]))
        smooth = (normal[one // 3] * normal[two // 3]).sum(1) >= math.cos(crease) - 1e-9
    elif mesh.normals is not None:
        normal = _unit(mesh.normals.reshape(-1, 3))
        cosine = np.minimum((normal[one] * normal[meets]).sum(1), (normal[_next_corner(one)] * normal[leaves]).sum(1))
        smooth = ~(cosine < SAME_NORMAL)  # NaN where none is stated
    else:
        groups = mesh.groups if mesh.groups is not None else np.zeros(0, np.int64)
        smooth = (groups[one // 3] == groups[two // 3]) & (groups[one // 3] != 0)
    start = np.concatenate((one[smooth], _next_corner(one)[smooth]))
    end = np.concatenate((meets[smooth], leaves[smooth]))
    graph = coo_matrix((np.ones(len(start), np.int8), (start, end)), (len(point), len(point)))
    label = connected_components(graph, directed=False)[1].astype(np.int64)
    _, first = np.unique(label, return_index=True)
    return mesh._replace(points=mesh.points[point[first]], faces=label.reshape(-1, 3))


def _next_corner(slot: Integers) -> Integers:
    """The corner that follows in the same face, both as three times the face plus the corner."""
    following: Integers = slot - slot % 3 + (slot + 1) % 3
    return following


class _Pairs(NamedTuple):
    """Edges that exactly two faces share.

    Attributes:
        first: (P,) three times the first face, plus the corner at which the edge starts in it.
        second: (P,) the same of the other face.
        opposed: (P,) whether both run along the edge in the same direction, so that one of them is turned over.
    """

    first: Integers
    second: Integers
    opposed: npt.NDArray[np.bool_]


def _neighbours(faces: Integers) -> _Pairs:
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    key = np.minimum(start, end) * (int(faces.max(initial=0)) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    opens = np.flatnonzero(np.r_[True, key[order][1:] != key[order][:-1]])
    two = opens[np.diff(np.r_[opens, len(order)]) == 2]
    first, second = order[two], order[two + 1]
    apart = start[first] != end[first]
    first, second = first[apart], second[apart]
    return _Pairs(first, second, start[first] == start[second])


def _choose(mesh: Triangles, rows: Integers) -> Triangles:
    normals = None if mesh.normals is None else mesh.normals[rows]
    return Triangles(mesh.points, mesh.faces[rows], normals, None if mesh.groups is None else mesh.groups[rows])


def _unique_rows(rows: Integers) -> tuple[Integers, Integers]:
    """Index of the first occurrence of each distinct row, ascending, and the distinct row of every row."""
    order = np.lexsort(rows.T[::-1])
    ordered = rows[order]
    opens = np.r_[True, (ordered[1:] != ordered[:-1]).any(1)] if len(rows) else np.zeros(0, bool)
    group = np.cumsum(opens) - 1
    first = order[opens]  # lexsort is stable
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    same = np.empty(len(rows), np.int64)
    same[order] = rank[group]
    return np.sort(first), same


def _unit(vectors: Floats) -> Floats:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: Floats = vectors / np.where(length > 0, length, 1)
    return unit
