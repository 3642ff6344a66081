"""Solve a capture of one known material for normals, albedo and highlights, in bands of rows that bound the memory."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..core.progress import track
from ..reconstruction import confidence_from_error
from . import robust_fit
from .channel_fit import fit_channels
from .interreflected_light import InterreflectedLight
from .material import Material
from .pixel_grid import Grid, choose_consistent, neighbourhood_normals, shared_misfit
from .pixel_sample import PixelSample
from .robust_fit import PixelFit, StartName
from .robust_stats import Used, mean_brightness
from .roughness_map import RADIUS, at_levels, blend, level_cost
from .solved_maps import SolvedMaps

BAND, BAND_ACCELERATOR = 2**26, 2**30
"""Observations that are solved together on a processor and on an accelerator: what bounds the memory of large captures
(``scripts/benchmarks/large_capture.py`` measures it). Set by hand."""
SWEEPS = 8
"""Last steps, in which neighbours' normals are a prior for pixels that fit badly. Set by hand."""
DOUBTFUL = 0.03
"""Residuals' standard deviation, as a share of a pixel's mean, above which other starts are tried: on photographs of
three objects no pixel below 0.04 took one. Set by hand."""
OVERLAP = SWEEPS + 5 + RADIUS
"""Rows beyond a band on which its pixels depend: through sweeps, choice of starts, shared misfit, shared roughness."""


@dataclass(frozen=True)
class _Band:
    """Rows that are solved together.

    Attributes:
        images: (K, C, R, W).
        sample: every pixel inside the mask.
        grid: where these lie.
        used: observations that count.
    """

    images: Tensor
    sample: PixelSample
    grid: Grid
    used: Used


def solve_bands(
    images: Tensor,
    lights: Tensor,
    inside: Tensor,
    material: Material,
    used: Used,
    interreflected: InterreflectedLight | None = None,
) -> SolvedMaps:
    """Maps of the whole picture, solved in bands of rows that bound the memory.

    Bands overlap by as many rows as pixels depend on beyond their own, so that no seam shows.

    Args:
        images: (K, C, H, W).
        lights: (K, 3) or (K, 3, H, W).
        inside: (H, W) bool.
        material: what all pixels share.
        used: observations that count.
        interreflected: light to subtract from the images first.
    """
    height = len(inside)
    rows = band_height(len(images), inside)
    whole: SolvedMaps | None = None
    for top in range(0, height, rows):
        bottom = min(top + rows, height)
        first, last = max(top - OVERLAP, 0), min(bottom + OVERLAP, height)
        if not bool(inside[top:bottom].any()):
            continue
        seen = images[:, :, first:last]
        if interreflected:
            seen = interreflected.removed_from(seen, first)
        part = lights if lights.ndim == 2 else lights[:, :, first:last]
        places = inside[first:last].flatten().nonzero().flatten()
        band = _Band(seen, PixelSample.gather(seen, part, places), Grid(inside[first:last]), used)
        found = _solve(band, material)
        if rows >= height:
            return found
        if whole is None:
            whole = SolvedMaps(*(value.new_zeros(len(value), *inside.shape) for value in found.tensors()))
        for target, value in zip(whole.tensors(), found.tensors(), strict=True):
            target[:, top:bottom] = value[:, top - first : bottom - first]
    assert whole is not None  # masks are not empty
    return whole


