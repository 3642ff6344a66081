from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torch_orennayar import Camera, RangeError, ShapeError, render_normals, swap_opencv_frame

coordinate = st.floats(-5, 5)
point = st.tuples(coordinate, coordinate, coordinate)


def pixel(camera: Camera, world: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    image = camera.to_image(camera.to_camera_frame(world[None]), size)[0]
    return image[:, :2] / image[:, 2:]


def test_default_orthographic_camera_looks_from_plus_z_with_y_up() -> None:
    world = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    wanted = torch.tensor([[30.0, 20], [50, 20], [30, 0], [30, 20]])
    assert torch.allclose(pixel(Camera.orthographic(), world, (40, 60)), wanted)
    depth = -Camera.orthographic().to_camera_frame(world)[0, :, 2]
    assert depth.tolist() == [2, 2, 2, 1]


def test_perspective_fills_its_field_of_view() -> None:
    camera = Camera.perspective(math.radians(60), eye=(0, 0, 3))
    top = torch.tensor([[0, 3 * math.tan(math.radians(30)), 0]])
    assert torch.allclose(pixel(camera, top, (40, 60)), torch.tensor([[30.0, 0]]), atol=1e-5)


@given(eye=point, target=point)
@pytest.mark.slow
def test_rotation_is_a_rotation_that_looks_at_the_target(eye: tuple[float, ...], target: tuple[float, ...]) -> None:
    e, t = (torch.tensor(p, dtype=torch.float64) for p in (eye, target))
    try:
        camera = Camera.perspective(1.0, e, t)
    except RangeError:
        assert torch.linalg.cross(torch.tensor([0.0, 1, 0]).double(), e - t).norm() <= 1e-5 * (e - t).norm()
        return
    rotation = camera.rotation[0]
    assert torch.allclose(rotation @ rotation.T, torch.eye(3).double(), atol=1e-9)
    assert torch.linalg.det(rotation).item() == pytest.approx(1, abs=1e-9)
    seen = camera.to_camera_frame(t[None])[0, 0]
    assert torch.allclose(seen, torch.tensor([0, 0, -(e - t).norm().item()]).double(), atol=1e-6)


@pytest.mark.parametrize("perspective", [False, True])
def test_points_invert_the_projection(perspective: bool) -> None:
    camera = Camera.perspective(0.8, (1, 2, 3)) if perspective else Camera.orthographic(1.5, (1, 2, 3))
    depth = torch.rand(1, 1, 6, 8) + 2
    points = camera.points(depth)[0].flatten(1).T
    image = camera.to_image(points[None], (6, 8))[0]
    row, column = torch.meshgrid(torch.arange(6) + 0.5, torch.arange(8) + 0.5, indexing="ij")
    assert torch.allclose(image[:, 0] / image[:, 2], column.flatten(), atol=1e-4)
    assert torch.allclose(image[:, 1] / image[:, 2], row.flatten(), atol=1e-4)
    assert torch.allclose(-points[:, 2], depth.flatten())


def test_view_directions_point_to_the_camera() -> None:
    camera = Camera.perspective(1.2)
    view, points = camera.view_directions((5, 7)), camera.points(torch.ones(1, 1, 5, 7))
    assert torch.allclose(view, -points / points.norm(dim=1, keepdim=True), atol=1e-6)
    assert torch.equal(Camera.orthographic().view_directions((2, 2))[0, :, 0, 0], torch.tensor([0.0, 0, 1]))


def test_intrinsics_put_a_pixel_centre_at_integer_coordinates() -> None:
    k = torch.tensor([[500.0, 0, 31.0], [0, 480.0, 22.0], [0, 0, 1]])
    camera = Camera.from_intrinsics(k, (48, 64))
    on_axis = pixel(camera, torch.tensor([[0.0, 0, 2]]), (48, 64))  # the OpenCV camera looks along +z
    assert torch.allclose(on_axis, torch.tensor([[31.5, 22.5]]), atol=1e-4)
    below_right = pixel(camera, torch.tensor([[0.02, 0.02, 2.0]]), (48, 64))
    assert torch.allclose(below_right, torch.tensor([[36.5, 27.3]]), atol=1e-3)
    half = pixel(camera, torch.tensor([[0.0, 0, 2]]), (24, 32))
    assert torch.allclose(half, torch.tensor([[15.75, 11.25]]), atol=1e-4)
    with pytest.raises(ShapeError, match="aspect"):
        camera.rays((48, 48))


def test_kornia_projects_to_the_same_pixels() -> None:
    camera = Camera.perspective(0.9, (1.0, 0.5, 3.0))
    world = torch.randn(20, 3, generator=torch.Generator().manual_seed(0)) * 0.5
    theirs = camera.to_kornia((40, 60)).project(world)
    assert torch.allclose(theirs + 0.5, pixel(camera, world, (40, 60)), atol=1e-3)
    again = Camera.from_kornia(camera.to_kornia((40, 60)))
    assert torch.allclose(again.rotation, camera.rotation, atol=1e-6)
    assert torch.allclose(again.eye, camera.eye, atol=1e-5)
    with pytest.raises(RangeError, match="perspective"):
        Camera.orthographic().to_kornia((4, 4))


@given(point)
def test_opencv_frame_round_trip(vector: tuple[float, ...]) -> None:
    v = torch.tensor(vector).reshape(1, 3, 1, 1)
    assert torch.equal(swap_opencv_frame(swap_opencv_frame(v)), v)
    assert swap_opencv_frame(v).flatten()[1] == -v.flatten()[1]


def test_batches() -> None:
    eyes = torch.tensor([[0.0, 0, 3], [3, 0, 0]])
    assert Camera.perspective(1.0, eyes).rotation.shape == (2, 3, 3)
    assert Camera.orthographic(torch.tensor([1.0, 2.0, 3.0])).eye.shape == (3, 3)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Camera.perspective(60.0),
        lambda: Camera.perspective(1.0, near=0.0),
        lambda: Camera.orthographic(-1.0),
        lambda: Camera.orthographic(math.inf),
        lambda: Camera.orthographic(1.0, (0, 0, math.nan)),
        lambda: Camera.from_intrinsics(torch.tensor([[1.0, 0, 0], [0, 1, 0], [3, 4, 1]]), (4, 4)),
        lambda: Camera.orthographic(1.0, (0, 0, 0), (0, 0, 0)),
        lambda: Camera.orthographic(1.0, (0, 3, 0)),
        lambda: Camera.from_intrinsics(torch.tensor([[1.0, 0.5, 0], [0, 1, 0], [0, 0, 1]]), (4, 4)),
    ],
)
def test_cameras_that_cannot_be(make: object) -> None:
    with pytest.raises(RangeError):
        make()  # type: ignore[operator]


