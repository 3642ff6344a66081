"""Captures of several materials, and the network's normals beside the fitted ones."""

from __future__ import annotations

import math

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from tests.support.rendered_captures import MATERIALS, Rendered, Surface, capture, halves_capture, objects
from torch_orennayar import OrenNayar, Reconstruction, angular_error, photometric_stereo
from torch_orennayar.geometry.primitives import spiral_lights
from torch_orennayar.stereo import row_bands
from torch_orennayar.stereo.channel_fit import fit_under
from torch_orennayar.stereo.material import LightDirections, Material
from torch_orennayar.stereo.mixed_fit import Mixture
from torch_orennayar.stereo.pixel_sample import SAMPLE_PIXELS, TILE, PixelSample, draw_tiles
from torch_orennayar.stereo.robust_fit import PixelFit, predict

ROUGH, PLASTIC = Surface("vcavity", 30.0, 0.7), Surface("lambert", 0.0, 0.4, ((0.2, 0.1),))


def error(case: Rendered, normal: Tensor, where: Tensor | None = None) -> float:
    mask = case.mask if where is None else case.mask & where
    return angular_error(normal, case.normal, mask).summary()["mean"]


def codes(found: Reconstruction) -> list[str]:
    return [finding.code for finding in found.report]


def test_rough_and_plastic_halves_are_told_apart() -> None:
    scene, truth = halves_capture(ROUGH, PLASTIC)
    found = photometric_stereo(scene.images, scene.lights, scene.mask)
    one = photometric_stereo(scene.images, scene.lights, scene.mask, model="vcavity")
    assert error(scene, found.normal) < 1.5
    assert error(scene, found.normal) < 0.5 * error(scene, one.normal)
    assert found.material is not None
    assert found.material.dtype == torch.int64
    assert bool((found.material[~scene.mask] == -1).all())
    label, true = found.material[scene.mask], truth[scene.mask]
    assert int(label.min()) >= 0
    assert int(label.max()) < len(found.falloffs)
    purity = sum(true[label == k].bincount().max().item() for k in label.unique().tolist()) / len(label)
    assert purity > 0.9
    there = torch.rad2deg(found.roughness[scene.mask & (truth == 0)])
    assert there.median().item() == pytest.approx(30, abs=5)
    (finding,) = (f for f in found.report if f.code == "materials")
    assert finding.value == len(found.falloffs)
    assert "vcavity" in finding
    relit = found.shade(scene.lights[:2])
    missed = (relit - scene.images[:2]).abs()[:, :, scene.mask[0]].mean() / scene.images[:2, :, scene.mask[0]].mean()
    assert missed < 0.06


@pytest.mark.parametrize("surface", [ROUGH, MATERIALS["alumina-oxide"]], ids=["rough", "alumina-oxide"])
def test_one_material_stays_one(surface: Surface) -> None:
    scene = capture(objects()["bumps"], surface, size=64)
    found = photometric_stereo(scene.images, scene.lights, scene.mask)
    assert found.material is None
    assert found.falloffs == ()
    assert "materials" not in codes(found)
    assert "network-beside" in codes(found)


def test_metal_gets_its_normals_from_the_network() -> None:
    metal = Surface("lambert", 0.0, 0.0, ((0.4, 0.5), (0.2, 0.1)))
    scene, truth = halves_capture(ROUGH, metal)
    found = photometric_stereo(scene.images, scene.lights, scene.mask)
    learned = photometric_stereo(scene.images, scene.lights, scene.mask, model="network")
    assert "taken where" in next(f for f in found.report if f.code == "network-beside")
    assert error(scene, found.normal, truth == 1) < 1.2 * error(scene, learned.normal, truth == 1)
    assert error(scene, found.normal, truth == 0) < 0.7 * error(scene, learned.normal, truth == 0)


def test_the_network_moves_nothing_that_fits_perfectly() -> None:
    normal = F.normalize(torch.randn(3, 12, 12, generator=torch.Generator().manual_seed(0)) * 0.3, dim=0)
    normal = F.normalize(normal + torch.tensor([0.0, 0.0, 1.0])[:, None, None], dim=0)
    lights = spiral_lights(24, math.radians(40))
    images = torch.stack([OrenNayar("lambert")(normal[None], light[None], albedo=0.5)[0] for light in lights])
    found = photometric_stereo(images, lights)
    assert angular_error(found.normal, normal, torch.ones(1, 12, 12, dtype=torch.bool)).max() < 0.05


def test_albedo_and_highlights_under_true_normals() -> None:
    generator = torch.Generator().manual_seed(0)
    normal = torch.randn(40, 3, generator=generator, dtype=torch.float64) * torch.tensor([0.3, 0.3, 0.0])
    normal = F.normalize(normal + torch.tensor([0.0, 0.0, 1.0]), dim=1)
    material = Material(minnaert_exponent=1.1, exponents=(8, 64))
    albedo = 0.2 + torch.rand(40, 1, generator=generator, dtype=torch.float64)
    lobes = 0.5 + torch.rand(40, 2, generator=generator, dtype=torch.float64)
    true = PixelFit(normal, albedo, lobes, albedo, albedo, albedo)
    directions = LightDirections.of(spiral_lights(60, math.radians(50)).double())
    sample = PixelSample(predict(true, directions, material), directions, torch.arange(40), 40)
    found = fit_under(normal, sample, material, "lit")
    assert (found.albedo / albedo - 1).abs().median() < 0.02  # the prior on lobes moves some of them
    assert (found.lobes / lobes - 1).abs().median() < 0.1
    assert (found.residual / sample.grey.mean(1, keepdim=True)).median() < 0.01


@pytest.mark.parametrize(("height", "width"), [(20, 30), (200, 150)])
def test_tiles_hold_about_as_many_pixels(height: int, width: int) -> None:
    lit = torch.rand(height, width, generator=torch.Generator().manual_seed(0)) < 0.8
    places = draw_tiles(lit, 0)
    assert bool((places.diff() > 0).all())
    assert bool(lit.flatten()[places].all())
    assert min(SAMPLE_PIXELS, int(lit.sum())) <= len(places) < SAMPLE_PIXELS + TILE**2
    assert places.equal(draw_tiles(lit, 0))


@pytest.mark.slow
def test_bands_leave_no_seam(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, _ = halves_capture(ROUGH, PLASTIC, lights=24)
    lobed = Material(exponents=(16,))
    mixture = Mixture((lobed, Material("vcavity", math.radians(40))), by_network=True)
    whole = row_bands.solve_bands(scene.images, scene.lights, scene.mask[0], lobed, "lit", mixture=mixture)
    monkeypatch.setattr(row_bands, "band_height", lambda count, inside: 24)
    banded = row_bands.solve_bands(scene.images, scene.lights, scene.mask[0], lobed, "lit", mixture=mixture)
    for name, a, b in zip(("normal", "albedo"), whole.tensors(), banded.tensors(), strict=False):
        assert a.allclose(b, atol=1e-3), name
    assert whole.material is not None
    assert banded.material is not None
    assert whole.material.equal(banded.material)
