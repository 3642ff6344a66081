from __future__ import annotations

import math
import time
from pathlib import Path

import pytest
import torch
import torch.nn.functional as F
from conftest import Scene
from torch import Tensor

from torch_orennayar import (
    CaptureError,
    ModelError,
    OrenNayar,
    RangeError,
    Reconstruction,
    ShapeError,
    angular_error,
    load_capture,
    photometric_stereo,
)
from torch_orennayar._robust_fit import solve_symmetric
from torch_orennayar.demo import spiral_lights
from torch_orennayar.selection import hold_out


def mean_error(found: Reconstruction, scene: Scene) -> float:
    return angular_error(found.normal, scene.normal, scene.mask).summary()["mean"]


def test_noise_free_lambert_is_exact() -> None:
    normal = F.normalize(torch.tensor([[0.2, 0.1, 1], [-0.4, 0.3, 1], [0.5, -0.5, 1]]).double(), dim=1)
    lights = spiral_lights(12, math.radians(35)).double()
    image = OrenNayar("lambert")(normal.T.reshape(1, 3, 1, 3), lights[None], albedo=0.6)[0]
    for robust in (True, False):
        found = photometric_stereo(image, lights, model="lambert", robust=robust)
        assert angular_error(found.normal, normal.T.reshape(3, 1, 3)).max() < 1e-3
        assert (found.albedo - 0.6).abs().max() < 1e-4
        assert found.normal.dtype == torch.float64


def test_plain_least_squares_is_least_squares(rough: Scene) -> None:
    found = photometric_stereo(rough.images, rough.lights, rough.mask, model="lambert", robust=False)
    inside = rough.mask[0]
    scaled = torch.linalg.lstsq(rough.lights.double(), rough.images.mean(1)[:, inside].double()).solution
    wanted = torch.zeros(3, *inside.shape).double()
    wanted[:, inside] = F.normalize(scaled, dim=0)
    facing = rough.mask & (wanted[2:] > 0.03)
    assert angular_error(found.normal.double(), wanted, facing).summary()["p90"] < 0.01


def test_rough_surface_needs_a_rough_model(rough: Scene) -> None:
    """The bars of the demo: half of Lambert's error, roughness within 3 degrees."""
    lambert = photometric_stereo(rough.images, rough.lights, rough.mask, model="lambert")
    rounded = photometric_stereo(rough.images, rough.lights, rough.mask, model="vcavity")
    assert mean_error(rounded, rough) <= 0.5 * mean_error(lambert, rough)
    assert mean_error(rounded, rough) <= 1.5
    assert rounded.roughness[rough.mask].unique().numel() == 1
    assert abs(math.degrees(rounded.roughness.max().item()) - 30) <= 3
    inside = rough.mask.expand(3, -1, -1)
    assert (rounded.albedo - rough.albedo)[inside].abs().mean() <= 0.02
    older = photometric_stereo(rough.images, rough.lights, rough.mask, model="qualitative")
    assert mean_error(rounded, rough) < mean_error(older, rough) < mean_error(lambert, rough)


@pytest.mark.parametrize(("scene", "wanted"), [("rough", "vcavity"), ("smooth", "lambert")])
def test_auto_takes_the_simplest_sufficient_model(scene: str, wanted: str, request: pytest.FixtureRequest) -> None:
    s: Scene = request.getfixturevalue(scene)
    found = photometric_stereo(s.images, s.lights, s.mask)
    assert found.model == wanted
    assert isinstance(found.scores, dict)
    assert set(found.scores) == {"lambert", "vcavity"}
    assert any(wanted in line and "held-out" in line for line in found.report)
    assert mean_error(found, s) <= 1.5


def test_outliers_move_robust_normals_little(smooth: Scene) -> None:
    generator = torch.Generator().manual_seed(0)
    images = smooth.images.clone()
    wrong = torch.rand(images[:, :1].shape, generator=generator) < 0.15
    images = torch.where(wrong, images + 0.8, images)
    plain = photometric_stereo(images, smooth.lights, smooth.mask, model="lambert", robust=False)
    robust = photometric_stereo(images, smooth.lights, smooth.mask, model="lambert")
    assert mean_error(robust, smooth) <= 0.4 * mean_error(plain, smooth)


def test_outside_the_mask_anything_may_be(rough: Scene) -> None:
    broken = torch.where(rough.mask, rough.images, torch.nan)
    found = photometric_stereo(broken, rough.lights, rough.mask, model="lambert")
    clean = photometric_stereo(rough.images, rough.lights, rough.mask, model="lambert")
    for name in ("normal", "albedo", "roughness", "residual", "confidence"):
        value = getattr(found, name)
        assert torch.equal(value, getattr(clean, name))
        assert (value * ~rough.mask == 0).all()


