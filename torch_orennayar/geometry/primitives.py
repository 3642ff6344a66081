"""Simple shapes and light arrangements that the demo, graphs, tests and benchmarks share."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ..core.optional import require


@dataclass(frozen=True)
class Ball:
    """The outline of a sphere in an orthographic image, in pixels; the centre of the top left pixel is (0, 0).

    Attributes:
        x: column of the centre, to the right.
        y: row of the centre, downwards.
        radius: radius in pixels, > 0.
    """

    x: float
    y: float
    radius: float

    def normals(self, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
        """Normals of the sphere at the pixels whose centres lie inside its outline.

        Args:
            size: (H, W) of the image in pixels.

        Returns:
            ``(normal, mask)``: (3, H, W) unit normals in the camera frame (x right, y up, z toward the viewer), 0
            outside the mask, and (1, H, W) bool.

        Example:
            >>> from torch_orennayar.geometry.primitives import Ball
            >>> normal, mask = Ball(x=2.0, y=1.0, radius=1.25).normals((3, 4))
            >>> [round(v, 6) for v in normal[:, 1, 3].tolist()], int(mask.sum())
            ([0.8, 0.0, 0.6], 5)
        """
        height, width = size
        row, column = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
        x, y = (column - self.x) / self.radius, (self.y - row) / self.radius
        inside = x * x + y * y < 1
        z = (1 - x * x - y * y).clamp_min(0).sqrt()
        return torch.where(inside, torch.stack((x, y, z)), 0.0), inside[None]


def bumpy_ball() -> tuple[Tensor, Tensor]:
    """A closed mesh for examples: a sphere whose radius varies in smooth waves between 0.81 and 1.

    Returns:
        ``(vertices, faces)``: (40962, 3) float32 around the origin, and (81920, 3) int64 with corners
        counter-clockwise as seen from outside.

    Example:
        >>> from torch_orennayar.geometry.primitives import bumpy_ball
        >>> vertices, faces = bumpy_ball()
        >>> vertices.shape, faces.shape
        (torch.Size([40962, 3]), torch.Size([81920, 3]))
    """
    require("trimesh")
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=6)
    points = torch.tensor(ball.vertices, dtype=torch.float32)
    x, y, z = points.unbind(1)
    bumps = 0.05 * torch.sin(6 * x + 1) * torch.cos(5 * y) + 0.035 * torch.sin(9 * y - 4 * z) + 0.02 * torch.cos(12 * x)
    return points * (0.9 + bumps)[:, None], torch.tensor(ball.faces)


def spiral_lights(count: int, widest: float = math.radians(60)) -> Tensor:
    """Directions spread evenly over a cone around the view axis, in a golden-angle spiral.

    Args:
        count: number of directions, at least 1.
        widest: half the opening angle of the cone, radians.

    Returns:
        (count, 3) unit directions in the camera frame, ordered from the axis outwards; each stands for an equal
        solid angle.

    Example:
        >>> from torch_orennayar.geometry.primitives import spiral_lights
        >>> spiral_lights(5).shape
        torch.Size([5, 3])
    """
    index = torch.arange(count) + 0.5
    cosine = 1 - index / count * (1 - math.cos(widest))
    sine, azimuth = (1 - cosine**2).sqrt(), index * math.pi * (3 - math.sqrt(5))
    return torch.stack((sine * azimuth.cos(), sine * azimuth.sin(), cosine), 1)
