from __future__ import annotations

import math

import pytest
import torch

from torch_orennayar import Camera, integrate_normals, render_normals
from torch_orennayar.geometry.primitives import Ball, bumpy_ball
from torch_orennayar.geometry.smooth_integration import integrate_smooth


@pytest.mark.parametrize("size", [(1, 1), (2, 7), (33, 20), (128, 300)])
def test_a_plane_is_exact(size: tuple[int, int]) -> None:
    """Its slopes are constant, so that the chord between two pixels is the plane itself."""
    normal = torch.tensor([-0.3, 0.2, math.sqrt(1 - 0.13)]).double()[:, None, None].expand(3, *size)
    found = integrate_smooth(normal, torch.ones(1, *size, dtype=torch.bool))
    y, x = torch.meshgrid(*(torch.arange(n).double() for n in size), indexing="ij")
    wanted = 0.3 / normal[2, 0, 0] * x + 0.2 / normal[2, 0, 0] * y
    assert torch.allclose(found[0], wanted - wanted.mean(), atol=1e-5 * max(size))


def test_regions_that_do_not_touch_are_planes_of_their_own() -> None:
    normal = torch.tensor([-0.6, 0.0, 0.8]).double()[:, None, None].expand(3, 12, 40)
    mask = torch.ones(1, 12, 40, dtype=torch.bool)
    mask[..., 15:20] = False
    found = integrate_smooth(normal, mask)[0]
    assert torch.allclose(found[:, 1:15] - found[:, :14], torch.full((12, 14), 0.75).double(), atol=1e-5)
    assert torch.allclose(found[:, 21:] - found[:, 20:-1], torch.full((12, 19), 0.75).double(), atol=1e-5)
    assert (found[:, 15:20] == 0).all()


@pytest.mark.parametrize("size", [(64, 71), (200, 257)])
def test_smooth_objects_are_those_of_integrate_normals(size: tuple[int, int]) -> None:
    """Within 2 % of the height of a bumpy ball and of a round one, root mean square."""
    vertices, faces = bumpy_ball()
    bumpy = render_normals(vertices, faces, Camera.orthographic(1.05), size)
    round_one = Ball(size[1] / 2, size[0] / 2, 0.4 * size[0]).normals(size)
    for normal, mask in ((bumpy.normal[0], bumpy.mask[0]), round_one):
        wanted, found = integrate_normals(normal, mask), integrate_smooth(normal, mask)
        apart = (found - wanted)[mask]
        assert float(apart.square().mean().sqrt()) <= 0.02 * float(wanted[mask].max() - wanted[mask].min())
        assert float(found[mask].mean()) == pytest.approx(0, abs=1e-3)