def test_same_seed_same_result(rough: Scene) -> None:
    first, second = (photometric_stereo(rough.images, rough.lights, rough.mask, seed=3) for _ in range(2))
    assert torch.equal(first.normal, second.normal)
    assert first.scores == second.scores


def test_batch_is_one_after_the_other(rough: Scene, smooth: Scene) -> None:
    images, lights = torch.stack((rough.images, smooth.images)), torch.stack((rough.lights, smooth.lights))
    both = photometric_stereo(images, lights, torch.stack((rough.mask, smooth.mask)))
    assert both.model == ("vcavity", "lambert")
    assert both.normal.shape == (2, 3, 64, 64)
    assert both.albedo.shape == (2, 3, 64, 64)
    alone = photometric_stereo(rough.images, rough.lights, rough.mask)
    assert torch.equal(both.normal[0], alone.normal)
    assert isinstance(both.scores, tuple)
    assert both.scores[0] == alone.scores


@pytest.mark.parametrize("factor", [1e-8, 1e-4, 1e4])
def test_brightness_changes_albedo_only(smooth: Scene, factor: float) -> None:
    found = photometric_stereo(smooth.images, smooth.lights, smooth.mask, model="lambert")
    dim = photometric_stereo(smooth.images * factor, smooth.lights, smooth.mask, model="lambert")
    assert angular_error(found.normal, dim.normal, smooth.mask).summary()["p90"] < 0.05
    assert torch.allclose(dim.albedo / factor, found.albedo, atol=2e-3)
    assert torch.allclose(dim.confidence, found.confidence, atol=1e-2)


def test_dark_pixels_are_counted_and_have_no_confidence(smooth: Scene) -> None:
    images = smooth.images.clone()
    images[..., 30:34, 30:34] = 0
    found = photometric_stereo(images, smooth.lights, smooth.mask, model="lambert")
    assert (found.confidence[..., 30:34, 30:34] == 0).all()
    assert any("16 pixels" in line for line in found.report)
    assert all(getattr(found, name).isfinite().all() for name in ("normal", "albedo", "residual", "confidence"))


def test_few_lights(smooth: Scene) -> None:
    lights = F.normalize(torch.tensor([[0.0, 0.4, 1], [0.4, -0.2, 1], [-0.4, -0.2, 1]]), dim=1)
    normal = smooth.normal[None, :, 24:40, 24:40]
    images = OrenNayar("lambert")(normal, lights[None], albedo=0.5)[0]
    found = photometric_stereo(images, lights)
    assert found.model == "lambert"
    assert any("too few" in line for line in found.report)
    lit = (images > 0.02).all(0)
    assert angular_error(found.normal, normal[0], lit).summary()["mean"] < 0.1


def test_three_lights_give_no_confidence(smooth: Scene) -> None:
    lights = F.normalize(torch.tensor([[0.0, 0.4, 1], [0.4, -0.2, 1], [-0.4, -0.2, 1]]), dim=1)
    found = photometric_stereo(torch.rand(3, 1, 4, 4) + 0.5, lights)
    assert (found.confidence == 0).all()
    assert any("confidence" in line for line in found.report)


def test_confidence_ranks_noise(smooth: Scene) -> None:
    """Left half clean, right half with ten times the noise: its confidence is lower, and it spreads over [0, 1]."""
    generator = torch.Generator().manual_seed(4)
    noise = torch.randn(smooth.images.shape, generator=generator) * 0.1
    noise[..., :32] = 0
    found = photometric_stereo((smooth.images + noise).clamp_min(0), smooth.lights, smooth.mask, model="lambert")
    left, right = found.confidence[..., :32][smooth.mask[..., :32]], found.confidence[..., 32:][smooth.mask[..., 32:]]
    assert left.median() > 0.7
    assert right.median() < 0.3


def test_held_out_lights_leave_a_solvable_rest() -> None:
    """Eight lights of which six lie in one plane: whatever is held out, the rest must span space."""
    plane = [[math.sin(a), 0, math.cos(a)] for a in (-0.9, -0.5, -0.2, 0.2, 0.5, 0.9)]
    lights = torch.tensor([plane[0], [0, 0.6, 0.8], *plane[1:4], [0, -0.6, 0.8], *plane[4:]])
    for seed in range(20):
        held = _hold_out(lights, seed)
        assert held is not None
        assert held.sum() == 2
        assert torch.linalg.matrix_rank(lights[~held]) == 3


def test_roughness_beyond_the_search_says_so(rough: Scene) -> None:
    normal, lights = rough.normal[None], rough.lights[None]
    images = OrenNayar("vcavity")(normal, lights, albedo=0.5, roughness=math.radians(88))[0]
    found = photometric_stereo(images, rough.lights, rough.mask, model="vcavity")
    assert any("end of the search" in line for line in found.report)


