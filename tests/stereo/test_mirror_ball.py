from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from torch_orennayar import CaptureError, OrenNayar
from torch_orennayar.geometry.primitives import Ball, spiral_lights
from torch_orennayar.io.ball_photographs import load_ball
from torch_orennayar.io.photographs import list_photographs, read_photographs
from torch_orennayar.stereo.calibrate import find_ball, light_directions
from torch_orennayar.stereo.mirror_ball import find_mirror_ball

SIZE = (150, 200)
ANYWHERE = [
    Ball(61.3, 48.7, 20.2),
    Ball(160.0, 120.0, 14.0),
    Ball(30.5, 100.2, 11.6),
    Ball(150.8, 40.1, 33.3),
    Ball(100.0, 75.0, 55.0),
]


def angles(found: Tensor, truth: Tensor) -> Tensor:
    return (found * truth.to(found)).sum(1).clamp(-1, 1).acos().rad2deg()


def photographs(ball: Ball, lights: Tensor, *, table: float, mirror: bool = True) -> Tensor:
    """A matt dome on a table and a ball that mirrors a dark room above its horizon and the table below it."""
    layer, generator = OrenNayar("lambert"), torch.Generator().manual_seed(3)
    flat = torch.tensor([0.0, 0.0, 1.0]).reshape(3, 1, 1).expand(3, *SIZE)
    dome, on_dome = Ball(100.0, 75.0, 40.0).normals(SIZE)
    normal = torch.where(on_dome, dome, flat)
    albedo = torch.where(on_dome, 0.7, table).expand(3, *SIZE)
    images = layer(normal[None], lights[None], albedo=albedo[None])[0]
    own, inside = ball.normals(SIZE)
    if mirror:
        mirrored = 2 * own[2:] * own - flat
        cosine = torch.einsum("kc,chw->khw", lights, mirrored)
        lamp = 20 * torch.exp((cosine - 1) / 0.05**2)  # far brighter than anything matt
        seen = torch.where(mirrored[2:] > 0, 0.01, 0.5 * table)[None] + lamp[:, None]
    else:
        seen = layer(own[None], lights[None], albedo=0.5)[0][:, :1]
    images = torch.where(inside, seen, images)
    blurred = F.avg_pool2d(F.pad(images, (1, 1, 1, 1), "replicate"), 3, 1)
    return (blurred + 0.004 * torch.randn(images.shape, generator=generator)).clamp(0, 1)


@pytest.mark.parametrize("table", [0.02, 0.45])
@pytest.mark.parametrize("ball", ANYWHERE)
def test_a_ball_is_found_beside_an_object(ball: Ball, table: float) -> None:
    lights = spiral_lights(10)
    images = photographs(ball, lights, table=table)
    found = find_mirror_ball(images)
    assert math.hypot(found.x - ball.x, found.y - ball.y) <= 0.04 * ball.radius + 0.3
    assert abs(found.radius - ball.radius) <= 0.04 * ball.radius + 0.3
    assert angles(light_directions(images, found), lights).mean() <= 5


@pytest.mark.parametrize("ball", ANYWHERE[:3])
def test_what_is_no_mirror_is_not_taken_for_one(ball: Ball) -> None:
    with pytest.raises(CaptureError, match=r"a mirror ball's highlight under each light.*--ball X,Y,RADIUS"):
        find_mirror_ball(photographs(ball, spiral_lights(10), table=0.3, mirror=False))


def test_two_photographs_are_too_few() -> None:
    with pytest.raises(CaptureError, match="at least 3 photographs"):
        find_mirror_ball(torch.rand(2, 3, 30, 30))


def test_a_ball_outside_the_pictures_is_refused() -> None:
    with pytest.raises(CaptureError, match="ball: expected a circle inside 30 x 20 pixels, got 500, 10, 8"):
        light_directions(torch.rand(3, 1, 20, 30), Ball(500.0, 10.0, 8.0))


def test_what_the_ball_mirrors_under_every_light_is_no_highlight() -> None:
    ball, lights = ANYWHERE[0], spiral_lights(6)
    images = photographs(ball, lights, table=0.1)
    images[:, :, 40:44, 50:56] = 1.0  # a window
    assert angles(light_directions(images, ball), lights).max() <= 3


def test_the_ball_of_a_real_capture_is_that_of_its_mask(data: Path) -> None:
    images, mask = load_ball(data / "uw_psm" / "chrome", encoding="linear")
    assert mask is not None
    by_mask = light_directions(images, find_ball(mask))
    assert angles(light_directions(images, find_mirror_ball(images)), by_mask).max() <= 3


@pytest.mark.parametrize(
    ("folder", "ball"),
    [("moai_ball", Ball(712.5, 487.5, 108.8)), ("plaster_frog/probe", Ball(576.0, 572.5, 489.5))],
)
def test_balls_of_real_captures_are_those_marked_by_hand(data: Path, folder: str, ball: Ball) -> None:
    files = list_photographs(data / "captures" / folder, ())
    images = read_photographs(files, "auto", torch.ones(len(files), 3)).images
    found = light_directions(images, find_mirror_ball(images))
    assert angles(found, light_directions(images, ball)).max() <= 1.5
