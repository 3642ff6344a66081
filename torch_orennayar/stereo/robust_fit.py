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

from ..core.threads import side_by_side
from .linear_systems import camera_facing, solve_symmetric, tangent_vectors, weighted_lambert
from .material import LightDirections, Material, Response, cosines, respond
from .pixel_sample import PixelSample
from .robust_stats import (
    MIDDLE_RANKS,
    NOISE_FLOOR,
    Used,
    between_ranks,
    geman_mcclure,
    geman_mcclure_cost,
    in_light,
    mean_brightness,
    median_rank,
    noise_level,
    select,
)

T = TypeVar("T")
StartName = Literal["middle", "dim", "highlight"]
Start = Callable[[Tensor, LightDirections], tuple[Tensor, Tensor]]
"""Normal and albedo to begin with, from observations over their mean."""

CHUNK = 120_000
"""Observations that are solved together on a processor, so that temporaries stay in its cache; set by hand.

Chunks run side by side, each on one thread: on a busy machine that is several times faster than one chunk after the
other, where every operation waits for all threads.
"""
CHUNK_ACCELERATOR = 20_000_000
"""Observations that are solved together on an accelerator; set by hand."""
DIM_RANKS = (0.05, 0.55)
"""Shares of a pixel's ranks for the start ``"dim"``, which leaves out broad highlights; set by hand."""
BRIGHTEST = 0.05
"""Share of a pixel's observations whose half vectors give the start ``"highlight"``; set by hand."""
DAMPING = 1e-3
"""Of Gauss-Newton steps, as a share of the diagonal (Levenberg-Marquardt); set by hand."""
MAX_TILT = 0.25
"""Radians by which a normal may tilt in a step; set by hand."""
LOBE_RIDGE = 0.02
"""Weight of the prior that lobes have no strength, in squared observations over their mean: without a highlight in
sight their strengths are not determined. Set by hand."""
NEIGHBOUR_WEIGHT = 440.0
"""Weight of the neighbours' normal per variance of the residuals, 10 / 0.15**2: as if neighbours differed by 0.15 rad,
and ten observations were worth one, because a model that does not fit errs the same way under many lights. Set by
hand."""


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
    return torch.get_num_threads() if grey.device.type == "cpu" else 1


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
    """`fit` of one chunk: unknowns are two tangent angles, albedo and the strengths of lobes."""
    mean, directions, count = mean_brightness(sample.grey), sample.directions, len(material.exponents)
    seen = sample.grey / mean
    normal, albedo, lobes = _begin(seen, mean, directions, start, count)
    selected = select(seen, used)
    rank = median_rank(selected)
    jacobian = seen.new_empty(len(seen), 4 + count, len(directions))
    curvature: list[list[Tensor]] = []
    for _ in range(steps):
        response = respond(material, normal, albedo, lobes, directions, mean)
        residual = seen - response.value
        noise = noise_level(residual, selected, rank)
        tangents = tangent_vectors(normal)
        fill_jacobian(jacobian, response, tangents, directions)
        jacobian[:, -1] = residual
        matrix, right = _normal_equations(jacobian, geman_mcclure(selected, residual, noise))
        curvature = [row[:] for row in matrix]
        for axis, row in enumerate(matrix):
            row[axis] = row[axis] * (1 + DAMPING) + 1e-9 * len(directions)
        if prior is not None:
            # Pixels at the noise floor fit perfectly and need no neighbours.
            weight = NEIGHBOUR_WEIGHT * (noise[:, 0].square() - NOISE_FLOOR**2)
            for axis, tangent in enumerate(tangents):
                matrix[axis][axis] = matrix[axis][axis] + weight
                right[axis] = right[axis] + weight * ((prior - normal) * tangent).sum(1)
        for axis in range(3, 3 + count):
            matrix[axis][axis] = matrix[axis][axis] + LOBE_RIDGE
            right[axis] = right[axis] - LOBE_RIDGE * lobes[:, axis - 3]
        step = _nonnegative_step(matrix, right, lobes)
        normal = tilted(normal, tangents, torch.stack(step[:2], 1))
        albedo = (albedo + step[2][:, None]).clamp_min(1e-6)
        if count:
            lobes = (lobes + torch.stack(step[3:], 1)).clamp_min(0)
    residual = seen - respond(material, normal, albedo, lobes, directions, mean).value
    noise = noise_level(residual, selected, rank)
    missed = residual.abs().mean(1, keepdim=True) * mean
    return PixelFit(normal, albedo * mean, lobes * mean, noise, missed, noise * _unit_spread(curvature))


