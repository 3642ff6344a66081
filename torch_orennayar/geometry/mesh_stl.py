"""What a binary STL file states of its size, before trimesh reads it: with bytes behind the triangles it finds none."""

from __future__ import annotations

import struct

from .mesh_polygons import MeshFormatError

_HEADER = 80
"""Bytes before the number of triangles."""
_TRIANGLE = 50
"""Bytes of a triangle: a normal and three points of float32, and 16 bits that say nothing of its shape."""


def cut_stl(data: bytes) -> bytes:
    """A binary file without what stands behind its triangles; a text file as it is.

    Raises:
        MeshFormatError: fewer or more triangles than the file states.
    """
    if b"\0" not in data or len(data) < _HEADER + 4:  # text holds no zero bytes
        return data
    (count,) = struct.unpack_from("<I", data, _HEADER)
    held = (len(data) - _HEADER - 4) // _TRIANGLE
    if count > held or (count == 0 and held):
        raise MeshFormatError(f"{held} triangles", f"{count} triangles as it states")
    return data[: _HEADER + 4 + _TRIANGLE * count]
