"""Choose the simplest material that explains photographs: by the error on lights that were held out."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..core.errors import CaptureError
from ..core.progress import track
from . import robust_fit
from .material import LightDirections, Material
from .robust_fit import PixelFit, mean_of
from .roughness_map import LEVELS, at_levels, level_cost, nearest

AUTO_MODEL = "vcavity"
"""The Oren-Nayar model that ``auto`` weighs against Lambert: the one nearest to the theory."""
TOLERANCE = 0.02
"""The simplest material within this share of the best held-out score is chosen."""
ERROR_CAP = 0.15
"""Scores cut absolute errors at this share of a pixel's mean, so that shadows and highlights weigh little."""
MAP_GAIN = 0.1
"""A map of roughness must beat what has none by this share: a few per cent it gains on glaze, which it mimics."""
DISAGREEMENT = 0.1
"""What a radian between the normals of two fits adds to a score: images do not show a misfit that went there."""
IDENTIFIABLE = math.radians(5)
"""A roughness with a larger standard error than this is not told by the photographs."""
SAMPLE_PIXELS = 2500
QUARTERS = 4
MIN_LIGHTS_ROUGHNESS = 5
MIN_LIGHTS_HELD_OUT = 8
MIN_LIGHTS_LOBES = 12
MIN_LIGHTS_HALVES = 20
MAX_CONDITION = 30
LOBES: tuple[tuple[tuple[int, ...], ...], ...] = (((),), ((64,), (32,), (16,), (8,)), ((16, 128), (8, 64)))
"""Exponents that are tried for no lobe, one and two, sharper ones first."""
FALLOFFS = (1.05, 1.1, 1.15, 1.2, 1.3, 1.4)
ROUGHNESSES = LEVELS[1:]
_FINE = math.radians(4)


@dataclass(frozen=True)
class Choice:
    """The material chosen, and why.

    Attributes:
        material: with the numbers that fit the training lights.
        scores: held-out error of every kind of material as a share of the pixel's mean, lower is better.
        reason: one sentence.
    """

    material: Material
    scores: dict[str, float]
    reason: str


def choose(sample: Tensor, places: Tensor, rays: LightDirections, seed: int) -> Choice:
    """The simplest sufficient material for pixels (P, K), by the error on lights that were held out.

    ``places`` (P, 2) are the pixels' rows and columns: neighbours decide together on a roughness that varies.
    """
    count = len(rays)
    if count < MIN_LIGHTS_HELD_OUT:
        return Choice(
            Material(), {}, f"lambert: {count} lights are too few to hold any out (from {MIN_LIGHTS_HELD_OUT} on)."
        )
    held = hold_out(rays.typical(), seed)
    if held is None:
        return Choice(Material(), {}, "lambert: no lights can be held out, the others would lie in one plane.")
    folds = [_Fold.of(sample, rays, out) for out in held]
    near = nearest(places)
    tried: dict[Material, float] = {}

    def score(material: Material) -> float:
        if material not in tried:
            (first, missed), (second, missed_too) = (fold.predict(material, near) for fold in folds)
            apart = torch.atan2(
                torch.linalg.cross(first.normal, second.normal).norm(dim=1), (first.normal * second.normal).sum(1)
            )
            disagreement = apart.clamp(max=math.radians(20)).mean().item()
            tried[material] = (missed + missed_too) / 2 + DISAGREEMENT * disagreement
        return tried[material]

    lobes = count >= MIN_LIGHTS_LOBES
    kinds = track(_kinds(score, lobes=lobes), "weighing materials", 12 if lobes else 4)
    best = [min(kind, key=score) for kind in kinds]
    scores = {material.name: score(material) for material in best}
    chosen = _first_sufficient(best, score)
    listed = ", ".join(f"{name} {value:.4f}" for name, value in scores.items())
    return Choice(
        chosen,
        scores,
        f"{chosen.name} chosen, the simplest within {TOLERANCE:.0%} of the best; scores, the error on held-out lights "
        f"and disagreement of the normals of two fits: {listed}.",
    )


