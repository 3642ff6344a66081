"""Simple shapes and light arrangements that the demo, graphs, tests and benchmarks share."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ..core.optional import require


@dataclass(frozen=True)
class Ball:
    """A sphere's outline in pixels: the centre of the top left pixel is (0, 0), y runs down.

    Attributes:
        x: column of the centre.
        y: row of the centre.
        radius: in pixels.
    """

    x: float
    y: float
    radius: float

    def normals(self, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
        """Normals (3, H, W), camera frame, and the mask (1, H, W) of the ball in a picture of ``size``."""
        height, width = size
        row, column = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        x, y = (column - self.x) / self.radius, (self.y - row) / self.radius
        inside = x * x + y * y < 1
        z = (1 - x * x - y * y).clamp_min(0).sqrt()
        return torch.where(inside, torch.stack((x, y, z)), 0.0), inside[None]


def bumpy_ball() -> tuple[Tensor, Tensor]:
    """A bumpy ball: an icosphere whose radius follows a few smooth waves; (V, 3) and (F, 3)."""
    require("trimesh")
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=6)
    points = torch.tensor(ball.vertices, dtype=torch.float32)
    x, y, z = points.unbind(1)
    bumps = 0.05 * torch.sin(6 * x + 1) * torch.cos(5 * y) + 0.035 * torch.sin(9 * y - 4 * z) + 0.02 * torch.cos(12 * x)
    return points * (0.9 + bumps)[:, None], torch.tensor(ball.faces)


def spiral_lights(count: int, widest: float = math.radians(60)) -> Tensor:
    """``count`` unit directions spread evenly over a cone about the view axis, (count, 3)."""
    index = torch.arange(count) + 0.5
    cosine = 1 - index / count * (1 - math.cos(widest))
    sine, azimuth = (1 - cosine**2).sqrt(), index * math.pi * (3 - math.sqrt(5))
    return torch.stack((sine * azimuth.cos(), sine * azimuth.sin(), cosine), 1)
