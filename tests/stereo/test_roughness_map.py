"""Objects whose roughness differs from place to place."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.support import rendered_captures
from tests.support.objects import mean_error
from torch_orennayar import photometric_stereo
from torch_orennayar.stereo import row_bands
from torch_orennayar.stereo.material import Material
from torch_orennayar.stereo.pixel_grid import Grid
from torch_orennayar.stereo.roughness_map import LEVELS, RADIUS, STEP, blend, nearest
from torch_orennayar.stereo.row_bands import solve_bands
from torch_orennayar.stereo.solved_maps import SolvedMaps


def levels_of(height: int, width: int) -> list[SolvedMaps]:
    """Maps at every level that differ by their roughness alone."""
    one = torch.ones(1, height, width)
    return [SolvedMaps(one.expand(3, -1, -1), one, one, one, one, one * level) for level in LEVELS]


@pytest.mark.parametrize(("left", "right"), [(10, 45), (0, 50)])
@pytest.mark.slow
def test_a_map_is_found_where_one_roughness_is_not_enough(left: float, right: float) -> None:
    scene, truth = rendered_captures.patched_capture(left, right)
    found = photometric_stereo(scene.images, scene.lights, scene.mask)
    one = photometric_stereo(scene.images, scene.lights, scene.mask, model="vcavity")
    assert "varied" in min(found.scores, key=found.scores.__getitem__)
    assert mean_error(found, scene) < 1.0
    assert mean_error(found, scene) < 0.6 * mean_error(one, scene)
    for degrees in (left, right):
        side = (truth - math.radians(degrees)).abs() < 1e-3
        there = torch.rad2deg(found.roughness[side & scene.mask])
        assert there.median().item() == pytest.approx(degrees, abs=5)  # noise hides 10 degrees almost whole
    (finding,) = (f for f in found.report if f.code == "roughness-map")
    assert finding.value == pytest.approx(math.degrees(found.roughness[scene.mask].median().item()), abs=0.01)
    assert 0 < math.degrees(found.roughness_error) < 10
    relit = found.shade(scene.lights[:2])
    missed = (relit - scene.images[:2]).abs()[:, :, scene.mask[0]].mean() / scene.images[:2, :, scene.mask[0]].mean()
    assert missed < 0.05


@pytest.mark.parametrize("degrees", [0, 30])
@pytest.mark.slow
def test_one_roughness_stays_one(degrees: float) -> None:
    scene, _ = rendered_captures.patched_capture(degrees, degrees)
    found = photometric_stereo(scene.images, scene.lights, scene.mask)
    assert found.roughness[scene.mask].std() < 1e-6
    assert found.model == ("vcavity" if degrees else "lambert")


@pytest.mark.slow
def test_bands_leave_no_seam(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, _ = rendered_captures.patched_capture(10, 45, lights=12)
    material = Material("vcavity", roughness_varies=True)
    whole = solve_bands(scene.images, scene.lights, scene.mask[0], material, "lit")
    monkeypatch.setattr(row_bands, "BAND", 1)
    monkeypatch.setattr(row_bands, "band_height", lambda count, inside: 20)
    banded = solve_bands(scene.images, scene.lights, scene.mask[0], material, "lit")
    for found, wanted in zip(banded.tensors(), whole.tensors(), strict=True):
        assert torch.allclose(found, wanted, atol=1e-4)


@given(place=st.floats(0, len(LEVELS) - 1.0), slope=st.floats(0.1, 10))
def test_blend_finds_the_lowest_point_of_a_parabola(place: float, slope: float) -> None:
    mask = torch.ones(5, 6, dtype=torch.bool)
    costs = slope * (torch.arange(len(LEVELS)).float() - place).square()[:, None].expand(-1, 30)
    found = blend(levels_of(5, 6), costs, Grid(mask))
    assert torch.allclose(found.roughness, torch.tensor(place * STEP), atol=1e-3)
    assert torch.allclose(found.normal.norm(dim=0), torch.ones(5, 6), atol=1e-6)


def test_neighbours_share_the_cost() -> None:
    """A lone pixel with another opinion gives way."""
    mask = torch.ones(15, 15, dtype=torch.bool)
    costs = (torch.arange(len(LEVELS)).float() - 2).square()[:, None].repeat(1, 225)
    costs[:, 112] = (torch.arange(len(LEVELS)).float() - 7).square()
    found = blend(levels_of(15, 15), costs, Grid(mask)).roughness
    assert (found - LEVELS[2]).abs().max() < 1.5 * 5 * STEP / (2 * RADIUS + 1) ** 2


def test_nearest_pixels() -> None:
    places = torch.cartesian_prod(torch.arange(40), torch.arange(40))
    near = nearest(places)
    assert near.shape == (1600, 25)
    assert (near == torch.arange(1600)[:, None]).any(1).all()
    assert (places[near] - places[:, None]).abs().amax() <= 7
    inner = 20 * 40 + 20
    assert (places[near[inner]] - places[inner]).abs().amax() <= 3
