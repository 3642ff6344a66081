"""Photometric stereo by the network that ships with the package."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from . import _robust_fit as robust_fit
from ._robust_fit import PixelFit
from .bands import band_height, gather, gather_directions
from .material import Material, Rays, dot
from .neighbours import Grid, neighbourhood_normals
from .progress import track
from .set_network import load_network, solve_pixels

NETWORK = "network"
"""The name that `photometric_stereo` takes."""
TRAINED_LIGHTS = 12
"""The fewest lights that it has seen."""


def solve_network(images: Tensor, lights: Tensor, inside: Tensor) -> dict[str, Tensor]:
    """Maps (C, H, W) as of `solve_bands`: the network's normals, and Lambert's albedo under them."""
    network = load_network().to(images.device)
    rows = band_height(len(images), inside)
    found: list[tuple[Tensor, Tensor]] = []
    for top in track(range(0, len(inside), rows), "network"):
        part = slice(top, top + rows)
        where = inside[part].flatten()
        grey = gather(images[:, :, part], where).float()
        directions = gather_directions(lights if lights.ndim == 2 else lights[:, :, part], where).float()
        found.append(solve_pixels(network, grey, directions))
    normal, error = (torch.cat(values) for values in zip(*found, strict=True))
    grid = Grid(inside)
    normal = neighbourhood_normals(normal, error, grid)
    maps = [_paint(images, lights, inside, slice(top, top + rows), normal) for top in range(0, len(inside), rows)]

    albedo, grey_albedo, residual = (grid.draw(torch.cat(values)) for values in zip(*maps, strict=True))
    confidence = 1 / (1 + (error / math.radians(2)) ** 2)
    return {
        "normal": grid.draw(normal),
        "albedo": albedo,
        "albedo_grey": grey_albedo,
        "residual": residual,
        "confidence": grid.draw(confidence),
    }


def _paint(
    images: Tensor, lights: Tensor, inside: Tensor, part: slice, normal: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Albedo (P, C), of grey (P, 1), and mean misfit (P, 1) of the pixels in some rows, without outliers."""
    before = int(inside[: part.start].sum())
    where = inside[part].flatten()
    grey = gather(images[:, :, part], where).float()
    rays = Rays.of(gather_directions(lights if lights.ndim == 2 else lights[:, :, part], where).float())
    fitted = _under(normal[before : before + len(grey)], grey, rays)
    place, flat = where.nonzero().flatten(), images[:, :, part].flatten(2)
    painted = []
    for piece in robust_fit.chunks(grey):
        channels = flat.index_select(2, place[piece]).permute(2, 0, 1).float()
        painted.append(robust_fit.colour(fitted[piece], grey[piece], channels, rays.at(piece), Material(), "middle")[0])
    return torch.cat(painted), fitted.albedo, fitted.residual


def _under(normal: Tensor, grey: Tensor, rays: Rays) -> PixelFit:
    """Lambert's fit with the normals given."""
    cosine = dot(normal, rays.light).clamp_min(0)
    blank = PixelFit(normal, cosine.new_ones(len(grey), 1), cosine[:, :0], cosine.new_full((len(grey), 1), torch.inf),
                     cosine[:, :1], cosine[:, :1])  # fmt: skip
    used = robust_fit.weights(blank, grey, grey, "middle")
    albedo = (used * cosine * grey).sum(1, keepdim=True) / (used * cosine.square()).sum(1, keepdim=True).clamp_min(1e-9)
    missed = (grey - albedo * cosine).abs()
    noise = (1.4826 * missed.median(1, keepdim=True).values / robust_fit.mean_of(grey)).clamp_min(
        robust_fit.NOISE_FLOOR
    )
    return replace(blank, albedo=albedo.clamp_min(1e-6), noise=noise, residual=missed.mean(1, keepdim=True))
