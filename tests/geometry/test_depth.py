from __future__ import annotations

import pytest
import torch
import trimesh
from kornia.geometry.depth import depth_to_normals as kornia_normals
from torch.autograd import gradcheck

from torch_orennayar import (
    Camera,
    ShapeError,
    angular_error,
    depth_to_normals,
    integrate_normals,
    render_normals,
    swap_opencv_frame,
)


@pytest.mark.parametrize("camera", [Camera.orthographic(1.2), Camera.perspective(0.8, (0.4, 0.2, 3.0))], ids=["o", "p"])
def test_a_rendered_sphere(camera: Camera) -> None:
    ball = trimesh.creation.icosphere(5)
    seen = render_normals(torch.tensor(ball.vertices), torch.tensor(ball.faces), camera, (128, 160))
    found = depth_to_normals(seen.depth, camera=camera)
    inner = seen.normal[:, 2:] > 0.3
    assert angular_error(found, seen.normal, inner).summary()["median"] < 0.4
    assert (found[~seen.mask.expand_as(found)] == 0).all()
    assert depth_to_normals(seen.depth[0], camera=camera).shape == (3, 128, 160)


def test_planes_are_exact_to_the_edge_of_a_ragged_mask() -> None:
    generator = torch.Generator().manual_seed(0)
    row, column = torch.meshgrid(torch.arange(20.0), torch.arange(30.0), indexing="ij")
    height = (0.5 * column - 0.25 * row)[None].double()
    mask = torch.rand(1, 20, 30, generator=generator) > 0.2
    height[~mask] = torch.nan
    found = depth_to_normals(height)
    wanted = torch.nn.functional.normalize(torch.tensor([-0.5, -0.25, 1.0]).double(), dim=0)
    there = found.norm(dim=0) > 0
    assert torch.allclose(found[:, there], wanted[:, None].expand(-1, int(there.sum())), atol=1e-12)
    assert not (there & ~mask[0]).any()
    alone = ~there & mask[0]
    for r, c in alone.nonzero().tolist():
        beside = [mask[0, r, k] for k in (c - 1, c + 1) if 0 <= k < 30]
        above = [mask[0, k, c] for k in (r - 1, r + 1) if 0 <= k < 20]
        assert not any(beside) or not any(above)


def test_the_way_back_from_integration() -> None:
    row, column = torch.meshgrid(torch.linspace(-1, 1, 60), torch.linspace(-1, 1, 60), indexing="ij")
    height = (8 * torch.cos(2 * column) * torch.sin(1.5 * row + 0.3))[None].double()
    normal = depth_to_normals(height)
    again = depth_to_normals(integrate_normals(normal, torch.ones(1, 60, 60, dtype=torch.bool)))
    assert angular_error(again, normal, torch.ones(1, 60, 60, dtype=torch.bool)).summary()["mean"] < 0.3


@pytest.mark.parametrize("camera", [Camera.orthographic(1.2), Camera.perspective(0.8)], ids=["o", "p"])
def test_the_way_back_through_a_camera(camera: Camera) -> None:
    ball = trimesh.creation.icosphere(4)
    seen = render_normals(torch.tensor(ball.vertices), torch.tensor(ball.faces), camera, (60, 60))
    inner = seen.mask[0] & (seen.normal[0, 2:] > 0.4)
    again = depth_to_normals(integrate_normals(seen.normal[0], inner, camera=camera), mask=inner, camera=camera)
    assert angular_error(again, seen.normal[0], inner).summary()["mean"] < 1.5


@pytest.mark.parametrize("scale", [1e-20, 1e20])
def test_units_do_not_matter(scale: float) -> None:
    depth = (3 + torch.rand(1, 1, 5, 5, generator=torch.Generator().manual_seed(0))) * scale
    found = depth_to_normals(depth, camera=Camera.perspective(0.8))
    assert torch.allclose(found.norm(dim=1), torch.ones(1, 5, 5))


def test_kornia_agrees_inside() -> None:
    camera = Camera.perspective(0.9)
    row, column = torch.meshgrid(torch.linspace(-1, 1, 40), torch.linspace(-1, 1, 50), indexing="ij")
    depth = (3 + 0.2 * torch.cos(2 * column + row))[None, None]
    theirs = swap_opencv_frame(kornia_normals(depth, camera.to_kornia((40, 50)).intrinsics[:, :3, :3]))
    theirs = theirs * theirs[:, 2:].sign()
    ours = depth_to_normals(depth, camera=camera)
    inner = torch.zeros(1, 1, 40, 50, dtype=torch.bool)
    inner[..., 2:-2, 2:-2] = True
    assert angular_error(ours, theirs, inner).summary()["mean"] < 0.1


@pytest.mark.parametrize("camera", [None, Camera.perspective(0.9)])
def test_gradients(camera: Camera | None) -> None:
    depth = 3 + 0.2 * torch.rand(1, 1, 4, 5, generator=torch.Generator().manual_seed(0)).double()
    mask = torch.ones(1, 1, 4, 5, dtype=torch.bool)
    mask[..., 1, 2] = False
    assert gradcheck(lambda d: depth_to_normals(d, mask=mask, camera=camera), (depth.requires_grad_(),))
    hole = torch.where(mask, depth.detach(), torch.inf).requires_grad_()
    depth_to_normals(hole, camera=camera).sum().backward()
    assert hole.grad is not None
    assert hole.grad.isfinite().all()


def test_shapes() -> None:
    with pytest.raises(ShapeError, match="depth"):
        depth_to_normals(torch.zeros(4, 5))
    with pytest.raises(ShapeError, match="mask"):
        depth_to_normals(torch.zeros(1, 4, 5), mask=torch.ones(1, 4, 4, dtype=torch.bool))
    with pytest.raises(ShapeError, match="mask"):
        depth_to_normals(torch.zeros(1, 4, 5), mask=torch.ones(1, 4, 5))
    with pytest.raises(ShapeError, match="camera"):
        depth_to_normals(torch.zeros(1, 4, 5), camera=Camera.orthographic(torch.ones(3)))
    assert (depth_to_normals(torch.zeros(1, 1, 1)) == 0).all()
