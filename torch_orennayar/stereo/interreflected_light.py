"""Light between parts of a surface, as a map that can be subtracted from photographs."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor


@dataclass(frozen=True)
class InterreflectedLight:
    """Light that every pixel receives from other parts of the surface.

    Attributes:
        share: (K, C, h, w) as a share of a pixel's mean over lights, for a surface whose brightest parts are white.
        factor: how many times smaller than the photographs that map is.
        strength: albedo of those parts.
    """

    share: Tensor
    factor: int
    strength: float = 1.0

    def removed_from(self, images: Tensor, first: int) -> Tensor:
        """Rows ``first`` on of the photographs, (K, C, R, W), without that light."""
        rows, columns = (torch.arange(n, device=images.device) for n in images.shape[2:])
        places = self._grid_coordinates(rows[:, None] + first, columns)
        mean = images.mean(0, dtype=self.share.dtype).clamp_min(0)
        left = torch.empty_like(images)
        for k, image in enumerate(images):
            left[k] = image - (self.strength * _interpolate(self.share[k : k + 1], places)[0] * mean).to(images)
        return left

    def at(self, seen: Tensor, places: Tensor, width: int) -> Tensor:
        """That light in P pixels that show ``seen`` (P, C, K), at ``places`` (P,) of a flattened picture so wide."""
        points = self._grid_coordinates(places // width, places % width)
        mean = seen.to(self.share).mean(2, keepdim=True).clamp_min(0)
        return self.strength * _interpolate(self.share, points[None])[:, :, 0].permute(2, 1, 0) * mean

    def _grid_coordinates(self, rows: Tensor, columns: Tensor) -> Tensor:
        """Pixels in grid_sample's units, (..., 2)."""
        height, width = (self.factor * n for n in self.share.shape[2:])
        x, y = torch.broadcast_tensors((columns + 0.5) / width * 2 - 1, (rows + 0.5) / height * 2 - 1)
        return torch.stack((x, y), -1).to(self.share)


def _interpolate(maps: Tensor, places: Tensor) -> Tensor:
    """Maps (N, C, h, w) at (R, S, 2)."""
    return F.grid_sample(maps, places.expand(len(maps), -1, -1, -1), padding_mode="border", align_corners=False)
