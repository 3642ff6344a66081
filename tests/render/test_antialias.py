from __future__ import annotations

import math

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import ConvexHull
from torch import Tensor
from torch.autograd import gradcheck

from torch_orennayar import Camera, RangeError, ShapeError, antialias, face_neighbours, render_normals


def polygon(corners: int, radius: float, turn: float) -> tuple[Tensor, Tensor]:
    """A flat fan around the origin."""
    angle = torch.arange(corners).double() * 2 * math.pi / corners + turn
    rim = torch.stack((angle.cos() * radius, angle.sin() * radius, angle * 0), 1)
    faces = [[k, (k + 1) % corners, corners] for k in range(corners)]
    return torch.cat((rim, torch.zeros(1, 3).double())), torch.tensor(faces)


def tumbled(subdivisions: int, scale: float = 0.7) -> tuple[Tensor, Tensor]:
    ball = trimesh.creation.icosphere(subdivisions, radius=scale)
    ball.apply_transform(trimesh.transformations.random_rotation_matrix(np.array([0.1, 0.5, 0.3])))
    return torch.tensor(ball.vertices), torch.tensor(ball.faces)


def soft_mask(vertices: Tensor, faces: Tensor, camera: Camera, size: tuple[int, int]) -> Tensor:
    seen = render_normals(vertices, faces, camera, size)
    return antialias(seen.mask.to(vertices), seen, vertices, faces)


def hull_area(vertices: Tensor, camera: Camera, size: tuple[int, int]) -> float:
    """Area in pixels of a convex shape's picture."""
    image = camera.to_image(camera.to_camera_frame(vertices), size)[0]
    return float(ConvexHull((image[:, :2] / image[:, 2:]).numpy()).volume)  # of dimension 2


def test_neighbours_by_brute_force() -> None:
    mesh = trimesh.creation.annulus(0.2, 0.5, 0.3, sections=6)
    faces = torch.tensor(mesh.faces)[:-3]  # with a hole
    edges = [[(int(f[k]), int(f[(k + 1) % 3])) for k in range(3)] for f in faces]
    for face, own in enumerate(edges):
        for k, (a, b) in enumerate(own):
            across = [other for other, theirs in enumerate(edges) if (b, a) in theirs]
            assert face_neighbours(faces)[face, k] == (across[0] if across else -1)
    three = torch.tensor([[0, 1, 2], [1, 0, 3], [1, 0, 4], [5, 6, 7], [5, 6, 8]])
    assert (face_neighbours(three) == -1).all()
    assert face_neighbours(torch.zeros(0, 3, dtype=torch.int64)).shape == (0, 3)


@pytest.mark.parametrize("corners", [3, 4, 5, 40])
@pytest.mark.parametrize("turn", [0.1, 0.4, 0.7])
def test_the_sum_of_a_mask_is_an_area_and_grows_like_one(corners: int, turn: float) -> None:
    vertices, faces = polygon(corners, 0.7, turn)
    vertices.requires_grad_()
    mask = soft_mask(vertices, faces, Camera.orthographic(), (64, 64))
    area = corners / 2 * math.sin(2 * math.pi / corners) * (0.7 * 32) ** 2
    assert mask.sum().item() == pytest.approx(area, abs=0.6)
    (gradient,) = torch.autograd.grad(mask.sum(), vertices)
    assert (gradient * vertices).sum().item() == pytest.approx(2 * area, rel=0.025)


@pytest.mark.parametrize("camera", [Camera.orthographic(), Camera.perspective(0.8, (0.5, 0.4, 2.5))], ids=["o", "p"])
@pytest.mark.parametrize("subdivisions", [1, 3, 5])
def test_the_same_for_a_ball_whose_faces_are_large_or_below_a_pixel(camera: Camera, subdivisions: int) -> None:
    vertices, faces = tumbled(subdivisions)
    wanted = hull_area(vertices, camera, (64, 80))
    vertices.requires_grad_()
    total = soft_mask(vertices, faces, camera, (64, 80)).sum()
    assert total.item() == pytest.approx(wanted, rel=0.002)
    (gradient,) = torch.autograd.grad(total, vertices)
    step = 1e-3
    slope = hull_area(vertices.detach() * (1 + step), camera, (64, 80)) - hull_area(
        vertices.detach() * (1 - step), camera, (64, 80)
    )
    assert (gradient * vertices).sum().item() == pytest.approx(slope / (2 * step), rel=0.04)


@pytest.mark.parametrize(
    "camera", [Camera.orthographic(1.03), Camera.perspective(0.9, (0.2, 0.3, 2.6))], ids=["o", "p"]
)
@pytest.mark.slow
def test_gradients_by_finite_differences(camera: Camera) -> None:
    vertices, faces = tumbled(1)

    def blended(v: Tensor) -> Tensor:
        seen = render_normals(v, faces, camera, (9, 11))
        return antialias(torch.cat((seen.mask.double(), seen.normal), 1), seen, v, faces)

    assert gradcheck(blended, (vertices.requires_grad_(),), eps=1e-7, atol=1e-5)


