"""Rendered synthetic captures: one mesh in one textured material, photographed under random lights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypedDict

import torch
import torch.nn.functional as F
from torch import Tensor

from ..geometry.camera import Camera
from ..render.normal_map import render_normals
from ..render.radiosity import SeenSurface, light_between
from ..render.shadow import cast_shadows
from .pixels import Draw, Ingredients, Materials, draw_lights, draw_materials, perturb_lights
from .scenes import MeshTensors, draw_mesh

SHADOW_OVERSAMPLING = 4
"""Side of the shadow maps over that of the picture. Set by hand."""
MIN_VIEW_COSINE = 0.05
"""Smallest cosine to the view that reflectance is evaluated at: facets at the rim would divide by less. Set by hand."""
MIN_LIGHT_COSINE = 1e-3
"""The same to the light; what lies beyond the terminator is dark anyway."""
WHITE_QUANTILE = 0.999
"""Quantile of the radiance that is the sensor's white: brighter pixels saturate. Set by hand."""
QUANTILE_LIMIT = 2**23
"""Values; of more the maximum is taken, as ``torch.quantile`` refuses more than 2**24."""
READ_NOISE = 0.3
"""Additive noise of pictures over that of pixels in `Ingredients`. Set by hand."""


class SyntheticImages(TypedDict):
    """A sample of kind ``"images"``: K photographs of one object.

    Attributes:
        images: (K, 3, H, W) linear light in [0, 1], 0 outside the mask.
        lights: (K, 3) unit directions as a capture states them, camera frame.
        mask: (1, H, W) bool.
        normal: (3, H, W) true unit normals, camera frame, 0 outside the mask.
        albedo: (3, H, W), 0 outside the mask.
        roughness: (1, H, W) radians, 0 outside the mask.
    """

    images: Tensor
    lights: Tensor
    mask: Tensor
    normal: Tensor
    albedo: Tensor
    roughness: Tensor


def draw_images(
    draw: Draw, count: int, mix: Ingredients, size: tuple[int, int], meshes: Sequence[MeshTensors] | None
) -> SyntheticImages:
    """A mesh seen by a random camera under ``count`` lights, with cast shadows and interreflection."""
    vertices, faces = draw_mesh(draw, meshes)
    camera = _draw_camera(draw)
    seen = render_normals(vertices, faces, camera, size)
    mask, normal = seen.mask[0], seen.normal[0]
    inside = mask[0]
    lights = draw_lights(draw, 1, count)[0]
    # The true albedo is the texture; that of the one material only weighs its diffuse part against the gloss.
    material = draw_materials(draw, 1, mix)
    texture = _draw_texture(draw, size)
    albedo = texture[:, inside].T
    surface = SeenSurface.of(seen)
    white, irradiance = _shade(surface, lights, material)
    if mix.shadows:
        resolution = SHADOW_OVERSAMPLING * max(size)
        reached = cast_shadows(vertices, faces, seen, lights, resolution=resolution)[:, 0, inside].T
        white, irradiance = white * reached, irradiance * reached
    colours = albedo[:, :, None] * white[:, None]  # (P, 3, K)
    if mix.bounce:
        between = light_between(surface, albedo * material.diffuse_weight, irradiance, draw.generator)
        reflected = albedo[:, :, None] * between
        colours = colours + material.albedo * material.diffuse_weight * reflected
    level = colours.mean().clamp_min(1e-6)
    colours = colours + draw.uniform(1, high=mix.ambient) * level
    recorded = _record_images(draw, colours, mix)
    images = torch.zeros(count, 3, *size, device=draw.device)
    images[:, :, inside] = recorded.permute(2, 1, 0)
    return {
        "images": images,
        "lights": perturb_lights(draw, lights[None], mix)[0],
        "mask": mask,
        "normal": normal,
        "albedo": texture * mask,
        "roughness": material.roughness.reshape(1, 1, 1) * mask,
    }


def _shade(surface: SeenSurface, lights: Tensor, material: Materials) -> tuple[Tensor, Tensor]:
    """Radiance and irradiance of P unshadowed pixels under K lights, (P, K) each."""
    ci, co = surface.normal @ lights.T, (surface.normal * surface.view).sum(1, keepdim=True)
    irradiance = ci.clamp_min(0)
    value = material.reflect(
        ci.clamp_min(MIN_LIGHT_COSINE), co.clamp_min(MIN_VIEW_COSINE).expand_as(ci), surface.view @ lights.T
    )
    return value * irradiance * (co > 0), irradiance


def _draw_camera(draw: Draw) -> Camera:
    """A camera on the unit sphere: half of them orthographic, half near enough that perspective shows."""
    if draw.uniform(1).item() < 0.5:
        return Camera.orthographic(1.0)
    field_of_view = math.radians(draw.uniform(1, low=15, high=45).item())
    return Camera.perspective(field_of_view, eye=(0.0, 0.0, 1.0 / math.sin(field_of_view / 2)))


def _draw_texture(draw: Draw, size: tuple[int, int]) -> Tensor:
    """Albedo (3, H, W): of one colour, or a few colours that blend into each other."""
    cells = 1 if draw.uniform(1).item() < 0.4 else int(draw.uniform(1, low=2, high=8).item())
    grid = draw.uniform(1, 3, cells, cells, low=0.2, high=0.95)
    if cells == 1:
        return grid[0].expand(3, *size)
    return F.interpolate(grid, size=size, mode="bilinear", align_corners=True)[0]


def _record_images(draw: Draw, colours: Tensor, mix: Ingredients) -> Tensor:
    """What a camera records of radiance (P, 3, K): intensity errors, noise, saturation, quantisation; [0, 1]."""
    count = colours.shape[2]
    few = colours.numel() < QUANTILE_LIMIT
    white = colours.flatten().quantile(WHITE_QUANTILE) if few else colours.amax()
    seen = colours / white.clamp_min(1e-9) * (1 + mix.intensity_error * draw.uniform(1, 1, count, low=-1))
    share, floor = (draw.uniform(1, high=most) for most in mix.noise)
    noise = draw.normal(*colours.shape), draw.normal(*colours.shape)
    seen = seen * (1 + share * noise[0]) + READ_NOISE * floor * noise[1]
    steps = (2 ** draw.uniform(1, low=mix.bits[0], high=mix.bits[1])).floor()
    return (seen.clamp(0, 1) * steps).round() / steps
