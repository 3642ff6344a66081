"""Samples at full scale are missing, not measured."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from tests.support.objects import findings, mean_error
from torch_orennayar import OrenNayar, ShapeError, angular_error, photometric_stereo
from torch_orennayar.geometry.primitives import spiral_lights
from torch_orennayar.stereo.normal_fill import fill_normals

SIZE = 40


@dataclass(frozen=True)
class Ball:
    """A Lambertian ball under lights, in the unit of its full scale before exposure."""

    normal: Tensor
    mask: Tensor
    lights: Tensor
    images: Tensor


@pytest.fixture(scope="module")
def ball() -> Ball:
    middle = (SIZE - 1) / 2
    y, x = torch.meshgrid(middle - torch.arange(SIZE), torch.arange(SIZE) - middle, indexing="ij")
    mask = x * x + y * y < 320
    normal = F.normalize(torch.stack((x, y, (400 - x * x - y * y).clamp_min(1).sqrt())), dim=0) * mask
    lights = spiral_lights(12)
    return Ball(normal, mask[None], lights, OrenNayar("lambert")(normal[None], lights[None], albedo=0.8)[0])


@pytest.mark.parametrize("model", ["lambert", "auto"])
@pytest.mark.parametrize(("exposure", "bar"), [(1.5, 0.02), (2.0, 0.05), (3.0, 1.0)])
def test_clipped_samples_do_not_bend_the_normals(ball: Ball, model: str, exposure: float, bar: float) -> None:
    """Seven samples in ten at exposure 3, where four pixels in ten keep fewer than three."""
    shot = (ball.images * exposure).clamp(0, 1)
    found = photometric_stereo(shot, ball.lights, ball.mask, model=model)
    share = 100 * (shot[:, 0][:, ball.mask[0]] >= 1).double().mean().item()
    assert [f.value for f in findings(found, "clipped-samples")] == [pytest.approx(share)]
    assert mean_error(found, ball) < bar
    assert found.albedo[ball.mask].median().item() / exposure == pytest.approx(0.8, abs=0.01)


def test_what_the_caller_calls_valid_counts(ball: Ball) -> None:
    """Images that are divided by intensities do not show where full scale is."""
    gain = torch.linspace(0.5, 2, 12).reshape(-1, 1, 1, 1)
    shot = (2 * ball.images * gain).clamp(0, 1)
    valid = shot < 1
    unknown = photometric_stereo(shot / gain, ball.lights, ball.mask, model="lambert")
    known = photometric_stereo(shot / gain, ball.lights, ball.mask, model="lambert", valid=valid)
    batched = photometric_stereo(
        (shot / gain)[None], ball.lights[None], ball.mask[None], model="lambert", valid=valid[None]
    )
    assert mean_error(known, ball) < 0.5 < mean_error(unknown, ball)
    assert torch.equal(batched.normal[0], known.normal)
    plain = photometric_stereo(shot / gain, ball.lights, ball.mask, model="lambert", robust=False, valid=valid)
    every = photometric_stereo(shot / gain, ball.lights, ball.mask, model="lambert", robust=False)
    whole = photometric_stereo(2 * ball.images, ball.lights, ball.mask, model="lambert", robust=False)
    assert mean_error(plain, ball) < mean_error(every, ball)
    assert mean_error(plain, ball) < mean_error(whole, ball) + 3
    for wrong in (valid[:3], valid.float()):
        with pytest.raises(ShapeError, match="valid"):
            photometric_stereo(shot, ball.lights, ball.mask, valid=wrong)


@pytest.mark.parametrize("images", ["brighter than 1", "a single 1", "flat"])
def test_ones_that_are_no_full_scale(ball: Ball, images: str) -> None:
    shot = ball.images.clone()
    if images == "brighter than 1":
        shot = 2 * shot
        shot[:, :, 20, 18:22] = 1
    elif images == "a single 1":
        shot = shot / shot.max()
    found = photometric_stereo(shot, ball.lights, ball.mask, model="lambert")
    assert findings(found, "clipped-samples") == []


def test_black_pixels_have_albedo_0_in_least_squares(ball: Ball) -> None:
    """As after the ambient light was subtracted."""
    shot = ball.images.clone()
    shot[:, :, 18:22, 18:22] = 0
    for robust in (False, True):
        found = photometric_stereo(shot, ball.lights, ball.mask, model="lambert", robust=robust)
        assert found.albedo.isfinite().all()
        assert (found.albedo[:, 18:22, 18:22] < 1e-6).all()
        assert (found.confidence[:, 18:22, 18:22] == 0).all()
        assert mean_error(found, ball) < 3


def test_gaps_are_filled_from_their_neighbourhood(ball: Ball) -> None:
    """The normals of a sphere are linear in the picture, so that the flattest continuation is nearly right."""
    gap = torch.zeros(SIZE, SIZE, dtype=torch.bool)
    gap[12:24, 15:25] = gap[20, :] = True
    broken = torch.where(gap, torch.tensor([1.0, 0, 0]).reshape(3, 1, 1), ball.normal)
    filled = fill_normals(broken, gap, ball.mask[0])
    assert torch.equal(filled[:, ~gap], ball.normal[:, ~gap])
    inside = ball.mask[0] & gap
    assert angular_error(filled, ball.normal, inside[None]).summary()["mean"] < 2
    assert torch.equal(fill_normals(broken, ball.mask[0], ball.mask[0]), broken)
