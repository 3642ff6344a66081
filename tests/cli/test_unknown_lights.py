"""A folder of photographs without a light file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from tests.support.command_line import Run
from torch_orennayar import OrenNayar
from torch_orennayar.geometry.primitives import Ball, spiral_lights
from torch_orennayar.io.capture import save_capture
from torch_orennayar.io.images import write_image


def ball(folder: Path, *, whole: bool, brightness: float = 1.0) -> torch.Tensor:
    """A capture of a rough ball, or of a part of one, without its lights, which are returned.

    The last of the lights is ``brightness`` times as bright as the first.
    """
    normal, mask = Ball(20.0, 20.0, 17.0 if whole else 40.0).normals((41, 41))
    lights = spiral_lights(12)
    images = OrenNayar("vcavity")(normal[None], lights[None], albedo=0.6, roughness=0.5)[0].expand(-1, 3, -1, -1)
    different = torch.linspace(1, brightness, 12)[torch.randperm(12, generator=torch.Generator().manual_seed(0))]
    save_capture(folder, images, lights, mask)
    taken = images * different[:, None, None, None]
    for index, image in enumerate(taken):  # in one exposure for all
        write_image(folder / f"{index + 1:03d}.png", image / taken.max(), bits=16)
    (folder / "light_intensities.txt").unlink()
    (folder / "light_directions.txt").unlink()
    return lights


@pytest.mark.slow
def test_lights_are_found_said_and_written(orennayar: Run, tmp_path: Path) -> None:
    lights = ball(tmp_path / "photos", whole=True)
    result = orennayar("stereo", tmp_path / "photos", "-o", tmp_path / "out", "--model", "lambert")
    assert result.status == 0
    assert "12 directions were found from the photographs" in result.out
    written = torch.from_numpy(np.loadtxt(tmp_path / "out" / "light_directions.txt")).float()
    assert (written * lights).sum(1).min() > 0.999
    assert np.loadtxt(tmp_path / "out" / "light_intensities.txt").shape == (12, 3)
    again = orennayar("stereo", tmp_path / "photos", "-o", tmp_path / "out2", "--model", "lambert",
                      "--lights", tmp_path / "out" / "light_directions.txt")  # fmt: skip
    assert again.status == 0
    assert "directions were found" not in again.out


def test_an_object_without_outline_is_refused_with_both_ways_on(orennayar: Run, tmp_path: Path) -> None:
    ball(tmp_path / "photos", whole=False)
    result = orennayar("stereo", tmp_path / "photos", "-o", tmp_path / "out")
    assert result.status == 1
    assert "one line 'x y z' per image" in result.err
    assert "photograph the whole object" in result.err


@pytest.mark.slow
def test_brightness_that_differs_is_found_too(orennayar: Run, tmp_path: Path) -> None:
    lights = ball(tmp_path / "photos", whole=True, brightness=2.0)
    result = orennayar("stereo", tmp_path / "photos", "-o", tmp_path / "out", "--model", "lambert")
    assert result.status == 0
    assert "the brightness of the lights was found with them" in result.out
    written = torch.from_numpy(np.loadtxt(tmp_path / "out" / "light_directions.txt")).float()
    assert (written * lights).sum(1).min() > 0.997
    intensities = np.loadtxt(tmp_path / "out" / "light_intensities.txt")
    assert intensities.max() / intensities.min() == pytest.approx(2, abs=0.2)


@pytest.mark.filterwarnings("ignore:12 of 12 lights that were given contradict")
@pytest.mark.slow
def test_a_light_file_in_the_wrong_order_is_refined(orennayar: Run, tmp_path: Path) -> None:
    lights = ball(tmp_path / "photos", whole=True)
    np.savetxt(tmp_path / "lights.txt", lights.flip(0).numpy())
    result = orennayar("stereo", tmp_path / "photos", "-o", tmp_path / "out", "--model", "lambert", "--refine-lights",
                       "--lights", tmp_path / "lights.txt")  # fmt: skip
    assert result.status == 0
    assert "contradict the photographs" in result.out
    written = torch.from_numpy(np.loadtxt(tmp_path / "out" / "light_directions.txt")).float()
    assert (written * lights).sum(1).min() > 0.997