def test_close_lights_warn() -> None:
    lights = F.normalize(torch.tensor([[0.12, 0, 1], [-0.06, 0.1, 1], [-0.06, -0.1, 1]]), dim=1)
    with pytest.warns(UserWarning, match="condition number"):
        found = photometric_stereo(torch.rand(3, 1, 2, 2), lights, model="lambert")
    assert any("condition number" in line for line in found.report)


GOOD_LIGHTS = spiral_lights(6)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"images": torch.rand(6, 4, 4)}, ShapeError, "images"),
        ({"lights": torch.rand(5, 3)}, ShapeError, r"\(6, 3\)"),
        ({"lights": GOOD_LIGHTS * 2}, RangeError, "unit"),
        ({"lights": GOOD_LIGHTS * torch.nan}, RangeError, "unit"),
        ({"lights": torch.tensor([[0.0, 0, 1]]).expand(6, 3)}, CaptureError, "plane"),
        (
            {"lights": F.normalize(torch.tensor([[x, 0, 1.0] for x in (-2, -1, -0.5, 0.5, 1, 2)]), dim=1)},
            CaptureError,
            "plane",
        ),
        ({"images": torch.rand(2, 1, 4, 4), "lights": GOOD_LIGHTS[:2]}, CaptureError, "at least 3"),
        ({"images": torch.full((6, 1, 4, 4), torch.nan)}, RangeError, "16 pixels"),
        ({"mask": torch.zeros(1, 4, 4, dtype=torch.bool)}, CaptureError, "mask"),
        ({"mask": torch.ones(1, 4, 4)}, ShapeError, "bool"),
        ({"mask": torch.ones(1, 4, 5, dtype=torch.bool)}, ShapeError, "mask"),
        ({"images": torch.zeros(6, 1, 4, 4)}, CaptureError, "at least 3 lights reach"),
        ({"images": torch.ones(6, 1, 4, 4).byte()}, ShapeError, "floating"),
        ({"images": torch.rand(6, 0, 4, 4)}, ShapeError, "images"),
        ({"lights": GOOD_LIGHTS * torch.tensor([1.0, -1, -1])}, CaptureError, "swap_opencv_frame"),
        ({"model": "phong"}, ModelError, "vcavity"),
        ({"model": "vcavity", "robust": False}, CaptureError, "robust"),
        ({"images": torch.rand(4, 1, 4, 4), "lights": GOOD_LIGHTS[:4], "model": "vcavity"}, CaptureError, "at least 5"),
        ({"images": torch.rand(2, 6, 1, 4, 4)}, ShapeError, "2 captures"),
    ],
)
def test_bad_input(change: dict[str, object], error: type[Exception], words: str) -> None:
    arguments = {"images": torch.rand(6, 1, 4, 4), "lights": GOOD_LIGHTS}
    with pytest.raises(error, match=words):
        photometric_stereo(**(arguments | change))  # type: ignore[arg-type]


def test_three_by_three_systems() -> None:
    generator = torch.Generator().manual_seed(0)
    half = torch.randn(50, 3, 3, generator=generator, dtype=torch.float64)
    matrix, right = half @ half.mT, torch.randn(50, 3, generator=generator, dtype=torch.float64)
    assert torch.allclose(solve3(matrix, right), torch.linalg.solve(matrix, right), rtol=1e-6)
    assert (solve3(torch.ones(1, 3, 3), torch.ones(1, 3)) == 0).all()


@pytest.mark.parametrize(("name", "bar"), [("ball", 2.4), ("cat", 7.2), ("reading", 13.5)])
def test_real_objects(data: Path, name: str, bar: float) -> None:
    begun = time.perf_counter()
    capture = load_capture(data / "diligent" / f"{name}PNG")
    found = photometric_stereo(capture.images, capture.lights, capture.mask)
    seconds = time.perf_counter() - begun
    assert capture.normal is not None
    assert angular_error(found.normal, capture.normal, capture.mask).summary()["mean"] <= bar
    assert found.model == "lambert"
    print(f"{name}: {seconds:.1f} s")


@pytest.mark.parametrize(("name", "wanted"), [("ball", 4.29), ("cat", 8.45), ("reading", 19.12)])
def test_least_squares_on_real_objects(data: Path, name: str, wanted: float) -> None:
    capture = load_capture(data / "diligent" / f"{name}PNG")
    found = photometric_stereo(capture.images, capture.lights, capture.mask, model="lambert", robust=False)
    assert capture.normal is not None
    error: Tensor = angular_error(found.normal, capture.normal, capture.mask)
    assert error.nanmean().item() == pytest.approx(wanted, abs=0.01)
