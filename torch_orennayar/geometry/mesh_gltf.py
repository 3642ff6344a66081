"""Make a glTF 2.0 file one that trimesh reads right.

trimesh draws geometry of extensions that it does not know empty, reads normalised whole numbers as they are, and leaves
out the sparse part of accessors.
"""

from __future__ import annotations

import json
import struct
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from .mesh_polygons import MeshFormatError

HARMLESS_EXTENSIONS = ("KHR_materials_", "KHR_texture_", "KHR_lights_", "EXT_texture_", "KHR_mesh_quantization")
"""How the names of extensions begin that a file may require without a change of its geometry, or that are read here."""
_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""NumPy's names of the types of components, by their number in glTF 2.0, section 3.6.2.2."""
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
"""Components of an element."""
_FLOAT = 5126
_BINARY_MAGIC = b"glTF"
_HEADERS = 20
"""Bytes of the header of a .glb file and of its first chunk."""


class ReadableGltf(NamedTuple):
    """Attributes: ``data``, the bytes for trimesh; ``with_normals``, whether all triangles come with normals."""

    data: bytes
    with_normals: bool


def readable_gltf(data: bytes) -> ReadableGltf:
    """Refuse what cannot be read, and write out what trimesh would misread.

    Raises:
        MeshFormatError: no glTF 2.0, damaged, or an extension is required that would change the geometry.
    """
    try:
        tree, binary = _parts(data)
        unknown = [name for name in tree.get("extensionsRequired", []) if not str(name).startswith(HARMLESS_EXTENSIONS)]
        if unknown:
            raise MeshFormatError(
                f"a file that cannot be read without {', '.join(map(str, unknown))}",
                "a glTF file without compressed or instanced geometry",
                "export it without compression",
            )
        primitives = [part for mesh in tree.get("meshes", []) for part in mesh.get("primitives", [])]
        used = {i for p in primitives for name, i in p["attributes"].items() if name in ("POSITION", "NORMAL")}
        hidden = [i for i in sorted(used) if tree["accessors"][i].get("normalized") or "sparse" in tree["accessors"][i]]
        if hidden and binary is None:
            raise MeshFormatError("sparse or normalised numbers in a .gltf file", "a .glb file", "export it as .glb")
        if hidden and binary is not None:
            data = _written_out(tree, binary, hidden)
        return ReadableGltf(data, bool(primitives) and all("NORMAL" in part["attributes"] for part in primitives))
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, struct.error, RecursionError) as error:
        raise MeshFormatError(f"{type(error).__name__}: {error}", "a .glb or .gltf file") from error


def _parts(data: bytes) -> tuple[dict[str, Any], bytes | None]:
    """The JSON part of a file, and the binary part of a .glb file."""
    if data[:4] != _BINARY_MAGIC:
        return json.loads(data), None
    version, _, length = struct.unpack_from("<III", data, 4)
    if version != 2:
        raise MeshFormatError(f"glTF {version}", "glTF 2.0", "export it as glTF 2.0")
    rest = data[_HEADERS + length :]
    size = struct.unpack_from("<I", rest)[0] if rest else 0
    return json.loads(data[_HEADERS : _HEADERS + length]), rest[8 : 8 + size]


def _written_out(tree: dict[str, Any], binary: bytes, accessors: list[int]) -> bytes:
    """A .glb file in which these accessors are plain float32."""
    for index in accessors:
        values = _decode(tree, binary, tree["accessors"][index])
        binary += b"\0" * (-len(binary) % 4)
        tree["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": values.nbytes})
        kept = {key: tree["accessors"][index][key] for key in ("count", "type")}
        tree["accessors"][index] = kept | {"componentType": _FLOAT, "bufferView": len(tree["bufferViews"]) - 1}
        binary += values.tobytes()
    tree["buffers"][0]["byteLength"] = len(binary)
    text = json.dumps(tree).encode()
    chunks = b""
    for kind, part, fill in ((b"JSON", text, b" "), (b"BIN\0", binary, b"\0")):
        part += fill * (-len(part) % 4)
        chunks += struct.pack("<I4s", len(part), kind) + part
    return struct.pack("<4sII", _BINARY_MAGIC, 2, 12 + len(chunks)) + chunks


def _decode(tree: dict[str, Any], binary: bytes, accessor: dict[str, Any]) -> npt.NDArray[np.float32]:
    """The values of an accessor (glTF 2.0, section 3.6.2), float32."""
    kind = np.dtype(_COMPONENTS[accessor["componentType"]])
    count, width = int(accessor["count"]), _WIDTHS[accessor["type"]]
    if not 0 <= count * width <= 2 * len(binary):
        raise MeshFormatError(f"{count} values in {len(binary)} bytes", "as many as the file states")
    values = np.zeros((count, width), kind)
    if "bufferView" in accessor:
        values = _take(tree, binary, accessor, kind, count, width).copy()
    if "sparse" in accessor:
        sparse = accessor["sparse"]
        index_kind = np.dtype(_COMPONENTS[sparse["indices"]["componentType"]])
        index = _take(tree, binary, sparse["indices"], index_kind, sparse["count"], 1)[:, 0]
        values[index] = _take(tree, binary, sparse["values"], kind, sparse["count"], width)
    if not accessor.get("normalized") or kind.kind == "f":
        return values.astype(np.float32)
    shares: npt.NDArray[np.float32] = np.maximum(values / np.float64(np.iinfo(kind).max), -1).astype(np.float32)
    return shares


def _take(
    tree: dict[str, Any], binary: bytes, part: dict[str, Any], kind: np.dtype[Any], count: int, width: int
) -> npt.NDArray[Any]:
    """Elements (count, width) from the buffer view of an accessor, or of a part of it."""
    view = tree["bufferViews"][part["bufferView"]]
    start = view.get("byteOffset", 0) + part.get("byteOffset", 0)
    stride = view.get("byteStride", kind.itemsize * width)
    if count < 1 or start < 0 or stride < kind.itemsize * width:
        raise MeshFormatError(f"{count} values, {stride} bytes apart", "one value or more, that do not overlap")
    if start + (count - 1) * stride + kind.itemsize * width > len(binary):
        raise MeshFormatError(f"{len(binary)} bytes", "as many as the file states")
    elements: npt.NDArray[Any] = np.ndarray((count, width), kind, binary, start, (stride, kind.itemsize))
    return elements
