"""What neighbouring pixels know of each other: means of their normals, the start they agree on, misfit they share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

AGREEMENT = 2.0
"""Weight of disagreement with the neighbours against the robust cost when a start is chosen."""
FIRST_START = 0.1
"""What another start than the first must gain in cost."""
AROUND = tuple((y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if (y, x) != (0, 0))
LARGEST = 0.3
"""Disagreement, ``1 - n.n'``, counts up to here: beyond a depth edge neighbours do not matter."""


@dataclass(frozen=True)
class Grid:
    """Where the P pixels of a mask lie.

    Attributes:
        mask: (H, W) bool, on the pixels' device.
    """

    mask: Tensor

    def mean(self, values: Tensor, weight: Tensor, radius: int = 1) -> Tensor:
        """Weighted mean of (P, C) ``values`` over a square window, the pixel itself included, (P, C)."""
        share = self._around(weight[:, 0], radius).clamp_min(torch.finfo(values.dtype).tiny)
        # Channel by channel: large captures leave little room.
        return torch.stack([self._around(column * weight[:, 0], radius) / share for column in values.unbind(1)], 1)

    def draw(self, values: Tensor) -> Tensor:
        """Values (P, C) where the pixels lie, 0 outside the mask, (C, H, W)."""
        drawn = values.new_zeros(values.shape[1], *self.mask.shape)
        drawn[:, self.mask] = values.T
        return drawn

    def _around(self, values: Tensor, radius: int) -> Tensor:
        """Mean of (P,) values over a square window, 0 outside the mask, (P,)."""
        canvas = values.new_zeros(self.mask.shape)
        canvas[self.mask] = values
        return F.avg_pool2d(canvas[None, None], 2 * radius + 1, 1, radius)[0, 0][self.mask]

    def neighbours(self, steps: Sequence[tuple[int, int]] = AROUND) -> Iterator[tuple[Tensor, Tensor]]:
        """For each step (rows, columns): the neighbour's index for every pixel, (P,), and 1 where there is one, (P,).

        A pixel without that neighbour gets its own index.
        """
        height, width = self.mask.shape
        count = int(self.mask.sum())
        own = torch.arange(count, dtype=torch.int32, device=self.mask.device)
        index = torch.full(self.mask.shape, -1, dtype=torch.int32, device=self.mask.device)
        index[self.mask] = own
        padded = F.pad(index, (1, 1, 1, 1), value=-1)
        for y, x in steps:
            found = padded[1 + y : 1 + y + height, 1 + x : 1 + x + width][self.mask]
            yield torch.where(found >= 0, found, own), (found >= 0).float()


def neighbourhood_normals(normal: Tensor, noise: Tensor, grid: Grid) -> Tensor:
    """Mean normal of every pixel and its 8 neighbours, those that fit well counting more, (P, 3) unit."""
    weight = 1 / noise.clamp(1e-3, 1e3).square()
    return F.normalize(grid.mean(normal, weight), dim=1)


def agree(normals: Sequence[Tensor], costs: Sequence[Tensor], grid: Grid, sweeps: int = 4) -> Tensor:
    """Which of S results every pixel takes, (P,): low cost, and normals that neighbours share."""
    stacked, cost = torch.stack(list(normals)), torch.stack(list(costs))  # (S, P, 3), (S, P)
    cost[1:] += FIRST_START
    choice = cost.argmin(0)
    known = torch.stack([there for _, there in grid.neighbours()]).sum(0).clamp_min(1)
    for _ in range(sweeps):
        current = stacked.gather(0, choice[None, :, None].expand(1, -1, 3))[0]
        apart = torch.zeros_like(cost)
        for index, there in grid.neighbours():
            apart += (1 - (stacked * current.index_select(0, index)).sum(2)).clamp(max=LARGEST) * there
        choice = (cost + AGREEMENT * apart / known).argmin(0)
    return choice


def shared_misfit(residuals: Callable[[slice], Tensor], grid: Grid, count: int) -> Tensor:
    """How much of their residuals neighbours share, (P, 1) in [0, 1].

    Noise differs from pixel to pixel, what a model cannot show is alike: the products of neighbours' residuals over
    their squares tell one from the other; those to the right and below are enough. ``residuals`` gives (p, K) for a
    run of the P = ``count`` pixels.
    """
    around = list(grid.neighbours(((0, 1), (1, 0))))
    reach = 2 * grid.mask.shape[1] + 2
    parts = []
    for begin in range(0, count, max(4 * reach, 4096)):
        end = min(begin + max(4 * reach, 4096), count)
        first = max(begin - reach, 0)
        window = residuals(slice(first, min(end + reach, count)))
        own = window[begin - first : end - first]
        together, alone = own.new_zeros(len(own)), own.new_full((len(own),), torch.finfo(own.dtype).tiny)
        for index, there in around:
            other = window.index_select(0, index[begin:end] - first)
            together += (own * other).sum(1) * there[begin:end]
            alone += (own.square() + other.square()).sum(1) * (there[begin:end] / 2)
        parts.append((together / alone).clamp(0, 1))
    return torch.cat(parts)[:, None]
