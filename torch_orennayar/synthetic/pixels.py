"""Synthetic pixels under random lights: materials, highlights, shadows, interreflection and sensors.

Every function that draws takes a `Draw`, the random numbers of one sample; `Ingredients` limits what may be drawn.

Numbers in the functions (shares of light arrangements, ranges of angles, widths and strengths) were set by hand; what
they rest on for materials is said at `Ingredients`.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple, TypedDict

import torch
import torch.nn.functional as F
from torch import Tensor

from .draw import Draw
from .ingredients import Ingredients
from .materials import draw_materials

WALL_REFLECTION = 0.35
"""Share of the light on an upright white wall that reaches a pixel which faces it. Set by hand."""
WALL_CHANCE = 0.4
"""Probability of each of the walls that may stand beside a pixel. Set by hand."""


class SyntheticPixels(TypedDict):
    """A sample of kind ``"pixels"``: P pixels, each under K lights of its own.

    Attributes:
        observed: (P, K) grey linear light in [0, 1], 1 where the pixel's sensor saturates.
        lights: (P, K, 3) unit directions as a capture states them.
        normal: (P, 3) true unit normals.

    Example:
        >>> import torch_orennayar as ton
        >>> sample = ton.SyntheticCaptures("pixels", seed=1, lights=(24, 24), observations=240).sample(0)
        >>> sample["observed"].shape, sample["normal"].shape
        (torch.Size([10, 24]), torch.Size([10, 3]))
    """

    observed: Tensor
    lights: Tensor
    normal: Tensor


def draw_lights(draw: Draw, pixels: int, count: int) -> Tensor:
    """Light directions (P, K, 3): jittered rectangular grids (60 %), cones (32 %) and rings (8 %), turned at random."""
    side = math.ceil(math.sqrt(count))
    places = torch.arange(count, device=draw.device)
    cell = torch.stack((places % side, places // side), 1).float()
    jittered = (cell + draw.uniform(pixels, count, 2)) / torch.tensor(
        (side, math.ceil(count / side)), device=draw.device
    )
    reach = draw.uniform(pixels, 1, 2, low=20, high=43).deg2rad()
    rectangle = torch.tan((2 * jittered - 1) * reach)
    azimuth = draw.uniform(pixels, count, high=2 * math.pi)
    widest = draw.uniform(pixels, 1, low=26, high=75).deg2rad().cos()
    cosine = 1 - draw.uniform(pixels, count) * (1 - widest)
    ring = draw.uniform(pixels, 1, low=20, high=60).deg2rad().cos().expand(-1, count)
    kind = draw.uniform(pixels, 1)
    cosine = torch.where(kind < 0.92, cosine, ring)
    flat = (1 - cosine * cosine).sqrt() / cosine
    cone = torch.stack((flat * azimuth.cos(), flat * azimuth.sin()), 2)
    plane = torch.where(kind[..., None] < 0.6, rectangle, cone)
    roll = draw.uniform(pixels, 1, high=2 * math.pi)
    x, y = plane.unbind(2)
    turned = torch.stack((roll.cos() * x - roll.sin() * y, roll.sin() * x + roll.cos() * y, torch.ones_like(x)), 2)
    return F.normalize(turned, dim=2)


def draw_normals(draw: Draw, pixels: int) -> Tensor:
    """Normals (P, 3), distributed as over the pixels of a ball's picture."""
    radius, azimuth = draw.uniform(pixels).sqrt() * 0.995, draw.uniform(pixels, high=2 * math.pi)
    return torch.stack((radius * azimuth.cos(), radius * azimuth.sin(), (1 - radius * radius).sqrt()), 1)


class Surroundings(NamedTuple):
    """What other surfaces do to P pixels under K lights, (P, K) each.

    Attributes:
        reached: share of each light that is not blocked.
        reflected: irradiance that arrives by reflection; 1 is a light that is faced.
    """

    reached: Tensor
    reflected: Tensor


def draw_walls(draw: Draw, normals: Tensor, lights: Tensor, mix: Ingredients, easy: Tensor) -> Surroundings:
    """Walls beside P pixels with normals (P, 3) under lights (P, K, 3); none where ``easy`` (P, 1) is 1."""
    pixels, count = lights.shape[:2]
    reached, reflected = lights.new_ones(pixels, count), lights.new_zeros(pixels, count)
    for _ in range(mix.shadows):
        exists = draw.bernoulli(WALL_CHANCE, pixels, 1) * (1 - easy)
        blocked, from_wall = _draw_wall(draw, normals, lights)
        reached = reached * (1 - exists * blocked)
        reflected = reflected + exists * from_wall * mix.bounce
    return Surroundings(reached, reflected * draw.uniform(pixels, 1, low=0.1, high=0.8))