def _begin(
    seen: Tensor, mean: Tensor, directions: LightDirections, start: PixelFit | StartName, count: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Normal, albedo and ``count`` lobes to begin with, over the pixels' mean; no lobes where the start has others."""
    lobes = seen.new_zeros(len(seen), count)
    if isinstance(start, PixelFit):
        lobes = start.lobes / mean if start.lobes.shape[1] == count else lobes
        return start.normal, start.albedo / mean, lobes
    return *STARTS[start](seen, directions), lobes


def fill_jacobian(
    jacobian: Tensor, response: Response, tangents: tuple[Tensor, Tensor], directions: LightDirections
) -> None:
    """Write derivatives by two tangent angles, albedo and lobes into the first rows of (P, N, K)."""
    for axis, tangent in enumerate(tangents):
        column = cosines(tangent, directions.light) * response.by_light
        if response.by_view is not None:
            column += response.by_view * tangent[:, 2:]
        if response.by_half is not None:
            column += response.by_half * cosines(tangent, directions.half)
        jacobian[:, axis] = column
    for axis, column in enumerate(response.columns):
        jacobian[:, 2 + axis] = column


def _normal_equations(jacobian: Tensor, weight: Tensor) -> tuple[list[list[Tensor]], list[Tensor]]:
    """Matrix and right side, entries (P,), from N derivatives and the residual in the last row of (P, N + 1, K)."""
    size = jacobian.shape[1] - 1
    products = torch.bmm(jacobian[:, :size] * weight[:, None], jacobian.mT).permute(1, 2, 0)
    matrix = [list(row.unbind(0)) for row in products[:, :size].contiguous()]
    return matrix, list(products[:, size].contiguous().unbind(0))


def _nonnegative_step(matrix: list[list[Tensor]], right: list[Tensor], lobes: Tensor) -> list[Tensor]:
    """The step; lobes that it would take below 0 stop there and the rest is solved again."""
    step = solve_symmetric(matrix, right)
    for axis in range(lobes.shape[1]):
        at = 3 + axis
        below = (lobes[:, axis] + step[at] < 0).to(lobes)
        penalty = 1e4 * matrix[at][at] * below
        right[at] = right[at] * (1 - below) - penalty * lobes[:, axis]
        matrix[at][at] = matrix[at][at] + penalty
    return solve_symmetric(matrix, right) if lobes.shape[1] else step


def tilted(normal: Tensor, tangents: tuple[Tensor, Tensor], angles: Tensor) -> Tensor:
    """Normals tilted by two tangent angles (P, 2), at most by `MAX_TILT`."""
    angles = angles * (MAX_TILT / angles.norm(dim=1, keepdim=True).clamp_min(MAX_TILT))
    return camera_facing(normal + tangents[0] * angles[:, :1] + tangents[1] * angles[:, 1:])


def _unit_spread(matrix: Sequence[Sequence[Tensor]]) -> Tensor:
    """Square root of the summed variances of both tangent angles for residuals of variance 1, (P, 1)."""
    trace = torch.zeros_like(matrix[0][0])
    for axis in (0, 1):
        basis = [torch.full_like(trace, float(i == axis)) for i in range(len(matrix))]
        trace = trace + solve_symmetric(matrix, basis)[axis]
    return torch.where(trace > 0, trace, torch.inf).sqrt()[:, None]


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
