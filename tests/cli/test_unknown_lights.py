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


def ball(folder: Path, *, whole: bool) -> torch.Tensor:
    """A capture of a ball, or of a part of one, without its lights, which are returned."""
    normal, mask = Ball(20.0, 20.0, 17.0 if whole else 40.0).normals((41, 41))
    lights = spiral_lights(12)
    images = OrenNayar("lambert")(normal[None], lights[None], albedo=0.6)[0].expand(-1, 3, -1, -1)
    save_capture(folder, images, lights, mask)
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
