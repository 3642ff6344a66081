"""Gauss-Newton steps compiled by numba against those of torch in float64."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from torch_orennayar import photometric_stereo
from torch_orennayar.core.optional import available
from torch_orennayar.stereo import robust_fit
from torch_orennayar.stereo.gauss_newton import Estimate, gauss_newton
from torch_orennayar.stereo.material import LightDirections, Material, respond
from torch_orennayar.stereo.material_selection import MIN_LIGHTS_LOBES

pytestmark = pytest.mark.skipif(not available("numba"), reason="numba is not installed")

PIXELS = 50
MATERIALS = (
    Material(),
    Material(minnaert_exponent=1.2),
    Material("vcavity", roughness=0.5),
    Material(exponents=(64,)),
    Material(minnaert_exponent=1.1, exponents=(8, 64)),
    Material("vcavity", roughness=0.3, exponents=(16,)),
)


def directions(count: int, generator: torch.Generator, spread: float = 0.6) -> Tensor:
    """Unit vectors (count, 3) about the view."""
    vectors = torch.randn(count, 3, generator=generator) * torch.tensor([spread, spread, 0.1])
    return F.normalize(vectors + torch.tensor([0.0, 0.0, 1.0]), dim=1)


@pytest.mark.parametrize(
    ("material", "lights"), [(m, n) for m in MATERIALS for n in (5, 37) if n >= MIN_LIGHTS_LOBES or not m.exponents]
)
@pytest.mark.parametrize("near", [False, True], ids=["distant", "near"])
@pytest.mark.parametrize("pulled", [False, True], ids=["alone", "with neighbours"])
def test_the_same_steps(material: Material, lights: int, near: bool, pulled: bool) -> None:
    from torch_orennayar.stereo.compiled_fit import compiled_gauss_newton

    generator = torch.Generator().manual_seed(lights)
    light, normal = directions(lights, generator), directions(PIXELS, generator, 0.4)
    if near:
        light = F.normalize(light + 0.05 * torch.randn(PIXELS, lights, 3, generator=generator), dim=2)
    toward = LightDirections.of(light)
    one, lobes = torch.ones(PIXELS, 1), torch.full((PIXELS, len(material.exponents)), 0.2)
    images = respond(material, normal, one / 2, lobes, toward, one).value
    images = (images + 0.01 * torch.randn(images.shape, generator=generator)).clamp_min(0)
    mean = images.mean(1, keepdim=True)
    selected = (images > 0.05 * mean).float()
    start = Estimate(F.normalize(normal + 0.1 * torch.randn(PIXELS, 3, generator=generator), dim=1), one, 0 * lobes)
    prior = F.normalize(normal + 0.02 * torch.randn(PIXELS, 3, generator=generator), dim=1) if pulled else None
    given = (images / mean, selected, mean, toward)
    found, quality = compiled_gauss_newton(*given, material, start, 3, prior)
    precise = LightDirections(toward.light.double(), toward.half.double())
    seen, used, level = (t.double() for t in given[:3])
    wanted, expected = gauss_newton(
        seen,
        used,
        level,
        precise,
        material,
        Estimate(*(t.double() for t in start)),
        3,
        None if prior is None else prior.double(),
    )
    for got, true in zip((*found, *quality), (*wanted, *expected), strict=True):
        torch.testing.assert_close(got.double(), true, rtol=1e-4, atol=1e-4)


@given(values=st.lists(st.floats(0, 1e6, width=32), min_size=1, max_size=40), seed=st.integers(0, 99))
def test_median_is_that_of_sorting(values: list[float], seed: int) -> None:
    from torch_orennayar.stereo.compiled_fit import UNUSED, _ranked

    array = np.array([*values, UNUSED], np.float32)
    rank = seed % len(values)
    for guess in (0.01, 0.1, 7.0):
        assert _ranked(array, rank, np.float32(guess)) == np.sort(array)[rank]


@pytest.mark.parametrize("model", ["lambert", "vcavity", "auto"])
def test_the_solver_finds_the_same(model: str, monkeypatch: pytest.MonkeyPatch) -> None:
    generator = torch.Generator().manual_seed(0)
    lights = directions(24, generator)
    row, column = torch.meshgrid(torch.linspace(0.6, -0.6, 24), torch.linspace(-0.6, 0.6, 24), indexing="ij")
    normal = F.normalize(torch.stack((column, row, (1 - column**2 - row**2).sqrt())), dim=0)
    pixels, one = normal.flatten(1).T, torch.ones(24 * 24, 1)
    shown = respond(Material("vcavity", roughness=0.4), pixels, 0.6 * one, one[:, :0], LightDirections.of(lights), one)
    images = shown.value.T.reshape(24, 1, 24, 24)
    images = (images + 0.003 * torch.randn(images.shape, generator=generator)).clamp_min(0)
    compiled = photometric_stereo(images, lights, model=model)
    monkeypatch.setattr(robust_fit, "available", lambda *_: False)
    plain = photometric_stereo(images, lights, model=model)
    assert (compiled.normal - plain.normal).abs().max() < 2e-3
    assert (compiled.albedo - plain.albedo).abs().max() < 2e-3
    assert compiled.model == plain.model
    assert compiled.scores.keys() == plain.scores.keys()
    for name, score in compiled.scores.items():
        assert score == pytest.approx(plain.scores[name], rel=2e-3)


def test_a_pixel_does_not_depend_on_those_beside_it() -> None:
    from torch_orennayar.stereo.compiled_fit import compiled_gauss_newton

    generator = torch.Generator().manual_seed(1)
    toward, seen = LightDirections.of(directions(30, generator)), torch.rand(64, 30, generator=generator)
    normal, one = directions(64, generator, 0.2), torch.ones(64, 1)

    def solve(part: slice) -> list[Tensor]:
        start = Estimate(normal[part], one[part], one[part])
        used = (seen[part] > 0.2).float()
        found = compiled_gauss_newton(seen[part], used, one[part], toward, Material(exponents=(16,)), start, 10, None)
        return [value for values in found for value in values]

    for whole, alone in zip(solve(slice(None)), solve(slice(17, 40)), strict=True):
        assert torch.equal(whole[17:40], alone)
