"""The reference: one page per part of the package, on it one section per public name, written from its docstring.

Under each stand the programs of the gallery that use it, with their pictures.
"""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import torch_orennayar
from scripts.benchmarks.record import ROOT

GROUPS: dict[str, tuple[str, tuple[str, ...]]] = {
    "shading": (
        "Shading and reflectance",
        (
            "OrenNayar", "oren_nayar", "brdf", "directional_albedo", "point_light", "MODELS", "Model",
            "register_model", "simplest_model", "ModelChoice", "roughness_from_slope", "slope_from_roughness",
            "phong", "blinn_phong", "microfacet",
        ),
    ),
    "rendering": (
        "Cameras, meshes and rendering",
        (
            "Camera", "load_mesh", "Mesh", "save_mesh", "normalise_mesh", "orient_faces", "vertex_normals",
            "render_normals", "NormalMap", "antialias", "face_neighbours", "cast_shadows", "swap_opencv_frame",
        ),
    ),
    "stereo": (
        "Photometric stereo",
        (
            "photometric_stereo", "Reconstruction", "BatchReconstruction", "near_light_stereo",
            "find_light_positions", "LightPositions", "find_lights", "FoundLights", "SetNetwork",
            "make_tokens", "load_network", "save_network",
        ),
    ),
    "shape": (
        "Shape, depth and errors of normals",
        (
            "shape_from_shading", "silhouette_normals", "integrate_normals", "depth_to_normals", "angular_error",
            "AngularError",
        ),
    ),
    "synthetic": (
        "Synthetic data",
        (
            "SyntheticCaptures", "SyntheticImages", "SyntheticPixels", "Ingredients", "SyntheticBatch",
            "collate_captures", "AugmentCaptures", "RandomRelight",
        ),
    ),
    "onnx": ("ONNX graphs", ("export_onnx",)),
    "files": (
        "Captures and files",
        (
            "load_capture", "Capture", "srgb_to_linear", "linear_to_srgb", "encode_normals", "decode_normals",
            "write_shards", "decode_shard",
        ),
    ),
    "errors": (
        "Errors and findings",
        (
            "TorchOrenNayarError", "ShapeError", "RangeError", "ModelError", "CaptureError", "FileError",
            "ExportError", "MissingPackageError", "Finding", "__version__",
        ),
    ),
}  # fmt: skip
"""Page, title and public names of every part, in the order of the menu."""


def write(folder: Path) -> None:
    """Write the pages as reStructuredText."""
    folder.mkdir(parents=True)
    index = _heading("Reference", "=") + "Every public name, as in ``import torch_orennayar as ton``.\n\n"
    for page, (title, names) in GROUPS.items():
        index += _heading(title, "-") + _summary(names)
        text = _heading(title, "=") + ".. py:currentmodule:: torch_orennayar\n\n"
        (folder / f"{page}.rst").write_text(text + "".join(_section(name) for name in names), encoding="utf-8")
    (folder / "index.rst").write_text(index + _toctree(list(GROUPS)), encoding="utf-8")


def _heading(title: str, line: str) -> str:
    return f"{title}\n{line * len(title)}\n\n"


def _toctree(pages: list[str]) -> str:
    return ".. toctree::\n   :hidden:\n\n" + "".join(f"   {page}\n" for page in pages)


def _summary(names: tuple[str, ...]) -> str:
    """A list of names with the first sentence of each."""
    rows = "".join(f"   * - `{name} <torch_orennayar.{name}>`\n     - {_first_line(name)}\n" for name in names)
    return ".. py:currentmodule:: torch_orennayar\n\n.. list-table::\n   :widths: 30 70\n\n" + rows + "\n"


def _section(name: str) -> str:
    """Heading and directive of one name."""
    value, title = getattr(torch_orennayar, name), name.replace("_", r"\_") if name.startswith("__") else name
    if not callable(value):
        body = f".. py:data:: {name}\n\n   {_first_line(name)}\n"
    elif inspect.isclass(value):
        body = f".. autoclass:: {name}\n   :members:\n   :exclude-members: {_hidden(value)}\n"
        if issubclass(value, Exception):
            body += "   :no-members:\n   :show-inheritance:\n"
    else:
        body = f".. autofunction:: {name}\n"
    return f"{_heading(title, '-')}{body}\n.. minigallery:: torch_orennayar.{name}\n\n"


def _hidden(kind: type) -> str:
    """Members without a docstring of their own, which only the interpreter calls."""
    return ", ".join(sorted(n for n in vars(kind) if not n.startswith("_") and not getattr(kind, n).__doc__)) or "None"


def _first_line(name: str) -> str:
    """The first sentence of a name's docstring; of a constant, of the string literal under it."""
    value = getattr(torch_orennayar, name)
    if callable(value):
        return (inspect.getdoc(value) or "").split("\n\n")[0].replace("\n", " ")
    module = "_version" if name == "__version__" else "reflectance/models"
    source = (ROOT / "torch_orennayar" / f"{module}.py").read_text(encoding="utf-8")
    (line,) = re.findall(rf'^{name}\b.*\n"""(.+)"""$', source, re.MULTILINE)
    return str(line)
