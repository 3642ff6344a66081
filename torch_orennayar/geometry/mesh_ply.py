"""Polygon File Format (Turk 1994), text and binary.

trimesh refuses binary files whose faces differ in size and cuts concave faces into fans.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from .mesh_polygons import Floats, Integers, MeshFormatError, Polygons

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
"""NumPy's names of the types of PLY, with and without their number of bits."""
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
"""NumPy's names of the byte orders."""
_WORD = "<f8"
"""Words of a text file are read as one array of these, and then like a binary file."""


class _Property(NamedTuple):
    """One column: the type of its numbers, and the type of the count before them if it is a list."""

    name: str
    kind: np.dtype[Any]
    count_kind: np.dtype[Any] | None


@dataclass
class _Element:
    """A table: its rows follow the header in the order of the elements."""

    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)

    def row(self, lengths: dict[str, int]) -> np.dtype[Any]:
        """Type of a row whose lists have these lengths."""
        columns: list[tuple[str, Any]] = []
        for name, kind, count_kind in self.properties:
            if count_kind is None:
                columns.append((f"value {name}", kind))
            else:
                columns += [(f"count {name}", count_kind), (f"value {name}", (kind, (lengths[name],)))]
        return np.dtype(columns)


class _Column(NamedTuple):
    """All values of a property, and for lists how many belong to each row."""

    values: npt.NDArray[Any]
    counts: Integers | None = None


def read_ply(data: bytes) -> Polygons:
    """The faces of a file, or its triangle strips, and the normals of its points.

    Raises:
        MeshFormatError: another header, an unknown type, fewer bytes or words than the header states.
    """
    elements, body = _header(data)
    at, tables = 0, dict[str, dict[str, _Column]]()
    for element in elements:
        tables[element.name], at = _read(element, body, at)
    vertex = tables.get("vertex", {})
    if not {"x", "y", "z"} <= set(vertex):
        raise MeshFormatError("no points with x, y and z", "an element vertex with x, y and z")
    points = _stack(vertex, "x", "y", "z")
    lists = [column for name, column in tables.get("face", {}).items() if name in ("vertex_indices", "vertex_index")]
    lists += [_unroll(strips) for strips in tables.get("tristrips", {}).values() if strips.counts is not None]
    if not lists or (counts := lists[0].counts) is None:
        return Polygons(points, np.zeros(0, np.int64), np.zeros(0, np.int64))
    corners = lists[0].values.astype(np.int64)
    valid = corners.size > 0 and corners.min() >= 0 and corners.max() < len(points)
    stated = valid and {"nx", "ny", "nz"} <= set(vertex)
    return Polygons(points, corners, counts, _stack(vertex, "nx", "ny", "nz")[corners] if stated else None)


def _stack(vertex: dict[str, _Column], *names: str) -> Floats:
    return np.stack([vertex[name].values.astype(np.float64) for name in names], 1)


def _header(data: bytes) -> tuple[list[_Element], bytes]:
    """The elements, and the bytes of their rows; the words of a text file as float64."""
    mark = data.find(b"end_header")
    if not data.startswith(b"ply") or mark < 0:
        raise MeshFormatError("no PLY header", "'ply' first, and 'end_header'")
    order, elements = "<", list[_Element]()
    try:
        for words in (line.split() for line in data[:mark].decode("utf-8", errors="replace").splitlines()[1:]):
            if words[:1] == ["format"]:
                order = _ORDERS[words[1]]
            elif words[:1] == ["element"]:
                elements.append(_Element(words[1], int(words[2])))
            elif words[:1] == ["property"]:
                *kinds, name = words[2:] if words[1] == "list" else words[1:]
                types = [np.dtype(order + _TYPES[kind] if order else _WORD) for kind in kinds]
                elements[-1].properties.append(_Property(name, types[-1], types[0] if words[1] == "list" else None))
        if any(len({p.name for p in element.properties}) < len(element.properties) for element in elements):
            raise ValueError("a property that occurs twice")
        rest = data[mark + len(b"end_header") :]
        rest = rest[2:] if rest.startswith(b"\r\n") else rest[1:]
        return elements, rest if order else np.array(rest.split(), _WORD).tobytes()
    except (KeyError, ValueError, IndexError) as error:
        raise MeshFormatError(str(error), "the formats, types and numbers of PLY 1.0") from error


def _read(element: _Element, body: bytes, at: int) -> tuple[dict[str, _Column], int]:
    """The columns of an element whose rows begin at byte ``at``, and where they end."""
    lists = [p for p in element.properties if p.count_kind is not None]
    empty = element.row({p.name: 0 for p in lists})
    if element.count < 0 or element.count * empty.itemsize > len(body) - at:
        raise MeshFormatError(
            f"{len(body) - at} bytes of data for {element.count} rows of '{element.name}'",
            "as many rows as the header states",
        )
    if not element.count or not element.properties:
        nothing = np.zeros(0, np.int64)
        return {p.name: _Column(nothing, None if p.count_kind is None else nothing) for p in element.properties}, at
    lengths = {name: len(values) for name, values in _row(element, body, at)[0].items()}
    regular = element.row(lengths)
    if element.count * regular.itemsize <= len(body) - at:
        rows = np.frombuffer(body, regular, element.count, at)
        if all((rows[f"count {p.name}"] == lengths[p.name]).all() for p in lists):
            counts = {p.name: rows[f"count {p.name}"].astype(np.int64) for p in lists}
            columns = {
                p.name: _Column(rows[f"value {p.name}"].reshape(-1), counts.get(p.name)) for p in element.properties
            }
            return columns, at + rows.nbytes
    table: list[dict[str, npt.NDArray[Any]]] = []
    for _ in range(element.count):
        row, at = _row(element, body, at)
        table.append(row)
    columns = {}
    for name, _, count_kind in element.properties:
        parts = [row[name] for row in table]
        columns[name] = _Column(
            np.concatenate(parts), None if count_kind is None else np.array([len(part) for part in parts], np.int64)
        )
    return columns, at


def _row(element: _Element, body: bytes, at: int) -> tuple[dict[str, npt.NDArray[Any]], int]:
    """The values of one row, and where it ends."""
    row: dict[str, npt.NDArray[Any]] = {}
    try:
        for name, kind, count_kind in element.properties:
            count = 1
            if count_kind is not None:
                count = int(np.frombuffer(body, count_kind, 1, at)[0])
                at += count_kind.itemsize
            if count < 0:
                raise ValueError(f"a list of {count}")
            row[name] = np.frombuffer(body, kind, count, at) if count else np.zeros(0, kind)
            at += row[name].nbytes
    except (ValueError, OverflowError) as error:
        raise MeshFormatError(
            f"a row of '{element.name}' that ends early", "as many numbers as the file states"
        ) from error
    return row, at


def _unroll(strips: _Column) -> _Column:
    """Triangles of strips, which end at -1; every other one is turned over."""
    values, faces = strips.values.astype(np.int64), list[Integers]()
    for strip in np.split(values, np.flatnonzero(values < 0)):
        strip = strip[strip >= 0]
        triangles = np.stack((strip[:-2], strip[1:-1], strip[2:]), 1) if len(strip) > 2 else np.zeros((0, 3), np.int64)
        triangles[1::2] = triangles[1::2, ::-1]
        faces.append(triangles)
    rows = np.concatenate(faces)
    return _Column(rows.reshape(-1), np.full(len(rows), 3))
