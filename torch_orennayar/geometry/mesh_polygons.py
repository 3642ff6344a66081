"""Polygons as mesh files hold them, and their triangles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..core.optional import require

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


class MeshFormatError(Exception):
    """What a reader found wrong; `load_mesh` adds the name of the file.

    Attributes:
        got: what the file holds.
        expected: what it should hold.
        mend: what to do about it.
    """

    def __init__(self, got: str, expected: str = "a triangle mesh", mend: str = "export it again") -> None:
        self.got, self.expected, self.mend = got, expected, mend
        super().__init__(got)


class Polygons(NamedTuple):
    """The faces of a file, before anything is cut, joined or moved.

    Attributes:
        points: (V, 3).
        corners: (C,) the points of all faces, one face after the other.
        counts: (F,) how many corners each face has.
        normals: (C, 3) the normal that the file states at every corner, NaN where it states none; None without any.
        groups: (F,) number of the smoothing group, 0 for flat faces, -1 where the file states none; None without any.
    """

    points: Floats
    corners: Integers
    counts: Integers
    normals: Floats | None = None
    groups: Integers | None = None


class Triangles(NamedTuple):
    """The same, cut into triangles.

    Attributes:
        points: (V, 3).
        faces: (T, 3).
        normals: (T, 3, 3) per corner, or None, as in `Polygons`.
        groups: (T,) or None, as in `Polygons`.
    """

    points: Floats
    faces: Integers
    normals: Floats | None = None
    groups: Integers | None = None


def triangulate(polygons: Polygons) -> Triangles:
    """Cut polygons into triangles: convex ones into fans, others by ear clipping in their mean plane.

    Faces of fewer than three corners have no area and are left out.

    Raises:
        MeshFormatError: a corner refers to a point that does not exist.
    """
    points, corners, counts, normals, groups = polygons
    if len(corners) and (corners.min() < 0 or corners.max() >= len(points)):
        raise MeshFormatError(
            f"a face with the corner {corners.min() if corners.min() < 0 else corners.max()} (counted from 0)",
            f"corners from 0 to {len(points) - 1}",
        )
    starts = np.cumsum(counts) - counts
    cut: list[Integers] = [np.zeros((0, 3), np.int64)]
    owner: list[Integers] = [np.zeros(0, np.int64)]
    for count in np.unique(counts[counts > 2]).tolist():
        chosen = np.flatnonzero(counts == count)
        slots = starts[chosen, None] + np.arange(count)
        convex = np.ones(len(slots), bool) if count == 3 else _convex(points[corners[slots]])
        fan = np.stack([np.zeros(count - 2, np.int64), np.arange(1, count - 1), np.arange(2, count)], 1)
        cut.append(slots[convex][:, fan].reshape(-1, 3))
        owner.append(chosen[convex].repeat(count - 2))
        for face, row in zip(chosen[~convex], slots[~convex], strict=True):
            ears = _clip_ears(points[corners[row]])
            cut.append(row[fan if ears is None else ears])
            owner.append(np.full(len(cut[-1]), face))
    slots, faces = np.concatenate(cut), np.concatenate(owner)
    order = np.argsort(faces, kind="stable")
    slots, faces = slots[order], faces[order]
    return Triangles(
        points,
        corners[slots],
        None if normals is None else normals[slots],
        None if groups is None else groups[faces],
    )


def _newell(outline: Floats) -> Floats:
    """Area vectors (..., 3) of polygons (..., N, 3), by Newell's sum over their edges."""
    local = outline - outline[..., :1, :]
    area: Floats = np.cross(local, np.roll(local, -1, axis=-2)).sum(-2)
    return area


def _convex(outlines: Floats) -> npt.NDArray[np.bool_]:
    """Which of the polygons (M, N, 3) turn the same way at every corner."""
    edge = np.roll(outlines, -1, axis=1) - outlines
    turn = np.cross(np.roll(edge, 1, axis=1), edge)
    bend = (turn * _newell(outlines)[:, None]).sum(2)
    convex: npt.NDArray[np.bool_] = (bend >= -1e-9 * np.abs(bend).max(1, keepdims=True)).all(1)  # straight corners too
    return convex


def _clip_ears(outline: Floats) -> Integers | None:
    """Triangles (T, 3) of one polygon (N, 3), wound as it is; None where it crosses itself or has no area."""
    require("mapbox_earcut")
    import mapbox_earcut

    area = _newell(outline)
    size = float(np.linalg.norm(area))
    if size == 0 or not np.isfinite(size):
        return None
    normal = area / size
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    flat = np.ascontiguousarray((outline - outline[0]) @ np.stack((first, np.cross(normal, first)), 1))
    found = mapbox_earcut.triangulate_float64(flat, np.array([len(flat)], np.uint32))
    triangles = np.asarray(found, np.int64).reshape(-1, 3)
    if len(triangles) != len(outline) - 2:
        return None
    a, b, c = (flat[triangles[:, k]] for k in range(3))
    turned = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] < 0
    triangles[turned] = triangles[turned][:, ::-1]
    return triangles
