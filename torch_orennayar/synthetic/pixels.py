"""Synthetic pixels under random lights: materials, highlights, shadows, interreflection and sensors.

Every function that draws takes a `Draw`, the random numbers of one sample; `Ingredients` limits what may be drawn.

Numbers in the functions (shares of light arrangements, ranges of angles, widths and strengths) were set by hand; what
they rest on for materials is said at `Ingredients`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import NamedTuple, TypedDict

import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.errors import RangeError
from ..reflectance.models import get_model
from ..reflectance.specular import microfacet

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
    """

    observed: Tensor
    lights: Tensor
    normal: Tensor


@dataclass(frozen=True)
class Ingredients:
    """What synthetic captures contain; every share is a probability.

    The shares of diffuse parts and the strengths of highlights are near those fitted to 151 measured materials
    (`tests/support/rendered_captures.py`): two thirds are diffuse under a glaze, a quarter is rough, and the broad
    highlight of many is nearly as bright as the diffuse part.

    Attributes:
        roughest: largest roughness of Oren-Nayar surfaces, radians.
        rough: share of Oren-Nayar surfaces; the others are Lambertian.
        glazed: share under a smooth dielectric interface, which reflects grazing light away.
        retro: share whose diffuse part brightens or darkens at grazing angles as measured paints do (Burley 2012).
        falloff: share whose diffuse part follows Minnaert's law.
        glossy: share with a specular lobe.
        second_lobe: share of those with a second one.
        metal: share of glossy surfaces with almost no diffuse part.
        sheen: share with a lobe at grazing angles, as cloth has.
        shadows: largest number of walls that may block lights; 0 also turns cast shadows off.
        bounce: whether walls, and in pictures and scenes the surface itself, reflect light onto pixels.
        ambient: largest uniform light, as a share of the mean.
        light_error: largest standard deviation of each coordinate of the stated light directions, radians.
        intensity_error: largest relative error of the lights' stated intensities.
        noise: largest multiplicative and additive noise, standard deviations, as shares of the pixel's value and mean.
        clipped: share of saturated pixels.
        outliers: share of pixels for which some photographs are capped or of wrong brightness.
        bits: fewest and most bits of a pixel's brightest value.
        easy: share of pixels without walls, sheen and outliers, and with less noise; shadows and interreflection of
            scenes stay.
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

    def __post_init__(self) -> None:
        """Check every value.

        Raises:
            RangeError: a share outside [0, 1], a size below 0, a pair out of order, or something that is no number.
        """
        for field in fields(self):
            value, name = getattr(self, field.name), f"Ingredients({field.name}=)"
            if isinstance(field.default, tuple):
                sound = isinstance(value, tuple) and len(value) == 2 and all(map(_is_size, value))
                if not sound or (field.name == "bits" and not 1 <= value[0] <= value[1]):
                    raise RangeError(name, expected="a pair of numbers, 0 or more", got=repr(value), mend="correct it")
            elif field.name in _SIZES:
                most = _SIZES[field.name]
                if not _is_size(value) or value > most:
                    mend = "angles are radians: use math.radians" if math.isfinite(most) else "correct it"
                    raise RangeError(name, expected=f"a number from 0 to {most:.3g}", got=repr(value), mend=mend)
            elif not _is_size(value) or value > 1:
                raise RangeError(name, expected="a share from 0 to 1", got=repr(value), mend="correct it")


_SIZES = {"roughest": math.pi / 2, "light_error": math.pi / 2, "shadows": math.inf, "intensity_error": math.inf}
"""Largest values of the ingredients that are no share."""


def _is_size(value: object) -> bool:
    return isinstance(value, (int, float)) and math.isfinite(value) and value >= 0


class Draw:
    """The random numbers of one sample, on one device."""

    def __init__(self, seed: int, device: torch.device | str = "cpu") -> None:
        self.generator = torch.Generator(device).manual_seed(seed)
        self.device = torch.device(device)

    def uniform(self, *shape: int, low: float = 0.0, high: float = 1.0) -> Tensor:
        """Uniform in [low, high)."""
        return low + (high - low) * torch.rand(shape, generator=self.generator, device=self.device)

    def normal(self, *shape: int) -> Tensor:
        """Standard normal."""
        return torch.randn(shape, generator=self.generator, device=self.device)

    def bernoulli(self, probability: float, *shape: int) -> Tensor:
        """1 with this probability, otherwise 0."""
        return (self.uniform(*shape) < probability).float()

    def log_uniform(self, *shape: int, low: float, high: float) -> Tensor:
        """Numbers in [low, high) whose logarithms are uniform."""
        return self.uniform(*shape, low=math.log(low), high=math.log(high)).exp()


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


def transmitted(cosine: Tensor, index: Tensor | float) -> Tensor:
    """Fresnel transmittance of a smooth dielectric, unpolarised, by the cosine outside and the refractive index."""
    cosine = cosine.clamp_min(1e-6)
    inside = (1 - (1 - cosine * cosine) / index**2).sqrt()
    s = (cosine - index * inside) / (cosine + index * inside)
    p = (inside - index * cosine) / (inside + index * cosine)
    return 1 - (s * s + p * p) / 2


class Lobe(NamedTuple):
    """A microfacet lobe of P materials, (P, 1) each: GGX width, reflectance at normal incidence, and strength."""

    width: Tensor
    facing_reflectance: Tensor
    strength: Tensor


@dataclass(frozen=True)
class Materials:
    """P materials; every tensor is (P, 1).

    Attributes:
        albedo: of the diffuse part.
        roughness: radians, of the diffuse part.
        index: refractive index of the interface above it; 1 for none.
        retro: 1 where Burley's diffuse factor applies, otherwise 0.
        burley_roughness: roughness in Burley's diffuse factor.
        falloff: power of ``n.l n.v`` that multiplies the diffuse part; 0 for none.
        diffuse_weight: of the diffuse part.
        lobes: specular lobes.
        sheen: strength of the sheen.
    """

    albedo: Tensor
    roughness: Tensor
    index: Tensor
    retro: Tensor
    burley_roughness: Tensor
    falloff: Tensor
    diffuse_weight: Tensor
    lobes: tuple[Lobe, ...]
    sheen: Tensor

    def reflect(self, ci: Tensor, co: Tensor, lv: Tensor) -> Tensor:
        """``pi f_r`` (P, K) by positive cosines (P, K): ``n.l``, ``n.v`` and ``l.v``."""
        value = get_model("vcavity").function(ci, co, lv, self.albedo, self.roughness)
        squared_lh = ((1 + lv) / 2).clamp_min(0)  # (l.h)^2
        grazing = 2 * self.burley_roughness * squared_lh - 0.5  # F_D90 - 1 of Burley 2012
        burley = (1 + grazing * (1 - ci) ** 5) * (1 + grazing * (1 - co) ** 5)
        value = value * (1 + self.retro * (burley - 1)) * (ci * co).clamp_min(1e-3) ** self.falloff
        value = value * self.diffuse_weight
        value = value * transmitted(ci, self.index) * transmitted(co, self.index)
        for lobe in self.lobes:
            value = value + lobe.strength * microfacet(ci, co, lv, lobe.width, lobe.facing_reflectance)
        return value + self.sheen * (1 - squared_lh.sqrt()) ** 5


def draw_materials(draw: Draw, pixels: int, mix: Ingredients) -> Materials:
    """A material for each of P pixels."""
    one = (pixels, 1)
    glossy = draw.bernoulli(mix.glossy, *one)
    metal = draw.bernoulli(mix.metal, *one) * glossy
    lobes = []
    for share in (1.0, mix.second_lobe):
        width = draw.uniform(*one, low=0.12, high=0.95) ** 2
        facing = draw.log_uniform(*one, low=0.02, high=0.2)
        facing = torch.where(metal > 0, draw.uniform(*one, low=0.2, high=0.9), facing)
        strength = glossy * draw.bernoulli(share, *one) * draw.uniform(*one, low=0.4, high=1.6)
        lobes.append(Lobe(width, facing, strength))
    return Materials(
        albedo=draw.log_uniform(*one, low=0.03, high=0.95),
        roughness=draw.uniform(*one, high=mix.roughest) * draw.bernoulli(mix.rough, *one),
        index=1 + draw.uniform(*one, low=0.3, high=0.8) * draw.bernoulli(mix.glazed, *one),
        retro=draw.bernoulli(mix.retro, *one),
        burley_roughness=draw.uniform(*one, high=1.2),
        falloff=draw.uniform(*one, low=-0.1, high=0.3) * draw.bernoulli(mix.falloff, *one),
        diffuse_weight=1 - metal * draw.uniform(*one, low=0.6, high=1.0),
        lobes=tuple(lobes),
        sheen=draw.bernoulli(mix.sheen, *one) * draw.uniform(*one, high=0.15),
    )


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
    steps = (2 ** draw.uniform(pixels, 1, low=mix.bits[0], high=mix.bits[1])).floor()
    seen = (seen / top.clamp_min(1e-6)).clamp(0, 1)
    return (seen * steps).round() / steps


def perturb_lights(draw: Draw, lights: Tensor, mix: Ingredients) -> Tensor:
    """Light directions (P, K, 3) as a capture states them: with an error of calibration."""
    return F.normalize(lights + draw.normal(*lights.shape) * mix.light_error * draw.uniform(len(lights), 1, 1), dim=2)
