"""Choose the simplest material that explains photographs, by the error on lights that were held out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from ..core.findings import Finding
from ..core.progress import track
from . import robust_fit
from .material import LightDirections, Material
from .material_refinement import MIN_LIGHTS_HELD_OUT, MINNAERT_EXPONENTS, ROUGHNESSES, TOLERANCE, capped_error
from .pixel_sample import PixelSample
from .robust_fit import PixelFit
from .robust_stats import capped_angle, in_light, mean_brightness
from .roughness_map import at_levels, level_cost, nearest

AUTO_MODEL = "vcavity"
"""The Oren-Nayar model that ``auto`` compares with Lambert: the nearest to the V-cavity theory
(``scripts/benchmarks/evaluate_reflectance.py``)."""
MAP_GAIN = 0.1
"""Share of the best score by which a map of roughness must beat materials without one: on glaze, which it imitates, it
gains a few per cent. Set by hand from scores of ``scripts/benchmarks/evaluate_stereo.py``."""
DISAGREEMENT = 0.1
"""Score per radian between the normals of the two fits: normals may absorb a misfit that images then do not show. Set
by hand."""
MIN_LIGHTS_LOBES = 12
"""Number of lights; with fewer no lobes are tried. Set by hand."""
MIN_LIGHTS_HALVES = 20
"""Number of lights from which half of them are held out, with fewer a quarter. Set by hand."""
MAX_CONDITION = 30
"""Greatest condition number of light directions that are solved: noise is amplified as much. Set by hand."""
DRAWS = 50
"""Times that lights to hold out are drawn before the search ends without any. Set by hand."""
LOBES: tuple[tuple[tuple[int, ...], ...], ...] = (((),), ((64,), (32,), (16,), (8,)), ((16, 128), (8, 64)))
"""Exponents that are tried for no lobe, one and two, sharper ones first. Set by hand."""


@dataclass(frozen=True)
class MaterialChoice:
    """The material chosen, and why.

    Attributes:
        material: of all pixels.
        scores: held-out error of every kind of material as a share of the pixel's mean, plus a tenth of the angle in
            radians between the normals of two fits, lower is better; empty where nothing was compared.
        findings: on the choice.
        roughness_error: standard error of the roughness, radians; 0 without one, infinite where it is unknown.
    """

    material: Material = field(default_factory=Material)
    scores: dict[str, float] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    roughness_error: float = 0.0


def choose_by_held_out_lights(sample: PixelSample, seed: int) -> MaterialChoice:
    """The simplest sufficient material for a sample of pixels, by the error on lights that were held out."""
    count = len(sample.directions)
    if count < MIN_LIGHTS_HELD_OUT:
        text = f"lambert: {count} lights are too few to hold any out; at least {MIN_LIGHTS_HELD_OUT} are needed."
        return MaterialChoice(findings=(Finding(text, "model-chosen"),))
    held_out = hold_out(sample.directions.as_distant(), seed)
    if held_out is None:
        text = "lambert: no lights can be held out, because the others would lie in one plane."
        return MaterialChoice(findings=(Finding(text, "model-chosen"),))
    folds = [_Fold.of(sample, out) for out in held_out]
    neighbours = nearest(sample.rows_and_columns())
    tried: dict[Material, float] = {}

    def score(material: Material) -> float:
        if material not in tried:
            (first, error), (second, other) = (fold.predict(material, neighbours) for fold in folds)
            tried[material] = (error + other) / 2 + DISAGREEMENT * capped_angle(
                first.normal, second.normal
            ).mean().item()
        return tried[material]

    lobes = count >= MIN_LIGHTS_LOBES
    kinds = track(_kinds(score, lobes=lobes), "comparing materials", 12 if lobes else 4)
    best = [min(kind, key=score) for kind in kinds]
    scores = {material.name: score(material) for material in best}
    chosen = _first_sufficient(best, score)
    listed = ", ".join(f"{name} {value:.4f}" for name, value in scores.items())
    text = (
        f"{chosen.name} chosen, the simplest within {TOLERANCE:.0%} of the best score; scores, error on held-out "
        f"lights plus disagreement between the normals of two fits: {listed}."
    )
    return MaterialChoice(chosen, scores, (Finding(text, "model-chosen"),))


@dataclass(frozen=True)
class _Fold:
    """One split of the lights.

    Attributes:
        shown: the pixels under the lights that are fitted.
        hidden: (P, H) their observations under those that are predicted.
        lit: (P, H) 1 where these are in light.
        directions: to the lights that are predicted.
        mean: (P, 1) brightness of the pixels under all lights.
        start: of the fits.
        fits: those made so far.
    """

    shown: PixelSample
    hidden: Tensor
    lit: Tensor
    directions: LightDirections
    mean: Tensor
    start: PixelFit
    fits: dict[Material, PixelFit]

    @staticmethod
    def of(sample: PixelSample, out: Tensor) -> _Fold:
        """``out`` (K,) bool are the lights to predict."""
        shown = sample.under(~out)
        start = robust_fit.fit(shown, Material(), used="middle", steps=8)
        lit = in_light(sample.grey)[:, out]
        directions = sample.directions.under(out)
        return _Fold(shown, sample.grey[:, out], lit, directions, mean_brightness(sample.grey), start, {})

    def predict(self, material: Material, neighbours: Tensor) -> tuple[PixelFit, float]:
        """The fit to the lights shown, and its error on the others; ``neighbours`` (P, N) share a roughness."""
        if not material.roughness_varies:
            fitted = self._fit(material)
            predicted = robust_fit.predict(fitted, self.directions, material)
        else:  # every pixel the level that suits its neighbours best under the lights shown
            levels = at_levels(material)
            fits = [self._fit(level) for level in levels]
            costs = [level_cost(f, self.shown, m) for f, m in zip(fits, levels, strict=True)]
            best = torch.stack(costs)[:, neighbours].mean(2).argmin(0)
            fitted = PixelFit.pick(fits, best)
            values = [robust_fit.predict(f, self.directions, m) for f, m in zip(fits, levels, strict=True)]
            predicted = torch.stack(values)[best, torch.arange(len(best), device=best.device)]
        return fitted, capped_error(self.hidden, predicted, self.mean, self.lit)

    def _fit(self, material: Material) -> PixelFit:
        if material not in self.fits:
            self.fits[material] = robust_fit.fit(self.shown, material, start=self.start, steps=12)
        return self.fits[material]


def _kinds(score: Callable[[Material], float], *, lobes: bool) -> Iterator[Sequence[Material]]:
    """Candidates by kind, the simplest kind first.

    A lobe costs each pixel a number, while a Minnaert exponent or a roughness costs the object one.
    """
    map_is_tried = True
    for sets in LOBES if lobes else LOBES[:1]:
        # Of highlights that explain as well the sharpest: a broad one can pass for diffuse light.
        plain = [Material(exponents=exponents) for exponents in sets]
        base = _first_sufficient(plain, score)
        uniform = [
            [base],
            _descend([replace(base, minnaert_exponent=k) for k in MINNAERT_EXPONENTS], score),
            _descend([replace(base, model=AUTO_MODEL, roughness=s) for s in ROUGHNESSES], score),
        ]
        yield from uniform
        if map_is_tried:  # with highlights only where it was good enough without
            varying = replace(base, model=AUTO_MODEL, roughness_varies=True)
            map_is_tried = score(varying) < (1 - MAP_GAIN) * min(score(m) for kind in uniform for m in kind)
            if map_is_tried:
                yield [varying]


def _first_sufficient(materials: Sequence[Material], score: Callable[[Material], float]) -> Material:
    """The first material whose score is within the tolerance of the best."""
    enough = min(map(score, materials)) * (1 + TOLERANCE)
    return next(material for material in materials if score(material) <= enough)


def _descend(path: Sequence[Material], score: Callable[[Material], float]) -> Sequence[Material]:
    """The path up to where the score has risen twice."""
    for end in range(2, len(path)):
        if score(path[end]) > score(path[end - 1]) > score(path[end - 2]):
            return path[: end + 1]
    return path


def hold_out(lights: Tensor, seed: int) -> tuple[Tensor, Tensor] | None:
    """Two sets of lights to predict from the others, (K,) bool each: the two halves, with few lights two quarters.

    Drawn so that the others still span space; None if no draw does.
    """
    generator = torch.Generator().manual_seed(seed)
    size = len(lights) // (2 if len(lights) >= MIN_LIGHTS_HALVES else 4)
    for _ in range(DRAWS):
        order = torch.randperm(len(lights), generator=generator)
        sets = torch.zeros(2, len(lights), dtype=torch.bool)
        sets[0, order[:size]] = True
        sets[1, order[size : 2 * size]] = True
        first, second = sets.to(lights.device)
        if max(condition(lights[~first]), condition(lights[~second])) <= MAX_CONDITION:
            return first, second
    return None


def condition(lights: Tensor) -> float:
    """Condition number of the light directions (K, 3): how much noise in the images is amplified."""
    largest, *_, smallest = torch.linalg.svdvals(lights.detach().cpu().double()).tolist()
    return float(largest / max(smallest, 1e-12))
