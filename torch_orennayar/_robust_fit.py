"""Per-pixel robust fits of normal and albedo under known lights, all pixels at once.

Observations are (P, K): P pixels, K lights. The view is orthographic, (0, 0, 1).
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from .evaluation import pull
from .progress import track
from .reflectance import Model, get_model

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
MIN_NORMAL_Z = 0.02


@dataclass(frozen=True)
class PixelFit:
    """Result for P pixels.

    Attributes:
        normal: (P, 3) unit.
        albedo: (P, 1).
        weight: (P, K) of every observation in the last step, in [0, 1].
        residual: (P, 1) mean absolute difference over all lights.
        spread: (P, 1) predicted standard error of the normal in radians; infinite if undetermined.
    """

    normal: Tensor
    albedo: Tensor
    weight: Tensor
    residual: Tensor
    spread: Tensor


def fit(
    grey: Tensor,
    lights: Tensor,
    model: str,
    sigma: float,
    *,
    steps: int = 10,
    lit_only: bool | None = None,
    start: PixelFit | None = None,
    show: str = "",
) -> PixelFit:
    """Fit every pixel of ``grey`` (P, K) under ``lights`` (K, 3) with one ``model`` and roughness.

    ``lit_only`` uses all observations in light instead of the middle ranks; default: for all but Lambert.
    ``start`` continues from an earlier fit of the same pixels.
    """
    every_lit = model != "lambert" if lit_only is None else lit_only
    known = get_model(model)
    size = max(1, (CHUNK if grey.device.type == "cpu" else CHUNK_ACCELERATOR) // len(lights))
    starts = range(0, len(grey), size)

    @torch.no_grad()  # threads do not inherit it
    def solve(i: int) -> PixelFit:
        begin = None if start is None else (start.normal[i : i + size], start.albedo[i : i + size])
        return _fit_chunk(grey[i : i + size], lights, known, every_lit, sigma, steps, begin)

    with ThreadPoolExecutor(torch.get_num_threads()) as pool:
        try:
            solved = pool.map(solve, starts)
            parts = list(track(solved, show, len(starts)) if show else solved)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return PixelFit(*(torch.cat([getattr(p, name) for p in parts]) for name in PixelFit.__dataclass_fields__))


def least_squares(grey: Tensor, lights: Tensor) -> PixelFit:
    """Plain Lambertian least squares over all observations."""
    weight = torch.ones_like(grey)
    scaled = _linear(grey, lights, weight)
    albedo = scaled.norm(dim=1, keepdim=True)
    normal = _upward(scaled)
    residual = (grey - scaled @ lights.T).abs().mean(1, keepdim=True)
    spread = residual / albedo.clamp_min(torch.finfo(grey.dtype).tiny) * math.sqrt(2 / len(lights))
    return PixelFit(normal, albedo, weight, residual, spread)


def predict(fitted: PixelFit, lights: Tensor, model: str, sigma: float) -> Tensor:
    """What the fit says every pixel shows under ``lights``, (P, K)."""
    value, ci = _evaluate(get_model(model), fitted.normal, fitted.albedo, lights, sigma)[:2]
    return value * ci


def albedo_per_channel(fitted: PixelFit, colour: Tensor, lights: Tensor, model: str, sigma: float) -> Tensor:
    """Albedo of each channel of ``colour`` (K, C, P) under the fitted normals and weights, (P, C).

    Inter-reflection makes the model nonlinear in albedo: a few fixed-point steps settle it.
    """
    known = get_model(model)
    channels = []
    for channel in colour.unbind(1):
        albedo = fitted.albedo
        for _ in range(1 if model == "lambert" else 4):
            value, ci, *_ = _evaluate(known, fitted.normal, albedo, lights, sigma)
            shape = value * ci / albedo
            weighted = fitted.weight * shape
            norm = (weighted * shape).sum(1, keepdim=True).clamp_min(1e-12)
            albedo = ((weighted * channel.T).sum(1, keepdim=True) / norm).clamp_min(1e-30)
        channels.append(albedo)
    return torch.cat(channels, 1)


def _fit_chunk(
    grey: Tensor,
    lights: Tensor,
    model: Model,
    every_lit: bool,
    sigma: float,
    steps: int,
    start: tuple[Tensor, Tensor] | None,
) -> PixelFit:
    """Gauss-Newton on two tangent angles and albedo with Geman-McClure weights."""
    used = _lit(grey) if every_lit else _middle_ranks(grey)
    scale = grey.abs().mean(1, keepdim=True).clamp_min(1e-12)
    normal, albedo = start or _start(grey, lights, scale)
    for _ in range(steps):
        value, ci, d_ci, d_co, d_rho = _evaluate(model, normal, albedo, lights, sigma)
        residual = grey - value * ci
        noise = _noise(residual, used, scale)
        weight = used / (1 + (residual / (2 * noise)) ** 2) ** 2
        by_light, by_view, by_rho = value + ci * d_ci, ci * d_co, ci * d_rho
        matrix, gradient, basis = _normal_equations(weight, residual, by_light, by_view, by_rho, lights, normal, scale)
        damping = 1e-3 * matrix.diagonal(dim1=1, dim2=2) + 1e-9 * len(lights)
        step = solve3(matrix + torch.diag_embed(damping), gradient)
        turn = step[:, :2] * (0.25 / step[:, :2].norm(dim=1, keepdim=True).clamp_min(0.25))
        normal = _upward(normal + (basis * turn[:, :, None]).sum(1))
        albedo = torch.maximum(albedo + step[:, 2:] * scale, 1e-6 * scale)
    value, ci, *_ = _evaluate(model, normal, albedo, lights, sigma)
    residual = (grey - value * ci).abs().mean(1, keepdim=True)
    return PixelFit(normal, albedo, weight, residual, 1.25 * residual / scale * _tangent_spread(matrix))


def _start(grey: Tensor, lights: Tensor, scale: Tensor) -> tuple[Tensor, Tensor]:
    """Least squares on the middle ranks."""
    scaled = _linear(grey, lights, _middle_ranks(grey))
    return _upward(scaled), torch.maximum(scaled.norm(dim=1, keepdim=True), 1e-3 * scale)


def _evaluate(
    model: Model, normal: Tensor, albedo: Tensor, lights: Tensor, sigma: float
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """``pi f_r``, n.l and the derivatives of the former by n.l, n.v and albedo, (P, K); 0 where unlit."""
    raw = normal @ lights.T
    lit = raw.sign().relu()
    ci = torch.maximum(raw * lit, 1 - lit).clamp_min(1e-4)
    co, rho = (t.expand_as(ci).contiguous() for t in (normal[:, 2:], albedo))
    value, (d_ci, d_co, _, d_rho, _) = pull(model, (ci, co, lights[:, 2], rho, normal.new_tensor(sigma)), lit)
    by_ci, by_co, by_rho = (torch.zeros_like(lit) if d is None else d for d in (d_ci, d_co, d_rho))
    return value * lit, ci, by_ci, by_co, by_rho


def _normal_equations(
    weight: Tensor,
    residual: Tensor,
    by_light: Tensor,
    by_view: Tensor,
    by_rho: Tensor,
    lights: Tensor,
    normal: Tensor,
    scale: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    """3 x 3 systems in (two tangent angles, albedo / scale), residuals over scale; the (P, 2, 3) tangent basis.

    The derivative by the normal is ``by_light l + by_view v``: sums over lights are matrix products.
    """
    outer = (lights[:, :, None] * lights[:, None, :]).reshape(-1, 9)
    relative = weight / scale**2  # brightness drops out: determinants of dim pixels would underflow
    wl, wv, wr = relative * by_light, relative * by_view, relative * by_rho
    nn = ((wl * by_light) @ outer).reshape(-1, 3, 3)
    cross = (wl * by_view) @ lights
    nn[:, :, 2] += cross
    nn[:, 2, :] += cross
    nn[:, 2, 2] += (wv * by_view).sum(1)
    nr = (wl * by_rho) @ lights
    nr[:, 2] += (wv * by_rho).sum(1)
    gn = (wl * residual) @ lights
    gn[:, 2] += (wv * residual).sum(1)
    basis = _tangents(normal)
    tt = basis @ nn @ basis.transpose(1, 2)
    tr = (basis @ nr[:, :, None]) * scale[:, :, None]
    rr = ((wr * by_rho).sum(1, keepdim=True) * scale**2)[:, :, None]
    matrix = torch.cat((torch.cat((tt, tr), 2), torch.cat((tr.transpose(1, 2), rr), 2)), 1)
    gradient = torch.cat(((basis @ gn[:, :, None])[:, :, 0], (wr * residual).sum(1, keepdim=True) * scale), 1)
    return matrix, gradient, basis


def solve3(matrix: Tensor, right: Tensor) -> Tensor:
    """Solve (P, 3, 3) symmetric systems by Cramer's rule; 0 where singular."""
    a, b, c = matrix.unbind(1)
    bc, ca, ab = torch.linalg.cross(b, c), torch.linalg.cross(c, a), torch.linalg.cross(a, b)
    determinant = (a * bc).sum(1, keepdim=True)
    solution = torch.stack((bc, ca, ab), 1) @ right[:, :, None]
    regular = determinant.abs() > torch.finfo(matrix.dtype).tiny * 1e6
    return torch.where(regular, solution[:, :, 0] / torch.where(regular, determinant, 1), 0)


