from __future__ import annotations

import pytest
import torch
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from torch_orennayar import (
    Camera,
    RangeError,
    ShapeError,
    normalise_mesh,
    render_normals,
    vertex_normals,
)
from torch_orennayar.geometry.mesh import depth_to_mesh


@given(st.integers(0, 100), st.floats(0.01, 1000))
def test_normalised_meshes_fit_the_unit_sphere(seed: int, scale: float) -> None:
    cloud = torch.randn(20, 3, generator=torch.Generator().manual_seed(seed)) * scale + scale
    placed = normalise_mesh(cloud)
    assert placed.norm(dim=1).max() <= 1 + 1e-4
    assert torch.allclose(placed.amin(0), -placed.amax(0), atol=1e-4)


def test_only_a_single_mesh_can_be_normalised() -> None:
    for vertices in (torch.zeros(2, 5, 3), torch.zeros(0, 3), torch.zeros(4, 2), torch.zeros(4, 3).long()):
        with pytest.raises(ShapeError, match="vertices"):
            normalise_mesh(vertices)


def test_depth_to_mesh_renders_back() -> None:
    """A depth map made a mesh and drawn by the same camera gives the depth again."""
    camera, pixel = Camera.orthographic(1.2), 2 * 1.2 / 48
    ball = trimesh.creation.icosphere(4)
    seen = render_normals(torch.tensor(ball.vertices).float(), torch.tensor(ball.faces), camera, (48, 48))
    vertices, faces, pixels = depth_to_mesh(torch.where(seen.mask, -seen.depth / pixel, 0.0)[0], seen.mask[0])
    assert len(pixels) == len(vertices) == int(seen.mask.sum())
    identity = Camera(torch.eye(3)[None], torch.zeros(1, 3), camera.focal, camera.centre, camera.is_perspective)
    again = render_normals(vertices * pixel, faces, identity, (48, 48))
    both = again.mask & seen.mask
    assert both.sum() > 0.9 * seen.mask.sum()
    assert (again.depth - seen.depth)[both].abs().max() < 1e-3
    flat = vertices[faces]
    normal = torch.linalg.cross(flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0])
    assert (normal[:, 2] > 0).all()


def test_heights_in_pixels_make_a_mesh_in_pixels() -> None:
    mask = torch.ones(1, 2, 3, dtype=torch.bool)
    vertices, faces, _ = depth_to_mesh(torch.arange(6.0).reshape(1, 2, 3), mask)
    assert vertices[0].tolist() == [-1.0, 0.5, 0.0]
    assert vertices[5].tolist() == [1.0, -0.5, 5.0]
    assert len(faces) == 4


def test_vertex_normals_are_exact_on_a_sphere_however_it_is_cut() -> None:
    """Points in irregular places; weights by angle would err."""
    points = torch.nn.functional.normalize(
        torch.randn(400, 3, generator=torch.Generator().manual_seed(0)).double(), dim=1
    )
    hull = trimesh.convex.convex_hull(points.numpy())
    vertices, faces = torch.tensor(hull.vertices), torch.tensor(hull.faces)
    if hull.volume < 0:
        faces = faces.flip(1)
    for scale in (1e-6, 1.0, 1e6):
        normals = vertex_normals(vertices * scale, faces)
        assert torch.allclose(normals, vertices, atol=1e-9)
    assert torch.allclose(
        vertex_normals(torch.stack((vertices, -vertices)), faces)[1], vertices, atol=1e-9
    )  # inside out


def test_vertices_without_area_have_no_normal_and_finite_gradients() -> None:
    vertices = torch.tensor([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 0, 0]], requires_grad=True)
    normals = vertex_normals(vertices, torch.tensor([[0, 1, 2], [0, 3, 1], [1, 1, 1]]))
    assert (normals == 0).all()
    normals.sum().backward()
    assert vertices.grad is not None
    assert vertices.grad.isfinite().all()


@pytest.mark.parametrize(
    ("vertices", "faces", "error"),
    [
        (torch.eye(3), torch.tensor([[0, 1, 3]]), RangeError),
        (torch.eye(3), torch.tensor([[0, 1, 2, 2]]), ShapeError),
        (torch.eye(3)[:, :2], torch.tensor([[0, 1, 2]]), ShapeError),
        (torch.eye(3).long(), torch.tensor([[0, 1, 2]]), ShapeError),
    ],
)
def test_normals_of_what_is_no_mesh(vertices: torch.Tensor, faces: torch.Tensor, error: type[Exception]) -> None:
    with pytest.raises(error):
        vertex_normals(vertices, faces)
