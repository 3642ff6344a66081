from __future__ import annotations

from pathlib import Path

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torch_orennayar import OrenNayar, RangeError, load_capture
from torch_orennayar.geometry.primitives import Ball, spiral_lights
from torch_orennayar.io.capture import save_capture
from torch_orennayar.io.region import Region

BALL = Ball(31.0, 22.0, 17.0)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    normal, mask = BALL.normals((48, 64))
    lights = spiral_lights(6)
    images = OrenNayar("lambert")(normal[None], lights[None], albedo=0.5)[0].expand(-1, 3, -1, -1)
    save_capture(tmp_path, images, lights, mask, normal)
    return tmp_path


def test_pictures_mask_and_truth_are_cut_alike(folder: Path) -> None:
    whole, part = load_capture(folder), load_capture(folder, crop=(10, 4, 40, 36))
    for name in ("images", "mask", "normal"):
        assert torch.equal(getattr(part, name), getattr(whole, name)[..., 4:40, 10:50]), name
    assert "size-changed" in {note.code for note in part.notes}


def test_reduced_pictures_are_means_of_light(folder: Path) -> None:
    whole, half = load_capture(folder), load_capture(folder, scale=0.5)
    assert half.images.shape == (6, 3, 24, 32)
    assert half.normal is not None
    assert (half.images - torch.nn.functional.avg_pool2d(whole.images, 2)).abs().max() <= 1e-6
    assert (half.normal[:, half.mask[0]].norm(dim=0) - 1).abs().max() <= 1e-5
    finding = next(note for note in half.notes if note.code == "size-changed")
    assert finding.value == 0.5


def test_a_sample_that_is_clipped_anywhere_is_not_measured() -> None:
    valid = torch.ones(1, 4, 4, dtype=torch.bool)
    valid[0, 0, 1] = False
    assert Region(scale=0.5).apply_mask(valid, share=1.0).tolist() == [[[False, True], [True, True]]]


@given(st.integers(0, 30), st.integers(0, 20), st.sampled_from([1.0, 0.5, 0.25]))
def test_a_ball_moves_with_its_pixels(left: int, top: int, scale: float) -> None:
    region = Region((left, top, 64, 48), scale)
    _, inside = BALL.normals((80, 100))
    moved = region.move(BALL)
    expected = region.apply_mask(inside)
    found = moved.normals((expected.shape[1], expected.shape[2]))[1]
    assert (found != expected).sum() <= 8 * moved.radius * 0.2 + 2  # pixels on the outline


@pytest.mark.parametrize("crop", [(-1, 0, 3, 3), (0, 0, 0, 3), (0, 0, 3), (60, 0, 10, 10)])
def test_a_crop_lies_inside_the_pictures(folder: Path, crop: tuple[int, ...]) -> None:
    with pytest.raises(RangeError, match="crop: expected"):
        load_capture(folder, crop=crop)


@pytest.mark.parametrize("scale", [0.0, 1.5, float("nan")])
def test_scale_is_a_reduction(folder: Path, scale: float) -> None:
    with pytest.raises(RangeError, match="scale: expected"):
        load_capture(folder, scale=scale)
