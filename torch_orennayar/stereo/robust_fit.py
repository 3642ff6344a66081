"""Robust fits of normal, albedo and highlights under known lights, pixel by pixel, all pixels at once.

Observations are (P, K): P pixels, K lights. The view is (0, 0, 1) in every pixel's own frame. Inside a fit everything
is divided by the pixel's mean observation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Literal, TypeVar

import torch
from torch import Tensor

from ..core.optional import available
from ..core.threads import side_by_side, worker_count
from .gauss_newton import Estimate, Quality, gauss_newton
from .linear_systems import camera_facing, weighted_lambert
from .material import LightDirections, Material, cosines, respond
from .pixel_sample import PixelSample
from .robust_stats import (
    MIDDLE_RANKS,
    Used,
    between_ranks,
    geman_mcclure,
    geman_mcclure_cost,
    in_light,
    mean_brightness,
    select,
)

T = TypeVar("T")
StartName = Literal["middle", "dim", "highlight"]
Start = Callable[[Tensor, LightDirections], tuple[Tensor, Tensor]]
"""Normal and albedo to begin with, from observations over their mean."""

CHUNK = 300_000
"""Observations that are solved together on a processor, few enough for its cache, and so many that Python's overhead
does not count; set by hand.

Chunks run side by side, each on one thread: on a busy machine that is several times faster than one chunk after the
other, where every operation waits for all threads.
"""
CHUNK_ACCELERATOR = 20_000_000
"""Observations that are solved together on an accelerator; set by hand."""
DIM_RANKS = (0.05, 0.55)
"""Shares of a pixel's ranks for the start ``"dim"``, which leaves out broad highlights; set by hand."""
BRIGHTEST = 0.05
"""Share of a pixel's observations whose half vectors give the start ``"highlight"``; set by hand."""


@dataclass(frozen=True)
class PixelFit:
    """Result for P pixels.

    Attributes:
        normal: (P, 3) unit.
        albedo: (P, 1).
        lobes: (P, L) strengths of ``(n.l) (n.h)**p``.
        noise: (P, 1) robust standard deviation of the residuals over the pixel's mean; infinite: no weighting.
        residual: (P, 1) mean absolute difference over all lights.
        spread: (P, 1) standard error of the normal in radians if residuals were independent; infinite if undetermined.
    """

    normal: Tensor
    albedo: Tensor
    lobes: Tensor
    noise: Tensor
    residual: Tensor
    spread: Tensor

    def __getitem__(self, part: slice | Tensor) -> PixelFit:
        return PixelFit(*(getattr(self, f.name)[part] for f in fields(self)))

    def replaced(self, places: Tensor, other: PixelFit) -> PixelFit:
        """A copy in which the pixels at these indices have the values of another fit."""
        parts = (getattr(self, f.name).index_copy(0, places, getattr(other, f.name)) for f in fields(self))
        return PixelFit(*parts)

    @staticmethod
    def joined(parts: Sequence[PixelFit]) -> PixelFit:
        """The fits of parts of the pixels, one after the other."""
        return PixelFit(*(torch.cat([getattr(part, f.name) for part in parts]) for f in fields(PixelFit)))

    @staticmethod
    def pick(fits: Sequence[PixelFit], which: Tensor) -> PixelFit:
        """Of every pixel the fit whose index is in ``which`` (P,)."""
        index = which[None, :, None]
        stacks = (torch.stack([getattr(fit, f.name) for fit in fits]) for f in fields(PixelFit))
        return PixelFit(*(values.gather(0, index.expand(1, -1, values.shape[2]))[0] for values in stacks))


