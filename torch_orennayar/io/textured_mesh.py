"""The surface as a GLB file with texture coordinates and textures, for Blender, Unity, three.js and others."""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..core.optional import require
from ..geometry.mesh import depth_to_mesh
from .images import encode_normals
from .result_maps import ResultMaps
from .srgb import as_rgb, linear_to_srgb

MOST_VERTICES = 250_000
"""Vertices of the mesh, at most; finer shape is in the normal texture, which has every pixel. Set by hand."""
MILLIMETRES = 1000.0
"""In a metre, the unit of glTF."""


def write_glb(path: Path, maps: ResultMaps, roughness: Tensor, pixel_mm: float | None) -> None:
    """Write the relief with albedo, roughness and normal textures.

    Vertices carry the normal (0, 0, 1) of the picture plane, so that the normal texture, whose tangents lie along the
    picture's axes, gives every pixel the normal that was found. The unit is the metre where the size of a pixel is
    known; elsewhere the longer side of the picture is 1.

    Args:
        path: of the file.
        maps: of the result.
        roughness: (1, H, W) perceptual roughness.
        pixel_mm: size of a pixel in millimetres, or None.

    Raises:
        MissingPackageError: trimesh or Pillow is not installed.
    """
    require("trimesh", "PIL")
    import trimesh
    from PIL import Image

    depth, mask = maps.depth, maps.mask[:, :: maps.step, :: maps.step]
    step = math.ceil(math.sqrt(max(1.0, int(mask.sum()) / MOST_VERTICES)))
    depth, mask = depth[:, ::step, ::step] / (step * maps.step), mask[:, ::step, ::step]
    vertices, faces, pixels = depth_to_mesh(depth, mask)
    height, width = maps.mask.shape[1:]
    every = step * maps.step
    scale = every * (1 / max(height, width) if pixel_mm is None else pixel_mm / MILLIMETRES)
    row, column = pixels // mask.shape[2], pixels % mask.shape[2]
    texture = torch.stack(((column * every + 0.5) / width, 1 - (row * every + 0.5) / height), 1)

    def picture(values: Tensor) -> Image.Image:
        array = (values.clamp(0, 1) * 255).round().to(torch.uint8).permute(1, 2, 0).numpy()
        buffer = io.BytesIO()
        Image.fromarray(np.ascontiguousarray(array)).save(buffer, "PNG")
        return Image.open(buffer)  # an opened one has the format that trimesh stores

    packed = torch.cat((torch.ones_like(roughness), roughness, torch.zeros_like(roughness)))  # glTF: G rough, B metal
    material = trimesh.visual.material.PBRMaterial(
        name="surface",
        baseColorTexture=picture(linear_to_srgb(as_rgb(maps.display_albedo))),
        metallicRoughnessTexture=picture(packed),
        normalTexture=picture(encode_normals(_outside_flat(maps.normal, maps.mask), torch.ones_like(maps.mask))),
        metallicFactor=1.0,
        roughnessFactor=1.0,
        doubleSided=True,
    )
    mesh = trimesh.Trimesh(
        (vertices * scale).numpy(),
        faces.numpy(),
        vertex_normals=np.tile(np.array([[0.0, 0.0, 1.0]]), (len(vertices), 1)),
        visual=trimesh.visual.TextureVisuals(uv=texture.numpy(), material=material),
        process=False,
    )
    path.write_bytes(trimesh.Scene(mesh).export(file_type="glb", include_normals=True))


def _outside_flat(normal: Tensor, mask: Tensor) -> Tensor:
    """Normals with (0, 0, 1) outside the mask, so that filtering at the edge mixes in no invalid ones."""
    return torch.where(mask, normal, normal.new_tensor((0.0, 0.0, 1.0)).reshape(3, 1, 1))
