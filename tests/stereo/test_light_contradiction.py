"""Lights in another order than their photographs are noticed; right ones are not, on any material."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
import torch
from torch import Tensor

from tests.support import rendered_captures
from tests.support.objects import findings
from torch_orennayar import load_capture, photometric_stereo

ORDERS = {
    "shuffled": lambda count: torch.randperm(count, generator=torch.Generator().manual_seed(1)),
    "reversed": lambda count: torch.arange(count).flip(0),
}


def codes(images: Tensor, lights: Tensor, mask: Tensor) -> list[str]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = photometric_stereo(images, lights, mask, model="lambert")
    return [finding.code for finding in findings(found, "lights-contradicted")]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("count", [6, 8, 16])
def test_another_order_is_told(meshes: dict[str, tuple[Tensor, Tensor]], count: int, order: str) -> None:
    surface = rendered_captures.Surface("vcavity", 30, 0.6)
    scene = rendered_captures.capture(meshes["bumps"], surface, lights=count, size=64)
    assert codes(scene.images, scene.lights, scene.mask) == []
    wrong = scene.lights[ORDERS[order](count)]
    assert codes(scene.images, wrong, scene.mask) == ["lights-contradicted"]


def test_what_it_says(meshes: dict[str, tuple[Tensor, Tensor]]) -> None:
    scene = rendered_captures.capture(meshes["bumps"], rendered_captures.Surface("vcavity", 30, 0.6), lights=8, size=64)
    with pytest.warns(UserWarning, match="contradict the light directions"):
        found = photometric_stereo(scene.images, scene.lights.flip(0), scene.mask, model="lambert")
    (finding,) = findings(found, "lights-contradicted")
    assert "--refine-lights" in finding
    assert finding.value is not None
    assert 0 < finding.value < 0.65


@pytest.mark.parametrize("material", ["gold-metallic-paint", "alum-bronze", "cardboard", "satin_white", "spectralon"])
@pytest.mark.slow
def test_right_lights_are_kept(meshes: dict[str, tuple[Tensor, Tensor]], material: str) -> None:
    for count in (8, 16):
        surface = rendered_captures.MATERIALS[material]
        scene = rendered_captures.capture(meshes["ring"], surface, lights=count, size=64)
        assert codes(scene.images, scene.lights, scene.mask) == []


@pytest.mark.parametrize("name", ["ball", "cat", "reading"])
@pytest.mark.slow
def test_real_objects(data: Path, name: str) -> None:
    capture = load_capture(data / "diligent" / f"{name}PNG")
    some = torch.linspace(0, 95, 12).long()
    images, lights = capture.images[some], capture.lights[some]
    assert codes(images, lights, capture.mask) == []
    assert codes(images, lights.roll(1, 0), capture.mask) == ["lights-contradicted"]