def band_height(count: int, inside: Tensor) -> int:
    """Rows that are solved together under so many lights."""
    pixels = (BAND if inside.device.type == "cpu" else BAND_ACCELERATOR) // count
    return max(4 * OVERLAP, pixels // inside.shape[1])


def _solve(band: _Band, material: Material) -> SolvedMaps:
    """Maps of one band."""
    if not material.roughness_varies:
        return _draw(_fit(band, material), band, material)
    maps, costs = [], []
    for level in track(at_levels(material), "roughness"):
        fitted = _fit(band, level)
        maps.append(_draw(fitted, band, level))
        costs.append(level_cost(fitted, band.sample, level))
    return blend(maps, torch.stack(costs), band.grid)


def _fit(band: _Band, material: Material) -> PixelFit:
    """All pixels: from Lambert, with lobes from other starts too, then with the neighbours; or plain least squares."""
    sample, grid = band.sample, band.grid
    if band.used == "all":
        return robust_fit.least_squares(sample)
    fitted = robust_fit.fit(sample, Material(), used="middle", progress="solving")
    if band.used == "lit":
        fitted = robust_fit.fit(sample, material, start=fitted, progress="solving")
        if material.exponents:
            fitted = _try_other_starts(fitted, band, material)
    for _ in track(range(SWEEPS), "smoothing", SWEEPS):
        neighbours = neighbourhood_normals(fitted.normal, fitted.noise, grid)
        fitted = robust_fit.fit(sample, material, used=band.used, steps=1, start=fitted, neighbours=neighbours)
    return fitted


def _try_other_starts(first: PixelFit, band: _Band, material: Material) -> PixelFit:
    """For every pixel the fit of low cost that agrees with the neighbours, of three starts where one does not do."""
    doubtful = (first.noise[:, 0] > DOUBTFUL).nonzero()[:, 0]
    if not len(doubtful):
        return first
    starts: tuple[StartName, ...] = ("dim", "highlight")
    others = [robust_fit.fit(band.sample[doubtful], material, start=start, progress="solving") for start in starts]
    fits = [first, *(first.replaced(doubtful, other) for other in others)]
    noise = torch.stack([f.noise for f in fits]).amin(0)
    costs = [robust_fit.common_cost(f, noise, band.sample, material) for f in fits]
    return PixelFit.pick(fits, choose_consistent([f.normal for f in fits], costs, band.grid))


def _draw(fitted: PixelFit, band: _Band, material: Material) -> SolvedMaps:
    """Maps of a fit."""
    albedo, strengths = _channels(fitted, band, material)
    draw, specular = band.grid.draw, None
    if material.exponents:
        scale = strengths.new_tensor([8 / (exponent + 8) for exponent in material.exponents])  # blinn_phong's factor
        specular = draw((strengths * scale[:, None]).flatten(1))
    return SolvedMaps(
        normal=draw(fitted.normal),
        albedo=draw(albedo),
        albedo_grey=draw(fitted.albedo),
        residual=draw(fitted.residual),
        confidence=draw(confidence_from_error(_standard_error(fitted, band, material))),
        roughness=draw(torch.full_like(fitted.albedo, material.roughness)),
        specular=specular,
    )


def _channels(fitted: PixelFit, band: _Band, material: Material) -> tuple[Tensor, Tensor]:
    """Albedo (P, C) and strengths of lobes (P, L, C)."""
    flat, sample = band.images.flatten(2), band.sample

    def work(part: slice) -> tuple[Tensor, Tensor]:
        channels = flat.index_select(2, sample.places[part]).permute(2, 0, 1).to(sample.grey)
        return fit_channels(fitted[part], sample[part], channels, material, band.used)

    albedo, lobes = zip(*robust_fit.map_chunks(work, sample.grey), strict=True)
    return torch.cat(albedo), torch.cat(lobes)


def _standard_error(fitted: PixelFit, band: _Band, material: Material) -> Tensor:
    """Standard error of the normal in radians, (P, 1); misfit that neighbours share counts as one observation."""

    def residuals(part: slice) -> Tensor:
        some, sample = fitted[part], band.sample[part]
        predicted = robust_fit.predict(some, sample.directions, material)
        root = robust_fit.weights(some, sample.grey, predicted, band.used).sqrt()
        return (sample.grey - predicted) * root / mean_brightness(sample.grey)

    shared = shared_misfit(residuals, band.grid, len(band.sample))
    return fitted.spread * (1 + shared * (len(band.sample.directions) - 1)).sqrt()
