"""The brightness of lights: given, equal or unknown, with directions given or not."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from tests.support.objects import findings
from torch_orennayar import OrenNayar, RangeError, ShapeError, photometric_stereo
from torch_orennayar.geometry.primitives import Ball, spiral_lights

COUNT = 12


@pytest.fixture(scope="module")
def ball() -> tuple[Tensor, Tensor, Tensor]:
    """Images under lights of different brightness, (12, 3) colours of these, and the mask."""
    normal, mask = Ball(23.5, 23.5, 21.0).normals((48, 48))
    images = OrenNayar("lambert")(normal[None], spiral_lights(COUNT)[None], albedo=torch.tensor([0.6, 0.5, 0.4]))[0]
    colour = 0.7 + 0.6 * torch.rand(COUNT, 3, generator=torch.Generator().manual_seed(0))
    return images * colour[:, :, None, None], colour, mask


def test_given_brightness_is_divided_out(ball: tuple[Tensor, Tensor, Tensor]) -> None:
    images, colour, mask = ball
    lights = spiral_lights(COUNT)
    by_hand = photometric_stereo(images / colour[:, :, None, None], lights, mask, model="lambert")
    found = photometric_stereo(images, lights, mask, model="lambert", intensities=colour)
    assert torch.equal(found.normal, by_hand.normal)
    assert torch.equal(found.albedo, by_hand.albedo)
    assert found.intensities is not None
    assert torch.equal(found.intensities, colour)
    assert by_hand.intensities is None
    batch = photometric_stereo(
        torch.stack((images, images)),
        torch.stack((lights, lights)),
        torch.stack((mask, mask)),
        model="lambert",
        intensities=torch.stack((colour, colour)),
    )
    assert torch.equal(batch.normal[1], by_hand.normal)
    assert batch.intensities is not None
    assert batch.intensities.shape == (2, COUNT, 3)


def test_samples_at_full_scale_are_left_out_before_the_division(ball: tuple[Tensor, Tensor, Tensor]) -> None:
    images, colour, mask = ball
    clipped = (3 * images).clamp(max=1)
    found = photometric_stereo(clipped, spiral_lights(COUNT), mask, model="lambert", intensities=colour)
    assert findings(found, "clipped-samples")


def test_unknown_brightness_of_known_lights(ball: tuple[Tensor, Tensor, Tensor]) -> None:
    images, colour, mask = ball
    grey = images.mean(1, keepdim=True)
    found = photometric_stereo(grey, spiral_lights(COUNT), mask, model="lambert", intensities="unknown")
    assert found.intensities is not None
    ratio = found.intensities[:, 0] / (colour * torch.tensor([0.6, 0.5, 0.4])).mean(1)
    assert ratio.std() / ratio.mean() < 0.02
    assert findings(found, "intensities-from-capture")


def test_known_lights_that_are_not_equally_bright_are_told(ball: tuple[Tensor, Tensor, Tensor]) -> None:
    images, colour, mask = ball
    even = images / colour[:, :, None, None]
    shuffled = torch.randperm(COUNT, generator=torch.Generator().manual_seed(0))
    uneven = even * torch.linspace(0.5, 1.5, COUNT)[shuffled][:, None, None, None]
    found = photometric_stereo(uneven, spiral_lights(COUNT), mask, model="lambert")
    assert findings(found, "lights-unequal")
    assert not findings(photometric_stereo(even, spiral_lights(COUNT), mask, model="lambert"), "lights-unequal")


@pytest.mark.parametrize(
    ("intensities", "error", "match"),
    [
        pytest.param(torch.ones(5), ShapeError, "one number per light", id="another number"),
        pytest.param(torch.ones(COUNT, 2), ShapeError, "one per light and channel", id="another number of channels"),
        pytest.param(torch.zeros(COUNT), RangeError, "> 0", id="off"),
        pytest.param("same", RangeError, "'equal', 'unknown' or a tensor", id="another word"),
    ],
)
def test_other_intensities_are_refused(
    ball: tuple[Tensor, Tensor, Tensor], intensities: object, error: type[Exception], match: str
) -> None:
    images, _, mask = ball
    with pytest.raises(error, match=match):
        photometric_stereo(images, spiral_lights(COUNT), mask, intensities=intensities)  # type: ignore[arg-type]
