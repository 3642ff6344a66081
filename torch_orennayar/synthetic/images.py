"""Rendered synthetic captures: one mesh in one textured material, photographed under random lights."""

from __future__ import annotations

import math
from typing import NamedTuple, TypedDict

import torch
import torch.nn.functional as F
from torch import Tensor

from ..geometry.camera import Camera
from ..render.normal_map import render_normals
from ..render.radiosity import SeenSurface, light_between
from ..render.shadow import cast_shadows
from ..shading.layer import OrenNayar
from .draw import Draw
from .ingredients import Ingredients
from .materials import Materials, draw_materials
from .pixels import draw_lights, perturb_lights, round_to_bits
from .scenes import Meshes, draw_mesh

SHADOW_OVERSAMPLING = 2
"""Side of the shadow maps over that of the picture: their texels are half a pixel. Set by hand."""
PATCHES = 128
"""Sample points that stand for the surface in the light between its parts. Set by hand, for time."""
MIN_VIEW_COSINE = 0.05
"""Smallest cosine to the view at which highlights and glaze are evaluated, which divide by it. Set by hand."""
MIN_LIGHT_COSINE = 1e-3
"""The same to the light; what lies beyond the terminator is dark anyway."""
WHITE_QUANTILE = 0.999
"""Quantile of the radiance that is the sensor's white where a capture is clipped: brighter pixels saturate. Set by
hand."""
QUANTILE_LIMIT = 2**23
"""Values; of more the quantile is taken of some, as ``torch.quantile`` refuses more than 2**24."""
READ_NOISE = 0.3
"""Additive noise of pictures over that of pixels in `Ingredients`. Set by hand."""


class SyntheticImages(TypedDict):
    """A sample of kind ``"images"``: K photographs of one object, and all that they follow from.

    With ``layer = OrenNayar("vcavity")`` the pictures are::

        brightness * (exposure * reached * layer(normal, true_lights, view, albedo, roughness) + between + remainder)

    with noise, cut to [0, 1] and rounded to a number of bits. The line holds as it is for a `SyntheticBatch`; of a
    single sample the layer takes ``normal[None]``, ``true_lights[None]`` and so on.

    Attributes:
        images: (K, 3, H, W) linear light in [0, 1], 0 outside the mask.
        lights: (K, 3) unit directions as a capture states them, camera frame.
        mask: (1, H, W) bool.
        normal: (3, H, W) true unit normals, camera frame, 0 outside the mask.
        view: (3, H, W) unit directions to the camera.
        depth: (1, H, W) distance along the viewing axis, 0 outside the mask. The object is 2 units wide.
        albedo: (3, H, W) of the diffuse part, 0 outside the mask.
        roughness: (1, H, W) radians, 0 outside the mask.
        exposure: (1, 1, 1, 1) factor from shading to picture.
        reached: (K, 1, H, W) share of each light that other parts do not block.
        between: (K, 3, H, W) what light that other parts reflect adds to the pictures.
        remainder: (K, 3, H, W) what glaze, retro-reflection, falloff, highlights, sheen and ambient light add to them,
            or take away where negative.
        true_lights: (K, 3) the lights that the pictures were made with.
        brightness: (K, 1, 1, 1) of the lights, where the capture states 1 for all.

    Example:
        >>> import torch_orennayar as ton
        >>> sample = ton.SyntheticCaptures("images", seed=1, size=(32, 32), lights=(4, 4)).sample(0)
        >>> sample["images"].shape, sample["albedo"].shape
        (torch.Size([4, 3, 32, 32]), torch.Size([3, 32, 32]))
    """

    images: Tensor
    lights: Tensor
    mask: Tensor
    normal: Tensor
    view: Tensor
    depth: Tensor
    albedo: Tensor
    roughness: Tensor
    exposure: Tensor
    reached: Tensor
    between: Tensor
    remainder: Tensor
    true_lights: Tensor
    brightness: Tensor


def draw_images(draw: Draw, count: int, mix: Ingredients, size: tuple[int, int], meshes: Meshes) -> SyntheticImages:
    """A mesh seen by a random camera under ``count`` lights, with cast shadows and interreflection."""
    vertices, faces = draw_mesh(draw, meshes)
    camera = _draw_camera(draw)
    seen = render_normals(vertices, faces, camera, size)
    mask = seen.mask[0]
    inside = mask[0]
    lights = draw_lights(draw, 1, count)[0]
    material = draw_materials(draw, 1, mix)
    albedo = _draw_map(draw, 3, size, low=0.2, high=0.95) * material.diffuse_weight * mask
    roughness = _draw_map(draw, 1, size, low=0.2, high=1.0) * material.roughness * mask
    surface = SeenSurface.of(seen)
    reached = torch.ones(count, 1, *size, device=draw.device)
    if mix.shadows:
        reached = cast_shadows(vertices, faces, seen, lights, resolution=SHADOW_OVERSAMPLING * max(size))
    here = _Lit(surface, lights, albedo[:, inside], roughness[:, inside], reached[:, :, inside])
    shaded = _shade(here)
    patches = draw.fork()
    between = _shade_between(here, patches) if mix.bounce else torch.zeros_like(shaded)
    remainder = _shade_remainder(here, shaded, material)
    shaded = shaded * here.reached
    level = (shaded + between + remainder).mean() if inside.any() else shaded.new_zeros(())
    remainder = remainder + draw.uniform(1, high=mix.ambient) * level
    exposure = _expose(draw, shaded + between + remainder, mix)
    brightness = 1 + mix.intensity_error * draw.uniform(count, low=-1)
    between, remainder = exposure * between, exposure * remainder
    recorded = _record(draw, brightness[:, None, None] * (exposure * shaded + between + remainder), mix)

    def spread(values: Tensor) -> Tensor:
        whole = torch.zeros(count, 3, *size, device=draw.device)
        whole[:, :, inside] = values
        return whole

    return {
        "images": spread(recorded),
        "lights": perturb_lights(draw, lights[None], mix)[0],
        "mask": mask,
        "normal": seen.normal[0],
        "view": camera.view_directions(size)[0].to(lights).expand(3, *size).contiguous(),
        "depth": torch.where(mask, seen.depth[0], 0.0),
        "albedo": albedo,
        "roughness": roughness,
        "exposure": exposure.reshape(1, 1, 1, 1),
        "reached": reached,
        "between": spread(between),
        "remainder": spread(remainder),
        "true_lights": lights,
        "brightness": brightness[:, None, None, None],
    }


