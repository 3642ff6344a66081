"""The distance of near lights whose directions alone are known, against tables and objects that are lit exactly."""

from __future__ import annotations

import math

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from tests.support import rendered_captures
from tests.support.near_relief import COUNT, SIZE, relief
from torch_orennayar import (
    CaptureError,
    RangeError,
    angular_error,
    find_light_positions,
    near_light_stereo,
    photometric_stereo,
)


def solve(images: Tensor, light: Tensor, normal: Tensor, origin: tuple[float, float] | None = None) -> float:
    """The mean error of normals under lights whose positions were found, degrees."""
    found = find_light_positions(images, light, origin=origin)
    seen = images / found.intensities[:, :, None, None] / found.positions.square().sum(1).mean()
    solved = near_light_stereo(seen, found.positions, model="lambert")
    return angular_error(solved.normal, normal).summary()["mean"]


@pytest.mark.parametrize("distance", [2.5, *(pytest.param(d, marks=pytest.mark.slow) for d in (1.5, 4.0))])
def test_distance_of_lamps_and_the_surface_under_them(distance: float) -> None:
    images, light, normal = relief(distance)
    found = find_light_positions(images, light)
    assert found.distance == pytest.approx(distance, rel=0.02)
    assert 0 < found.uncertainty < 0.02 * distance
    assert [finding.code for finding in found.findings] == ["light-distance-found"]
    assert torch.allclose(found.positions, found.distance * SIZE * light, atol=1e-3)
    assert solve(images, light, normal) < 0.8


@pytest.mark.slow
def test_directions_measured_beside_the_middle() -> None:
    """As a mirror ball at the edge of the picture shows them."""
    beside = (56.0, 52.0)
    images, light, normal = relief(2.0, origin=beside)
    assert find_light_positions(images, light, origin=beside).distance == pytest.approx(2, rel=0.06)
    assert solve(images, light, normal, beside) < 0.8
    assert solve(images, light, normal) > 2.0


@pytest.mark.slow
def test_lamps_of_unequal_brightness() -> None:
    images, light, normal = relief(2.0)
    brightness = torch.linspace(0.6, 1.4, COUNT)[torch.randperm(COUNT, generator=torch.Generator().manual_seed(1))]
    images = images * brightness[:, None, None, None]
    found = find_light_positions(images, light)
    assert found.distance == pytest.approx(2, rel=0.1)
    assert torch.allclose(found.intensities[:, 0], brightness, rtol=0.03)
    assert [finding.code for finding in found.findings] == ["light-distance-found", "intensities-from-capture"]
    assert solve(images, light, normal) < 1.0


@pytest.mark.parametrize("distance", [12.0, 40.0, 1e6])
def test_lamps_far_away_are_refused(distance: float) -> None:
    images, light, _ = relief(distance)
    with pytest.raises(CaptureError, match="solve as under distant lights"):
        find_light_positions(images, light)


@pytest.mark.parametrize("name", ["bumps", "ring"])
@pytest.mark.slow
def test_a_rough_object_without_a_table(meshes: dict[str, tuple[Tensor, Tensor]], name: str) -> None:
    """Its shape and its roughness differ from a matt plane by more than near lights from distant ones."""
    scene = rendered_captures.near_capture(meshes[name])
    light = F.normalize(scene.positions + torch.tensor([0.0, 0.0, scene.distance]), dim=1)
    with pytest.warns(UserWarning, match="the surface found is bent"):
        distant = photometric_stereo(scene.images, light, scene.mask, model="vcavity")
    found = find_light_positions(scene.images, light, scene.mask)
    row, column = scene.mask[0].nonzero().unbind(1)
    pixels = float(torch.maximum(row.max() - row.min(), column.max() - column.min()) + 1)
    size = pixels * 2 * scene.distance * math.tan(math.radians(35) / 2) / scene.mask.shape[1]
    assert found.distance == pytest.approx(3 / size, rel=0.1)  # the lamps are 3 from the origin
    seen = scene.images / found.positions.square().sum(1).mean()
    near = near_light_stereo(seen, found.positions, scene.mask, model="vcavity")
    error, bent = (angular_error(r.normal, scene.normal, scene.mask).summary()["mean"] for r in (near, distant))
    assert error < 3 < 8 < bent


@pytest.mark.parametrize("dtype", [torch.float16, torch.float64])
def test_types_and_threads_change_nothing(dtype: torch.dtype) -> None:
    images, light, _ = relief(2.5)
    threads, found = torch.get_num_threads(), find_light_positions(images, light)
    torch.set_num_threads(threads + 1)
    try:
        again = find_light_positions(images, light)
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(found.positions, again.positions)
    other = find_light_positions(images.to(dtype), light.to(dtype))
    assert other.positions.dtype == other.intensities.dtype == dtype
    assert other.distance == pytest.approx(found.distance, rel=1e-2)


def test_lights_that_are_no_directions_are_refused() -> None:
    images, light, _ = relief(2.5)
    with pytest.raises(RangeError, match="unit vectors"):
        find_light_positions(images, 2 * light)


def test_few_lights_are_refused() -> None:
    images, light, _ = relief(2.0)
    with pytest.raises(CaptureError, match="at least 8"):
        find_light_positions(images[:7], light[:7])


@pytest.mark.slow
def test_photographs_under_other_lamps_are_left_out() -> None:
    images, light, normal = relief(2.0)
    images[[3, 9]] = images[[9, 3]]
    found = find_light_positions(images, light)
    seen = images / found.positions.square().sum(1).mean()
    with pytest.warns(UserWarning, match="photographs 4, 10"):
        solved = near_light_stereo(seen, found.positions, model="lambert")
    assert [finding.value for finding in solved.report if finding.code == "frames-left-out"] == [2]
    assert angular_error(solved.normal, normal).summary()["mean"] < 0.8


def test_a_mask_and_samples_that_do_not_count() -> None:
    images, light, normal = relief(2.0)
    mask = torch.zeros(1, SIZE, SIZE, dtype=torch.bool)
    mask[:, 8:56, 10:54] = True
    valid = torch.ones(COUNT, 1, SIZE, SIZE, dtype=torch.bool)
    valid[0, :, 10:30, 20:40] = False
    spoiled = torch.where(valid, images, 1.0).where(mask, 7.0)
    found = find_light_positions(spoiled, light, mask, valid=valid)
    assert found.distance == pytest.approx(2 * SIZE / 48, rel=0.06)
    seen = spoiled / found.positions.square().sum(1).mean()
    solved = near_light_stereo(seen, found.positions, mask, model="lambert", valid=valid)
    assert angular_error(solved.normal, normal, mask).summary()["mean"] < 0.8


def test_the_distant_solution_is_bent() -> None:
    images, light, normal = relief(2.0)
    with pytest.warns(UserWarning, match="find_light_positions"):
        distant = photometric_stereo(images, light, model="lambert")
    assert angular_error(distant.normal, normal).summary()["mean"] > 5.0