def shade_pixels(
    draw: Draw, lights: Tensor, normals: Tensor, around: Surroundings, mix: Ingredients, easy: Tensor
) -> Tensor:
    """Radiance (P, K) of pixels of random materials by lights (P, K, 3) and normals (P, 3); ``easy`` is (P, 1)."""
    pixels = len(normals)
    materials = draw_materials(draw, pixels, mix)
    materials = replace(materials, sheen=materials.sheen * (1 - easy))
    ci = (lights * normals[:, None]).sum(2)
    co = normals[:, 2:].clamp_min(0.05).expand_as(ci)
    direct = materials.reflect(ci.clamp_min(1e-3), co, lights[..., 2].contiguous()) * ci.clamp_min(0)
    level = direct.mean(1, keepdim=True).clamp_min(1e-6)
    white = level / ci.clamp_min(0).mean(1, keepdim=True).clamp_min(0.05)
    return direct * around.reached + white * around.reflected + draw.uniform(pixels, 1, high=mix.ambient) * level


def _draw_wall(draw: Draw, normals: Tensor, lights: Tensor) -> tuple[Tensor, Tensor]:
    """A wall beside each pixel, most often on the side that its normal leans to.

    Returns:
        Whether the wall blocks each light, 0 or 1, and the irradiance that it reflects to the pixel; (P, K) each.
    """
    pixels = len(normals)
    lean = torch.atan2(normals[:, 1], normals[:, 0])[:, None]
    slope = normals[:, :2].norm(dim=1, keepdim=True)
    azimuth = lean + draw.normal(pixels, 1) * (0.4 + 2.5 * (1 - slope))
    height = draw.uniform(pixels, 1, low=0.2, high=1.0) * (0.35 + slope) * math.pi / 2.4
    width = draw.uniform(pixels, 1, low=0.5, high=1.6)
    toward = lights[..., 0] * azimuth.cos() + lights[..., 1] * azimuth.sin()
    aside = (lights[..., 1] * azimuth.cos() - lights[..., 0] * azimuth.sin()).abs()
    low = torch.atan2(lights[..., 2], toward.clamp_min(1e-6)) < height
    blocked = (low & (toward > 0) & (torch.atan2(aside, toward.clamp_min(1e-6)) < width)).float()
    tilt = draw.uniform(pixels, 1, low=0.0, high=1.0)
    lit = (-toward * tilt.cos() + lights[..., 2] * tilt.sin()).clamp_min(0)
    faces = (normals[:, :1] * azimuth.cos() + normals[:, 1:2] * azimuth.sin()) * 0.8 + 0.2
    return blocked, lit * faces.clamp_min(0) * height.sin() * WALL_REFLECTION


def record_pixels(draw: Draw, radiance: Tensor, mix: Ingredients, easy: Tensor) -> Tensor:
    """What a sensor records of radiance (P, K): intensity errors, outliers, noise, saturation, quantisation; [0, 1]."""
    pixels, count = radiance.shape
    level = radiance.mean(1, keepdim=True).clamp_min(1e-9)
    seen = radiance / level * (1 + mix.intensity_error * draw.uniform(pixels, count, low=-1))
    wrong = draw.bernoulli(mix.outliers, pixels, 1) * draw.uniform(pixels, 1, high=0.35) * (1 - easy)
    hit = (draw.uniform(pixels, count) < wrong).float()
    capped = torch.minimum(seen, draw.uniform(pixels, 1, low=0.3, high=1.0))
    scaled = seen * draw.log_uniform(pixels, count, low=0.3, high=3.0)
    seen = torch.where(hit > 0, torch.where(draw.uniform(pixels, 1) < 0.5, capped, scaled), seen)
    share, floor = (draw.uniform(pixels, 1, high=most) * (1 - 0.7 * easy) for most in mix.noise)
    seen = seen * (1 + share * draw.normal(pixels, count)) + floor * draw.normal(pixels, count)
    top = seen.amax(1, keepdim=True)
    clip = draw.bernoulli(mix.clipped, pixels, 1)
    top = torch.where(clip > 0, top * draw.uniform(pixels, 1, low=0.4, high=1.0), top)
    bits = draw.uniform(pixels, 1, low=mix.bits[0], high=mix.bits[1])
    return round_to_bits((seen / top.clamp_min(1e-6)).clamp(0, 1), bits)


def round_to_bits(values: Tensor, bits: Tensor) -> Tensor:
    """Values in [0, 1] as a sensor of so many bits counts them; of 0 bits as they are."""
    steps = (2**bits).floor()
    return torch.where(bits > 0, (values * steps).round() / steps, values)


def perturb_lights(draw: Draw, lights: Tensor, mix: Ingredients) -> Tensor:
    """Light directions (P, K, 3) as a capture states them: with an error of calibration."""
    error = draw.normal(*lights.shape) * mix.light_error * draw.uniform(len(lights), 1, 1)
    return F.normalize(lights + error, dim=2) if mix.light_error else lights
