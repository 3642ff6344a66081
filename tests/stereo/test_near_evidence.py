"""Near lights that are solved as distant ones are noticed; distant ones are not taken for near."""

from __future__ import annotations

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from tests.support import rendered_captures
from tests.support.objects import findings
from torch_orennayar import photometric_stereo

COUNT, SIZE = 12, 64


def wavy_table(distance: float) -> tuple[Tensor, Tensor, Tensor]:
    """Photographs of a low relief under a ring of lamps at so many of its sizes, directions to these, true normals."""
    across = (torch.arange(SIZE) - (SIZE - 1) / 2) / SIZE
    x, y = across[None].expand(SIZE, SIZE), -across[:, None].expand(SIZE, SIZE)
    normal = F.normalize(torch.stack((0.4 * torch.cos(25 * x), 0.4 * torch.sin(20 * y), torch.ones_like(x))), dim=0)
    turned = torch.arange(COUNT) * 2 * torch.pi / COUNT
    light = F.normalize(torch.stack((turned.cos(), turned.sin(), torch.full_like(turned, 1.4)), 1), dim=1)
    toward = distance * light[:, :, None, None] - torch.stack((x, y, torch.zeros_like(x)))
    length = toward.norm(dim=1, keepdim=True)
    cosine = (normal * toward / length).sum(1, keepdim=True).clamp_min(0)
    noise = torch.randn(COUNT, 1, SIZE, SIZE, generator=torch.Generator().manual_seed(0))
    return (0.5 * cosine * (distance / length) ** 2 * (1 + 0.01 * noise)), light, normal


@pytest.mark.parametrize("distance", [2.0, 3.0])
def test_near_lamps_are_noticed(distance: float) -> None:
    images, light, _ = wavy_table(distance)
    with pytest.warns(UserWarning, match="the surface found is bent"):
        found = photometric_stereo(images, light, model="lambert")
    (finding,) = findings(found, "lights-near")
    assert finding.value == pytest.approx(distance, abs=1)


@pytest.mark.parametrize("distance", [20.0, 1e6])
def test_lamps_far_away_are_distant(distance: float) -> None:
    images, light, _ = wavy_table(distance)
    assert not findings(photometric_stereo(images, light, model="lambert"), "lights-near")


@pytest.mark.parametrize("surface", ["satin_white", "spectralon", "alum-bronze"])
@pytest.mark.slow
def test_other_materials_are_not_taken_for_near_lamps(meshes: dict[str, tuple[Tensor, Tensor]], surface: str) -> None:
    scene = rendered_captures.capture(meshes["bumps"], rendered_captures.MATERIALS[surface], lights=16, size=64)
    found = photometric_stereo(scene.images, scene.lights, scene.mask, model="lambert")
    assert not findings(found, "lights-near")
