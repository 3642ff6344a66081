"""Lights whose y or x points the other way are noticed by the object's outline."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
import torch
from torch import Tensor

from tests.support.objects import Scene, findings
from torch_orennayar import OrenNayar, load_capture, photometric_stereo
from torch_orennayar.geometry.primitives import Ball, spiral_lights
from torch_orennayar.stereo.light_frame import check_light_frame


def photographs(lights: Tensor) -> tuple[Tensor, Tensor]:
    normal, mask = Ball(20.0, 20.0, 17.0).normals((41, 41))
    return OrenNayar("lambert")(normal[None], lights[None], albedo=0.6)[0], mask


@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_axis_is_told(axis: int) -> None:
    lights = spiral_lights(12)
    images, mask = photographs(lights)
    wrong = lights.clone()
    wrong[:, axis] *= -1
    with pytest.warns(UserWarning, match=f"turn the sign of their {'xy'[axis]}"):
        found = photometric_stereo(images, wrong, mask, model="lambert")
    assert len(findings(found, "lights-mirrored")) == 1


@pytest.mark.parametrize(
    ("turn", "words"),
    [
        pytest.param(
            [[-1.0, 0, 0], [0, -1, 0], [0, 0, 1]], "a hollow, or .* turned by about 180 degrees", id="half a turn"
        ),
        pytest.param([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]], "x and y exchanged", id="exchanged"),
        pytest.param([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]], "turned by about 90 degrees", id="a quarter to the left"),
        pytest.param([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]], "turned by about 90 degrees", id="a quarter to the right"),
    ],
)
def test_a_turned_frame_is_told(turn: list[list[float]], words: str) -> None:
    lights = spiral_lights(12)
    images, mask = photographs(lights)
    with pytest.warns(UserWarning, match=words):
        found = photometric_stereo(images, lights @ torch.tensor(turn), mask, model="lambert")
    assert len(findings(found, "lights-mirrored")) == 1


def test_right_lights_and_missing_outlines_say_nothing(rough: Scene) -> None:
    lights = spiral_lights(12)
    images, mask = photographs(lights)
    assert check_light_frame(images, lights, mask[0]) == []
    wrong = lights * torch.tensor([1.0, -1, 1])
    assert check_light_frame(images, wrong, torch.ones_like(mask[0])) == []
    assert check_light_frame(rough.images, rough.lights, rough.mask[0]) == []


@pytest.mark.parametrize(("name", "told"), [("ball", True), ("cat", True), ("reading", False)])
@pytest.mark.slow
def test_real_objects(data: Path, name: str, told: bool) -> None:
    """Reading's outline says too little of its shape."""
    capture = load_capture(data / "diligent" / f"{name}PNG")
    mask = torch.nn.functional.pad(capture.mask[0], (1, 1, 1, 1))  # DiLiGenT's are cut to the object here
    images = torch.nn.functional.pad(capture.images, (1, 1, 1, 1))
    assert check_light_frame(images, capture.lights, mask) == []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = check_light_frame(images, capture.lights * torch.tensor([1.0, -1, 1]), mask)
    assert [f.code for f in found] == ["lights-mirrored"] * told
    assert len(caught) == told
