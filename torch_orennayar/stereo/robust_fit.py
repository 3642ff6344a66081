"""Robust fits of normal, albedo and highlights under known lights, pixel by pixel, all pixels at once.

Observations are (P, K): P pixels, K lights. The view is (0, 0, 1) in every pixel's own frame.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from typing import TypeVar

import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.progress import track
from .material import LightDirections, Material, Response, dot, respond

T = TypeVar("T")
Start = Callable[[Tensor, LightDirections], tuple[Tensor, Tensor]]
"""Normal and albedo to begin with, from observations over their mean."""

CHUNK = 120_000
"""Observations solved together: temporaries stay in cache.

Chunks run side by side on as many threads as torch has: on a busy machine that is several times faster than
one chunk after the other, where every operation waits for all threads.
"""
CHUNK_ACCELERATOR = 20_000_000
SHADOW = 0.08
"""Observations below this share of a pixel's 90th percentile count as shadow."""
MIN_LIGHTS_RANKED = 10
"""With fewer lights no ranks are left out, only shadows."""
MIN_RANKED = 6
"""Where fewer observations than this lie in the chosen ranks and in light, all in light count."""
MIN_NORMAL_Z = 0.02
NOISE_FLOOR = 0.01
"""Least standard deviation of the residuals, as a share of the pixel's mean."""
RIDGE = 0.02
"""Pull of the lobes' strengths toward 0: without a highlight in sight they are not determined."""
NEIGHBOURS = 440.0
"""Pull toward the neighbours' normal per variance of the residuals.

As if neighbours differed by 0.15 rad and ten observations told what one would: a misfit errs alike under many lights.
"""


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


