"""Shapes and light arrangements against analytic geometry."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torch_orennayar import face_neighbours
from torch_orennayar.geometry.primitives import Ball, bumpy_ball, spiral_lights


@given(
    x=st.floats(-4, 20),
    y=st.floats(-4, 16),
    radius=st.floats(0.3, 12),
    height=st.integers(1, 14),
    width=st.integers(1, 18),
)
def test_ball_normals_are_those_of_an_intersected_sphere(
    x: float, y: float, radius: float, height: int, width: int
) -> None:
    """Every pixel's line of sight is intersected with a sphere in space: x right, y up, z toward the viewer."""
    normal, mask = Ball(x, y, radius).normals((height, width))
    assert normal.shape == (3, height, width)
    assert mask.shape == (1, height, width)
    assert mask.dtype == torch.bool
    for row in range(height):
        for column in range(width):
            away = math.hypot(column - x, row - y)
            if abs(away - radius) < 1e-4:  # rounding decides whether the centre is inside
                continue
            found = normal[:, row, column].tolist()
            assert mask[0, row, column].item() == (away < radius)
            if away > radius:
                assert found == [0, 0, 0]
                continue
            point = (column, -row, math.sqrt(radius**2 - away**2))  # the sphere's centre is at (x, -y, 0)
            wanted = [(p - c) / radius for p, c in zip(point, (x, -y, 0.0), strict=True)]
            assert found == pytest.approx(wanted, abs=2e-3)  # the slope of z is infinite at the outline
            assert math.hypot(*found) == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("degrees", [10, 60, 90])
@pytest.mark.parametrize("count", [1, 7, 400])
def test_spiral_lights_are_unit_directions_inside_the_cone(count: int, degrees: float) -> None:
    lights = spiral_lights(count, math.radians(degrees)).double()
    assert lights.shape == (count, 3)
    assert torch.allclose(lights.norm(dim=1), torch.ones(count).double(), atol=1e-6)
    assert lights[:, 2].min() > math.cos(math.radians(degrees))
    assert (lights[:, 2].diff() < 0).all()  # from the axis outwards


@pytest.mark.parametrize("degrees", [20, 60, 90])
def test_spiral_lights_are_spread_evenly(degrees: float) -> None:
    """Equal areas hold equal numbers, all around the axis, and no two directions are close."""
    count, cap = 600, 1 - math.cos(math.radians(degrees))
    lights = spiral_lights(count, math.radians(degrees)).double()
    for share in (0.1, 0.35, 0.8):  # a smaller cone that has this share of the area
        assert (lights[:, 2] > 1 - share * cap).sum().item() == pytest.approx(share * count, abs=1)
    sectors = torch.atan2(lights[:, 1], lights[:, 0]).add(math.pi).div(math.pi / 4).long().clamp(0, 7)
    assert (torch.bincount(sectors, minlength=8) - count / 8).abs().max() <= 6
    nearest = torch.cdist(lights, lights).fill_diagonal_(math.inf).amin(1)
    spacing = math.sqrt(2 * math.pi * cap / count * 2 / math.sqrt(3))  # that of a hexagonal lattice
    assert nearest.min() > 0.7 * spacing
    assert nearest.max() < 1.1 * spacing


def test_bumpy_ball_is_closed_and_outward() -> None:
    vertices, faces = bumpy_ball()
    assert (face_neighbours(faces) >= 0).all()  # two faces at every edge, which run through it in opposite directions
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).sort(1).values.unique(dim=0)
    assert len(vertices) - len(edges) + len(faces) == 2  # Euler: a sphere's topology
    assert torch.equal(faces.unique(), torch.arange(len(vertices)))
    a, b, c = vertices.double()[faces].unbind(1)
    outward = (torch.linalg.cross(b - a, c - a) * (a + b + c)).sum(1)
    assert (outward > 0).all()  # seen from the origin, every face shows its back
    volume = (torch.linalg.cross(a, b) * c).sum(1).sum().item() / 6
    radius = vertices.norm(dim=1)
    assert radius.min() >= 0.81
    assert radius.max() <= 1.0001
    assert 4 / 3 * math.pi * radius.min() ** 3 < volume < 4 / 3 * math.pi * radius.max() ** 3