class _Lit(NamedTuple):
    """P pixels under K lights: their surface, (K, 3) lights, (3, P) albedo, (1, P) roughness, (K, 1, P) light."""

    surface: SeenSurface
    lights: Tensor
    albedo: Tensor
    roughness: Tensor
    reached: Tensor


def _shade(here: _Lit) -> Tensor:
    """What the layer makes of the pixels, without cast shadows, (K, 3, P)."""
    normal, view = (part.T[None, :, :, None] for part in (here.surface.normal, here.surface.view))
    layer, maps = OrenNayar("vcavity"), (here.albedo[None, :, :, None], here.roughness[None, :, :, None])
    shaded: Tensor = layer(normal, here.lights[None], view, *maps)
    return shaded[0, :, :, :, 0]


def _shade_between(here: _Lit, draw: Draw) -> Tensor:
    """The light that parts reflect onto each other, as they reflect it to the camera, (K, 3, P)."""
    irradiance = (here.surface.normal @ here.lights.T).clamp_min(0) * here.reached[:, 0].T
    arriving = light_between(here.surface, here.albedo.T, irradiance, draw.generator, patches=PATCHES)
    return (here.albedo.T[:, :, None] * arriving).permute(2, 1, 0)


def _shade_remainder(here: _Lit, shaded: Tensor, material: Materials) -> Tensor:
    """What a material adds to a rough diffuse surface, (K, 3, P): the albedo tints the highlights of metals only."""
    ci = here.lights @ here.surface.normal.T  # (K, P)
    co = (here.surface.normal * here.surface.view).sum(1)
    lv = here.lights @ here.surface.view.T
    cosines = ci.clamp_min(MIN_LIGHT_COSINE), co.clamp_min(MIN_VIEW_COSINE).expand_as(ci), lv
    tint = torch.where(material.diffuse_weight < 1, here.albedo / material.diffuse_weight, 1.0)
    gloss = material.highlights(*cosines) * ci.clamp_min(0) * (co > 0)
    more = shaded * (material.diffuse_factor(*cosines) - 1)[:, None] + tint * gloss[:, None]
    return more * here.reached


def _draw_camera(draw: Draw) -> Camera:
    """A camera on the unit sphere: half of them orthographic, half near enough that perspective shows."""
    if draw.uniform(1).item() < 0.5:
        return Camera.orthographic(1.0)
    field_of_view = math.radians(draw.uniform(1, low=15, high=45).item())
    return Camera.perspective(field_of_view, eye=(0.0, 0.0, 1.0 / math.sin(field_of_view / 2)))


def _draw_map(draw: Draw, channels: int, size: tuple[int, int], *, low: float, high: float) -> Tensor:
    """A texture (C, H, W): one value, or a few that blend into each other or meet at edges."""
    kind, cells = draw.uniform(1).item(), int(draw.uniform(1, low=2, high=8).item())
    grid = draw.uniform(1, channels, cells, cells, low=low, high=high)
    if kind < 0.4:
        return grid[0, :, :1, :1].expand(channels, *size)
    if kind < 0.7:
        return F.interpolate(grid, size=size, mode="bilinear", align_corners=True)[0]
    return F.interpolate(grid, size=size, mode="nearest")[0]


def _expose(draw: Draw, radiance: Tensor, mix: Ingredients) -> Tensor:
    """The factor () that brings the brightest radiance, or a quantile of it, to 1."""
    clipped = draw.uniform(1).item() < mix.clipped
    if not radiance.numel():
        return radiance.new_ones(())
    some = radiance.flatten()[:: 1 + radiance.numel() // QUANTILE_LIMIT]
    white = some.quantile(WHITE_QUANTILE) if clipped else radiance.amax()
    return 1 / white.clamp_min(1e-9)


def _record(draw: Draw, light: Tensor, mix: Ingredients) -> Tensor:
    """What a sensor records of light (K, 3, P): noise, saturation, quantisation; [0, 1]."""
    share, floor = (draw.uniform(1, high=most) for most in mix.noise)
    if any(mix.noise):
        light = light * (1 + share * draw.normal(*light.shape)) + READ_NOISE * floor * draw.normal(*light.shape)
    return round_to_bits(light.clamp(0, 1), draw.uniform(1, low=mix.bits[0], high=mix.bits[1]))
