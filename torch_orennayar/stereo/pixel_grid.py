"""What neighbouring pixels know of each other: mean normals, which start they agree on, misfit that they share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

AGREEMENT = 2.0
"""Weight of the disagreement with the neighbours, ``1 - n.n'``, against the robust cost per observation when one of
several fits is chosen. Set by hand."""
FIRST_FIT = 0.1
"""Robust cost per observation by which another fit must beat the first one. Set by hand."""
MAX_DISAGREEMENT = 0.3
"""``1 - n.n'`` counts up to here: beyond a depth edge neighbours do not matter. Set by hand."""
SWEEPS_OF_CHOICE = 4
"""Times that pixels choose again after their neighbours did. Set by hand."""
EIGHT_NEIGHBOURS = tuple((y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if (y, x) != (0, 0))
"""Steps (rows, columns) to them."""


@dataclass(frozen=True)
class Grid:
    """Where the P pixels of a mask lie.

    Attributes:
        mask: (H, W) bool, on the pixels' device.
    """

    mask: Tensor

    def mean(self, values: Tensor, weight: Tensor, radius: int = 1) -> Tensor:
        """Weighted mean of (P, C) ``values`` over a square window, the pixel itself included, (P, C)."""
        share = self._window_mean(weight[:, 0], radius).clamp_min(torch.finfo(values.dtype).tiny)
        # Channel by channel: large captures leave little room.
        columns = [self._window_mean(column * weight[:, 0], radius) / share for column in values.unbind(1)]
        return torch.stack(columns, 1)

    def draw(self, values: Tensor) -> Tensor:
        """Values (P, C) where the pixels lie, 0 outside the mask, (C, H, W)."""
        drawn = values.new_zeros(values.shape[1], *self.mask.shape)
        drawn[:, self.mask] = values.T
        return drawn

    def _window_mean(self, values: Tensor, radius: int) -> Tensor:
        """Mean of (P,) values over a square window, with 0 outside the mask, (P,)."""
        canvas = values.new_zeros(self.mask.shape)
        canvas[self.mask] = values
        return F.avg_pool2d(canvas[None, None], 2 * radius + 1, 1, radius)[0, 0][self.mask]

    def neighbours(self, steps: Sequence[tuple[int, int]] = EIGHT_NEIGHBOURS) -> Iterator[tuple[Tensor, Tensor]]:
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
    """Mean normal of every pixel and its 8 neighbours weighted by their inverse variance, (P, 3) unit."""
    weight = 1 / noise.clamp(1e-3, 1e3).square()
    return F.normalize(grid.mean(normal, weight), dim=1)


def choose_consistent(normals: Sequence[Tensor], costs: Sequence[Tensor], grid: Grid) -> Tensor:
    """Index of the fit that every pixel takes, (P,): low robust cost, and normals that neighbours share.

    Args:
        normals: (P, 3) of each fit.
        costs: (P,) of each fit, per observation.
        grid: where the pixels lie.
    """
    stacked, cost = torch.stack(list(normals)), torch.stack(list(costs))  # (S, P, 3), (S, P)
    cost[1:] += FIRST_FIT
    choice = cost.argmin(0)
    known = torch.stack([there for _, there in grid.neighbours()]).sum(0).clamp_min(1)
    for _ in range(SWEEPS_OF_CHOICE):
        current = stacked.gather(0, choice[None, :, None].expand(1, -1, 3))[0]
        apart = torch.zeros_like(cost)
        for index, there in grid.neighbours():
            apart += (1 - (stacked * current.index_select(0, index)).sum(2)).clamp(max=MAX_DISAGREEMENT) * there
        choice = (cost + AGREEMENT * apart / known).argmin(0)
    return choice


def shared_misfit(residuals: Callable[[slice], Tensor], grid: Grid, count: int) -> Tensor:
    """Correlation of the residuals of neighbours, (P, 1) in [0, 1].

    Noise is independent from pixel to pixel, what a model cannot show is not: the products of neighbours' residuals
    over their squares estimate the correlation; the neighbours to the right and below suffice.

    Args:
        residuals: gives (p, K) for a run of the pixels.
        grid: where the pixels lie.
        count: P.
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