def _linear(grey: Tensor, lights: Tensor, weight: Tensor) -> Tensor:
    """Weighted Lambertian least squares, albedo times normal, (P, 3)."""
    outer = (lights[:, :, None] * lights[:, None, :]).reshape(-1, 9)
    matrix = (weight @ outer).reshape(-1, 3, 3)
    ridge = 1e-6 * matrix.diagonal(dim1=1, dim2=2).sum(1)[:, None, None] * torch.eye(3).to(matrix)
    return solve3(matrix + ridge, (weight * grey) @ lights)


def _upward(vector: Tensor) -> Tensor:
    """Unit vectors that face the camera; (0, 0, 1) for a zero vector."""
    unit = F.normalize(vector, dim=1, eps=torch.finfo(vector.dtype).tiny)
    return F.normalize(torch.cat((unit[:, :2], unit[:, 2:].clamp_min(MIN_NORMAL_Z)), 1), dim=1)


def _tangents(normal: Tensor) -> Tensor:
    """Two unit tangents of every normal, (P, 2, 3)."""
    x, _, z = normal.unbind(1)
    first = F.normalize(torch.stack((z, torch.zeros_like(z), -x), 1), dim=1)
    return torch.stack((first, torch.linalg.cross(normal, first)), 1)


def _tangent_spread(matrix: Tensor) -> Tensor:
    """Square root of the summed variances of both tangent angles per unit noise, (P, 1)."""
    inverse_trace = torch.zeros_like(matrix[:, 0, 0])
    for axis in (0, 1):
        unit = torch.zeros_like(matrix[:, 0])
        unit[:, axis] = 1
        inverse_trace = inverse_trace + solve3(matrix, unit)[:, axis]
    return torch.where(inverse_trace > 0, inverse_trace, torch.inf).sqrt()[:, None]