@dataclass(frozen=True)
class _Fold:
    """Lights to fit, lights to predict, and a start for the fits."""

    shown: Tensor
    hidden: Tensor
    lit: Tensor
    trained: LightDirections
    held: LightDirections
    unit: Tensor
    start: PixelFit
    fits: dict[Material, PixelFit]

    @staticmethod
    def of(sample: Tensor, rays: LightDirections, out: Tensor) -> _Fold:
        shown, trained = sample[:, ~out].contiguous(), rays.under(~out)
        start = robust_fit.fit(shown, trained, Material(), used="middle", steps=8)
        lit = robust_fit.in_light(sample)[:, out]
        return _Fold(shown, sample[:, out], lit, trained, rays.under(out), mean_of(sample), start, {})

    def predict(self, material: Material, near: Tensor) -> tuple[PixelFit, float]:
        """The fit to the lights shown, and its error on the others."""
        if not material.varied:
            fitted = self._fit(material)
            predicted = robust_fit.predict(fitted, self.held, material)
        else:  # every pixel the level that suits its neighbours best under the lights shown
            levels = at_levels(material)
            fits = [self._fit(level) for level in levels]
            costs = [level_cost(f, self.shown, self.trained, m) for f, m in zip(fits, levels, strict=True)]
            taken = torch.stack(costs)[:, near].mean(2).argmin(0)
            fitted = robust_fit.take(fits, taken)
            shown = [robust_fit.predict(f, self.held, m) for f, m in zip(fits, levels, strict=True)]
            predicted = torch.stack(shown)[taken, torch.arange(len(taken), device=taken.device)]
        return fitted, error(self.hidden, predicted, self.unit, self.lit)

    def _fit(self, material: Material) -> PixelFit:
        if material not in self.fits:
            self.fits[material] = robust_fit.fit(self.shown, self.trained, material, start=self.start, steps=12)
        return self.fits[material]


def _kinds(score: Callable[[Material], float], *, lobes: bool) -> Iterator[Sequence[Material]]:
    """Candidates by kind, the simplest kind first: lobes cost each pixel a number, falloff and roughness the object."""
    varied = True
    for sets in LOBES if lobes else LOBES[:1]:
        # Of highlights that explain as well the sharpest: a broad one can pass for matt light.
        plain = [Material(exponents=exponents) for exponents in sets]
        base = _first_sufficient(plain, score)
        alike = [
            [base],
            _descend([replace(base, falloff=k) for k in FALLOFFS], score),
            _descend([replace(base, model=AUTO_MODEL, roughness=s) for s in ROUGHNESSES], score),
        ]
        yield from alike
        if varied:  # with highlights only where it was worth a trial without
            last = replace(base, model=AUTO_MODEL, varied=True)
            varied = score(last) < (1 - MAP_GAIN) * min(score(m) for kind in alike for m in kind)
        if varied:
            yield [last]


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


def refine(sample: Tensor, rays: LightDirections, material: Material) -> Material:
    """Falloff or roughness that explains the sample best: from the material's own, finer steps and a parabola."""
    if material.varied:
        return material
    if material.model != "lambert":
        grid, step, name, least = ROUGHNESSES, _FINE, "roughness", 0.0
    elif material.falloff != 1:
        grid, step, name, least = FALLOFFS, 0.025, "falloff", 1.0
    else:
        return material
    unit, lit = mean_of(sample), robust_fit.in_light(sample)
    fits: dict[float, PixelFit] = {}
    costs: dict[float, float] = {}

    def visit(value: float, start: PixelFit | str, steps: int) -> None:
        trial = replace(material, **{name: value})  # type: ignore[arg-type]
        fits[value] = robust_fit.fit(sample, rays, trial, start=start, steps=steps)
        costs[value] = error(sample, robust_fit.predict(fits[value], rays, trial), unit, lit)

    begin: PixelFit | str = robust_fit.fit(sample, rays, Material(), used="middle", steps=8)
    for value in (least, *grid):
        visit(value, begin, 4 if costs else 8)
        begin = fits[value]
    best = min(costs, key=costs.__getitem__)
    for value in (best - step, best + step):
        if value > least:
            visit(value, fits[best], 4)
    found = _parabola(costs)
    if name == "falloff":  # what highlights and shadows leave open is not taken for glaze
        found = _smallest_sufficient(costs, found)
    return replace(material, **{name: found})  # type: ignore[arg-type]


