"""The pictures of a synthetic capture follow from what comes with them."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from torch_orennayar import Ingredients, OrenNayar, RangeError, SyntheticCaptures, SyntheticImages, angular_error
from torch_orennayar.geometry.depth import depth_to_normals

EXACT: dict[str, Any] = {"noise": (0.0, 0.0), "bits": (0.0, 0.0), "clipped": 0.0}
"""A sensor that records light as it is."""


def captures(mix: Ingredients, **options: Any) -> SyntheticCaptures[SyntheticImages]:
    return SyntheticCaptures("images", mix=mix, lights=options.pop("lights", (4, 6)), **options)


def shading(sample: SyntheticImages) -> Tensor:
    """What the layer makes of the truth, (K, 3, H, W)."""
    maps = [sample[name][None] for name in ("normal", "true_lights", "view", "albedo", "roughness")]
    shaded: Tensor = OrenNayar("vcavity")(*maps)[0]
    return shaded


@pytest.mark.parametrize("rough", [0.0, 1.0])
@pytest.mark.parametrize("index", range(8))
def test_a_plain_sample_renders_again(index: int, rough: float) -> None:
    sample = captures(Ingredients.plain(rough=rough), seed=3).sample(index)
    again = sample["exposure"] * shading(sample)
    lit = again > 0.02
    difference = (sample["images"] / again - 1)[lit].abs()
    assert lit.sum() > 1000
    assert difference.quantile(0.95) <= 1e-5
    assert difference.max() <= 1e-4
    assert torch.equal(sample["lights"], sample["true_lights"])
    assert (sample["roughness"].amax() > 0) == bool(rough)


@pytest.mark.parametrize("index", range(8))
def test_a_sample_with_everything_is_the_sum_of_its_parts(index: int) -> None:
    sample = captures(Ingredients(rough=1.0, **EXACT), seed=5).sample(index)
    direct = sample["exposure"] * sample["reached"] * shading(sample)
    light = sample["brightness"] * (direct + sample["between"] + sample["remainder"])
    assert torch.allclose(sample["images"], light.clamp(0, 1), atol=2e-5)
    assert ((sample["reached"] >= 0) & (sample["reached"] <= 1)).all()
    assert (sample["between"] >= 0).all()


SWITCHES: dict[str, tuple[object, str]] = {
    "glazed": (1.0, "remainder"), "retro": (1.0, "remainder"), "falloff": (1.0, "remainder"),
    "glossy": (1.0, "remainder"), "sheen": (1.0, "remainder"), "ambient": (0.2, "remainder"), "shadows": (1, "reached"),
    "bounce": (True, "between"), "light_error": (0.05, "lights"), "intensity_error": (0.1, "brightness"),
}  # fmt: skip
"""Ingredients, a value that turns them on, and where their contribution is."""


@pytest.mark.parametrize("name", SWITCHES)
def test_each_switch_changes_its_own_contribution_alone(name: str) -> None:
    value, place = SWITCHES[name]
    off, on = (captures(Ingredients.plain(rough=1.0, **kept), seed=1).sample(4) for kept in ({}, {name: value}))
    for part in ("normal", "albedo", "roughness", "true_lights", "depth", "mask", "view"):
        assert torch.equal(off[part], on[part]), part
    changed = [
        part
        for part in ("lights", "brightness", "reached", "between", "remainder")
        if not torch.equal(off[part], on[part])
    ]
    assert changed == [place]


@pytest.mark.parametrize(("name", "value"), [("noise", (0.05, 0.0)), ("bits", (4.0, 4.0)), ("clipped", 1.0)])
def test_the_sensor_changes_nothing_but_the_pictures(name: str, value: object) -> None:
    off, on = (captures(Ingredients.plain(**kept), seed=1).sample(4) for kept in ({}, {name: value}))
    assert not torch.equal(off["images"], on["images"])
    assert torch.equal(off["normal"], on["normal"])
    assert torch.equal(off["exposure"], on["exposure"]) == (name != "clipped")


def test_depth_and_normals_are_of_one_surface() -> None:
    """Of orthographic views, with differences of the depth; at steps between parts they differ."""
    compared = 0
    for index in range(8):
        sample = captures(Ingredients.plain(), lights=(3, 3), seed=2, size=(128, 128)).sample(index)
        assert torch.allclose(sample["view"].norm(dim=0), torch.ones(128, 128), atol=1e-5)
        if not bool((sample["view"][2] == 1).all()):
            continue
        found = depth_to_normals(-sample["depth"] * 128 / 2 * sample["mask"], mask=sample["mask"])  # height in pixels
        both = sample["mask"] & (found != 0).any(0)
        assert angular_error(found, sample["normal"], both).summary()["median"] < 5
        compared += 1
    assert compared


def test_maps_of_roughness_and_albedo_vary() -> None:
    samples = [captures(Ingredients.plain(rough=1.0), lights=(3, 3), size=(32, 32)).sample(k) for k in range(12)]
    for name in ("albedo", "roughness"):
        values = [sample[name][:, sample["mask"][0]] for sample in samples]
        assert 2 < sum(float(v.std(1).max()) > 0.01 for v in values) < 12


def test_one_light_is_enough_for_pictures() -> None:
    assert captures(Ingredients(), lights=(1, 1)).sample(0)["images"].shape == (1, 3, 64, 64)
    with pytest.raises(RangeError, match="3 or more"):
        SyntheticCaptures("pixels", lights=(1, 1))


def test_a_plain_mix_keeps_what_is_named() -> None:
    assert Ingredients.plain(rough=0.5).rough == 0.5
    assert Ingredients.plain().bits == (0.0, 0.0)
    with pytest.raises(RangeError, match="rough"):
        Ingredients.plain(rough=2.0)
