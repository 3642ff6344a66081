from __future__ import annotations

import math

import pytest
import torch

from torch_orennayar.render.radiosity import BOUNCES, bounced_light


def bowl(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Points spread evenly in the lower half of the unit sphere, and normals that look inward."""
    generator = torch.Generator().manual_seed(0)
    z, turn = -torch.rand(count, generator=generator), 2 * math.pi * torch.rand(count, generator=generator)
    flat = (1 - z * z).sqrt()
    points = torch.stack((flat * turn.cos(), flat * turn.sin(), z), 1).double()
    return points, -points


@pytest.mark.parametrize("albedo", [0.2, 0.9])
def test_an_evenly_lit_bowl(albedo: float) -> None:
    """In a sphere every part sends every other the same, so in half of one each bounce keeps half the albedo."""
    points, normal = bowl(3000)
    area = torch.full((3000, 1), 2 * math.pi / 3000, dtype=torch.float64)
    arriving = bounced_light(points, normal, area, torch.full((3000, 1), albedo).double(), torch.ones(3000, 2).double())
    assert arriving.shape == (3000, 1, 2)
    wanted = sum((albedo / 2) ** k for k in range(1, BOUNCES + 1))
    assert abs(arriving.mean() / wanted - 1) < 0.03
    assert arriving.std() < 0.1 * arriving.mean()


def test_nothing_arrives_on_the_outside_of_a_ball() -> None:
    points, normal = bowl(500)
    area = torch.full((500, 1), 0.01, dtype=torch.float64)
    assert bounced_light(points, -normal, area, torch.ones(500, 3).double(), torch.ones(500, 1).double()).max() == 0


def test_two_small_patches_face_to_face() -> None:
    """At distance d, area a: albedo a / (pi d^2 + a), from the disc's formula on its axis."""
    points = torch.tensor([[0.0, 0, 0], [0, 0, 2]])
    normal = torch.tensor([[0.0, 0, 1], [0, 0, -1]])
    area = torch.tensor([[0.1], [0.3]])
    arriving = bounced_light(points, normal, area, torch.tensor([[0.0], [0.5]]), torch.tensor([[0.0], [1.0]]))
    assert abs(arriving[0, 0, 0] - 0.5 * 0.3 / (math.pi * 4 + 0.3)) < 1e-6
    assert arriving[1, 0, 0] == 0
