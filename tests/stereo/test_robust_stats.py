"""Which observations count, how much, and what the confidence makes of an error."""

from __future__ import annotations

import math

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from torch_orennayar.geometry.primitives import spiral_lights
from torch_orennayar.reconstruction import confidence_from_error
from torch_orennayar.stereo.pixel_sample import PixelSample
from torch_orennayar.stereo.robust_stats import (
    MIDDLE_RANKS,
    SHADOW,
    SHADOW_RAMP,
    geman_mcclure,
    geman_mcclure_cost,
    in_light,
    median_rank,
    noise_level,
    quantile,
    select,
    soft_in_light,
    soft_middle,
)


@pytest.fixture
def grey() -> Tensor:
    """Observations of 200 pixels under 24 lights, a fifth of them in shadow."""
    generator = torch.Generator().manual_seed(0)
    return torch.rand(200, 24, generator=generator).sub(0.2).clamp_min(0)


def test_continuous_selections_are_the_others_away_from_the_step(grey: Tensor) -> None:
    bright = quantile(grey.sort(1)[0], torch.full((1, 1), 0.9))
    far = (grey / bright - SHADOW).abs() > SHADOW_RAMP
    assert torch.equal(soft_in_light(grey)[far], in_light(grey)[far])
    hard, soft = select(grey, "middle"), soft_middle(grey)
    assert ((hard > 0) == (soft > 0.5)).double().mean() > 0.9
    assert soft.mean() == pytest.approx(MIDDLE_RANKS[1] - MIDDLE_RANKS[0], abs=0.1)


@pytest.mark.parametrize("count", [4, 6])
def test_few_lights_all_count(count: int) -> None:
    bright = torch.rand(50, count, generator=torch.Generator().manual_seed(0)) + 0.5
    for used in (select(bright, "middle"), select(bright, "lit"), select(bright, "all"), soft_middle(bright)):
        assert torch.equal(used, torch.ones_like(bright))


def test_noise_is_the_standard_deviation_whatever_the_outliers() -> None:
    residual = 0.05 * torch.randn(400, 200, generator=torch.Generator().manual_seed(0))
    selected = torch.ones_like(residual)
    residual[:, :20] = 10
    selected[:, :20] = 0
    noise = noise_level(residual, selected, median_rank(selected))
    assert noise.mean().item() == pytest.approx(0.05, rel=0.02)


def test_weights_are_those_of_the_cost() -> None:
    """A weight is the cost's derivative over that of least squares."""
    noise = torch.tensor(0.1, dtype=torch.float64)
    residual = torch.linspace(-1, 1, 201, dtype=torch.float64).requires_grad_()
    (slope,) = torch.autograd.grad(geman_mcclure_cost(residual, noise).sum(), residual)
    weight = geman_mcclure(torch.ones_like(residual), residual, noise)
    assert torch.allclose(slope, 2 * residual / (2 * noise) ** 2 * weight)


def test_confidence_of_an_error() -> None:
    error = torch.tensor([0.0, math.radians(2), math.inf])
    assert confidence_from_error(error).tolist() == pytest.approx([1, 0.5, 0])


@pytest.mark.parametrize("near", [False, True])
def test_samples_are_the_pixels_at_their_places(near: bool) -> None:
    generator = torch.Generator().manual_seed(0)
    images, lights = torch.rand(9, 3, 5, 7, generator=generator), spiral_lights(9)
    if near:
        lights = F.normalize(lights[:, :, None, None] + 0.1 * torch.rand(9, 3, 5, 7, generator=generator), dim=1)
    sample = PixelSample.gather(images, lights, torch.tensor([33, 8, 20]))
    assert sample.rows_and_columns().tolist() == [[4, 5], [1, 1], [2, 6]]
    assert torch.allclose(sample.grey[1], images[:, :, 1, 1].mean(1))
    out = torch.arange(9) < 4
    part = sample.under(~out)[1:]
    assert torch.equal(part.grey, sample.grey[1:, 4:])
    assert torch.equal(part.places, torch.tensor([8, 20]))
    assert len(part.directions) == 5
    wanted = lights[4:, :, 2, 6] if near else lights[4:]
    assert torch.equal(part.directions.light[1] if near else part.directions.light, wanted)
