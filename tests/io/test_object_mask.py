from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor

from torch_orennayar import OrenNayar
from torch_orennayar.geometry.primitives import Ball, spiral_lights
from torch_orennayar.io.masks import find_mask, read_mask
from torch_orennayar.io.object_mask import disc, find_object
from torch_orennayar.io.photographs import list_photographs, read_photographs

SIZE = (80, 100)
BALL = Ball(52.0, 38.0, 26.0)


def overlap(one: Tensor, other: Tensor) -> float:
    return float((one & other).sum()) / float((one | other).sum())


def photographs(background: float) -> tuple[Tensor, Tensor]:
    """A sphere with a band of dark paint and a cast speck, before a background that reflects so much."""
    normal, inside = BALL.normals(SIZE)
    albedo = torch.full((1, *SIZE), 0.6)
    albedo[:, 36:40, 50:54] = 0.02
    shaded = OrenNayar("lambert")(normal[None], spiral_lights(8)[None], albedo=albedo[None])[0]
    images = torch.where(inside, shaded, background)
    images[0, :, 2:4, 2:4] = 1.0  # one reflection, in one photograph
    noise = 0.002 * torch.randn(images.shape, generator=torch.Generator().manual_seed(0))
    return (images + noise).clamp(0, 1).expand(-1, 3, -1, -1), inside


def test_an_object_before_dark_cloth_is_found_with_its_dark_paint() -> None:
    images, inside = photographs(0.004)
    found = find_object(images)
    assert found.finding.code == "mask-found"
    assert overlap(found.inside, inside) >= 0.97
    assert bool(found.inside[0, 38, 52])


def test_before_a_light_background_every_pixel_counts() -> None:
    found = find_object(photographs(0.3)[0])
    assert found.finding.code == "no-mask"
    assert bool(found.inside.all())


def test_what_fills_the_picture_is_no_object_before_a_background() -> None:
    images = photographs(0.004)[0][:, :, 24:56, 40:70]  # the sphere covers the border
    assert bool(find_object(images).inside.all())


def test_a_ball_and_its_blurred_edge_are_left_out() -> None:
    left_out = disc(BALL, SIZE)
    assert bool(left_out[0, 38, 52 + 27])
    assert not bool(left_out[0, 38, 52 + 30])


@pytest.mark.parametrize(
    "folder",
    [
        "captures/plaster_frog/photographs", "uw_psm/cat", "uw_psm/gray",
        "diligent/ballPNG", "diligent/catPNG", "diligent/readingPNG",
    ],
)  # fmt: skip
def test_masks_of_real_captures(data: Path, folder: str) -> None:
    mask = find_mask(data / folder)
    files = list_photographs(data / folder, () if mask is None else (mask,))[:24]
    photographed = read_photographs(files, "auto", torch.ones(len(files), 3))
    given, _ = read_mask(mask, photographed.size)
    assert overlap(find_object(photographed.images).inside, given) >= 0.97
