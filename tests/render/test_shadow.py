from __future__ import annotations

import math

import pytest
import torch
import torch.nn.functional as F
import trimesh

from torch_orennayar import Camera, RangeError, ShapeError, cast_shadows, render_normals
from torch_orennayar.geometry.primitives import spiral_lights


@pytest.mark.slow
def test_shadows_are_those_of_rays() -> None:
    """Two balls over a floor against rays traced by trimesh; pixels whose neighbours differ are left out."""
    parts = [
        trimesh.creation.icosphere(subdivisions=3, radius=0.35).apply_translation((-0.3, 0.1, 0.3)),
        trimesh.creation.icosphere(subdivisions=3, radius=0.2).apply_translation((0.4, -0.3, 0.5)),
        trimesh.creation.box((1.8, 1.8, 0.1)),
    ]
    mesh = trimesh.util.concatenate(parts)
    vertices, faces = torch.tensor(mesh.vertices, dtype=torch.float32), torch.tensor(mesh.faces)
    camera = Camera.orthographic(1.0, eye=(0.5, 0.4, 3.0))
    seen = render_normals(vertices, faces, camera, (40, 40), smooth=False)
    lights = spiral_lights(4, math.radians(60))
    reached = cast_shadows(vertices, faces, seen, lights)
    mask = seen.mask[0, 0]
    world = camera.points(torch.where(seen.mask, seen.depth, 0.0))[0][:, mask].T @ camera.rotation[0] + camera.eye[0]
    normal = seen.normal[0][:, mask].T
    for index, light in enumerate(lights):
        toward = light @ camera.rotation[0]
        origins = world + 1e-3 * (normal @ camera.rotation[0]) + 1e-3 * toward
        blocked = torch.from_numpy(mesh.ray.intersects_any(origins.numpy(), toward.expand_as(origins).numpy()))
        found = reached[index, 0][mask]
        facing = normal @ light > 0.15
        clear = ((found < 0.02) | (found > 0.98)) & facing
        assert clear.sum() > 0.85 * facing.sum()
        wrong = ((found > 0.5) == blocked)[clear]
        assert wrong.float().mean() < 0.01
        assert blocked[clear].any()


def test_nothing_shades_a_ball() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4)
    vertices, faces = torch.tensor(ball.vertices, dtype=torch.float32), torch.tensor(ball.faces)
    seen = render_normals(vertices, faces, Camera.orthographic(1.1), (64, 64))
    reached = cast_shadows(vertices, faces, seen, spiral_lights(5))
    assert reached.min() > 0.9
    assert (reached[:, :, ~seen.mask[0, 0]] == 1).all()


def test_bad_input() -> None:
    ball = trimesh.creation.icosphere(subdivisions=1)
    vertices, faces = torch.tensor(ball.vertices, dtype=torch.float32), torch.tensor(ball.faces)
    seen = render_normals(vertices, faces, Camera.orthographic(1.1), (8, 8))
    with pytest.raises(ShapeError, match="lights"):
        cast_shadows(vertices, faces, seen, torch.tensor([0.0, 0.0, 1.0]))
    with pytest.raises(RangeError, match="unit"):
        cast_shadows(vertices, faces, seen, torch.tensor([[0.0, 0.0, 2.0]]))
    two = render_normals(torch.stack((vertices, vertices)), faces, Camera.orthographic(1.1), (8, 8))
    with pytest.raises(ShapeError, match="one view"):
        cast_shadows(vertices, faces, two, F.normalize(torch.rand(2, 3), dim=1))
