"""Choose how many materials a capture holds and which, by what they say of lights that were held out."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from ..core.findings import Finding
from . import robust_fit
from .channel_fit import fit_under
from .material import Material
from .material_refinement import TOLERANCE, refine
from .material_selection import AUTO_MODEL, DISAGREEMENT, MaterialChoice, hold_out
from .mixed_fit import APART, Mixture
from .network_solver import TRAINED_LIGHTS, LearnedNormals, read_normals
from .pixel_grid import Grid
from .pixel_sample import PixelSample
from .robust_fit import PixelFit
from .robust_stats import ERROR_CAP, capped_angle, in_light, mean_brightness
from .roughness_map import at_levels, nearest
from .solved_maps import SolvedMaps

LOBES = ((), (64,), (8,), (16, 128), (8, 64), (4, 32))
"""Exponents of highlights that are tried over Lambert's material, with and without falloff. Set by hand."""
FALLOFF = 1.1
"""Exponent of Minnaert's law that is tried: about that of measured materials under glaze. Set by hand."""
ROUGHNESSES = tuple(math.radians(degrees) for degrees in (16, 32, 48))
"""Roughnesses that are tried without highlights and with `ROUGH_LOBES`, radians. Set by hand."""
ROUGH_LOBES = ((), (8, 64))
"""Exponents of highlights that are tried over rough materials. Set by hand."""
GAIN, NEXT_GAIN = 0.055, 0.01
"""Shares of the score by which a second material must better it for there to be several, and by which each must.
Photographs of three objects of one material gain up to 0.043 by a second, rendered captures of two or more 0.058 to
0.35. Set by hand."""
NETWORK_GAIN, NETWORK_NEXT_GAIN = 0.02, 0.005
"""Shares of the score that the network's normals must gain beside one material for the capture not to be of that one
alone, and beside those of several: on those photographs they gain 0.006 to 0.016, on captures with metals 0.04 to 0.1.
Set by hand."""
MIN_LIGHTS = 30
"""Number of lights; with fewer, half of them say too little, and several materials are not tried. Set by hand."""
MOST = 8
"""Number of materials; set by hand."""
MIN_PIXELS = 50
"""Pixels of a sample that a roughness or an exponent of falloff is refined on, at least. Set by hand."""


class _Scores(NamedTuple):
    """Of candidates on P pixels, each the mean over a pixel's neighbours.

    Attributes:
        held_out: (M, P) error on held-out lights and a share of the angle between the normals of two fits.
        apart: (M, P) radians between the fits' normals and the network's.
    """

    held_out: Tensor
    apart: Tensor

    @property
    def total(self) -> Tensor:
        """What materials are chosen by, (M, P)."""
        return self.held_out + APART * self.apart


def choose_mixture(sample: PixelSample, single: MaterialChoice, seed: int) -> Mixture | None:
    """Materials for a sample whose simplest ``single`` material is known, which may be that one.

    None where the network does not help: with fewer lights than it was trained on, or under a map of roughness.

    Args:
        sample: pixels in ascending order of their places, of which many are neighbours.
        single: the choice of one material for all.
        seed: draws the lights that are held out.
    """
    material, count = single.material, len(sample.directions)
    if count < TRAINED_LIGHTS:
        return None
    alone = None if material.roughness_varies else Mixture((material,), False)
    held_out = hold_out(sample.directions.as_distant(), seed) if count >= MIN_LIGHTS else None
    if held_out is None:
        return alone
    grid = sample.grid()
    splits = [_Split.of(sample, out, grid) for out in held_out]
    neighbours = nearest(sample.rows_and_columns())
    own = at_levels(material) if material.roughness_varies else [material]
    listed = list(dict.fromkeys((*own, *candidates())))
    scores = _score([[s.fit(candidate) for s in splits] for candidate in listed], listed, splits, neighbours)
    totals = scores.total
    chosen = _choose_greedily(totals)
    which, least = totals[chosen].min(0).indices, totals[chosen].amin(0).mean()
    some = [listed[k] for k in chosen]
    rendered = _score([[s.render(candidate) for s in splits] for candidate in some], some, splits, neighbours)
    one, all_of_them = scores.held_out[chosen[0]], scores.held_out[chosen].gather(0, which[None])[0]
    several = len(some) > 1 and bool(totals[chosen[:2]].amin(0).mean() <= (1 - GAIN) * totals[chosen[0]].mean())
    if not several and _gain(one, rendered.held_out[0]) < NETWORK_GAIN:
        return alone
    gain = _gain(all_of_them, rendered.held_out.amin(0))
    as_good = least > (1 - TOLERANCE) * totals[: len(own)].amin(0).mean()
    if material.roughness_varies and gain < NETWORK_GAIN and as_good:  # a map of roughness stands for several materials
        return alone
    parts = [(which == k).nonzero().flatten() for k in range(len(some))]
    rough = [len(p) >= MIN_PIXELS and m.model != "lambert" for p, m in zip(parts, some, strict=True)]
    refined = [refine(sample[p], m) if r else m for p, m, r in zip(parts, some, rough, strict=True)]
    return Mixture(tuple(refined), gain >= NETWORK_NEXT_GAIN)