def test_only_pixels_at_silhouettes_change() -> None:
    """A small square before a large one: its outline and that of the large one, not the seams between faces."""
    square = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    vertices = torch.cat((square * 0.83, square * 0.4 + torch.tensor([0.01, 0.02, 0.5])))
    faces = torch.tensor([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    seen = render_normals(vertices, faces, Camera.orthographic(), (40, 40))
    paint = (seen.face // 2).float()
    changed = antialias(paint, seen, vertices, faces) != paint
    near = torch.nn.functional.max_pool2d(paint, 3, 1, 1) + torch.nn.functional.max_pool2d(-paint, 3, 1, 1)
    assert changed.any()
    assert not (changed & (near == 0)).any()
    normals = antialias(seen.normal, seen, vertices, faces)
    inner = (slice(None), slice(None), slice(8, 32), slice(8, 32))
    assert torch.equal(normals[inner], seen.normal[inner])


@pytest.mark.parametrize("seed", range(6))
def test_a_box_seen_face_on_has_the_area_of_its_front_whatever_the_order_of_faces(seed: int) -> None:
    box = trimesh.creation.box(extents=(0.61, 0.78, 0.7))
    faces = torch.tensor(box.faces)[torch.randperm(12, generator=torch.Generator().manual_seed(seed))]
    vertices = (torch.tensor(box.vertices) + torch.tensor([0.013, 0.007, 0.0])).requires_grad_()
    total = soft_mask(vertices, faces, Camera.orthographic(), (40, 40)).sum()
    assert total.item() == pytest.approx(0.61 * 0.78 * 400, abs=0.2)
    (gradient,) = torch.autograd.grad(total, vertices)
    for axis, wanted in ((0, 0.78 * 400), (1, 0.61 * 400)):  # moving one side outward
        grown = (gradient[:, axis] * (vertices.detach()[:, axis] > 0)).sum().item()
        assert grown == pytest.approx(wanted, rel=0.05)


@pytest.mark.parametrize("offset", [-1e-6, 0.0, 1e-6])
def test_edges_midway_between_centres_have_one_gradient(offset: float) -> None:
    """Round numbers are what people try first."""
    right = torch.tensor(0.5 + offset).double().requires_grad_()
    x, y = torch.stack((-right * 0 - 0.5, right, right, -right * 0 - 0.5)), torch.tensor([-0.5, -0.5, 0.5, 0.5])
    vertices = torch.stack((x, y.double(), x * 0), 1)
    total = soft_mask(vertices, torch.tensor([[0, 1, 2], [0, 2, 3]]), Camera.orthographic(), (16, 16)).sum()
    assert torch.autograd.grad(total, right)[0].item() == pytest.approx(64)


@pytest.mark.parametrize("side", [0.1, 0.3, 0.5, 0.8, 1.3])
def test_shapes_below_a_pixel_stay_in_range(side: float) -> None:
    half = side / 2 / 8
    square = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]).double() * half + 1 / 16
    mask = soft_mask(
        square * torch.tensor([1.0, 1, 0]), torch.tensor([[0, 1, 2], [0, 2, 3]]), Camera.orthographic(), (16, 16)
    )
    assert mask.min() >= 0
    assert mask.max() <= 1 + 1e-9
    if side <= 1:
        assert mask.sum().item() == pytest.approx(side**2, abs=1e-6)


def test_a_batch_is_its_views() -> None:
    vertices, faces = tumbled(2)
    camera = Camera.perspective(0.9, torch.tensor([[0.2, 0.3, 2.6], [2.0, 0.5, 1.0]]).double())
    both = soft_mask(vertices, faces, camera, (20, 20))
    for view in range(2):
        one = soft_mask(vertices, faces, Camera.perspective(0.9, camera.eye[view]), (20, 20))
        assert torch.allclose(both[view], one[0], atol=1e-12)


@pytest.mark.slow
def test_a_shape_moves_and_grows_to_a_target_mask() -> None:
    """From hard masks alone there would be no gradient at all."""
    vertices, faces = tumbled(3, 0.4)
    camera, size = Camera.perspective(0.8), (48, 48)
    target = soft_mask(vertices * 1.4 + torch.tensor([0.25, -0.2, 0.0]), faces, camera, size)
    place, growth = torch.zeros(3).double().requires_grad_(), torch.zeros(1).double().requires_grad_()
    neighbours = face_neighbours(faces)
    optimiser = torch.optim.Adam([place, growth], 0.02)
    for _ in range(120):
        moved = vertices * growth.exp() + place * torch.tensor([1.0, 1.0, 0.0])
        seen = render_normals(moved, faces, camera, size)
        loss = (antialias(seen.mask.double(), seen, moved, faces, neighbours=neighbours) - target).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    assert place[:2].tolist() == pytest.approx([0.25, -0.2], abs=0.005)
    assert growth.exp().item() == pytest.approx(1.4, abs=0.01)


def test_nothing_in_view_and_edges_behind_the_eye() -> None:
    vertices, faces = tumbled(1)
    away = Camera.perspective(0.9, (0.0, 0, -3), (0.0, 0, -4))
    assert (soft_mask(vertices, faces, away, (8, 8)) == 0).all()
    inside = soft_mask(vertices.requires_grad_(), faces, Camera.perspective(1.5, (0.1, 0.2, 0.1)), (8, 8))
    assert (inside == 1).all()
    inside.sum().backward()
    assert vertices.grad is not None
    assert vertices.grad.isfinite().all()


def test_maps_of_another_size_are_refused() -> None:
    vertices, faces = tumbled(1)
    seen = render_normals(vertices, faces, Camera.orthographic(), (8, 8))
    for maps in (torch.zeros(1, 1, 8, 9), seen.mask, seen.face):
        with pytest.raises(ShapeError, match="maps"):
            antialias(maps, seen, vertices, faces)
    mask = seen.mask.double()
    with pytest.raises(RangeError, match="faces"):
        antialias(mask, seen, vertices, faces[:3])
    with pytest.raises(RangeError, match="faces"):
        antialias(mask, seen, vertices[:5], faces)
    with pytest.raises(ShapeError, match="neighbours"):
        antialias(mask, seen, vertices, faces, neighbours=faces[:2])
    with pytest.raises(ShapeError, match="vertices"):
        antialias(mask, seen, vertices.expand(3, -1, -1), faces)
    with pytest.raises(ShapeError, match="faces"):
        face_neighbours(torch.zeros(2, 4, dtype=torch.int64))
