"""Light files that are wrong: noticed, told, mended; right ones are left alone."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from tests.support.objects import degrees_apart, findings
from torch_orennayar import CaptureError, OrenNayar, ShapeError, angular_error, photometric_stereo
from torch_orennayar.geometry.primitives import Ball, spiral_lights
from torch_orennayar.stereo.light_refinement import refine_lights

COUNT = 16


@pytest.fixture(scope="module")
def rough_ball() -> tuple[Tensor, Tensor, Tensor]:
    normal, mask = Ball(23.5, 23.5, 21.0).normals((48, 48))
    images = OrenNayar("vcavity")(normal[None], spiral_lights(COUNT)[None], albedo=0.6, roughness=0.5)[0]
    noise = torch.randn(images.shape, generator=torch.Generator().manual_seed(0))
    return (images + 0.002 * noise).clamp_min(0) * mask, mask, normal


def turned(lights: Tensor, degrees: float, axis: tuple[float, float, float]) -> Tensor:
    x, y, z = (math.radians(degrees) * a for a in axis)
    rotation: Tensor = torch.linalg.matrix_exp(torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]]))
    return lights @ rotation


def one_wrong(lights: Tensor) -> Tensor:
    changed = lights.clone()
    changed[3] = F.normalize(changed[3] + torch.tensor([0.4, -0.3, 0]), dim=0)
    return changed


def noisy(lights: Tensor) -> Tensor:
    return F.normalize(lights + 0.06 * torch.randn(lights.shape, generator=torch.Generator().manual_seed(1)), dim=1)


@pytest.mark.parametrize(
    ("wrong", "count"),
    [
        pytest.param(lambda lights: turned(lights, 5, (0.6, 0.8, 0)), COUNT, id="turned by 5 degrees"),
        pytest.param(lambda lights: turned(lights, 45, (0, 0, 1)), COUNT, id="ring turned by 45 degrees"),
        pytest.param(one_wrong, 1, id="one light"),
        pytest.param(lambda lights: lights[[1, 0, *range(2, COUNT)]], 2, id="two swapped"),
        pytest.param(noisy, None, id="each by some degrees"),
    ],
)
@pytest.mark.slow
def test_wrong_lights_are_mended(
    rough_ball: tuple[Tensor, Tensor, Tensor], wrong: Callable[[Tensor], Tensor], count: int | None
) -> None:
    images, mask, _ = rough_ball
    lights = spiral_lights(COUNT)
    given = wrong(lights)
    before, worst = degrees_apart(given, lights).mean().item(), degrees_apart(given, lights).max()
    with pytest.warns(UserWarning, match="contradict the photographs"):
        found = refine_lights(images, given, mask)
    assert worst > 4
    assert degrees_apart(found.directions, lights).mean().item() < min(1.5, before)
    assert [f.code for f in found.findings] == ["lights-refined"]
    if count is not None:
        replaced = (found.directions - given).norm(dim=1) > 0
        assert int(replaced.sum()) == count


def test_right_lights_are_left_alone(rough_ball: tuple[Tensor, Tensor, Tensor]) -> None:
    images, mask, normal = rough_ball
    lights = spiral_lights(COUNT)
    solved = photometric_stereo(images, lights, mask, model="lambert", refine_lights=True)
    assert solved.lights is not None
    assert torch.equal(solved.lights, lights)
    (kept,) = findings(solved, "lights-kept")
    assert kept.value is not None
    assert kept.value < 1.5
    plain = photometric_stereo(images, lights, mask, model="lambert")
    assert torch.equal(solved.normal, plain.normal)
    assert angular_error(plain.normal, normal, mask).summary()["mean"] < 15


def test_what_cannot_be_refined_is_refused(rough_ball: tuple[Tensor, Tensor, Tensor]) -> None:
    images, mask, _ = rough_ball
    lights = spiral_lights(COUNT)
    with pytest.raises(CaptureError, match="outline"):
        photometric_stereo(images, lights, None, refine_lights=True)
    near = lights[:, :, None, None].expand(-1, -1, 48, 48)
    with pytest.raises(ShapeError, match="refine_lights"):
        photometric_stereo(images, near, mask, refine_lights=True)
