"""Photographs that contradict the others are left out and named, whatever solves the rest."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor

from tests.support import rendered_captures
from tests.support.objects import findings
from tests.support.rendered_captures import Rendered
from torch_orennayar import OrenNayar, angular_error, load_capture, photometric_stereo

LEFT_OUT = "were left out"


@pytest.fixture(scope="module")
def good(meshes: dict[str, tuple[Tensor, Tensor]]) -> Rendered:
    return rendered_captures.capture(meshes["bumps"], rendered_captures.Surface("vcavity", 30, 0.6), lights=24, size=64)


def dark(images: Tensor) -> Tensor:
    return torch.cat((0.02 * images[:2], images[2:]))


def brighter(images: Tensor) -> Tensor:
    return torch.cat((1.5 * images[:2], images[2:]))


def moved(images: Tensor) -> Tensor:
    return torch.cat((images[:2].roll((5, 4), (2, 3)), images[2:]))


def swapped(images: Tensor) -> Tensor:
    return images[[20, 1, *range(2, 20), 0, *range(21, 24)]]


def another_light(images: Tensor) -> Tensor:
    return torch.cat((images[:2] + 0.8 * images[20:22], images[2:]))


@pytest.mark.parametrize(
    ("spoil", "broken"),
    [
        pytest.param(dark, (0, 1), id="flash not fired"),
        pytest.param(brighter, (0, 1), id="another exposure"),
        pytest.param(moved, (0, 1), id="moved"),
        pytest.param(swapped, (0, 20), id="swapped"),
        pytest.param(another_light, (0, 1), id="another light on"),
    ],
)
def test_what_is_left_out_changes_nothing_else(
    good: Rendered, spoil: Callable[[Tensor], Tensor], broken: tuple[int, int]
) -> None:
    images = spoil(good.images)
    with pytest.warns(UserWarning, match=LEFT_OUT):
        found = photometric_stereo(images, good.lights, good.mask, model="lambert")
    (finding,) = findings(found, "frames-left-out")
    assert f"photographs {broken[0] + 1}, {broken[1] + 1} " in str(finding)
    assert finding.value == 2
    kept = [k for k in range(24) if k not in broken]
    by_hand = photometric_stereo(images[kept], good.lights[kept], good.mask, model="lambert")
    assert torch.equal(found.normal, by_hand.normal)
    assert torch.equal(found.residual, by_hand.residual)


@pytest.mark.parametrize("model", ["vcavity", "auto", "network"])
@pytest.mark.slow
def test_every_model_leaves_them_out(good: Rendered, model: str) -> None:
    with pytest.warns(UserWarning, match=LEFT_OUT):
        found = photometric_stereo(swapped(good.images), good.lights, good.mask, model=model)
    whole = photometric_stereo(good.images, good.lights, good.mask, model=model)
    error, usual = (angular_error(r.normal, good.normal, good.mask).summary()["mean"] for r in (found, whole))
    assert error < usual + 0.3


@pytest.mark.parametrize(("surface", "count"), [("satin_white", 16), ("spectralon", 8), ("alum-bronze", 24)])
@pytest.mark.slow
def test_good_photographs_are_kept(meshes: dict[str, tuple[Tensor, Tensor]], surface: str, count: int) -> None:
    """Also of glossy and metallic rings, whose shadows and highlights are furthest from a matt surface."""
    scene = rendered_captures.capture(meshes["ring"], rendered_captures.MATERIALS[surface], lights=count, size=64)
    found = photometric_stereo(scene.images, scene.lights, scene.mask, model="lambert")
    assert not findings(found, "frames-left-out")


@pytest.mark.parametrize("count", [8, 12, 24])
@pytest.mark.parametrize("roughness", [30, 45])
def test_a_frontal_light_on_a_rough_surface_is_no_mistake(count: int, roughness: int) -> None:
    """A flash beside the lens, and a ring of lamps at 55 degrees: as Lambert's model does not expect it."""
    across = (torch.arange(48) - 23.5) / 22
    x, y = across[None].expand(48, 48), -across[:, None].expand(48, 48)
    mask = (x**2 + y**2 < 0.98)[None]
    normal = torch.stack((x, y, (1 - x**2 - y**2).clamp_min(0).sqrt())) * mask
    turn, tilt = torch.arange(count - 1) * 2 * math.pi / (count - 1), math.radians(55)
    ring = torch.stack((turn.cos() * math.sin(tilt), turn.sin() * math.sin(tilt), turn * 0 + math.cos(tilt)), 1)
    lights = torch.cat((torch.tensor([[0.0, 0, 1]]), ring))
    layer = OrenNayar("vcavity")
    images = layer(normal[None], lights[:, :, None, None], albedo=0.6, roughness=math.radians(roughness)) * mask
    assert not findings(photometric_stereo(images, lights, mask, model="lambert"), "frames-left-out")


def test_plain_least_squares_takes_what_it_is_given(good: Rendered) -> None:
    found = photometric_stereo(swapped(good.images), good.lights, good.mask, model="lambert", robust=False)
    assert not findings(found, "frames-left-out")


@pytest.mark.filterwarnings("ignore:photographs")
@pytest.mark.slow
def test_twenty_of_96_photographs_of_a_real_object(data: Path) -> None:
    """In one another's place: the network errs as on the good ones."""
    capture = load_capture(data / "diligent" / "ballPNG")
    assert capture.normal is not None
    generator = torch.Generator().manual_seed(0)
    broken = torch.randperm(96, generator=generator)[:20]
    kept = torch.ones(96, dtype=torch.bool)
    kept[broken] = False
    images = capture.images.clone()
    images[broken] = images[broken.roll(7)]
    found = photometric_stereo(images, capture.lights, capture.mask, model="network")
    usual = photometric_stereo(images[kept], capture.lights[kept], capture.mask, model="network")
    error, best = (angular_error(r.normal, capture.normal, capture.mask).summary()["mean"] for r in (found, usual))
    assert error < best + 0.3