def _middle_ranks(grey: Tensor) -> Tensor:
    """1 for observations of the ranks 20 % to 80 % of their pixel, with few lights for those in light."""
    count = grey.shape[1]
    if count < MIN_LIGHTS_RANKED:
        return _lit(grey)
    kept = torch.zeros_like(grey)
    order = grey.argsort(1)[:, math.floor(0.2 * count) : math.ceil(0.8 * count)]
    return kept.scatter_(1, order, 1.0)


def _lit(grey: Tensor) -> Tensor:
    """1 for observations that are not in shadow; at least the three brightest."""
    count = grey.shape[1]
    threshold = SHADOW * grey.kthvalue(max(1, round(0.9 * count)), dim=1, keepdim=True).values
    third = grey.kthvalue(max(1, count - 2), dim=1, keepdim=True).values
    return (grey >= torch.minimum(threshold, third)).to(grey)


def _noise(residual: Tensor, used: Tensor, scale: Tensor) -> Tensor:
    """Robust standard deviation of the residuals in use, at least 1 % of the pixel's mean, (P, 1)."""
    magnitude = torch.where(used > 0, residual.abs(), torch.inf).sort(1).values
    middle = ((used.sum(1, keepdim=True) - 1) / 2).long().clamp_min(0)
    return torch.maximum(1.4826 * magnitude.gather(1, middle), 0.01 * scale)