def _gain(error: Tensor, other: Tensor) -> float:
    """Share of the mean error (P,) that vanishes where pixels may take the other."""
    return 1 - (torch.minimum(error, other).mean() / error.mean()).item()


def candidates() -> list[Material]:
    """Materials that may be part of a capture."""
    smooth = [Material(minnaert_exponent=k, exponents=lobes) for lobes in LOBES for k in (1.0, FALLOFF)]
    rough = [Material(AUTO_MODEL, sigma, exponents=lobes) for lobes in ROUGH_LOBES for sigma in ROUGHNESSES]
    return smooth + rough


class _Split(NamedTuple):
    """Lights that are fitted, and lights that are predicted.

    Attributes:
        sample: the pixels under all lights.
        shown: the pixels under the lights that are fitted.
        out: (K,) bool, the lights that are predicted.
        start: Lambert's fit with the network's normals.
        learned: the network's normals.
    """

    sample: PixelSample
    shown: PixelSample
    out: Tensor
    start: PixelFit
    learned: LearnedNormals

    @staticmethod
    def of(sample: PixelSample, out: Tensor, grid: Grid) -> _Split:
        """``out`` (K,) bool are the lights to predict."""
        shown = sample.under(~out)
        learned = read_normals(shown, grid)
        return _Split(sample, shown, out, fit_under(learned.normal, shown, Material(), "lit"), learned)

    def fit(self, material: Material) -> PixelFit:
        """To the lights shown, from the network's normals."""
        return robust_fit.fit(self.shown, material, start=self.start, steps=12)

    def render(self, material: Material) -> PixelFit:
        """To the lights shown, under the network's normals."""
        return fit_under(self.learned.normal, self.shown, material, "lit")

    def error(self, fitted: PixelFit, material: Material) -> Tensor:
        """Of the other lights' observations as a share of the pixel's mean, each cut, (P,)."""
        grey = self.sample.grey
        lit, mean = in_light(grey)[:, self.out], mean_brightness(grey)
        predicted = robust_fit.predict(fitted, self.sample.directions.under(self.out), material)
        missed = ((predicted - grey[:, self.out]).abs() / mean).clamp(max=ERROR_CAP)
        return (missed * lit).sum(1) / lit.sum(1).clamp_min(1)


def _score(fits: list[list[PixelFit]], materials: list[Material], splits: list[_Split], neighbours: Tensor) -> _Scores:
    """Scores of fits by candidate and split."""
    held_out, apart = [], []
    for (first, second), material in zip(fits, materials, strict=True):
        a, b = splits
        error = (a.error(first, material) + b.error(second, material)) / 2
        held_out.append(error + DISAGREEMENT * capped_angle(first.normal, second.normal))
        aside = capped_angle(first.normal, a.learned.normal) + capped_angle(second.normal, b.learned.normal)
        apart.append(aside / 2)
    return _Scores(*(torch.stack(values)[:, neighbours].mean(2) for values in (held_out, apart)))


def _choose_greedily(score: Tensor) -> list[int]:
    """Indices of the materials, the best single one, then one by one the most useful."""
    chosen = [int(score.mean(1).argmin())]
    least = score[chosen[0]]
    while len(chosen) < MOST:
        together = torch.minimum(least, score).mean(1)
        best = int(together.argmin())
        if together[best] > (1 - NEXT_GAIN) * least.mean():
            break
        chosen.append(best)
        least = torch.minimum(least, score[best])
    return chosen


def mixture_findings(mixture: Mixture, maps: SolvedMaps) -> list[Finding]:
    """What a user must know of several materials and of the network's part."""
    found, count = [], len(mixture.materials)
    if maps.material is not None:
        pixels = torch.bincount(maps.material.flatten(), minlength=count + 1)[1:].tolist()
        listed = "; ".join(
            f"{index}, {material}, {share / sum(pixels):.0%} of the pixels"
            for index, (material, share) in enumerate(zip(mixture.materials, pixels, strict=True))
        )
        found.append(
            Finding(f"{count} materials explain held-out lights better than one: {listed}.", "materials", count)
        )
    text = "normals of the network are averaged in where they agree with the fit and the fit is uncertain"
    if mixture.by_network:
        text += ", and taken where neighbouring pixels are explained better under them"
    found.append(Finding(f"{text}.", "network-beside"))
    return found
