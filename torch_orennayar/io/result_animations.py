"""Animations of a reconstruction: under a light that circles it, and from a viewer who walks past it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import torch

from ..geometry.camera import Camera
from ..geometry.mesh import depth_to_mesh, normalise_mesh
from ..reconstruction import Reconstruction
from ..render.normal_map import render_normals
from ..shading.layer import OrenNayar
from .figures import show_light
from .images import write_animation
from .result_maps import ResultMaps
from .srgb import as_rgb

FRAMES = 24
"""Pictures of an animation: 2 seconds at the default rate; set by hand."""
RELIGHT_SIDE = 320
"""Pixels along the longer side of the relit pictures, about; set by hand, for the size of the report."""
TURNTABLE_SIDE = 160
"""Pixels of the depth map along its longer side from which the turntable's mesh is made, about; set by hand."""
TURNTABLE_SIZE = (240, 240)
"""Height and width of the turntable's pictures in pixels; set by hand."""
TURNTABLE_ANGLE = math.radians(50)
"""Largest angle of the walk to either side, radians; set by hand: the surface has no back."""


def write_relighting(path: Path, found: Reconstruction, top: float) -> None:
    """Write the object under a light that circles the view axis, about 40 degrees off it; ``top`` is drawn as white."""
    step = math.ceil(max(found.normal.shape[1:]) / RELIGHT_SIDE)
    small = replace(
        found,
        normal=found.normal[:, ::step, ::step].cpu(),
        albedo=found.albedo[:, ::step, ::step].cpu(),
        roughness=found.roughness[:, ::step, ::step].cpu(),
        specular=None if found.specular is None else found.specular[:, :, ::step, ::step].cpu(),
    )
    mask = (small.normal != 0).any(0, keepdim=True)
    angle = torch.arange(FRAMES) * (2 * math.pi / FRAMES)
    lights = torch.stack((angle.sin(), angle.cos(), torch.full_like(angle, 1.2)), 1)
    images = small.shade(torch.nn.functional.normalize(lights, dim=1)) / top
    write_animation(path, [show_light(as_rgb(image), mask) for image in images])


def write_turntable(path: Path, maps: ResultMaps) -> None:
    """Write the surface as seen from the right, the left and back, under a light that stays with the viewer.

    Nothing is written where the depth map has no faces.
    """
    albedo, mask = maps.thinned()
    step = math.ceil(max(mask.shape[1:]) / TURNTABLE_SIDE)
    depth = maps.depth[:, ::step, ::step].float() / step
    vertices, faces, pixels = depth_to_mesh(depth, mask[:, ::step, ::step])
    if len(faces) == 0:
        return
    vertices = normalise_mesh(vertices)
    colours = albedo[:, ::step, ::step].flatten(1)[:, pixels].T
    layer, light = OrenNayar("lambert"), torch.nn.functional.normalize(torch.tensor([[0.4, 0.5, 1.0]]), dim=1)
    pictures = []
    for k in range(FRAMES):
        azimuth = TURNTABLE_ANGLE * math.sin(2 * math.pi * k / FRAMES)
        eye = (3 * math.sin(azimuth), 0.6, 3 * math.cos(azimuth))
        seen = render_normals(vertices, faces, Camera.perspective(math.radians(40), eye), TURNTABLE_SIZE)
        at_corners = colours[faces[seen.face[0, 0].clamp_min(0)]]  # (H, W, 3, C)
        weights = seen.barycentric[0].clamp_min(0)  # on an edge rounding takes some below 0
        tint = torch.einsum("hwkc,khw->chw", at_corners, weights)[None]
        pictures.append(show_light(seen.shade(layer, light, albedo=tint)[0], seen.mask[0]))
    write_animation(path, pictures)
