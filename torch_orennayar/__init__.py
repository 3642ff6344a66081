"""Batched, differentiable Oren-Nayar shading, normal-map rendering and photometric stereo in PyTorch.

Conventions: images (B, C, H, W), linear light; camera frame x right, y up, z toward the viewer;
directions are unit vectors away from the surface; roughness in radians, 0 is Lambert.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._version import __version__

if TYPE_CHECKING:  # what type checkers and editors read; at run time `__getattr__` loads a name when it is first used
    from .core.errors import (
        CaptureError,
        ExportError,
        FileError,
        MissingPackageError,
        ModelError,
        RangeError,
        ShapeError,
        TorchOrenNayarError,
    )
    from .core.findings import Finding
    from .export.api import export_onnx
    from .geometry.camera import Camera
    from .geometry.depth import depth_to_normals
    from .geometry.frames import swap_opencv_frame
    from .geometry.height_field import silhouette_normals
    from .geometry.integrate import integrate_normals
    from .geometry.mesh import normalise_mesh, vertex_normals
    from .geometry.mesh_files import Mesh, load_mesh, orient_faces, save_mesh
    from .geometry.metrics import AngularError, angular_error
    from .io.capture import Capture, load_capture
    from .io.images import decode_normals, encode_normals
    from .io.shards import decode_shard, write_shards
    from .io.srgb import linear_to_srgb, srgb_to_linear
    from .reconstruction import BatchReconstruction, Reconstruction
    from .reflectance.model_choice import ModelChoice, simplest_model
    from .reflectance.models import MODELS, Model, register_model
    from .reflectance.roughness import roughness_from_slope, slope_from_roughness
    from .reflectance.specular import blinn_phong, microfacet, phong
    from .render.antialias import antialias, face_neighbours
    from .render.normal_map import NormalMap, render_normals
    from .render.shadow import cast_shadows
    from .shading.functional import brdf, directional_albedo, oren_nayar
    from .shading.layer import OrenNayar
    from .shading.point_light import point_light
    from .shape.solver import shape_from_shading
    from .stereo.light_positions import LightPositions, find_light_positions
    from .stereo.near_light import near_light_stereo
    from .stereo.set_network import SetNetwork, load_network, make_tokens, save_network
    from .stereo.solver import photometric_stereo
    from .stereo.unknown_lights import FoundLights, find_lights
    from .synthetic.augment import AugmentCaptures, RandomRelight
    from .synthetic.captures import SyntheticCaptures
    from .synthetic.collate import SyntheticBatch, collate_captures
    from .synthetic.images import SyntheticImages
    from .synthetic.ingredients import Ingredients
    from .synthetic.pixels import SyntheticPixels

_HOMES = {
    "core.errors": (
        "CaptureError",
        "ExportError",
        "FileError",
        "MissingPackageError",
        "ModelError",
        "RangeError",
        "ShapeError",
        "TorchOrenNayarError",
    ),
    "core.findings": ("Finding",),
    "export.api": ("export_onnx",),
    "geometry.camera": ("Camera",),
    "geometry.depth": ("depth_to_normals",),
    "geometry.frames": ("swap_opencv_frame",),
    "geometry.height_field": ("silhouette_normals",),
    "geometry.integrate": ("integrate_normals",),
    "geometry.mesh": (
        "normalise_mesh",
        "vertex_normals",
    ),
    "geometry.mesh_files": (
        "Mesh",
        "load_mesh",
        "orient_faces",
        "save_mesh",
    ),
    "geometry.metrics": (
        "AngularError",
        "angular_error",
    ),
    "io.capture": (
        "Capture",
        "load_capture",
    ),
    "io.images": (
        "decode_normals",
        "encode_normals",
    ),
    "io.shards": (
        "decode_shard",
        "write_shards",
    ),
    "io.srgb": (
        "linear_to_srgb",
        "srgb_to_linear",
    ),
    "reconstruction": (
        "BatchReconstruction",
        "Reconstruction",
    ),
    "reflectance.model_choice": (
        "ModelChoice",
        "simplest_model",
    ),
    "reflectance.models": (
        "MODELS",
        "Model",
        "register_model",
    ),
    "reflectance.roughness": (
        "roughness_from_slope",
        "slope_from_roughness",
    ),
    "reflectance.specular": (
        "blinn_phong",
        "microfacet",
        "phong",
    ),
    "render.antialias": (
        "antialias",
        "face_neighbours",
    ),
    "render.normal_map": (
        "NormalMap",
        "render_normals",
    ),
    "render.shadow": ("cast_shadows",),
    "shading.functional": (
        "brdf",
        "directional_albedo",
        "oren_nayar",
    ),
    "shading.layer": ("OrenNayar",),
    "shading.point_light": ("point_light",),
    "shape.solver": ("shape_from_shading",),
    "stereo.light_positions": (
        "LightPositions",
        "find_light_positions",
    ),
    "stereo.near_light": ("near_light_stereo",),
    "stereo.set_network": (
        "SetNetwork",
        "load_network",
        "make_tokens",
        "save_network",
    ),
    "stereo.solver": ("photometric_stereo",),
    "stereo.unknown_lights": (
        "FoundLights",
        "find_lights",
    ),
    "synthetic.augment": (
        "AugmentCaptures",
        "RandomRelight",
    ),
    "synthetic.captures": ("SyntheticCaptures",),
    "synthetic.collate": (
        "SyntheticBatch",
        "collate_captures",
    ),
    "synthetic.images": ("SyntheticImages",),
    "synthetic.ingredients": ("Ingredients",),
    "synthetic.pixels": ("SyntheticPixels",),
}
"""The module that defines each public name."""
_MODULE_OF = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    "MODELS",
    "AngularError",
    "AugmentCaptures",
    "BatchReconstruction",
    "Camera",
    "Capture",
    "CaptureError",
    "ExportError",
    "FileError",
    "Finding",
    "FoundLights",
    "Ingredients",
    "LightPositions",
    "Mesh",
    "MissingPackageError",
    "Model",
    "ModelChoice",
    "ModelError",
    "NormalMap",
    "OrenNayar",
    "RandomRelight",
    "RangeError",
    "Reconstruction",
    "SetNetwork",
    "ShapeError",
    "SyntheticBatch",
    "SyntheticCaptures",
    "SyntheticImages",
    "SyntheticPixels",
    "TorchOrenNayarError",
    "__version__",
    "angular_error",
    "antialias",
    "blinn_phong",
    "brdf",
    "cast_shadows",
    "collate_captures",
    "decode_normals",
    "decode_shard",
    "depth_to_normals",
    "directional_albedo",
    "encode_normals",
    "export_onnx",
    "face_neighbours",
    "find_light_positions",
    "find_lights",
    "integrate_normals",
    "linear_to_srgb",
    "load_capture",
    "load_mesh",
    "load_network",
    "make_tokens",
    "microfacet",
    "near_light_stereo",
    "normalise_mesh",
    "oren_nayar",
    "orient_faces",
    "phong",
    "photometric_stereo",
    "point_light",
    "register_model",
    "render_normals",
    "roughness_from_slope",
    "save_mesh",
    "save_network",
    "shape_from_shading",
    "silhouette_normals",
    "simplest_model",
    "slope_from_roughness",
    "srgb_to_linear",
    "swap_opencv_frame",
    "vertex_normals",
    "write_shards",
]


def __getattr__(name: str) -> Any:
    """Load the module of a public name when the name is first used."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(f".{_MODULE_OF[name]}", __name__), name)
    return value


def __dir__() -> list[str]:
    """The public names, for completion."""
    return sorted(__all__)
