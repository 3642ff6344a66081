"""Wavefront OBJ files, by Wavefront's specification of 1995.

trimesh counts relative indices from the end of the file (its issue 2364), takes index 0 for the last point and cuts
concave faces into fans.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

import numpy as np

from .mesh_polygons import MeshFormatError, Polygons

MAX_INDEX = 2**62
"""Larger numbers are no indices; NumPy holds up to 2**63."""


def read_obj(data: bytes) -> Polygons:
    """The faces of an OBJ file: points, stated normals and smoothing groups; materials and textures are left out.

    Raises:
        MeshFormatError: an index 0 or without a point, words for numbers.
    """
    found = _Found()
    for number, words in _lines(data):
        read = _STATEMENTS.get(words[0])
        if read is None:
            continue
        try:
            read(found, words[1:])
        except (ValueError, IndexError) as error:
            got = f"{' '.join(words)[:60]!r} in line {number}"
            if isinstance(error, _IndexRangeError):
                raise MeshFormatError(got, error.expected, "number the points from 1, or from -1 backwards") from error
            mend = "write numbers with a point, not a comma" if "," in got else "export it again"
            raise MeshFormatError(got, "three numbers for a point, whole numbers for a face", mend) from error
    return found.polygons()


class _IndexRangeError(ValueError):
    """An index that refers to nothing."""

    def __init__(self, expected: str) -> None:
        self.expected = expected
        super().__init__(expected)


class _Found:
    """What was read so far."""

    def __init__(self) -> None:
        self.points: list[tuple[float, float, float]] = []
        self.normals: list[tuple[float, float, float]] = []
        self.corners: list[int] = []
        self.stated: list[int] = []
        self.counts: list[int] = []
        self.groups: list[int] = []
        self.group = -1

    def point(self, words: list[str]) -> None:
        """``x y z``, ``x y z w`` with a weight that divides them, or colours behind them."""
        x, y, z, *rest = (float(word) for word in words)
        weight = rest[0] if len(rest) == 1 else 1.0
        if weight == 0:
            raise ValueError("a point at infinity")
        self.points.append((x / weight, y / weight, z / weight))

    def normal(self, words: list[str]) -> None:
        """``i j k``."""
        x, y, z = (float(word) for word in words[:3])
        self.normals.append((x, y, z))

    def face(self, words: list[str]) -> None:
        """Corners ``v``, ``v/vt``, ``v//vn`` or ``v/vt/vn``."""
        for word in words:
            parts = word.split("/")
            self.corners.append(_index(parts[0], len(self.points)))
            self.stated.append(_index(parts[2], len(self.normals)) if len(parts) > 2 and parts[2] else -1)
        self.counts.append(len(words))
        self.groups.append(self.group)

    def smooth(self, words: list[str]) -> None:
        """``s off``, or the number of a group whose faces join smoothly."""
        self.group = 0 if words[:1] in (["off"], []) else int(words[0])

    def polygons(self) -> Polygons:
        """All of it."""
        if max(self.corners, default=0) > MAX_INDEX or max(self.stated, default=0) > MAX_INDEX:
            raise MeshFormatError("an index of more than 64 bits", f"corners from 1 to {len(self.points)}")
        stated, normals = np.array(self.stated, np.int64), None
        if stated.size and stated.max() >= len(self.normals):
            raise MeshFormatError(f"the normal {stated.max() + 1}", f"normals from 1 to {len(self.normals)}")
        if (stated >= 0).any():
            normals = np.where(stated[:, None] >= 0, np.array(self.normals)[stated], np.nan)
        groups = np.array(self.groups, np.int64)
        return Polygons(
            np.array(self.points, np.float64).reshape(-1, 3),
            np.array(self.corners, np.int64),
            np.array(self.counts, np.int64),
            normals,
            groups if (groups >= 0).any() else None,
        )


_STATEMENTS: dict[str, Callable[[_Found, list[str]], None]] = {
    "v": _Found.point,
    "vn": _Found.normal,
    "f": _Found.face,
    "fo": _Found.face,  # its name in files of the first version
    "s": _Found.smooth,
}


def _index(word: str, known: int) -> int:
    """A reference counted from 0; relative ones count back from the ``known`` ones before this line."""
    index = int(word)
    if index > 0:
        return index - 1
    if index == 0 or -index > known:
        raise _IndexRangeError(f"indices from 1, or from -1 to -{known} for the last before this line")
    return known + index


def _lines(data: bytes) -> Iterator[tuple[int, list[str]]]:
    """Number and words of every line that says something; lines are joined at a backslash, comments cut."""
    text = data.decode("utf-8-sig", errors="replace")
    number, pending = 0, ""
    for line in re.split(r"\r\n|\n|\r", text):
        number += 1
        line = pending + line
        if line.rstrip().endswith("\\"):
            pending = line.rstrip()[:-1] + " "
            continue
        pending = ""
        words = line.partition("#")[0].split()
        if words:
            yield number, words
