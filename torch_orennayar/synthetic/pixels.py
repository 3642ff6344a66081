"""Made-up pixels under made-up lights: materials, highlights, shadows, bounces and sensors, all drawn at random.

Every function takes a generator and draws what a capture might do; `Ingredients` says what may be drawn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from ..reflectance.models import get_model
from ..reflectance.specular import microfacet

WALL = 0.35
"""What a white wall that stands upright sends to a pixel that faces it, as a share of the light on it."""


@dataclass(frozen=True)
class Ingredients:
    """What synthetic captures are made of; every share is a probability.

    Shares of matt parts and strengths of highlights lean to what was fitted to 151 measured materials
    (`tests/support/rendered_captures.py`): two thirds are matt under a glaze, a quarter is rough, and the broad
    highlight of many is nearly as bright as the matt part.

    Attributes:
        roughest: largest roughness of Oren-Nayar surfaces, radians.
        rough: share of Oren-Nayar surfaces; the rest is Lambert's.
        glazed: share under a smooth interface, which turns grazing light away.
        retro: share whose matt part brightens or darkens at grazing angles as measured paints do (Burley 2012).
        falloff: share whose shading is a power of the cosine.
        glossy: share with a highlight.
        second_lobe: share of those with another.
        metal: share of glossy surfaces without a matt part worth naming.
        sheen: share that glows at grazing angles.
        shadows: most walls that may stand in the way of lights; 0 for none, of cast shadows too.
        bounce: whether walls, and in pictures and scenes the surface itself, send light on.
        ambient: most light from everywhere, as a share of the mean.
        light_error: largest error of light directions, radians.
        intensity_error: largest error of the lights' brightness as told.
        noise: most multiplicative and additive noise.
        clipped: share of saturated pixels.
        outliers: share of captures in which some photographs are capped or of wrong brightness.
        bits: fewest and most bits of a pixel's brightest value.
        easy: share of pixels without walls, sheen and outliers, and with little noise; what stands in scenes stays.
    """

    roughest: float = 1.0
    rough: float = 0.25
    glazed: float = 0.6
    retro: float = 0.25
    falloff: float = 0.3
    glossy: float = 0.85
    second_lobe: float = 0.45
    metal: float = 0.22
    sheen: float = 0.2
    shadows: int = 3
    bounce: bool = True
    ambient: float = 0.03
    light_error: float = math.radians(0.35)
    intensity_error: float = 0.03
    noise: tuple[float, float] = (0.02, 0.012)
    clipped: float = 0.12
    outliers: float = 0.18
    bits: tuple[float, float] = (6.5, 14.0)
    easy: float = 0.35


class Draw:
    """Random numbers of one sample, on one device."""

    def __init__(self, seed: int, device: torch.device | str = "cpu") -> None:
        self.generator = torch.Generator(device).manual_seed(seed)
        self.device = torch.device(device)

    def uniform(self, *shape: int, low: float = 0.0, high: float = 1.0) -> Tensor:
        """Numbers between ``low`` and ``high``."""
        return low + (high - low) * torch.rand(shape, generator=self.generator, device=self.device)

    def normal(self, *shape: int) -> Tensor:
        """Numbers of the standard normal distribution."""
        return torch.randn(shape, generator=self.generator, device=self.device)

    def happens(self, share: float, *shape: int) -> Tensor:
        """1 with probability ``share``, otherwise 0."""
        return (self.uniform(*shape) < share).float()

    def logarithmic(self, *shape: int, low: float, high: float) -> Tensor:
        """Numbers whose logarithms are uniform."""
        return self.uniform(*shape, low=math.log(low), high=math.log(high)).exp()


def draw_lights(draw: Draw, pixels: int, count: int) -> Tensor:
    """Directions (P, K, 3): jittered rectangles (60 %), cones (32 %) and rings (8 %), in any order."""
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
    """(P, 3), as the pixels of a ball's picture see them."""
    radius, azimuth = draw.uniform(pixels).sqrt() * 0.995, draw.uniform(pixels, high=2 * math.pi)
    return torch.stack((radius * azimuth.cos(), radius * azimuth.sin(), (1 - radius * radius).sqrt()), 1)


def transmitted(cosine: Tensor, index: Tensor | float) -> Tensor:
    """What Fresnel's equations let through at a smooth interface, by the cosine outside and the refractive index."""
    cosine = cosine.clamp_min(1e-6)
    inside = (1 - (1 - cosine * cosine) / index**2).sqrt()
    s = (cosine - index * inside) / (cosine + index * inside)
    p = (inside - index * cosine) / (inside + index * cosine)
    return 1 - (s * s + p * p) / 2


@dataclass(frozen=True)
class Materials:
    """P materials; every field is (P, 1), lobes are (width, facing reflectance, strength)."""

    albedo: Tensor
    roughness: Tensor
    index: Tensor
    retro: Tensor
    grazing: Tensor
    power: Tensor
    matt: Tensor
    lobes: tuple[tuple[Tensor, Tensor, Tensor], ...]
    sheen: Tensor

    def reflect(self, ci: Tensor, co: Tensor, lv: Tensor) -> Tensor:
        """``pi f_r`` from positive cosines (P, K)."""
        value = get_model("vcavity").function(ci, co, lv, self.albedo, self.roughness)
        halved = ((1 + lv) / 2).clamp_min(0)  # (l.h)^2
        bent = 2 * self.grazing * halved - 0.5
        burley = (1 + bent * (1 - ci) ** 5) * (1 + bent * (1 - co) ** 5)
        value = value * (1 + self.retro * (burley - 1)) * (ci * co).clamp_min(1e-3) ** self.power * self.matt
        value = value * transmitted(ci, self.index) * transmitted(co, self.index)
        for width, facing, strength in self.lobes:
            value = value + strength * microfacet(ci, co, lv, width, facing)
        return value + self.sheen * (1 - halved.sqrt()) ** 5


