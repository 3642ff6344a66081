from __future__ import annotations

import math

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from torch_orennayar import Camera, CaptureError, RangeError, ShapeError, integrate_normals


def waves(size: int) -> tuple[Tensor, Tensor]:
    """A height field in pixels and its exact normals, camera frame (rows go down, y goes up)."""
    row, column = torch.meshgrid(torch.arange(size).double(), torch.arange(size).double(), indexing="ij")
    w = 2 * math.pi / size
    height = 6 * torch.sin(1.5 * w * column) * torch.cos(w * row)
    right = 6 * 1.5 * w * torch.cos(1.5 * w * column) * torch.cos(w * row)
    down = -6 * w * torch.sin(1.5 * w * column) * torch.sin(w * row)
    return height[None], F.normalize(torch.stack((-right, down, torch.ones_like(right))), dim=0)


def test_orthographic_heights_in_pixels() -> None:
    height, normal = waves(64)
    found = integrate_normals(normal)
    assert ((found - found.mean()) - (height - height.mean())).abs().max() < 0.02


def test_orthographic_camera_gives_world_units() -> None:
    _, normal = waves(64)
    found = integrate_normals(normal, camera=Camera.orthographic(2.0))
    assert torch.allclose(found, -integrate_normals(normal) * 4 / 64, atol=1e-6)  # distance grows away from the viewer


def test_perspective_depth_up_to_scale() -> None:
    """A tilted plane has depth d / (n.r)."""
    camera = Camera.perspective(math.radians(50))
    normal = F.normalize(torch.tensor([0.3, -0.2, 1.0]).double(), dim=0)
    rays = camera.rays((40, 56))[0].double()
    depth = -1 / (normal.reshape(3, 1, 1) * rays).sum(0)
    found = integrate_normals(normal.reshape(3, 1, 1).expand(3, 40, 56), camera=camera)[0]
    ratio = found / depth
    assert (found > 0).all()
    assert (ratio / ratio.mean() - 1).abs().max() < 1e-3


def test_regions_holes_and_single_pixels() -> None:
    height, normal = waves(64)
    mask = torch.ones(1, 64, 64, dtype=torch.bool)
    mask[:, :, 30:32] = False
    mask[:, 10:20, 5:15] = False
    mask[:, 0:3, 0:3] = False
    mask[:, 1, 1] = True
    found = integrate_normals(normal, mask)
    assert (found[~mask] == 0).all()
    assert found[0, 1, 1].item() == 0
    left, right = mask.clone(), mask.clone()
    left[:, :, 30:] = False
    left[:, 1, 1] = False
    right[:, :, :32] = False
    for region in (left, right):
        difference = (found - height)[region]
        assert (difference - difference.mean()).abs().max() < 0.05
        assert abs(found[region].mean()) < 1e-6


def test_normals_at_the_horizon_stay_finite() -> None:
    normal = torch.tensor([1.0, 0, 0]).reshape(3, 1, 1).expand(3, 8, 8)
    assert integrate_normals(normal).isfinite().all()


@pytest.mark.parametrize(
    ("normal", "mask", "error"),
    [
        (torch.zeros(3, 4, 4), None, CaptureError),
        (torch.zeros(1, 3, 4, 4), None, ShapeError),
        (torch.ones(3, 4, 4), torch.ones(1, 4, 5, dtype=torch.bool), ShapeError),
        (torch.full((3, 4, 4), torch.nan), torch.ones(1, 4, 4, dtype=torch.bool), RangeError),
    ],
)
def test_bad_input(normal: Tensor, mask: Tensor | None, error: type[Exception]) -> None:
    with pytest.raises(error):
        integrate_normals(normal, mask)
