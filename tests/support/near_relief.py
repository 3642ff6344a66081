"""A low relief under a ring of near lamps, lit exactly."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

COUNT, SIZE = 12, 64
"""Of the lamps, and pixels on a side."""


def relief(
    distance: float, *, origin: tuple[float, float] | None = None, noise: float = 0.01
) -> tuple[Tensor, Tensor, Tensor]:
    """Photographs of the relief under lamps at so many of its sizes, directions to these, and true normals.

    Directions are those from a pixel, column and row, by default the middle; ``noise`` is a share of the brightness.
    """
    across = (torch.arange(SIZE) - (SIZE - 1) / 2) / SIZE
    x, y = across[None].expand(SIZE, SIZE), -across[:, None].expand(SIZE, SIZE)
    normal = F.normalize(torch.stack((0.4 * torch.cos(25 * x), 0.4 * torch.sin(20 * y), torch.ones_like(x))), dim=0)
    height = 0.4 / 20 * torch.cos(20 * y) - 0.4 / 25 * torch.sin(25 * x)
    turned = torch.arange(COUNT) * 2 * torch.pi / COUNT
    lamp = distance * F.normalize(torch.stack((turned.cos(), turned.sin(), torch.full_like(turned, 1.4)), 1), dim=1)
    column, row = origin or ((SIZE - 1) / 2, (SIZE - 1) / 2)
    light = F.normalize(lamp - torch.tensor([column - (SIZE - 1) / 2, (SIZE - 1) / 2 - row, 0]) / SIZE, dim=1)
    toward = lamp[:, :, None, None] - torch.stack((x, y, height))
    length = toward.norm(dim=1, keepdim=True)
    cosine = (normal * toward / length).sum(1, keepdim=True).clamp_min(0)
    drawn = torch.randn(COUNT, 1, SIZE, SIZE, generator=torch.Generator().manual_seed(0))
    return 0.5 * cosine * (distance / length) ** 2 * (1 + noise * drawn), light, normal