def draw_material(draw: Draw, pixels: int, mix: Ingredients) -> Materials:
    """P materials."""
    one = (pixels, 1)
    glossy = draw.happens(mix.glossy, *one)
    metal = draw.happens(mix.metal, *one) * glossy
    lobes = []
    for share in (1.0, mix.second_lobe):
        width = draw.uniform(*one, low=0.12, high=0.95) ** 2
        facing = draw.logarithmic(*one, low=0.02, high=0.2)
        facing = torch.where(metal > 0, draw.uniform(*one, low=0.2, high=0.9), facing)
        lobes.append((width, facing, glossy * draw.happens(share, *one) * draw.uniform(*one, low=0.4, high=1.6)))
    return Materials(
        albedo=draw.logarithmic(*one, low=0.03, high=0.95),
        roughness=draw.uniform(*one, high=mix.roughest) * draw.happens(mix.rough, *one),
        index=1 + draw.uniform(*one, low=0.3, high=0.8) * draw.happens(mix.glazed, *one),
        retro=draw.happens(mix.retro, *one),
        grazing=draw.uniform(*one, high=1.2),
        power=draw.uniform(*one, low=-0.1, high=0.3) * draw.happens(mix.falloff, *one),
        matt=1 - metal * draw.uniform(*one, low=0.6, high=1.0),
        lobes=tuple(lobes),
        sheen=draw.happens(mix.sheen, *one) * draw.uniform(*one, high=0.15),
    )


def stand_walls(draw: Draw, normals: Tensor, lights: Tensor, mix: Ingredients, easy: Tensor) -> tuple[Tensor, Tensor]:
    """About P pixels (P, 3): the share of each light (P, K, 3) that walls let by, and what they send on, (P, K)."""
    pixels, count = lights.shape[:2]
    reached, sent = lights.new_ones(pixels, count), lights.new_zeros(pixels, count)
    for _ in range(mix.shadows):
        stands = draw.happens(0.4, pixels, 1) * (1 - easy)
        blocked, bounced = _wall(draw, normals, lights)
        reached = reached * (1 - stands * blocked)
        sent = sent + stands * bounced * mix.bounce
    return reached, sent * draw.uniform(pixels, 1, low=0.1, high=0.8)


def shade_pixels(
    draw: Draw, lights: Tensor, normals: Tensor, reached: Tensor, sent: Tensor, mix: Ingredients, easy: Tensor
) -> Tensor:
    """What P pixels (P, 3) of any materials show before the sensor, (P, K).

    ``reached`` and ``sent`` (P, K) are as of `stand_walls`; ``easy`` (P, 1) is 0 or 1.
    """
    pixels = len(normals)
    materials = draw_material(draw, pixels, mix)
    materials = replace(materials, sheen=materials.sheen * (1 - easy))
    ci = (lights * normals[:, None]).sum(2)
    co = normals[:, 2:].clamp_min(0.05).expand_as(ci)
    held = ci.clamp_min(1e-3)
    direct = materials.reflect(held, co, lights[..., 2].contiguous()) * ci.clamp_min(0)
    level = direct.mean(1, keepdim=True).clamp_min(1e-6)
    white = level / ci.clamp_min(0).mean(1, keepdim=True).clamp_min(0.05)
    return direct * reached + white * sent + draw.uniform(pixels, 1, high=mix.ambient) * level


def _wall(draw: Draw, normals: Tensor, lights: Tensor) -> tuple[Tensor, Tensor]:
    """A wall beside each pixel, most often where the surface leans to: what it blocks and what it sends on, (P, K)."""
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
    return blocked, lit * faces.clamp_min(0) * height.sin() * WALL


def sense(draw: Draw, light: Tensor, mix: Ingredients, easy: Tensor) -> Tensor:
    """What a camera makes of light (P, K): exposure errors, noise, saturation, steps, photographs gone wrong."""
    pixels, count = light.shape
    level = light.mean(1, keepdim=True).clamp_min(1e-9)
    seen = light / level * (1 + mix.intensity_error * draw.uniform(pixels, count, low=-1))
    wrong = draw.happens(mix.outliers, pixels, 1) * draw.uniform(pixels, 1, high=0.35) * (1 - easy)
    hit = (draw.uniform(pixels, count) < wrong).float()
    capped = torch.minimum(seen, draw.uniform(pixels, 1, low=0.3, high=1.0))
    scaled = seen * draw.logarithmic(pixels, count, low=0.3, high=3.0)
    seen = torch.where(hit > 0, torch.where(draw.uniform(pixels, 1) < 0.5, capped, scaled), seen)
    share, floor = (draw.uniform(pixels, 1, high=most) * (1 - 0.7 * easy) for most in mix.noise)
    seen = seen * (1 + share * draw.normal(pixels, count)) + floor * draw.normal(pixels, count)
    top = seen.amax(1, keepdim=True)
    clip = draw.happens(mix.clipped, pixels, 1)
    top = torch.where(clip > 0, top * draw.uniform(pixels, 1, low=0.4, high=1.0), top)
    steps = (2 ** draw.uniform(pixels, 1, low=mix.bits[0], high=mix.bits[1])).floor()
    seen = (seen / top.clamp_min(1e-6)).clamp(0, 1)
    return (seen * steps).round() / steps


def tell_lights(draw: Draw, lights: Tensor, mix: Ingredients) -> Tensor:
    """Directions (P, K, 3) as a capture's file has them: a little off."""
    return F.normalize(lights + draw.normal(*lights.shape) * mix.light_error * draw.uniform(len(lights), 1, 1), dim=2)
