"""Solve a capture of one known material for normals, albedo and highlights, in bands of rows that bound the memory."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from ..core.checks import check_unit
from ..core.progress import track
from ..shading.precision import working_dtype
from . import robust_fit
from .material import LightDirections, Material
from .pixel_grid import Grid, agree, neighbourhood_normals, shared_misfit
from .robust_fit import PixelFit
from .roughness_map import RADIUS, at_levels, blend, level_cost

BAND, BAND_ACCELERATOR = 2**26, 2**30
"""Observations that are solved together: what bounds the memory of large captures."""
SWEEPS = 8
"""Steps in which neighbours pull at pixels that fit badly."""
OVERLAP = SWEEPS + 5 + RADIUS
"""Rows beyond a band that its pixels hear of: through sweeps, choice of starts, shared misfit and shared roughness."""


Mend = Callable[[Tensor, int], Tensor]
"""What photographs' rows (K, C, R, W), from a first one on, should have shown."""


def solve_bands(
    images: Tensor, lights: Tensor, inside: Tensor, material: Material, used: str, mend: Mend | None = None
) -> dict[str, Tensor]:
    """Maps (C, H, W) of the whole picture, solved in bands of rows that bound the memory.

    Bands overlap by as many rows as pixels see of their neighbours, so that no seam shows.
    """
    height = len(inside)
    rows = band_height(len(images), inside)
    whole: dict[str, Tensor] = {}
    for top in range(0, height, rows):
        bottom = min(top + rows, height)
        first, last = max(top - OVERLAP, 0), min(bottom + OVERLAP, height)
        if not bool(inside[top:bottom].any()):
            continue
        part = lights if lights.ndim == 2 else lights[:, :, first:last]
        seen = images[:, :, first:last]
        found = _solve(mend(seen, first) if mend else seen, part, inside[first:last], material, used)
        if rows >= height:
            return found
        for name, value in found.items():
            if name not in whole:
                whole[name] = value.new_zeros(len(value), *inside.shape)
            whole[name][:, top:bottom] = value[:, top - first : bottom - first]
    return whole