K = torch.tensor([[100.0, 0, 49.5], [0, 100.0, 49.5], [0, 0, 1]])


def pose(turn: torch.Tensor, last: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)) -> torch.Tensor:
    return torch.cat((torch.cat((turn, torch.tensor([[0.1], [0.2], [3.0]])), 1), torch.tensor([last])))


@pytest.mark.parametrize(
    ("extrinsics", "words"),
    [
        (pose(2 * torch.eye(3)), "differs from 1 by 3"),
        (pose(torch.diag(torch.tensor([1.0, 1, -1]))), "mirrored"),
        (pose(torch.eye(3).fill_diagonal_(math.nan)), "finite"),
        (pose(torch.eye(3)).T, "last row|finite"),
        (pose(torch.tensor([[1.0, 0.1, 0], [0, 1, 0], [0, 0, 1]])), "differs from 1"),
    ],
)
def test_extrinsics_that_are_no_pose(extrinsics: torch.Tensor, words: str) -> None:
    with pytest.raises(RangeError, match=words):
        Camera.from_intrinsics(K, (100, 100), extrinsics)


def test_rounded_matrices_are_taken() -> None:
    turn = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(0)))[0]
    turn = turn * torch.linalg.det(turn)
    exact, rounded = (Camera.from_intrinsics(K, (100, 100), pose(t)) for t in (turn, (turn * 1e4).round() / 1e4))
    assert torch.allclose(exact.rotation, rounded.rotation, atol=1e-4)
    skewed = K.clone()
    skewed[0, 1], skewed[2, 2] = 1e-9, 1 + 1e-7
    Camera.from_intrinsics(skewed, (100, 100))


@pytest.mark.parametrize(("near", "told"), [(5.0, True), (0.01, False)])
def test_an_empty_picture_says_that_all_lies_before_the_near_plane(near: float, told: bool) -> None:
    triangle = torch.tensor([[-1.0, -1, 0], [3, -1, 0], [-1, 3, 0]])
    faces, camera = torch.tensor([[0, 1, 2]]), Camera.perspective(0.6, eye=(0, 0, 4), near=near)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        seen = render_normals(triangle, faces, camera, (8, np.int64(8)))
        aside = render_normals(triangle + 100, faces, camera, (8, 8))
    assert bool(seen.mask.any()) != told
    assert not aside.mask.any()
    assert [("smaller near=" in str(w.message)) for w in caught] == [True] * told
