"""Batched, differentiable Oren-Nayar shading, normal-map rendering and photometric stereo in PyTorch.

Conventions: images (B, C, H, W), linear light; camera frame x right, y up, z toward the viewer;
directions are unit vectors away from the surface; roughness in radians, 0 is Lambert.
"""

from ._version import __version__
from .camera import Camera, swap_opencv_frame
from .capture import Capture, load_capture
from .choice import ModelChoice, simplest_model
from .depth import depth_to_normals
from .errors import (
    CaptureError,
    ExportError,
    FileError,
    ModelError,
    RangeError,
    ShapeError,
    TorchOrenNayarError,
)
from .export import export_onnx
from .images import decode_normals, encode_normals, linear_to_srgb, srgb_to_linear
from .integrate import integrate_normals
from .mesh import load_mesh, save_mesh, vertex_normals
from .metrics import AngularError, angular_error
from .near_light import near_light_stereo
from .reconstruction import Reconstruction
from .reflectance import MODELS, Model, register_model, roughness_from_slope, slope_from_roughness
from .render import NormalMap, render_normals
from .shading import OrenNayar, brdf, directional_albedo, oren_nayar, point_light
from .shadow import cast_shadows
from .shape_from_shading import shape_from_shading
from .silhouette import antialias, face_neighbours
from .specular import blinn_phong, microfacet, phong
from .stereo import photometric_stereo
from .synthetic import SyntheticCaptures
from .synthetic_pixels import Ingredients

__all__ = [
    "MODELS",
    "AngularError",
    "Camera",
    "Capture",
    "CaptureError",
    "ExportError",
    "FileError",
    "Ingredients",
    "Model",
    "ModelChoice",
    "ModelError",
    "NormalMap",
    "OrenNayar",
    "RangeError",
    "Reconstruction",
    "ShapeError",
    "SyntheticCaptures",
    "TorchOrenNayarError",
    "__version__",
    "angular_error",
    "antialias",
    "blinn_phong",
    "brdf",
    "cast_shadows",
    "decode_normals",
    "depth_to_normals",
    "directional_albedo",
    "encode_normals",
    "export_onnx",
    "face_neighbours",
    "integrate_normals",
    "linear_to_srgb",
    "load_capture",
    "load_mesh",
    "microfacet",
    "near_light_stereo",
    "oren_nayar",
    "phong",
    "photometric_stereo",
    "point_light",
    "register_model",
    "render_normals",
    "roughness_from_slope",
    "save_mesh",
    "shape_from_shading",
    "simplest_model",
    "slope_from_roughness",
    "srgb_to_linear",
    "swap_opencv_frame",
    "vertex_normals",
]
