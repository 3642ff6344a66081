"""Fit several materials to one picture: every pixel takes the one that explains it and its neighbours best.

Beside the fits stand the normals of the network, with albedo and highlights fitted under them.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from . import robust_fit
from .band_fit import Band, draw_fit, fit_band, standard_error
from .channel_fit import fit_under
from .material import Material
from .network_solver import LearnedNormals, read_normals
from .pixel_grid import Grid
from .pixel_sample import PixelSample
from .robust_fit import PixelFit
from .robust_stats import ERROR_CAP, NOISE_FLOOR, capped_angle, in_light, mean_brightness
from .solved_maps import SolvedMaps

RADIUS = 3
"""Rows and columns within which pixels decide on a material together: the smoothness that is assumed. Set by hand."""
APART = 0.2
"""Error per radian between a fit's normal and the network's: a material that does not suit can explain a pixel with a
wrong normal, which images then do not show. Chosen among 0.1, 0.2 and 0.4 on rendered captures of several materials
(``scripts/benchmarks/evaluate_materials.py``, those to tune on)."""
DISTRUST = 3.0
"""Share of the error under the network's normals that is forgiven per unit of a fit's error, as these normals are not
fitted to what they explain, and a fit that explains little bends its own. Chosen as `APART`, among 1 to 3."""
NETWORK_ERROR = 1.5
"""Factor of the error that the network expects; set by hand, from its errors on photographs and captures."""
AGREEING = math.radians(12)
"""Radians between a fit and the network from which they no longer err about one normal; set by hand."""


class Mixture(NamedTuple):
    """What the pixels of a capture may be made of.

    Attributes:
        materials: at least one.
        by_network: whether the network's normals stand beside the fitted ones.
    """

    materials: tuple[Material, ...]
    by_network: bool

    @property
    def is_mixed(self) -> bool:
        """Whether pixels choose."""
        return self.by_network or len(self.materials) > 1

    def as_one(self, maps: SolvedMaps) -> Material:
        """The material of most pixels, with the lobes of all, and rough if one of them is."""
        if maps.material is None:
            return self.materials[0]
        count = torch.bincount(maps.material.flatten(), minlength=len(self.materials) + 1)[1:]
        rough = [material for material in self.materials if material.model != "lambert"]
        most = self.materials[int(count.argmax())]
        return replace(most, model=rough[0].model if rough else most.model, exponents=self.exponents)

    @property
    def falloffs(self) -> tuple[float, ...]:
        """Exponent of Minnaert's law of each material."""
        return tuple(float(material.minnaert_exponent) for material in self.materials)

    @property
    def exponents(self) -> tuple[int, ...]:
        """Of the lobes of all materials, in ascending order."""
        return tuple(sorted({exponent for material in self.materials for exponent in material.exponents}))


class _Candidate(NamedTuple):
    """A fit of all pixels.

    Attributes:
        place: of the material in the mixture.
        fitted: normals and the rest.
        error: (P, 1) standard error of the normals, radians.
        cost: (P,) `capped_misfit`.
        apart: (P,) radians to the network's normal.
    """

    place: int
    fitted: PixelFit
    error: Tensor
    cost: Tensor
    apart: Tensor


def solve_mixture(band: Band, mixture: Mixture) -> SolvedMaps:
    """Maps of one band."""
    learned = read_normals(band.sample, band.grid)
    fits, rendered = [], []
    begin = learned.normal if mixture.is_mixed else None
    for place, material in enumerate(mixture.materials):
        fitted = fit_band(band, material, begin)
        fits.append(_judge(place, fitted, standard_error(fitted, band, material), band, material, learned))
        if mixture.by_network:
            fitted = under_normals(learned.normal, band, material)
            rendered.append(_judge(place, fitted, NETWORK_ERROR * learned.error, band, material, learned))
    which = _assign(fits, rendered, band.grid)
    maps: SolvedMaps | None = None
    for k, candidate in enumerate((*fits, *rendered)):
        part = which == k
        if bool(part.any()):
            material, here = mixture.materials[candidate.place], band.at(part)
            fitted, error = candidate.fitted[part], candidate.error[part]
            if k < len(fits):
                fitted = _average(fitted, error, here, material, learned, part)
            drawn = draw_fit(fitted, error, here, material, mixture.exponents)
            if len(mixture.materials) > 1:
                drawn = replace(drawn, material=here.grid.mask[None] * (candidate.place + 1))
            maps = drawn if maps is None else maps.plus(drawn)
    assert maps is not None  # every pixel has a candidate
    return maps


def under_normals(normal: Tensor, band: Band, material: Material) -> PixelFit:
    """`fit_under` of all pixels of a band."""

    def fit(part: slice) -> PixelFit:
        return fit_under(normal[part], band.sample[part], material, band.used)

    return PixelFit.joined(robust_fit.map_chunks(fit, band.sample.grey))


def _judge(
    place: int, fitted: PixelFit, error: Tensor, band: Band, material: Material, learned: LearnedNormals
) -> _Candidate:
    cost = torch.cat(
        robust_fit.map_chunks(lambda part: capped_misfit(fitted[part], band.sample[part], material), band.sample.grey)
    )
    apart = capped_angle(fitted.normal, learned.normal)
    return _Candidate(place, fitted, error, cost, apart)


def capped_misfit(fitted: PixelFit, sample: PixelSample, material: Material) -> Tensor:
    """Mean absolute error of the observations in light as a share of the pixel's mean, each cut, (P,)."""
    lit, mean = in_light(sample.grey), mean_brightness(sample.grey)
    missed = (robust_fit.predict(fitted, sample.directions, material) - sample.grey).abs() / mean
    return (missed.clamp(max=ERROR_CAP) * lit).sum(1) / lit.sum(1)


def _assign(fits: list[_Candidate], rendered: list[_Candidate], grid: Grid) -> Tensor:
    """Index of every pixel's candidate, (P,), those under the network's normals last."""

    def shared(values: list[Tensor]) -> Tensor:
        stacked = torch.stack(values, 1)
        return grid.mean(stacked, torch.ones_like(stacked[:, :1]), RADIUS)  # (P, candidates)

    cost, apart = shared([c.cost for c in fits]), shared([c.apart for c in fits])
    which = (cost + APART * apart).argmin(1)
    if not rendered:
        return which
    least, best = shared([c.cost for c in rendered]).min(1)
    ours = cost.gather(1, which[:, None])[:, 0]
    return torch.where((1 - DISTRUST * ours) * least < ours, len(fits) + best, which)


def _average(
    fitted: PixelFit, error: Tensor, band: Band, material: Material, learned: LearnedNormals, part: Tensor
) -> PixelFit:
    """A fit with the network's normals averaged in by their errors, where they are near."""
    one = torch.ones_like(error)
    ours = error.clamp_max(math.pi / 2) * (1 - (NOISE_FLOOR / fitted.noise).square()).clamp_min(0).sqrt()
    theirs, apart = learned.error[part], capped_angle(fitted.normal, learned.normal[part])
    mean = band.grid.mean(torch.stack((ours[:, 0], NETWORK_ERROR * theirs[:, 0], apart), 1), one, RADIUS)
    a, b = mean[:, :1].square(), mean[:, 1:2].square()
    share = (a / (a + b)).clamp_max(0.5) * torch.exp(-(mean[:, 2:] / AGREEING).square())
    normal = F.normalize(torch.lerp(fitted.normal, learned.normal[part], share), dim=1)
    return under_normals(normal, band, material)
