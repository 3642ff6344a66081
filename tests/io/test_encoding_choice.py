"""8-bit photographs that do not say how they are encoded: the lights that are left out tell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from torch_orennayar import OrenNayar, linear_to_srgb, load_capture
from torch_orennayar.geometry.primitives import Ball, spiral_lights


def photographs(folder: Path, count: int, *, linear: bool) -> Tensor:
    """A capture of a rough ball in 8-bit files without any statement; its images in linear light."""
    normal, mask = Ball(23.5, 23.5, 21.0).normals((48, 48))
    lights = spiral_lights(count)
    images = OrenNayar("vcavity")(normal[None], lights[None], albedo=0.8, roughness=0.4)[0].expand(-1, 3, -1, -1)
    folder.mkdir()
    for index, image in enumerate(images if linear else linear_to_srgb(images)):
        values = (255 * image.permute(1, 2, 0)).round().to(torch.uint8).numpy()
        Image.fromarray(values).save(folder / f"{index:03d}.png")
    Image.fromarray((255 * mask[0].numpy()).astype(np.uint8)).save(folder / "mask.png")
    np.savetxt(folder / "light_directions.txt", lights.numpy())
    return images


@pytest.mark.parametrize("linear", [True, False], ids=["linear", "srgb"])
def test_what_predicts_better_is_read(tmp_path: Path, *, linear: bool) -> None:
    images = photographs(tmp_path / "photos", 12, linear=linear)
    capture = load_capture(tmp_path / "photos")
    assert (capture.images - images).abs().max() < 0.01
    codes = {note.code: note for note in capture.notes}
    assert ("read-as-linear" if linear else "read-as-srgb") in codes
    ratio = codes["encoding-chosen"].value
    assert ratio is not None
    assert ratio < 0.7 if linear else ratio > 1


def test_what_the_caller_says_is_obeyed(tmp_path: Path) -> None:
    photographs(tmp_path / "photos", 12, linear=True)
    capture = load_capture(tmp_path / "photos", encoding="srgb")
    assert "encoding-chosen" not in {note.code for note in capture.notes}
    assert capture.images.max() < 0.8


def test_few_lights_do_not_tell(tmp_path: Path) -> None:
    photographs(tmp_path / "photos", 6, linear=True)
    codes = {note.code for note in load_capture(tmp_path / "photos").notes}
    assert "read-as-srgb" in codes
    assert "encoding-chosen" not in codes


@pytest.mark.slow
def test_photographs_that_are_known_to_be_linear(data: Path) -> None:
    """The University of Washington's grey ball."""
    lights = data / "uw_psm" / "light_directions.txt"
    codes = {note.code for note in load_capture(data / "uw_psm" / "gray", lights=lights).notes}
    assert "read-as-linear" in codes
