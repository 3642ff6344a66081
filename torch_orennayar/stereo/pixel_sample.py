"""Pixels picked from photographs: their grey observations, the directions to their lights, and where they lie."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.checks import check_unit
from ..shading.precision import working_dtype
from .material import LightDirections
from .pixel_grid import Grid
from .robust_stats import MISSING

SAMPLE_PIXELS = 2500
"""Pixels of a sample on which the material, its numbers and the light between parts of a surface are decided. Set by
hand."""

TILE = 8
"""Rows and columns of a tile of pixels on which the number of materials is decided: neighbours agree on one. Set by
hand."""


@dataclass(frozen=True)
class PixelSample:
    """P pixels under K lights.

    Attributes:
        grey: (P, K) mean of the channels, float32 or float64.
        directions: to the lights.
        places: (P,) index of each pixel in the flattened picture.
        width: of that picture, pixels.
    """

    grey: Tensor
    directions: LightDirections
    places: Tensor
    width: int

    @staticmethod
    def gather(images: Tensor, lights: Tensor, places: Tensor) -> PixelSample:
        """The pixels of ``images`` (K, C, H, W) at ``places`` (P,); ``lights`` are (K, 3) or (K, 3, H, W)."""
        grey = gather_grey(images, places)
        directions = LightDirections.of(gather_directions(lights, places).to(grey))
        return PixelSample(grey, directions, places, images.shape[3])

    def __len__(self) -> int:
        return len(self.grey)

    def __getitem__(self, part: slice | Tensor) -> PixelSample:
        return PixelSample(self.grey[part], self.directions.at(part), self.places[part], self.width)

    def under(self, lights: Tensor) -> PixelSample:
        """The pixels under some of the lights, (K,) bool."""
        return replace(self, grey=self.grey[:, lights].contiguous(), directions=self.directions.under(lights))

    def grid(self) -> Grid:
        """Where the pixels lie, if their places ascend."""
        rows = int(self.places[-1]) // self.width + 1
        mask = torch.zeros(rows * self.width, dtype=torch.bool, device=self.places.device)
        mask[self.places] = True
        return Grid(mask.reshape(rows, self.width))

    def rows_and_columns(self) -> Tensor:
        """Where the pixels lie, (P, 2)."""
        return torch.stack((self.places // self.width, self.places % self.width), 1)


def gather_grey(images: Tensor, where: Tensor) -> Tensor:
    """Grey observations, (P, K), float32 or float64; ``where`` picks P of the H W pixels, as bool or indices."""
    seen = [image.flatten(1)[:, where].to(working_dtype(images.dtype)).mean(0) for image in images]
    return torch.stack(seen, 1)


def gather_directions(lights: Tensor, where: Tensor) -> Tensor:
    """Unit directions to the lights, (K, 3), or of a map those at P of its pixels, (P, K, 3)."""
    directions = lights if lights.ndim == 2 else lights.flatten(2)[:, :, where].permute(2, 0, 1)
    check_unit("lights", directions, directions.ndim - 1, gaps=False)
    return directions


def gather_reduced(images: Tensor, inside: Tensor, pixels: int) -> tuple[Tensor, Tensor]:
    """Grey observations of the photographs reduced to about so many ``pixels`` of the object, on the processor.

    Args:
        images: (K, C, H, W); outside the object they may hold any values. Where one is `MISSING`, so is what it is
            reduced to.
        inside: (H, W) bool, the object.
        pixels: about how many it has afterwards; small objects are not enlarged.

    Returns:
        Observations (P, K) float64, and where they lie, (h, w) bool.
    """
    factor = reduction(inside, pixels)
    share = F.avg_pool2d(inside.double()[None], factor)[0]
    small = share > 0.5
    seen = []
    for image in images:
        grey = torch.where(inside, image.double().mean(0), 0.0)[None]
        missing = F.max_pool2d((grey == MISSING).double(), factor)[0] > 0
        reduced = F.avg_pool2d(grey, factor)[0] / share.clamp_min(1e-9)
        seen.append(torch.where(missing, MISSING, reduced)[small])
    return torch.stack(seen, 1).cpu(), small.cpu()


def reduction(inside: Tensor, pixels: int) -> int:
    """By how many rows and columns are averaged so that about so many ``pixels`` of the object (H, W) are left."""
    return max(1, round(math.sqrt(int(inside.sum()) / pixels)))


def draw_places(inside: Tensor, count: int, seed: int) -> Tensor:
    """Indices of at most ``count`` pixels, drawn among ``inside`` (H, W) or (1, H, W) bool."""
    places = inside.flatten().nonzero().flatten()
    generator = torch.Generator().manual_seed(seed)
    return places[torch.randperm(len(places), generator=generator)[:count].to(places.device)]


def draw_tiles(lit: Tensor, seed: int) -> Tensor:
    """Indices of about as many pixels in square tiles, drawn among ``lit`` (H, W) bool, in ascending order."""
    rows, columns = (torch.arange(n, device=lit.device) // TILE for n in lit.shape)
    tile = rows[:, None] * (1 + columns[-1]) + columns
    generator = torch.Generator().manual_seed(seed)
    order = torch.randperm(int(tile[-1, -1]) + 1, generator=generator).to(lit.device)
    count = torch.bincount(tile[lit], minlength=len(order))[order].cumsum(0)
    drawn = torch.zeros_like(order, dtype=torch.bool)
    drawn[order[: 1 + int((count < SAMPLE_PIXELS).sum())]] = True
    return (drawn[tile] & lit).flatten().nonzero().flatten()