def _smallest_sufficient(costs: dict[float, float], best: float) -> float:
    """The smallest value up to ``best`` whose cost, drawn as straight lines, is within a tenth of the tolerance."""
    enough = min(costs.values()) * (1 + TOLERANCE / 10)
    ordered = sorted(value for value in costs if value <= best)
    for low, high in itertools.pairwise(ordered):
        if costs[low] <= enough:
            return low
        if costs[high] <= enough:
            return high - (high - low) * (enough - costs[high]) / (costs[low] - costs[high])
    return best


def find_roughness(sample: Tensor, rays: LightDirections, model: str) -> Material:
    """A model with the one roughness that explains the sample best."""
    if len(rays) < MIN_LIGHTS_ROUGHNESS:
        raise CaptureError(
            "lights",
            expected=f"at least {MIN_LIGHTS_ROUGHNESS} to find a roughness",
            got=str(len(rays)),
            mend="photograph under more lights, or use model='lambert'",
        )
    return refine(sample, rays, Material(model=model, roughness=ROUGHNESSES[0]))


def error(observed: Tensor, predicted: Tensor, unit: Tensor, lit: Tensor) -> float:
    """Mean absolute error as a share of the pixel's mean, cut at ``ERROR_CAP``, over observations in light.

    Cast shadows, which no candidate knows, would drown what tells candidates apart.
    """
    missed = ((predicted - observed).abs() / unit).clamp(max=ERROR_CAP)
    return (missed * lit).sum().item() / max(lit.sum().item(), 1.0)


def hold_out(lights: Tensor, seed: int) -> tuple[Tensor, Tensor] | None:
    """Two sets of lights to predict from the others, (K,) bool each: the two halves, with few lights two quarters.

    Drawn so that the others still span space; None if none do.
    """
    generator = torch.Generator().manual_seed(seed)
    size = len(lights) // (2 if len(lights) >= MIN_LIGHTS_HALVES else 4)
    for _ in range(50):
        order = torch.randperm(len(lights), generator=generator)
        sets = torch.zeros(2, len(lights), dtype=torch.bool)
        sets[0, order[:size]] = True
        sets[1, order[size : 2 * size]] = True
        first, second = sets.to(lights.device)
        if max(condition(lights[~first]), condition(lights[~second])) <= MAX_CONDITION:
            return first, second
    return None


def condition(lights: Tensor) -> float:
    """Condition number of the light directions: how much noise in the images is amplified."""
    largest, *_, smallest = torch.linalg.svdvals(lights.detach().cpu().double()).tolist()
    return float(largest / max(smallest, 1e-12))


def _parabola(costs: dict[float, float]) -> float:
    """Lowest point of the parabola through the best sample and its neighbours; the best itself at an end."""
    ordered = sorted(costs)
    best = min(costs, key=costs.__getitem__)
    at = ordered.index(best)
    if at in (0, len(ordered) - 1):
        return best
    x0, x1, x2 = ordered[at - 1 : at + 2]
    left, right = (costs[x1] - costs[x0]) / (x1 - x0), (costs[x2] - costs[x1]) / (x2 - x1)
    curvature = (right - left) / (x2 - x0)
    return min(max((x0 + x1) / 2 - left / (2 * curvature), x0), x2) if curvature > 0 else best


def roughness_error(sample: Tensor, rays: LightDirections, material: Material) -> float:
    """Standard error of the roughness in radians: the larger of what two views of the fit say.

    The curvature of the fit, where what normals, albedo and lobes can imitate is taken off pixel by pixel; and how far
    the roughnesses of four quarters of the pixels lie apart, which sees a cost with several valleys.
    """
    curvature = nearby_error(sample, rays, material, len(sample))
    size = -(-len(sample) // QUARTERS)
    split = [slice(i, i + size) for i in range(0, len(sample), size)]
    quarters = [refine(sample[part], rays.at(part), material).roughness for part in split]
    apart = torch.tensor(quarters).std(correction=1).item() / math.sqrt(len(quarters)) if len(quarters) > 1 else 0.0
    return max(curvature, apart)


def nearby_error(sample: Tensor, rays: LightDirections, material: Material, count: int) -> float:
    """Standard error of a roughness that ``count`` pixels such as these share, radians, by the curvature of the fit."""
    fitted = robust_fit.fit(sample, rays, material)
    parts = robust_fit.chunks(sample)
    told = sum(robust_fit.information(fitted[part], sample[part], rays.at(part), material) for part in parts)
    return math.sqrt(len(sample) / (told * count)) if told > 0 else math.inf
