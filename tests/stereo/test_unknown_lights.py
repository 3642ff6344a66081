"""Lights that nobody measured: found where the photographs show them, refused or doubted where they do not."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from tests.support import rendered_captures
from tests.support.objects import degrees_apart, findings
from torch_orennayar import (
    CaptureError,
    OrenNayar,
    RangeError,
    angular_error,
    find_lights,
    load_capture,
    photometric_stereo,
)
from torch_orennayar.geometry.primitives import Ball, spiral_lights
from torch_orennayar.stereo.surface_rotation import rotation_to_surface


@pytest.fixture(scope="module")
def ball() -> tuple[Tensor, Tensor]:
    return Ball(27.5, 27.5, 25.0).normals((56, 56))


@pytest.mark.parametrize("count", [6, pytest.param(12, marks=pytest.mark.slow)])
def test_lights_of_a_lambertian_ball(ball: tuple[Tensor, Tensor], count: int) -> None:
    normal, mask = ball
    lights = spiral_lights(count)
    images = OrenNayar("lambert")(normal[None], lights[None], albedo=0.6)[0]
    found = find_lights(images, mask)
    assert degrees_apart(found.directions, lights).mean() < 1
    assert found.brightness.log().mean().item() == pytest.approx(0, abs=1e-5)
    assert found.brightness.log().std() < 0.02
    assert [f.code for f in found.findings] == ["lights-found"]
    assert 0.5 < found.uncertainty < 5
    beyond = torch.where(mask, images, torch.nan)  # outside the mask images may hold any values
    assert torch.equal(find_lights(beyond, mask).directions, found.directions)
    solved = photometric_stereo(images, None, mask, model="lambert")
    assert solved.lights is not None
    assert torch.equal(solved.lights, found.directions)
    assert solved.intensities is not None
    assert torch.equal(solved.intensities[:, 0], found.brightness)
    assert angular_error(solved.normal, normal, mask).summary()["mean"] < 1.5
    assert len(findings(solved, "lights-found")) == 1
    batch = photometric_stereo(images[None], None, mask[None], model="lambert")
    assert batch.lights is not None
    assert torch.equal(batch.lights[0], found.directions)


@pytest.mark.slow
def test_clipped_samples_say_nothing(ball: tuple[Tensor, Tensor]) -> None:
    normal, mask = ball
    lights = spiral_lights(12)
    images = OrenNayar("lambert")(normal[None], lights[None], albedo=1.0)[0]
    clipped = (1.4 * images).clamp(max=1)
    assert degrees_apart(find_lights(clipped, mask).directions, lights).mean() < 1
    valid = images < 0.6
    spoiled = torch.where(valid, images, 0.6)
    assert degrees_apart(find_lights(spoiled, mask, valid=valid).directions, lights).mean() < 1


@pytest.mark.parametrize(("name", "surface"), [("bumps", "rough"), ("balls", "rough"), ("ring", "glossy")])
@pytest.mark.parametrize("intensities", ["equal", "unknown"])
@pytest.mark.filterwarnings("ignore:the directions found are uncertain")
@pytest.mark.slow
def test_lights_of_objects_with_shadows(
    meshes: dict[str, tuple[Tensor, Tensor]], name: str, surface: str, intensities: Literal["equal", "unknown"]
) -> None:
    """16 lights, cast shadows, 1 % noise; roughness or highlights stand in for the brightness where it is unknown."""
    material, bar = rendered_captures.Surface("vcavity", 30, 0.6), 1.5
    if surface == "glossy":
        material, bar = rendered_captures.MATERIALS["delrin"], 2.5
    scene = rendered_captures.capture(meshes[name], material, lights=16, size=96)
    gain = torch.ones(16)
    if intensities == "unknown":
        gain = (0.2 * torch.randn(16, generator=torch.Generator().manual_seed(1))).exp()
    images = scene.images * gain[:, None, None, None]
    found = find_lights(images, scene.mask, intensities=intensities)
    assert degrees_apart(found.directions, scene.lights).mean() < bar
    assert (found.brightness / gain).log().std() < max(0.03, found.brightness_uncertainty / 2)
    assert degrees_apart(found.directions, scene.lights).mean() < 2 * found.uncertainty
    codes = {f.code for f in found.findings} - {"lights-uncertain"}
    assert codes == {"lights-found"} | ({"brightness-found"} if intensities == "unknown" else set())
    if intensities == "unknown":
        with pytest.warns(UserWarning, match="not equally bright"):
            assert "lights-unequal" in {f.code for f in find_lights(images, scene.mask).findings}


@pytest.mark.slow
def test_lights_of_a_real_ball(data: Path) -> None:
    """Measured 1.0 degrees."""
    capture = load_capture(data / "diligent" / "ballPNG")
    assert degrees_apart(find_lights(capture.images, capture.mask).directions, capture.lights).mean() < 1.5


@pytest.mark.slow
def test_lights_of_unknown_brightness_of_a_real_object(data: Path) -> None:
    """Measured 1.4 degrees and 2.2 %."""
    capture = load_capture(data / "diligent" / "catPNG")
    taken = capture.images * capture.intensities[:, :, None, None]
    found = find_lights(taken, capture.mask, intensities="unknown")
    assert degrees_apart(found.directions, capture.lights).mean() < 2
    assert (found.brightness / capture.intensities.mean(1)).log().std() < 0.05


@pytest.mark.slow
def test_metal_is_refused(meshes: dict[str, tuple[Tensor, Tensor]]) -> None:
    material = rendered_captures.MATERIALS["gold-metallic-paint"]
    scene = rendered_captures.capture(meshes["bumps"], material, lights=16, size=64)
    with pytest.raises(CaptureError, match="no matt or glossy surface explains"):
        find_lights(scene.images, scene.mask)


@pytest.mark.slow
def test_a_mask_that_is_not_the_outline_is_refused() -> None:
    """A square of waves leans to all sides along its edge."""
    across = torch.arange(64) / 64
    x, y = across[None].expand(64, 64), across[:, None].expand(64, 64)
    normal = F.normalize(torch.stack((torch.cos(20 * x + 2), torch.sin(17 * y), torch.ones_like(x))), dim=0)
    mask = torch.zeros(1, 64, 64, dtype=torch.bool)
    mask[:, 10:54, 10:54] = True
    images = OrenNayar("lambert")(normal[None], spiral_lights(16)[None], albedo=0.6)[0]
    with pytest.raises(CaptureError, match=r"lean outward along its outline|stay uncertain"):
        find_lights(images, mask)


def test_what_does_not_show_its_lights_is_refused(ball: tuple[Tensor, Tensor]) -> None:
    normal, mask = ball
    few = OrenNayar("lambert")(normal[None], spiral_lights(5)[None], albedo=0.6)[0]
    with pytest.raises(CaptureError, match="at least 6"):
        find_lights(few, mask)
    images = OrenNayar("lambert")(normal[None], spiral_lights(12)[None], albedo=0.6)[0]
    with pytest.raises(CaptureError, match="border cuts"):
        find_lights(images, torch.ones_like(mask))
    with pytest.raises(CaptureError, match="border cuts"):
        find_lights(images[:, :, :, 15:35], mask[:, :, 15:35])
    one = torch.zeros_like(mask)
    one[0, 20, 20] = True
    with pytest.raises(CaptureError, match="at least 200 pixels"):
        find_lights(images, one)
    broken = torch.where(one, torch.nan, images)
    with pytest.raises(RangeError, match="finite values inside the mask"):
        find_lights(broken, mask)
    with pytest.raises(RangeError, match="'equal' or 'unknown'"):
        find_lights(images, mask, intensities="same")  # type: ignore[arg-type]
    off = torch.ones(12, 1, 1, 1).index_fill(0, torch.tensor([3, 7]), 0)
    with pytest.raises(CaptureError, match=r"none in 2 of 12: 4, 8 \(the first is 1\).*; leave these out"):
        find_lights(images * off, mask)
    for value in (0.0, 1.0):  # clipped at full scale all over
        with pytest.raises(CaptureError, match="none in 12 of 12"):
            find_lights(torch.full_like(images, value), mask)


def ring() -> Tensor:
    turned = torch.arange(12) * math.pi / 6
    return F.normalize(torch.stack((turned.cos(), turned.sin(), torch.ones(12)), 1), dim=1)


def on_one_line() -> Tensor:
    across = torch.linspace(-1, 1, 12)
    return F.normalize(torch.stack((across, torch.zeros(12), torch.ones(12)), 1), dim=1)


def nearly_the_same() -> Tensor:
    scatter = 0.005 * torch.randn(12, 3, generator=torch.Generator().manual_seed(0))
    return F.normalize(torch.tensor([[0.3, 0.2, 1.0]]) + scatter, dim=1)


@pytest.mark.filterwarnings("ignore:the directions found are uncertain")
@pytest.mark.slow
@pytest.mark.parametrize("lights", [ring(), on_one_line(), nearly_the_same()], ids=["ring", "line", "same"])
def test_lights_that_photographs_hardly_determine(ball: tuple[Tensor, Tensor], lights: Tensor) -> None:
    """They are refused, or said to be uncertain by about as much as they are wrong or more."""
    normal, mask = ball
    images = OrenNayar("lambert")(normal[None], lights[None], albedo=0.6)[0]
    images = images + 0.003 * torch.randn(images.shape, generator=torch.Generator().manual_seed(0))
    try:
        found = find_lights(images.clamp_min(0), mask)
    except CaptureError:  # refused, which is as good
        return
    assert found.uncertainty > 5
    assert degrees_apart(found.directions, lights).mean() < 2 * found.uncertainty


@pytest.mark.slow
def test_lights_on_one_side_are_found(ball: tuple[Tensor, Tensor]) -> None:
    normal, mask = ball
    lights = spiral_lights(24)
    lights = lights[lights[:, 0] > 0.1]
    images = OrenNayar("lambert")(normal[None], lights[None], albedo=0.6)[0]
    assert degrees_apart(find_lights(images, mask).directions, lights).mean() < 1


@pytest.mark.slow
def test_two_objects_in_the_mask() -> None:
    halves = [Ball(x, 31.5, 14.0).normals((64, 64)) for x in (15.5, 47.5)]
    mask = halves[0][1] | halves[1][1]
    normal = torch.where(halves[0][1], halves[0][0], halves[1][0])
    lights = spiral_lights(12)
    images = OrenNayar("lambert")(normal[None], lights[None], albedo=0.6)[0]
    assert degrees_apart(find_lights(images, mask).directions, lights).mean() < 1


def test_a_flat_object_is_refused() -> None:
    normal = torch.tensor([0.0, 0, 1]).reshape(3, 1, 1).expand(3, 64, 64)
    mask = torch.zeros(1, 64, 64, dtype=torch.bool)
    mask[:, 10:54, 10:54] = True
    images = OrenNayar("lambert")(normal[None], spiral_lights(12)[None], albedo=0.6)[0]
    images = images + 0.003 * torch.randn(images.shape, generator=torch.Generator().manual_seed(0))
    with pytest.raises(CaptureError, match="surface that is flat"):
        find_lights(images, mask)


@pytest.mark.slow
def test_a_lambertian_surface_does_not_show_the_brightness(ball: tuple[Tensor, Tensor]) -> None:
    normal, mask = ball
    images = OrenNayar("lambert")(normal[None], spiral_lights(10)[None], albedo=0.6)[0]
    with pytest.raises(CaptureError, match="of unknown brightness"):
        find_lights(images, mask, intensities="unknown")


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
    found, stiffness = rotation_to_surface(normal @ turn, inside)
    assert bool((torch.linalg.eigvalsh(stiffness) > 100).all())
    assert torch.allclose(turn @ found, torch.eye(3).double(), atol=0.02)
    few = torch.ones(3, 3, dtype=torch.bool)
    assert torch.equal(rotation_to_surface(normal[:9], few)[0], torch.eye(3).double())
