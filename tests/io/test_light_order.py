"""Light files without names: their lines may follow the alphabet, 1, 10, 2, where photographs are taken as 1, 2, 10."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor

from torch_orennayar import Capture, OrenNayar, load_capture
from torch_orennayar.geometry.primitives import Ball, spiral_lights
from torch_orennayar.io.images import write_image

COUNT = 12


def photograph(folder: Path, brightness: Tensor) -> None:
    """1.png to 12.png of a rough ball, whose light k + 1 shines brightness[k], and mask.png."""
    normal, mask = Ball(23.5, 23.5, 21.0).normals((48, 48))
    shaded = OrenNayar("vcavity")(normal[None], spiral_lights(COUNT)[None], albedo=0.4, roughness=0.4)[0]
    for k, image in enumerate(shaded * brightness[:, None, None, None]):
        write_image(folder / f"{k + 1}.png", image.expand(3, -1, -1), bits=16)
    write_image(folder / "mask.png", mask.float())


def list_lights(folder: Path, order: list[int]) -> None:
    lines = [" ".join(f"{v:.6f}" for v in spiral_lights(COUNT)[k].tolist()) for k in order]
    (folder / "light_directions.txt").write_text("\n".join(lines) + "\n")


def codes(capture: Capture) -> set[str]:
    return {note.code for note in capture.notes}


ALPHABETICAL = sorted(range(COUNT), key=lambda k: f"{k + 1}.png")
EQUAL = torch.ones(COUNT)
UNEQUAL = torch.linspace(0.4, 1.6, COUNT)[torch.randperm(COUNT, generator=torch.Generator().manual_seed(0))]


@pytest.mark.parametrize("brightness", [EQUAL, UNEQUAL])
def test_lines_in_alphabetical_order_are_told(tmp_path: Path, brightness: Tensor) -> None:
    photograph(tmp_path, brightness)
    list_lights(tmp_path, ALPHABETICAL)
    with pytest.warns(UserWarning, match=r"1\.png, 10\.png, 11\.png"):
        assert "lights-out-of-order" in codes(load_capture(tmp_path))
    (tmp_path / "filenames.txt").write_text("".join(f"{k + 1}.png\n" for k in ALPHABETICAL))  # stated, so obeyed
    assert "lights-out-of-order" not in codes(load_capture(tmp_path))


def test_lines_in_natural_order_are_not_doubted(tmp_path: Path) -> None:
    photograph(tmp_path, EQUAL)
    list_lights(tmp_path, list(range(COUNT)))
    assert not {"lights-out-of-order", "intensities-from-capture"} & codes(load_capture(tmp_path))


def test_brightness_that_no_file_states_is_taken_from_the_photographs_where_it_differs(tmp_path: Path) -> None:
    photograph(tmp_path, UNEQUAL)
    list_lights(tmp_path, list(range(COUNT)))
    capture = load_capture(tmp_path)
    assert "intensities-from-capture" in codes(capture)
    assert "no-intensities" not in codes(capture)
    assert (capture.intensities[:, 0] / UNEQUAL - 1).abs().max() < 0.1  # a Lambertian surface is assumed, this is rough
    (tmp_path / "light_intensities.txt").write_text("1\n" * COUNT)  # stated, so obeyed
    assert torch.equal(load_capture(tmp_path).intensities, torch.ones(COUNT, 3))


def test_one_dark_photograph_is_no_reason_to_doubt_all(tmp_path: Path) -> None:
    photograph(tmp_path, torch.where(torch.arange(COUNT) == 5, 0.1, 1.0))
    list_lights(tmp_path, list(range(COUNT)))
    assert "intensities-from-capture" not in codes(load_capture(tmp_path))
