"""Lights that nobody measured: found where the photographs show them, refused or doubted where they do not."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from tests.support import rendered_captures
from tests.support.objects import findings
from torch_orennayar import (
    CaptureError,
    OrenNayar,
    angular_error,
    find_lights,
    load_capture,
    photometric_stereo,
)
from torch_orennayar.geometry.primitives import Ball, spiral_lights
from torch_orennayar.stereo.surface_rotation import SmoothNormals, rotation_to_surface


def degrees(one: Tensor, other: Tensor) -> float:
    return float(torch.rad2deg(torch.acos((one.double() * other.double()).sum(1).clamp(-1, 1))).mean())


@pytest.fixture(scope="module")
def ball() -> tuple[Tensor, Tensor]:
    return Ball(31.5, 31.5, 29.0).normals((64, 64))


@pytest.mark.parametrize("count", [6, 12, 24])
def test_lights_of_a_lambertian_ball(ball: tuple[Tensor, Tensor], count: int) -> None:
    normal, mask = ball
    lights = spiral_lights(count)
    images = OrenNayar("lambert")(normal[None], lights[None], albedo=0.6)[0]
    found = find_lights(images, mask)
    assert degrees(found.directions, lights) < 1.5
    assert found.brightness.mean().item() == pytest.approx(1)
    assert [f.code for f in found.findings] == ["lights-found"]
    assert found.uncertainty < 1.5
    beyond = torch.where(mask, images, torch.nan)  # outside the mask images may hold any values
    assert torch.equal(find_lights(beyond, mask).directions, found.directions)
    solved = photometric_stereo(images, None, mask, model="lambert")
    assert solved.lights is not None
    assert torch.equal(solved.lights, found.directions)
    assert angular_error(solved.normal, normal, mask).summary()["mean"] < 1.5
    assert len(findings(solved, "lights-found")) == 1
    batch = photometric_stereo(torch.stack((images, images)), None, torch.stack((mask, mask)), model="lambert")
    assert batch.lights is not None
    assert torch.equal(batch.lights[1], found.directions)


@pytest.mark.parametrize("name", ["bumps", "balls"])
@pytest.mark.filterwarnings("ignore:the lights of halves of the object differ")
@pytest.mark.slow
def test_lights_of_rough_objects_with_shadows(meshes: dict[str, tuple[Tensor, Tensor]], name: str) -> None:
    surface = rendered_captures.Surface("vcavity", 30, 0.6)
    scene = rendered_captures.capture(meshes[name], surface, lights=24, size=96)
    found = find_lights(scene.images, scene.mask)
    assert degrees(found.directions, scene.lights) < 3.5


@pytest.mark.filterwarnings("ignore:the lights of halves of the object differ")
@pytest.mark.parametrize(("name", "bar"), [("ball", 2.0), ("cat", 2.6)])
@pytest.mark.slow
def test_lights_of_real_objects(data: Path, name: str, bar: float) -> None:
    """Measured 1.8 and 2.5 degrees; with unequal lights the doubt is said."""
    capture = load_capture(data / "diligent" / f"{name}PNG")
    found = find_lights(capture.images, capture.mask)
    assert degrees(found.directions, capture.lights) < bar
    assert found.uncertainty < bar
    if name == "cat":
        raw = capture.images * capture.intensities[:, :, None, None]
        with pytest.warns(UserWarning, match="not equally bright"):
            assert "lights-unequal" in {f.code for f in find_lights(raw, capture.mask).findings}


def test_what_does_not_show_its_lights_is_refused(ball: tuple[Tensor, Tensor]) -> None:
    normal, mask = ball
    few = OrenNayar("lambert")(normal[None], spiral_lights(5)[None], albedo=0.6)[0]
    with pytest.raises(CaptureError, match="at least 6"):
        find_lights(few, mask)
    images = OrenNayar("lambert")(normal[None], spiral_lights(12)[None], albedo=0.6)[0]
    with pytest.raises(CaptureError, match="border cuts"):
        find_lights(images, torch.ones_like(mask))
    with pytest.raises(CaptureError, match="border cuts"):
        find_lights(images[:, :, :, 20:40], mask[:, :, 20:40])
    turned = torch.arange(12) * math.pi / 6
    ring = F.normalize(torch.stack((turned.cos(), turned.sin(), torch.ones(12)), 1), dim=1)
    on_a_ring = OrenNayar("lambert")(normal[None], ring[None], albedo=0.6)[0]
    with pytest.raises(CaptureError, match="on one ring"):
        find_lights(on_a_ring, mask)


@pytest.mark.parametrize("seed", range(3))
def test_a_turned_surface_is_turned_back(seed: int) -> None:
    """Normals of waves, turned by up to ten degrees about any axis."""
    size = 60
    row, column = torch.meshgrid(torch.arange(size).double(), torch.arange(size).double(), indexing="ij")
    right, down = torch.cos(column / 7) * torch.cos(row / 9), -torch.sin(column / 7) * torch.sin(row / 9) * 7 / 9
    normal = F.normalize(torch.stack((-right, down, torch.ones_like(right))), dim=0).flatten(1).T
    axis = 0.1 * torch.randn(3, generator=torch.Generator().manual_seed(seed)).double()
    x, y, z = axis.tolist()
    turn = torch.linalg.matrix_exp(torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]]).double())
    inside = torch.ones(size, size, dtype=torch.bool)
    found = rotation_to_surface(SmoothNormals.of(normal @ turn, inside))
    assert torch.allclose(turn @ found, torch.eye(3).double(), atol=0.02)
    few = torch.ones(3, 3, dtype=torch.bool)
    assert torch.equal(rotation_to_surface(SmoothNormals.of(normal[:9], few)), torch.eye(3).double())
