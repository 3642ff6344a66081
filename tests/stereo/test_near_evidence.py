"""Near lights that are solved as distant ones are noticed; distant ones are not taken for near."""

from __future__ import annotations

import pytest
from torch import Tensor

from tests.support import rendered_captures
from tests.support.near_relief import relief
from tests.support.objects import findings
from torch_orennayar import photometric_stereo


@pytest.mark.parametrize("distance", [2.0, 3.0])
def test_near_lamps_are_noticed(distance: float) -> None:
    images, light, _ = relief(distance)
    with pytest.warns(UserWarning, match="the surface found is bent"):
        found = photometric_stereo(images, light, model="lambert")
    (finding,) = findings(found, "lights-near")
    assert finding.value == pytest.approx(distance, abs=1)


@pytest.mark.parametrize("distance", [20.0, 1e6])
def test_lamps_far_away_are_distant(distance: float) -> None:
    images, light, _ = relief(distance)
    assert not findings(photometric_stereo(images, light, model="lambert"), "lights-near")


@pytest.mark.parametrize("surface", ["satin_white", "spectralon", "alum-bronze"])
@pytest.mark.slow
def test_other_materials_are_not_taken_for_near_lamps(meshes: dict[str, tuple[Tensor, Tensor]], surface: str) -> None:
    scene = rendered_captures.capture(meshes["bumps"], rendered_captures.MATERIALS[surface], lights=16, size=64)
    found = photometric_stereo(scene.images, scene.lights, scene.mask, model="lambert")
    assert not findings(found, "lights-near")
