"""The Minnaert exponent or the roughness that explains a sample best, and how well the photographs determine it."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import torch
from torch import Tensor

from ..core.errors import CaptureError
from . import robust_fit
from .gauss_newton import fill_jacobian
from .linear_systems import solve_symmetric, tangent_vectors
from .material import Material, respond
from .pixel_sample import PixelSample
from .robust_fit import PixelFit, StartName
from .robust_stats import ERROR_CAP, in_light, mean_brightness
from .roughness_map import LEVELS

TOLERANCE = 0.02
"""Share of the best held-out score within which the simplest material is chosen. Set by hand."""
MINNAERT_EXPONENTS = (1.05, 1.1, 1.15, 1.2, 1.3, 1.4)
"""Exponents of Minnaert's law that are tried. Set by hand: of 151 measured materials those under glaze have about 1.1,
as noted when `material_choice.STEEP` was set; no script for it is kept."""
ROUGHNESSES = LEVELS[1:]
"""Roughnesses that are tried, radians."""
FINE_EXPONENT = 0.025
"""Step on both sides of the best exponent; set by hand."""
FINE_ROUGHNESS = math.radians(4)
"""Step on both sides of the best roughness, radians: half a step between levels; set by hand."""
SMOOTH = math.radians(1)
"""Least roughness, radians, of a joint search, as nothing depends on it at 0; set by hand."""
QUARTERS = 4
"""Parts of the pixels whose roughnesses are compared; set by hand."""
MIN_LIGHTS_ROUGHNESS = 5
"""Number of lights; with fewer, normal and albedo leave too little to find a roughness from. Set by hand."""
MIN_LIGHTS_HELD_OUT = 8
"""Number of lights; with fewer none are held out, and light between parts of the surface is not sought. Set by hand."""


def refine(sample: PixelSample, material: Material) -> Material:
    """The exponent or roughness that explains the sample best: a coarse grid, finer steps, and a parabola."""
    if material.roughness_varies:
        return material
    if material.model != "lambert":
        grid, step, least = ROUGHNESSES, FINE_ROUGHNESS, 0.0
    elif material.minnaert_exponent != 1:
        grid, step, least = MINNAERT_EXPONENTS, FINE_EXPONENT, 1.0
    else:
        return material
    mean, lit = mean_brightness(sample.grey), in_light(sample.grey)
    fits: dict[float, PixelFit] = {}
    costs: dict[float, float] = {}

    def visit(value: float, start: PixelFit | StartName, steps: int) -> None:
        trial = with_number(material, value)
        fits[value] = robust_fit.fit(sample, trial, start=start, steps=steps)
        predicted = robust_fit.predict(fits[value], sample.directions, trial)
        costs[value] = capped_error(sample.grey, predicted, mean, lit)

    start = robust_fit.fit(sample, Material(), used="middle", steps=8)
    for value in (least, *grid):
        visit(value, start, 4 if costs else 8)
        start = fits[value]
    best = min(costs, key=costs.__getitem__)
    for value in (best - step, best + step):
        if value > least:
            visit(value, fits[best], 4)
    found = _parabola(costs)
    if material.model == "lambert":  # what highlights and shadows leave open is not taken for glaze
        found = _smallest_sufficient(costs, found)
    return with_number(material, found)


def number_of(material: Material) -> float:
    """The exponent of Minnaert's law, if it is Lambert's material, else the roughness."""
    return material.minnaert_exponent if material.model == "lambert" else material.roughness


def number_range(material: Material) -> tuple[float, float]:
    """Least and greatest value of that number."""
    return (1.0, MINNAERT_EXPONENTS[-1]) if material.model == "lambert" else (SMOOTH, ROUGHNESSES[-1])


def with_number(material: Material, value: float) -> Material:
    """The material with another value of that number."""
    if material.model == "lambert":
        return replace(material, minnaert_exponent=value)
    return replace(material, roughness=value)


def _smallest_sufficient(costs: dict[float, float], best: float) -> float:
    """The smallest value up to ``best`` whose cost, interpolated linearly, is within a tenth of the tolerance."""
    enough = min(costs.values()) * (1 + TOLERANCE / 10)
    ordered = sorted(value for value in costs if value <= best)
    for low, high in itertools.pairwise(ordered):
        if costs[low] <= enough:
            return low
        if costs[high] <= enough:
            return high - (high - low) * (enough - costs[high]) / (costs[low] - costs[high])
    return best


def _parabola(costs: dict[float, float]) -> float:
    """Lowest point of the parabola through the best value and its neighbours; the best itself at an end."""
    ordered = sorted(costs)
    best = min(costs, key=costs.__getitem__)
    at = ordered.index(best)
    if at in (0, len(ordered) - 1):
        return best
    x0, x1, x2 = ordered[at - 1 : at + 2]
    left, right = (costs[x1] - costs[x0]) / (x1 - x0), (costs[x2] - costs[x1]) / (x2 - x1)
    curvature = (right - left) / (x2 - x0)
    return min(max((x0 + x1) / 2 - left / (2 * curvature), x0), x2) if curvature > 0 else best


def capped_error(observed: Tensor, predicted: Tensor, mean: Tensor, weight: Tensor) -> float:
    """Weighted mean of absolute errors as a share of the pixel's mean (P, 1), each cut at `ERROR_CAP`.

    Cast shadows, which no candidate models, would otherwise dominate the differences between candidates.
    """
    missed = ((predicted - observed).abs() / mean).clamp(max=ERROR_CAP)
    return (missed * weight).sum().item() / max(weight.sum().item(), 1.0)


def find_roughness(sample: PixelSample, model: str) -> Material:
    """A model with the one roughness that explains the sample best."""
    count = len(sample.directions)
    if count < MIN_LIGHTS_ROUGHNESS:
        raise CaptureError(
            "lights",
            expected=f"at least {MIN_LIGHTS_ROUGHNESS} to find a roughness",
            got=str(count),
            mend="photograph under more lights, or use model='lambert'",
        )
    return refine(sample, Material(model=model, roughness=ROUGHNESSES[0]))


def roughness_error(sample: PixelSample, material: Material) -> float:
    """Standard error of the roughness in radians: the larger of two estimates.

    One is the curvature of the fit. The other is how far the roughnesses of four quarters of the pixels lie apart,
    which also sees a cost with several minima.
    """
    curvature = curvature_error(sample, material, len(sample))
    size = -(-len(sample) // QUARTERS)
    parts = [slice(i, i + size) for i in range(0, len(sample), size)]
    quarters = [refine(sample[part], material).roughness for part in parts]
    apart = torch.tensor(quarters).std(correction=1).item() / math.sqrt(len(quarters)) if len(quarters) > 1 else 0.0
    return max(curvature, apart)


def curvature_error(sample: PixelSample, material: Material, count: int) -> float:
    """Standard error in radians, by the curvature of the fit, of a roughness that ``count`` such pixels share."""
    fitted = robust_fit.fit(sample, material)
    parts = robust_fit.chunks(sample.grey)
    information = sum(roughness_information(fitted[part], sample[part], material) for part in parts)
    return math.sqrt(len(sample) / (information * count)) if information > 0 else math.inf


def roughness_information(fitted: PixelFit, sample: PixelSample, material: Material) -> float:
    """Inverse variance of the roughness that the pixels share, by the curvature of the fit, 1 / radians**2.

    What changes of normal, albedo and lobes can imitate is projected out pixel by pixel.
    """
    grey, mean = sample.grey, mean_brightness(sample.grey)
    albedo, lobes = fitted.albedo / mean, fitted.lobes / mean
    response = respond(material, fitted.normal, albedo, lobes, sample.directions, mean, by_roughness=True)
    if response.by_roughness is None:
        return 0.0
    size = 3 + len(material.exponents)
    jacobian = grey.new_empty(len(grey), size + 1, grey.shape[1])
    fill_jacobian(jacobian, response, tangent_vectors(fitted.normal), sample.directions)
    jacobian[:, size] = response.by_roughness
    used = robust_fit.weights(fitted, grey, response.value * mean, "lit")
    spare = (used.sum(1, keepdim=True) - size).clamp_min(0.5)  # observations beyond what the unknowns use up
    weight = used * spare / used.sum(1, keepdim=True).clamp_min(1e-9) / fitted.noise.square()
    jacobian, weight = jacobian.double(), weight.double()  # differences of nearly equal sums follow
    products = torch.bmm(jacobian * weight[:, None], jacobian.mT).permute(1, 2, 0)
    rows = [list(row.unbind(0)) for row in products[:size, :size]]
    for axis in range(size):
        rows[axis][axis] = rows[axis][axis] * (1 + 1e-6)
    cross = list(products[size, :size].unbind(0))
    imitated = sum(a * b for a, b in zip(cross, solve_symmetric(rows, cross), strict=True))
    return float((products[size, size] - imitated).clamp_min(0).sum())
