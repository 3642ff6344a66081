"""`Ingredients`: what synthetic captures contain."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

from ..core.errors import RangeError


@dataclass(frozen=True)
class Ingredients:
    """What synthetic captures contain; every share is a probability.

    The shares of diffuse parts and the strengths of highlights are near those fitted to 151 measured materials
    (``tests/support/rendered_captures.py``): two thirds are diffuse under a glaze, a quarter is rough, and the broad
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
        clipped: share of saturated pixels; of ``"images"`` the share of captures whose brightest thousandth saturates.
        outliers: share of pixels for which some photographs are capped or of wrong brightness; not of ``"images"``.
        bits: fewest and most bits of a pixel's brightest value; (0, 0) for values that are not rounded.
        easy: share of pixels without walls, sheen and outliers, and with less noise; shadows and interreflection of
            scenes stay; not of ``"images"``.

    Example:
        >>> import torch_orennayar as ton
        >>> ton.Ingredients.plain(rough=1.0, shadows=1).glossy  # rough surfaces and cast shadows, nothing else
        0.0
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

    @classmethod
    def plain(cls, **kept: Any) -> Ingredients:
        """Nothing but smooth Lambertian surfaces, except for what is given by name.

        Raises:
            RangeError: values out of range.
        """
        off = cls(
            rough=0.0, glazed=0.0, retro=0.0, falloff=0.0, glossy=0.0, second_lobe=0.0, metal=0.0, sheen=0.0,
            shadows=0, bounce=False, ambient=0.0, light_error=0.0, intensity_error=0.0, noise=(0.0, 0.0), clipped=0.0,
            outliers=0.0, bits=(0.0, 0.0), easy=0.0,
        )  # fmt: skip
        return replace(off, **kept)

    def __post_init__(self) -> None:
        """Check every value.

        Raises:
            RangeError: a share outside [0, 1], a size below 0, a pair out of order, or something that is no number.
        """
        for field in fields(self):
            value, name = getattr(self, field.name), f"Ingredients({field.name}=)"
            if isinstance(field.default, tuple):
                sound = isinstance(value, tuple) and len(value) == 2 and all(map(_is_size, value))
                if not sound or (field.name == "bits" and value != (0, 0) and not 1 <= value[0] <= value[1]):
                    raise RangeError(name, expected="a pair of numbers, 0 or more", got=repr(value), mend="correct it")
            elif field.name in _SIZES:
                most = _SIZES[field.name]
                if not _is_size(value) or value > most:
                    mend = "angles are radians: use math.radians" if math.isfinite(most) else "correct it"
                    raise RangeError(name, expected=f"a number from 0 to {most:.3g}", got=repr(value), mend=mend)
            elif not _is_size(value) or value > 1:
                raise RangeError(name, expected="a share from 0 to 1", got=repr(value), mend="correct it")


_SIZES = {"roughest": math.pi / 2, "light_error": math.pi / 2, "shadows": math.inf, "intensity_error": 1.0}
"""Largest values of the ingredients that are no share."""


def _is_size(value: object) -> bool:
    return isinstance(value, (int, float)) and math.isfinite(value) and value >= 0