def chunks(grey: Tensor) -> list[slice]:
    """Pixels that are solved together: as many as fit in cache, and enough parts for every thread."""
    most = (CHUNK if grey.device.type == "cpu" else CHUNK_ACCELERATOR) // grey.shape[1]
    size = max(1, min(most, -(-len(grey) // torch.get_num_threads())))
    return [slice(i, i + size) for i in range(0, len(grey), size)]


def side_by_side(work: Callable[[slice], T], parts: Sequence[slice], show: str = "") -> list[T]:
    """``work`` on every part, on as many threads as torch has; stops at the first error or Ctrl-C."""

    @torch.no_grad()  # threads do not inherit it
    def quietly(part: slice) -> T:
        return work(part)

    with ThreadPoolExecutor(torch.get_num_threads()) as pool:
        try:
            done = pool.map(quietly, parts)
            return list(track(done, show, len(parts)) if show else done)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def fit(
    grey: Tensor,
    rays: LightDirections,
    material: Material,
    *,
    steps: int = 10,
    used: str = "lit",
    start: PixelFit | str = "middle",
    toward: Tensor | None = None,
    show: str = "",
) -> PixelFit:
    """Gauss-Newton with Geman-McClure weights, for every pixel of ``grey`` (P, K) under K lights.

    Args:
        grey: observations.
        rays: to the lights.
        material: what all pixels share.
        steps: of Gauss-Newton.
        used: observations that count: ``"lit"``, all that are not in shadow, or ``"middle"``, those of middle rank.
        start: an earlier fit of the same pixels, or a name in ``STARTS``.
        toward: (P, 3) normals of the neighbourhood, or None.
        show: what the progress bar says; empty for none.
    """
    choose = _SELECTIONS[used]
    whole = PixelFit(*(grey.new_empty(len(grey), n) for n in (3, 1, len(material.exponents), 1, 1, 1)))

    def solve(part: slice) -> None:
        begin = STARTS[start] if isinstance(start, str) else start[part]
        near = None if toward is None else toward[part]
        found = _fit_chunk(grey[part], rays.at(part), material, choose, steps, begin, near)
        for f in fields(PixelFit):
            getattr(whole, f.name)[part] = getattr(found, f.name)

    side_by_side(solve, chunks(grey), show)
    return whole


def take(fits: Sequence[PixelFit], which: Tensor) -> PixelFit:
    """Of every pixel the fit whose index is in ``which`` (P,)."""
    values = {f.name: torch.stack([getattr(fit, f.name) for fit in fits]) for f in fields(PixelFit)}
    return PixelFit(**{n: v.gather(0, which[None, :, None].expand(1, -1, v.shape[2]))[0] for n, v in values.items()})


def least_squares(grey: Tensor, rays: LightDirections) -> PixelFit:
    """Plain Lambertian least squares over all observations."""
    scaled = _linear(grey, rays, torch.ones_like(grey))
    albedo = scaled.norm(dim=1, keepdim=True)
    residual = (grey - dot(scaled, rays.light)).abs().mean(1, keepdim=True)
    spread = residual / albedo.clamp_min(torch.finfo(grey.dtype).tiny) * math.sqrt(2 / len(rays))
    return PixelFit(
        upward(scaled), albedo, grey.new_empty(len(grey), 0), torch.full_like(albedo, torch.inf), residual, spread
    )


def predict(fitted: PixelFit, rays: LightDirections, material: Material) -> Tensor:
    """What the fit says every pixel shows under the lights, (P, K)."""
    unit = torch.ones_like(fitted.albedo)
    return respond(material, fitted.normal, fitted.albedo, fitted.lobes, rays, unit).value


def weights(fitted: PixelFit, grey: Tensor, predicted: Tensor, used: str) -> Tensor:
    """How much every observation counts, (P, K), in [0, 1]."""
    share = (grey - predicted) / (2 * fitted.noise * mean_of(grey))
    return _SELECTIONS[used](grey) / (1 + share * share) ** 2


def mean_of(grey: Tensor) -> Tensor:
    """Mean of every pixel's observations, (P, 1), above 0."""
    return grey.abs().mean(1, keepdim=True).clamp_min(1e-12)


def colour(
    fitted: PixelFit, grey: Tensor, channels: Tensor, rays: LightDirections, material: Material, used: str
) -> tuple[Tensor, Tensor]:
    """Albedo (P, C) and lobes' strengths (P, L, C) of every channel (P, K, C) under the fitted normals and weights.

    Light between facets makes the model nonlinear in albedo: a few fixed-point steps settle it.
    """
    unit = mean_of(grey)
    weight = weights(fitted, grey, predict(fitted, rays, material), used)
    albedos, strengths = [], []
    for channel in (channels / unit[:, :, None]).unbind(2):
        albedo, lobes = fitted.albedo / unit, fitted.lobes / unit
        for _ in range(1 if material.model == "lambert" else 4):
            response = respond(material, fitted.normal, albedo, lobes, rays, unit)
            shapes = response.columns[1:]
            matt = (response.value - _shine(lobes, shapes)) / albedo
            if shapes:
                columns = torch.stack((matt, *shapes), 1)
                products = torch.bmm(columns * weight[:, None], torch.cat((columns, channel[:, None]), 1).mT)
                rows = [list(row.unbind(0)) for row in products.permute(1, 2, 0)]
                for axis in range(1, len(rows)):
                    rows[axis][axis] = rows[axis][axis] + RIDGE
                parts = solve_symmetric([row[:-1] for row in rows], [row[-1] for row in rows])
                lobes = torch.stack(parts[1:], 1).clamp_min(0)
            alone = (weight * matt * (channel - _shine(lobes, shapes))).sum(1, keepdim=True)
            albedo = (alone / (weight * matt * matt).sum(1, keepdim=True).clamp_min(1e-12)).clamp_min(1e-12)
        albedos.append(albedo * unit)
        strengths.append(lobes * unit)
    return torch.cat(albedos, 1), torch.stack(strengths, 2)


def _shine(lobes: Tensor, shapes: Sequence[Tensor]) -> Tensor | float:
    """What lobes (P, L) add to the observations."""
    return sum(strength[:, None] * shape for strength, shape in zip(lobes.unbind(1), shapes, strict=True))


def common_cost(fitted: PixelFit, noise: Tensor, grey: Tensor, rays: LightDirections, material: Material) -> Tensor:
    """Robust cost of a fit per observation in light, (P,), residuals over ``noise`` (P, 1), which fits share."""

    def work(part: slice) -> Tensor:
        seen = grey[part]
        lit = in_light(seen)
        share = ((seen - predict(fitted[part], rays.at(part), material)) / (2 * noise[part] * mean_of(seen))).square()
        return (lit * share / (1 + share)).sum(1) / lit.sum(1)

    return torch.cat(side_by_side(work, chunks(grey)))


def _fit_chunk(
    grey: Tensor,
    rays: LightDirections,
    material: Material,
    choose: Callable[[Tensor], Tensor],
    steps: int,
    start: PixelFit | Start,
    toward: Tensor | None,
) -> PixelFit:
    """Everything over the pixel's mean: two tangent angles, albedo, strengths of lobes."""
    unit = mean_of(grey)
    seen = grey / unit
    used = choose(seen)
    count = len(material.exponents)
    lobes = seen.new_zeros(len(seen), count)
    if isinstance(start, PixelFit):
        normal, albedo = start.normal, start.albedo / unit
        lobes = start.lobes / unit if start.lobes.shape[1] == count else lobes
    else:
        normal, albedo = start(seen, rays)
    size = 3 + count
    jacobian = seen.new_empty(len(seen), size + 1, len(rays))
    place = ((used.sum(1, keepdim=True) - 1) / 2).long().clamp_min(0)
    for _ in range(steps):
        response = respond(material, normal, albedo, lobes, rays, unit)
        residual = seen - response.value
        noise = _noise(residual, used, place)
        weight = used / (1 + (residual / (2 * noise)) ** 2) ** 2
        tangents = _tangents(normal)
        _fill(jacobian, response, tangents, rays)
        jacobian[:, size] = residual
        products = torch.bmm(jacobian[:, :size] * weight[:, None], jacobian.mT).permute(1, 2, 0)
        matrix = [list(row.unbind(0)) for row in products[:, :size].contiguous()]
        right = list(products[:, size].contiguous().unbind(0))
        curvature = [row[:] for row in matrix]
        for axis in range(size):
            matrix[axis][axis] = matrix[axis][axis] * (1 + 1e-3) + 1e-9 * len(rays)
        if toward is not None:
            pull_in = NEIGHBOURS * (noise[:, 0].square() - NOISE_FLOOR**2)
            for axis, tangent in enumerate(tangents):
                matrix[axis][axis] = matrix[axis][axis] + pull_in
                right[axis] = right[axis] + pull_in * ((toward - normal) * tangent).sum(1)
        for axis in range(count):
            matrix[3 + axis][3 + axis] = matrix[3 + axis][3 + axis] + RIDGE
            right[3 + axis] = right[3 + axis] - RIDGE * lobes[:, axis]
        step = _bounded(matrix, right, lobes)
        turn = torch.stack(step[:2], 1)
        turn = turn * (0.25 / turn.norm(dim=1, keepdim=True).clamp_min(0.25))
        normal = upward(normal + tangents[0] * turn[:, :1] + tangents[1] * turn[:, 1:])
        albedo = (albedo + step[2][:, None]).clamp_min(1e-6)
        if count:
            lobes = (lobes + torch.stack(step[3:], 1)).clamp_min(0)
    residual = seen - respond(material, normal, albedo, lobes, rays, unit).value
    noise = _noise(residual, used, place)
    return PixelFit(
        normal,
        albedo * unit,
        lobes * unit,
        noise,
        residual.abs().mean(1, keepdim=True) * unit,
        noise * _tangent_spread(curvature),
    )


def _fill(jacobian: Tensor, response: Response, tangents: tuple[Tensor, Tensor], rays: LightDirections) -> None:
    """Derivatives by two tangent angles, albedo and lobes into the first rows of (P, N, K)."""
    for axis, tangent in enumerate(tangents):
        column = dot(tangent, rays.light) * response.by_light
        if response.by_view is not None:
            column += response.by_view * tangent[:, 2:]
        if response.by_half is not None:
            column += response.by_half * dot(tangent, rays.half)
        jacobian[:, axis] = column
    for axis, column in enumerate(response.columns):
        jacobian[:, 2 + axis] = column


def information(fitted: PixelFit, grey: Tensor, rays: LightDirections, material: Material) -> float:
    """What the pixels say of the roughness that they share: its inverse variance."""
    unit = mean_of(grey)
    response = respond(
        material, fitted.normal, fitted.albedo / unit, fitted.lobes / unit, rays, unit, by_roughness=True
    )
    if response.by_roughness is None:
        return 0.0
    size = 3 + len(material.exponents)
    jacobian = grey.new_empty(len(grey), size + 1, len(rays))
    _fill(jacobian, response, _tangents(fitted.normal), rays)
    jacobian[:, size] = response.by_roughness
    used = weights(fitted, grey, response.value * unit, "lit")
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


def _bounded(matrix: list[list[Tensor]], right: list[Tensor], lobes: Tensor) -> list[Tensor]:
    """The step; lobes that it would take below 0 stop there and the rest is solved again."""
    step = solve_symmetric(matrix, right)
    for axis in range(lobes.shape[1]):
        at = 3 + axis
        below = (lobes[:, axis] + step[at] < 0).to(lobes)
        hold = 1e4 * matrix[at][at] * below
        right[at] = right[at] * (1 - below) - hold * lobes[:, axis]
        matrix[at][at] = matrix[at][at] + hold
    return solve_symmetric(matrix, right) if lobes.shape[1] else step


def solve_symmetric(matrix: Sequence[Sequence[Tensor]], right: Sequence[Tensor]) -> list[Tensor]:
    """Solve symmetric positive N x N systems, given as tensors (P,) of entries; unknowns without a pivot are 0."""
    size = len(right)
    rows, target = [list(row) for row in matrix], list(right)
    inverse = []
    for i in range(size):
        pivot = rows[i][i]
        sound = (pivot > 1e-7 * matrix[i][i]).to(pivot)
        inverse.append(sound / (pivot * sound + (1 - sound)))
        for j in range(i + 1, size):
            factor = rows[i][j] * inverse[i]
            for k in range(j, size):
                rows[j][k] = torch.addcmul(rows[j][k], factor, rows[i][k], value=-1)
            target[j] = torch.addcmul(target[j], factor, target[i], value=-1)
    solution: list[Tensor] = [right[0]] * size
    for i in reversed(range(size)):
        total = target[i]
        for k in range(i + 1, size):
            total = torch.addcmul(total, rows[i][k], solution[k], value=-1)
        solution[i] = total * inverse[i]
    return solution


def _linear(grey: Tensor, rays: LightDirections, weight: Tensor) -> Tensor:
    """Weighted Lambertian least squares, albedo times normal, (P, 3)."""
    light = rays.light
    outer = (light[..., :, None] * light[..., None, :]).flatten(-2)
    matrix = (weight[:, None] @ outer)[:, 0].T.reshape(3, 3, -1)
    ridge = 1e-6 * (matrix[0, 0] + matrix[1, 1] + matrix[2, 2])
    rows = [[matrix[i, j] + ridge if i == j else matrix[i, j] for j in range(3)] for i in range(3)]
    return torch.stack(solve_symmetric(rows, list(((weight * grey)[:, None] @ light)[:, 0].T)), 1)


def upward(vector: Tensor) -> Tensor:
    """Unit vectors that face the camera; (0, 0, 1) for a zero vector."""
    unit = F.normalize(vector, dim=1, eps=torch.finfo(vector.dtype).tiny)
    return F.normalize(torch.cat((unit[:, :2], unit[:, 2:].clamp_min(MIN_NORMAL_Z)), 1), dim=1)


def _tangents(normal: Tensor) -> tuple[Tensor, Tensor]:
    """Two unit tangents of every normal, (P, 3) each."""
    x, _, z = normal.unbind(1)
    first = F.normalize(torch.stack((z, torch.zeros_like(z), -x), 1), dim=1)
    return first, torch.linalg.cross(normal, first)


def _tangent_spread(matrix: Sequence[Sequence[Tensor]]) -> Tensor:
    """Square root of the summed variances of both tangent angles per unit noise, (P, 1)."""
    trace = torch.zeros_like(matrix[0][0])
    for axis in (0, 1):
        unit = [torch.full_like(trace, float(i == axis)) for i in range(len(matrix))]
        trace = trace + solve_symmetric(matrix, unit)[axis]
    return torch.where(trace > 0, trace, torch.inf).sqrt()[:, None]


def _ranks(grey: Tensor, low: float, high: float) -> Tensor:
    """1 for observations in light between two shares of their pixel's ranks; for all in light where these are few."""
    count = grey.shape[1]
    lit = in_light(grey)
    if count < MIN_LIGHTS_RANKED:
        return lit
    order = grey.argsort(1)[:, math.floor(low * count) : math.ceil(high * count)]
    both = torch.zeros_like(grey).scatter_(1, order, 1.0) * lit
    enough = (both.sum(1, keepdim=True) >= MIN_RANKED).to(grey)
    return both * enough + lit * (1 - enough)


def _middle(grey: Tensor) -> Tensor:
    return _ranks(grey, 0.2, 0.8)


def in_light(grey: Tensor) -> Tensor:
    """1 for observations that are not in shadow; at least the three brightest."""
    count = grey.shape[1]
    threshold = SHADOW * grey.kthvalue(max(1, round(0.9 * count)), dim=1, keepdim=True).values
    third = grey.kthvalue(max(1, count - 2), dim=1, keepdim=True).values
    return (grey >= torch.minimum(threshold, third)).to(grey)


def _noise(residual: Tensor, used: Tensor, place: Tensor) -> Tensor:
    """Robust standard deviation of the residuals in use, (P, 1)."""
    magnitude = (residual.abs() + (1 - used) * 1e9).sort(1).values
    return (1.4826 * magnitude.gather(1, place)).clamp_min(NOISE_FLOOR)


def _start_lambert(low: float, high: float) -> Start:
    """Least squares on some ranks."""

    def begin(grey: Tensor, rays: LightDirections) -> tuple[Tensor, Tensor]:
        scaled = _linear(grey, rays, _ranks(grey, low, high))
        return upward(scaled), scaled.norm(dim=1, keepdim=True).clamp_min(1e-3)

    return begin


def _start_highlight(grey: Tensor, rays: LightDirections) -> tuple[Tensor, Tensor]:
    """The mean half vector of the brightest 5 %: where a highlight is, the normal is there."""
    brightest = grey.topk(max(1, round(0.05 * grey.shape[1])), 1).indices
    half = rays.half.expand(len(grey), -1, -1)
    normal = upward(half.gather(1, brightest[:, :, None].expand(-1, -1, 3)).mean(1))
    cosine = dot(normal, rays.light).relu() * in_light(grey)
    albedo = (cosine * grey).sum(1, keepdim=True) / cosine.square().sum(1, keepdim=True).clamp_min(1e-6)
    return normal, albedo.clamp_min(1e-3)


STARTS: dict[str, Start] = {
    "middle": _start_lambert(0.2, 0.8),
    "dim": _start_lambert(0.05, 0.55),
    "highlight": _start_highlight,
}
"""Where a fit may begin."""
_SELECTIONS: dict[str, Callable[[Tensor], Tensor]] = {"middle": _middle, "lit": in_light, "all": torch.ones_like}
