"""Solve a capture of one known material for normals, albedo and highlights, in bands of rows that bound the memory."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.progress import track
from .band_fit import SWEEPS, Band, draw_fit, fit_band, standard_error
from .interreflected_light import InterreflectedLight
from .material import Material
from .mixed_fit import Mixture, solve_mixture
from .network_solver import REACH
from .pixel_grid import Grid
from .pixel_sample import PixelSample
from .robust_fit import PixelFit
from .robust_stats import Used
from .roughness_map import RADIUS, at_levels, blend, level_cost
from .solved_maps import SolvedMaps

BAND, BAND_ACCELERATOR = 2**26, 2**30
"""Observations that are solved together on a processor and on an accelerator: what bounds the memory of large captures
(``scripts/benchmarks/large_capture.py`` measures it). Set by hand."""
OVERLAP = SWEEPS + 5 + 2 * RADIUS + REACH
"""Rows beyond a band on which its pixels depend: through sweeps, choice of starts, shared misfit, shared roughness or
material, smoothing of the network's normals and their average with the fitted ones."""


def solve_bands(
    images: Tensor,
    lights: Tensor,
    inside: Tensor,
    material: Material,
    used: Used,
    interreflected: InterreflectedLight | None = None,
    mixture: Mixture | None = None,
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
        mixture: materials among which pixels choose, and the network beside them, instead of ``material``.
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
        band = Band(seen, PixelSample.gather(seen, part, places), Grid(inside[first:last]), used)
        found = _solve(band, material, mixture)
        if rows >= height:
            return found
        if whole is None:
            whole = found.like(value.new_zeros(len(value), *inside.shape) for value in found.tensors())
        for target, value in zip(whole.tensors(), found.tensors(), strict=True):
            target[:, top:bottom] = value[:, top - first : bottom - first]
    assert whole is not None  # masks are not empty
    return whole


def band_height(count: int, inside: Tensor) -> int:
    """Rows that are solved together under so many lights."""
    pixels = (BAND if inside.device.type == "cpu" else BAND_ACCELERATOR) // count
    return max(3 * OVERLAP, pixels // inside.shape[1])


def _solve(band: Band, material: Material, mixture: Mixture | None) -> SolvedMaps:
    """Maps of one band."""
    if mixture is not None:
        return solve_mixture(band, mixture)
    if not material.roughness_varies:
        return _draw(fit_band(band, material), band, material)
    maps, costs = [], []
    for level in track(at_levels(material), "roughness"):
        fitted = fit_band(band, level)
        maps.append(_draw(fitted, band, level))
        costs.append(level_cost(fitted, band.sample, level))
    return blend(maps, torch.stack(costs), band.grid)


def _draw(fitted: PixelFit, band: Band, material: Material) -> SolvedMaps:
    return draw_fit(fitted, standard_error(fitted, band, material), band, material)