def chunks(grey: Tensor) -> list[slice]:
    """Runs of pixels that are solved together: on a processor, as many as fit in cache, and enough for every thread."""
    on_processor = grey.device.type == "cpu"
    most = (CHUNK if on_processor else CHUNK_ACCELERATOR) // grey.shape[1]
    size = max(1, min(most, -(-len(grey) // _workers(grey))))
    return [slice(i, i + size) for i in range(0, len(grey), size)]


def map_chunks(work: Callable[[slice], T], grey: Tensor, progress: str = "") -> list[T]:
    """``work`` on all `chunks` of ``grey``, on a processor on as many threads as torch has."""
    return side_by_side(work, chunks(grey), workers=_workers(grey), progress=progress)


def _workers(grey: Tensor) -> int:
    return worker_count() if grey.device.type == "cpu" else 1


def fit(
    sample: PixelSample,
    material: Material,
    *,
    steps: int = 10,
    used: Used = "lit",
    start: PixelFit | StartName = "middle",
    neighbours: Tensor | None = None,
    progress: str = "",
) -> PixelFit:
    """Gauss-Newton with Geman-McClure weights, for every pixel.

    Args:
        sample: observations and light directions.
        material: what all pixels share.
        steps: of Gauss-Newton.
        used: observations that count.
        start: an earlier fit of the same pixels, or a name in `STARTS`.
        neighbours: (P, 3) mean normals of the neighbourhood as a prior, or None.
        progress: label of the progress bar; empty for none.
    """
    whole = PixelFit(*(sample.grey.new_empty(len(sample), n) for n in (3, 1, len(material.exponents), 1, 1, 1)))

    def solve(part: slice) -> None:
        begin = start if isinstance(start, str) else start[part]
        prior = None if neighbours is None else neighbours[part]
        found = _fit_chunk(sample[part], material, used, steps, begin, prior)
        for f in fields(PixelFit):
            getattr(whole, f.name)[part] = getattr(found, f.name)

    map_chunks(solve, sample.grey, progress)
    return whole


def least_squares(sample: PixelSample) -> PixelFit:
    """Plain Lambertian least squares over all observations that were measured."""
    grey, light = sample.grey, sample.directions.light
    measured = select(grey, "all")
    scaled = weighted_lambert(grey, light, measured)
    albedo = scaled.norm(dim=1, keepdim=True)
    missed = (grey - cosines(scaled, light)).abs() * measured
    residual = missed.sum(1, keepdim=True) / measured.sum(1, keepdim=True).clamp_min(1)
    spread = residual / albedo.clamp_min(torch.finfo(grey.dtype).tiny) * math.sqrt(2 / grey.shape[1])
    no_lobes, no_weighting = grey.new_empty(len(grey), 0), torch.full_like(albedo, torch.inf)
    return PixelFit(camera_facing(scaled), albedo, no_lobes, no_weighting, residual, spread)


def predict(fitted: PixelFit, directions: LightDirections, material: Material) -> Tensor:
    """What the fit says every pixel shows under the lights, (P, K)."""
    one = torch.ones_like(fitted.albedo)
    return respond(material, fitted.normal, fitted.albedo, fitted.lobes, directions, one).value


def weights(fitted: PixelFit, grey: Tensor, predicted: Tensor, used: Used) -> Tensor:
    """How much every observation counts, (P, K), in [0, 1]."""
    return geman_mcclure(select(grey, used), grey - predicted, fitted.noise * mean_brightness(grey))


def common_cost(fitted: PixelFit, noise: Tensor, sample: PixelSample, material: Material) -> Tensor:
    """Robust cost of a fit per observation in light, (P,), residuals over ``noise`` (P, 1), which fits share."""

    def work(part: slice) -> Tensor:
        some = sample[part]
        lit = in_light(some.grey)
        residual = some.grey - predict(fitted[part], some.directions, material)
        cost = lit * geman_mcclure_cost(residual, noise[part] * mean_brightness(some.grey))
        return cost.sum(1) / lit.sum(1)

    return torch.cat(map_chunks(work, sample.grey))


def _fit_chunk(
    sample: PixelSample, material: Material, used: Used, steps: int, start: PixelFit | StartName, prior: Tensor | None
) -> PixelFit:
    """`fit` of one chunk, where everything is divided by the pixel's mean."""
    mean, directions = mean_brightness(sample.grey), sample.directions
    seen = sample.grey / mean
    begin = _begin(seen, mean, directions, start, len(material.exponents))
    improve = _solver(seen, material)
    (normal, albedo, lobes), (noise, missed, spread) = improve(
        seen, select(seen, used), mean, directions, material, begin, steps, prior
    )
    return PixelFit(normal, albedo * mean, lobes * mean, noise, missed * mean, spread)


def _solver(seen: Tensor, material: Material) -> Callable[..., tuple[Estimate, Quality]]:
    """The compiled steps where they can take the pixels, else those of torch."""
    if seen.device.type == "cpu" and seen.dtype == torch.float32 and available("numba"):
        from .compiled_fit import MODELS, compiled_gauss_newton

        if material.model in MODELS:
            return compiled_gauss_newton
    return gauss_newton


def _begin(
    seen: Tensor, mean: Tensor, directions: LightDirections, start: PixelFit | StartName, count: int
) -> Estimate:
    """Normal, albedo and ``count`` lobes to begin with, over the pixels' mean; no lobes where the start has others."""
    lobes = seen.new_zeros(len(seen), count)
    if isinstance(start, PixelFit):
        lobes = start.lobes / mean if start.lobes.shape[1] == count else lobes
        return Estimate(start.normal, start.albedo / mean, lobes)
    return Estimate(*STARTS[start](seen, directions), lobes)


def _start_lambert(low: float, high: float) -> Start:
    """Lambertian least squares on the observations between two shares of a pixel's ranks."""

    def begin(grey: Tensor, directions: LightDirections) -> tuple[Tensor, Tensor]:
        scaled = weighted_lambert(grey, directions.light, between_ranks(grey, low, high))
        return camera_facing(scaled), scaled.norm(dim=1, keepdim=True).clamp_min(1e-3)

    return begin


def _start_highlight(grey: Tensor, directions: LightDirections) -> tuple[Tensor, Tensor]:
    """The mean half vector of the brightest observations: where a highlight is, the normal is there."""
    brightest = grey.topk(max(1, round(BRIGHTEST * grey.shape[1])), 1).indices
    half = directions.half.expand(len(grey), -1, -1)
    normal = camera_facing(half.gather(1, brightest[:, :, None].expand(-1, -1, 3)).mean(1))
    cosine = cosines(normal, directions.light).relu() * in_light(grey)
    albedo = (cosine * grey).sum(1, keepdim=True) / cosine.square().sum(1, keepdim=True).clamp_min(1e-6)
    return normal, albedo.clamp_min(1e-3)


STARTS: dict[StartName, Start] = {
    "middle": _start_lambert(*MIDDLE_RANKS),
    "dim": _start_lambert(*DIM_RANKS),
    "highlight": _start_highlight,
}
"""Where a fit may begin."""
