"""Fit all pixels of some rows of a capture with one material, and draw maps of the result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..core.progress import track
from ..reconstruction import confidence_from_error
from . import robust_fit
from .channel_fit import fit_channels
from .material import Material
from .pixel_grid import Grid, choose_consistent, neighbourhood_normals, shared_misfit
from .pixel_sample import PixelSample
from .robust_fit import PixelFit, StartName
from .robust_stats import Used, mean_brightness
from .solved_maps import SolvedMaps

SWEEPS = 8
"""Last steps, in which neighbours' normals are a prior for pixels that fit badly. Set by hand."""
DOUBTFUL = 0.03
"""Residuals' standard deviation, as a share of a pixel's mean, above which other starts are tried: on photographs of
three objects no pixel below 0.04 took one. Set by hand."""


@dataclass(frozen=True)
class Band:
    """Pixels that are solved together.

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

    def at(self, part: Tensor) -> Band:
        """Some of the pixels, (P,) bool."""
        mask = torch.zeros_like(self.grid.mask)
        mask[self.grid.mask] = part
        return replace(self, sample=self.sample[part], grid=Grid(mask))


def fit_band(band: Band, material: Material, begin: Tensor | None = None) -> PixelFit:
    """All pixels: from Lambert, with lobes from other starts too, then with the neighbours; or plain least squares.

    Args:
        band: the pixels.
        material: what they share.
        begin: (P, 3) normals to begin with instead of Lambert's.
    """
    sample, grid = band.sample, band.grid
    if band.used == "all":
        return robust_fit.least_squares(sample)
    fitted = robust_fit.fit(sample, Material(), used="middle", progress="solving")
    if begin is not None:
        fitted = replace(fitted, normal=begin)
    if band.used == "lit":
        fitted = robust_fit.fit(sample, material, start=fitted, progress="solving")
        if material.exponents:
            fitted = _try_other_starts(fitted, band, material)
    for _ in track(range(SWEEPS), "smoothing", SWEEPS):
        neighbours = neighbourhood_normals(fitted.normal, fitted.noise, grid)
        fitted = robust_fit.fit(sample, material, used=band.used, steps=1, start=fitted, neighbours=neighbours)
    return fitted


def _try_other_starts(first: PixelFit, band: Band, material: Material) -> PixelFit:
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


def draw_fit(
    fitted: PixelFit, error: Tensor, band: Band, material: Material, exponents: Sequence[int] | None = None
) -> SolvedMaps:
    """Maps of a fit.

    Args:
        fitted: of the pixels.
        error: (P, 1) standard error of their normals, radians.
        band: the pixels.
        material: what they share.
        exponents: of the lobes to draw, among which are the material's; default: these.
    """
    albedo, strengths = _channels(fitted, band, material)
    draw, specular, drawn = band.grid.draw, None, material.exponents if exponents is None else exponents
    if drawn:
        lobes = strengths.new_zeros(len(strengths), len(drawn), albedo.shape[1])
        for lobe, exponent in zip(strengths.unbind(1), material.exponents, strict=True):
            lobes[:, drawn.index(exponent)] = lobe * (8 / (exponent + 8))  # blinn_phong's factor
        specular = draw(lobes.flatten(1))
    return SolvedMaps(
        normal=draw(fitted.normal),
        albedo=draw(albedo),
        albedo_grey=draw(fitted.albedo),
        residual=draw(fitted.residual),
        confidence=draw(confidence_from_error(error)),
        roughness=draw(torch.full_like(fitted.albedo, material.roughness)),
        specular=specular,
    )


def _channels(fitted: PixelFit, band: Band, material: Material) -> tuple[Tensor, Tensor]:
    """Albedo (P, C) and strengths of lobes (P, L, C)."""
    flat, sample = band.images.flatten(2), band.sample

    def work(part: slice) -> tuple[Tensor, Tensor]:
        channels = flat.index_select(2, sample.places[part]).permute(2, 0, 1).to(sample.grey)
        return fit_channels(fitted[part], sample[part], channels, material, band.used)

    albedo, lobes = zip(*robust_fit.map_chunks(work, sample.grey), strict=True)
    return torch.cat(albedo), torch.cat(lobes)


def standard_error(fitted: PixelFit, band: Band, material: Material) -> Tensor:
    """Standard error of the normal in radians, (P, 1); misfit that neighbours share counts as one observation."""

    def residuals(part: slice) -> Tensor:
        some, sample = fitted[part], band.sample[part]
        predicted = robust_fit.predict(some, sample.directions, material)
        root = robust_fit.weights(some, sample.grey, predicted, band.used).sqrt()
        return (sample.grey - predicted) * root / mean_brightness(sample.grey)

    shared = shared_misfit(residuals, band.grid, len(band.sample))
    return fitted.spread * (1 + shared * (len(band.sample.directions) - 1)).sqrt()
