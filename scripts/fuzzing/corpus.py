"""Readers, and small sound files that they read."""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import torch

import torch_orennayar as ton
from torch_orennayar.core.files import WRITTEN_LIST, written_files
from torch_orennayar.export.describe import describe_onnx
from torch_orennayar.geometry.primitives import spiral_lights
from torch_orennayar.io.capture import save_capture
from torch_orennayar.io.light_files import INTENSITIES_FILE, read_directions, read_intensities
from torch_orennayar.io.picture import read_picture
from torch_orennayar.stereo.set_network import SetNetwork, load_network, save_network

LIGHTS = 4
"""Photographs of the capture."""


class Reader(NamedTuple):
    """What is tested.

    Attributes:
        files: sound contents by file name.
        read: reads the file of that name in a folder.
        together: whether the other files stand beside the mutated one.
    """

    files: dict[str, list[bytes]]
    read: Callable[[Path, str], object]
    together: bool = False


def readers() -> dict[str, Reader]:
    """Every reader by name."""
    listed = _light_files()
    intensities = [b"1\n2\n", b"1 2 3\n4 5 6\n", b"0,5\n1,5\n"]
    capture = {name: [data] for name, data in _capture().items()}
    results = json.dumps({"a.txt": [3, 4]}).encode()
    return {
        "images": Reader({"a.png": _pictures()}, lambda f, n: read_picture(f / n)),  # contents decide on the format
        "light files": Reader({"lights.txt": listed, "a.lp": listed}, lambda f, n: read_directions(f / n)),
        "light intensities": Reader({INTENSITIES_FILE: intensities}, lambda f, _: read_intensities(f, 2)),
        "captures": Reader(capture, lambda f, _: ton.load_capture(f), together=True),
        "meshes": Reader(_meshes(), lambda f, n: ton.load_mesh(f / n)),
        "ONNX files": Reader({"a.onnx": [_graph()]}, lambda f, n: describe_onnx(f / n)),
        "checkpoints": Reader({"a.pt": [_checkpoint()]}, lambda f, n: load_network(f / n)),
        "lists of results": Reader({WRITTEN_LIST: [results]}, lambda f, _: written_files(f)),
    }


def _pictures() -> list[bytes]:
    """Formats, depths, orientation, profiles and alpha, as Pillow and OpenImageIO write them."""
    import OpenImageIO
    import PIL.Image
    import PIL.ImageCms

    draw = np.random.default_rng(0)
    grey, colours = draw.integers(0, 255, (6, 5), np.uint8), draw.integers(0, 255, (6, 5, 4), np.uint8)
    exif = PIL.Image.Exif()
    exif[0x0112] = 6
    profile = PIL.ImageCms.ImageCmsProfile(PIL.ImageCms.createProfile("sRGB")).tobytes()
    found = []
    for picture, kind in (
        (grey, "PNG"), (grey.astype(np.uint16) * 257, "PNG"), (colours, "PNG"), (colours[..., :3], "JPEG"),
        (grey, "TIFF"), (colours[..., :3], "TIFF"), (colours[..., :3], "WEBP"), (grey, "BMP"), (colours, "TGA"),
        (colours[..., :3], "PPM"), (grey, "GIF"), (colours[..., :3], "JPEG2000"),
    ):  # fmt: skip
        stream = io.BytesIO()
        options = {"icc_profile": profile, "exif": exif} if kind in ("PNG", "JPEG", "TIFF", "WEBP") else {}
        PIL.Image.fromarray(picture).save(stream, kind, **options)
        found.append(stream.getvalue())
    with TemporaryDirectory() as folder:
        for name in ("a.exr", "a.hdr"):
            target = OpenImageIO.ImageOutput.create(f"{folder}/{name}")
            assert target is not None
            target.open(f"{folder}/{name}", OpenImageIO.ImageSpec(5, 6, 3, "float"))
            target.write_image(colours[..., :3].astype(np.float32))
            target.close()
            found.append(Path(folder, name).read_bytes())
    return found


def _light_files() -> list[bytes]:
    rows = [" ".join(f"{v:.4f}" for v in light) for light in spiral_lights(LIGHTS).tolist()]
    named = [f"00{k + 1}.png {row}" for k, row in enumerate(rows)]
    table = ["name,x,y,z", *(row.replace(" ", ",") for row in named)]
    commas = [row.replace(".", ",") for row in rows]
    texts = ["\n".join(part) for part in ([str(LIGHTS), *named], rows, table, commas, ["azimuth;elevation", "30;60"])]
    return [text.encode() for text in texts] + [texts[0].encode("utf-16")]


def _capture() -> dict[str, bytes]:
    """The files of a small capture."""
    with TemporaryDirectory() as folder:
        images = torch.rand(LIGHTS, 3, 4, 5, generator=torch.Generator().manual_seed(0))
        mask = torch.ones(1, 4, 5, dtype=torch.bool)
        normal = torch.zeros(3, 4, 5)
        normal[2] = 1
        save_capture(folder, images, spiral_lights(LIGHTS), mask, normal)
        return {file.name: file.read_bytes() for file in Path(folder).iterdir()}


def _meshes() -> dict[str, list[bytes]]:
    """Each format as trimesh writes it, and what it does not write."""
    import trimesh

    box = trimesh.creation.box()
    found = {f"a.{kind}": [_bytes(box.export(file_type=kind))] for kind in ("obj", "ply", "off", "stl", "glb")}
    found["a.stl"].append(_bytes(box.export(file_type="stl_ascii")))
    found["a.obj"].append(b"v 0 0 0\nv 2 1 0\nv 4 0 0\nv 2 4 0\nvn 0 0 1\ns 1\nf -4//1 -3//1 -2//1 -1//1\n")
    header = b"ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
    header += b"property float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
    body = np.arange(12, dtype="<f4").tobytes() + struct.pack("<B3iB4i", 3, 0, 1, 2, 4, 0, 1, 2, 3)
    found["a.ply"].append(header + body)
    found["a.ply"].append(_bytes(box.export(file_type="ply", encoding="ascii")))
    tree = found["a.glb"][0]
    found["a.gltf"] = [tree[20 : 20 + struct.unpack_from("<I", tree, 12)[0]]]
    return found


def _bytes(written: str | bytes) -> bytes:
    return written.encode() if isinstance(written, str) else bytes(written)


def _graph() -> bytes:
    from onnx import TensorProto, helper

    value = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", 3]) for name in ("x", "y")]
    graph = helper.make_graph([helper.make_node("Relu", ["x"], ["y"])], "g", value[:1], value[1:])
    model = helper.make_model(graph)
    model.metadata_props.add(key="graph", value="shading")
    return bytes(model.SerializeToString())


def _checkpoint() -> bytes:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "a.pt"
        save_network(file, SetNetwork(width=8))
        return file.read_bytes()
