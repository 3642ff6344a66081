"""Object File Format, with colours, normals or texture coordinates beside the points.

trimesh cuts concave faces into fans and knows only two of the headers.
"""

from __future__ import annotations

import re

import numpy as np

from .mesh_polygons import MeshFormatError, Polygons

_HEADER = re.compile(r"\s*(?P<kind>(ST)?C?N?OFF)(?=[\s\d])\s*(?P<binary>BINARY)?", re.IGNORECASE)
"""ModelNet's files write the counts directly behind the header."""


def read_off(data: bytes) -> Polygons:
    """The faces of a text file.

    Raises:
        MeshFormatError: no OFF header, a binary file, fewer points or faces than it states, words for numbers.
    """
    text = re.sub(r"#[^\r\n]*", "", data.decode("utf-8-sig", errors="replace"))
    header = _HEADER.match(text)
    if header is None:
        raise MeshFormatError(repr(text[:20]), "the word OFF, COFF or NOFF first")
    if header["binary"]:
        raise MeshFormatError("a binary OFF file", "text", "export it as text, or as PLY")
    lines = [line.split() for line in text[header.end() :].splitlines() if line.strip()]
    try:
        points_count, faces_count = (int(word) for word in lines[0][:2])
        rows, faces = lines[1 : points_count + 1], lines[points_count + 1 : points_count + faces_count + 1]
        if points_count < 0 or faces_count < 0 or len(rows) != points_count or len(faces) != faces_count:
            raise MeshFormatError(
                f"{len(rows)} points and {len(faces)} faces",
                f"{points_count} points and {faces_count} faces as it states, one in a line",
            )
        points = np.array([[float(word) for word in row[:3]] for row in rows], np.float64).reshape(-1, 3)
        counts = np.array([int(row[0]) for row in faces], np.int64)
        listed = [int(word) for row, count in zip(faces, counts, strict=True) for word in row[1 : count + 1]]
        corners = np.array(listed, np.int64)
    except (ValueError, IndexError, OverflowError) as error:
        raise MeshFormatError(f"{type(error).__name__}: {error}", "numbers, one point or face in a line") from error
    if (counts < 0).any() or len(corners) != counts.sum():
        raise MeshFormatError("a face with fewer corners than it states", "as many corners as a face states")
    return Polygons(points, corners, counts)