def band_height(count: int, inside: Tensor) -> int:
    """Rows that are solved together."""
    pixels = (BAND if inside.device.type == "cpu" else BAND_ACCELERATOR) // count
    return max(4 * OVERLAP, pixels // inside.shape[1])


def _solve(images: Tensor, lights: Tensor, inside: Tensor, material: Material, used: str) -> dict[str, Tensor]:
    """Maps (C, H, W) of one band; ``albedo_grey`` is what the grey observations say."""
    grid = Grid(inside)
    grey = gather(images, inside.flatten())
    rays = LightDirections.of(gather_directions(lights, inside.flatten()).to(grey))
    if not material.varied:
        return _draw(_fit(grey, rays, material, used, grid), grey, images, rays, material, used, grid)
    maps, costs = [], []
    for level in track(at_levels(material), "roughness"):
        fitted = _fit(grey, rays, level, used, grid)
        maps.append(_draw(fitted, grey, images, rays, level, used, grid))
        costs.append(level_cost(fitted, grey, rays, level))
    return blend(maps, torch.stack(costs), grid)


def _draw(
    fitted: PixelFit, grey: Tensor, images: Tensor, rays: LightDirections, material: Material, used: str, grid: Grid
) -> dict[str, Tensor]:
    """Maps (C, H, W) of a fit."""
    albedo, strengths = _colours(fitted, grey, images, grid.mask, rays, material, used)
    spread = _spread(fitted, grey, rays, material, used, grid)

    maps = {
        "normal": grid.draw(fitted.normal),
        "albedo": grid.draw(albedo),
        "albedo_grey": grid.draw(fitted.albedo),
        "residual": grid.draw(fitted.residual),
        "roughness": grid.draw(torch.full_like(fitted.albedo, material.roughness)),
        "confidence": grid.draw(1 / (1 + (spread / math.radians(2)) ** 2)),
    }
    if material.exponents:
        scale = strengths.new_tensor([8 / (exponent + 8) for exponent in material.exponents])  # blinn_phong's factor
        maps["specular"] = grid.draw((strengths * scale[:, None]).flatten(1))
    return maps


def _fit(grey: Tensor, rays: LightDirections, material: Material, used: str, grid: Grid) -> PixelFit:
    """All pixels: from Lambert, with lobes from other starts too, then with the neighbours; or plain least squares."""
    if used == "all":
        return robust_fit.least_squares(grey, rays)
    fitted = robust_fit.fit(grey, rays, Material(), used="middle", show="solving")
    if used == "lit":
        fits = [robust_fit.fit(grey, rays, material, start=fitted, show="solving")]
        if material.exponents:
            fits += [robust_fit.fit(grey, rays, material, start=s, show="solving") for s in ("dim", "highlight")]
        fitted = fits[0] if len(fits) == 1 else _take_best(fits, grey, rays, material, grid)
    for _ in track(range(SWEEPS), "smoothing", SWEEPS):
        near = neighbourhood_normals(fitted.normal, fitted.noise, grid)
        fitted = robust_fit.fit(grey, rays, material, used=used, steps=1, start=fitted, toward=near)
    return fitted


def _take_best(
    fits: Sequence[PixelFit], grey: Tensor, rays: LightDirections, material: Material, grid: Grid
) -> PixelFit:
    """For every pixel the fit of low cost that agrees with the neighbours."""
    noise = torch.stack([f.noise for f in fits]).amin(0)
    costs = [robust_fit.common_cost(f, noise, grey, rays, material) for f in fits]
    return robust_fit.take(fits, agree([f.normal for f in fits], costs, grid))


def _colours(
    fitted: PixelFit, grey: Tensor, images: Tensor, inside: Tensor, rays: LightDirections, material: Material, used: str
) -> tuple[Tensor, Tensor]:
    """Albedo (P, C) and strengths of lobes (P, L, C)."""
    place = inside.flatten().nonzero().flatten()
    flat = images.flatten(2)

    def work(part: slice) -> tuple[Tensor, Tensor]:
        channels = flat.index_select(2, place[part]).permute(2, 0, 1).to(grey)
        return robust_fit.colour(fitted[part], grey[part], channels, rays.at(part), material, used)

    albedo, lobes = zip(*robust_fit.side_by_side(work, robust_fit.chunks(grey)), strict=True)
    return torch.cat(albedo), torch.cat(lobes)


def _spread(fitted: PixelFit, grey: Tensor, rays: LightDirections, material: Material, used: str, grid: Grid) -> Tensor:
    """Standard error of the normal in radians, (P, 1); misfit that neighbours share counts as one observation."""

    def residuals(part: slice) -> Tensor:
        some = fitted[part]
        predicted = robust_fit.predict(some, rays.at(part), material)
        root = robust_fit.weights(some, grey[part], predicted, used).sqrt()
        return (grey[part] - predicted) * root / robust_fit.mean_of(grey[part])

    shared = shared_misfit(residuals, grid, len(grey))
    return fitted.spread * (1 + shared * (len(rays) - 1)).sqrt()


def gather(images: Tensor, where: Tensor) -> Tensor:
    """Grey observations, (P, K), float32 or float64; ``where`` picks P of the H W pixels, as bool or indices."""
    seen = [image.flatten(1)[:, where].to(working_dtype(images.dtype)).mean(0) for image in images]
    return torch.stack(seen, 1)


def gather_directions(lights: Tensor, where: Tensor) -> Tensor:
    """Unit directions to the lights, (K, 3), or of a map those at P of its pixels, (P, K, 3)."""
    directions = lights if lights.ndim == 2 else lights.flatten(2)[:, :, where].permute(2, 0, 1)
    check_unit("lights", directions, directions.ndim - 1, gaps=False)
    return directions
