"""Angles of view that files state, and lights of balls that the camera sees from the side, against traced rays."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
import PIL.Image
import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from torch_orennayar import Capture, RangeError, load_capture
from torch_orennayar.geometry.primitives import Ball
from torch_orennayar.io.optics import stated_field_of_view

SIZE = (240, 320)
"""Height and width of photographs, pixels."""


def write(file: Path, pixels: npt.NDArray[np.uint8], **numbers: int) -> Path:
    """Write a photograph with numbers of Exif: its orientation, and of its folder focal length, width and height."""
    exif = PIL.Image.Exif()
    exif[0x0112] = numbers.get("orientation", 1)
    folder = {0xA405: "focal", 0xA002: "width", 0xA003: "height"}
    exif.get_ifd(0x8769).update({tag: numbers[name] for tag, name in folder.items() if name in numbers})
    PIL.Image.fromarray(pixels).save(file, exif=exif)
    return file


def blank(height: int, width: int) -> npt.NDArray[np.uint8]:
    return np.zeros((height, width, 3), np.uint8)


@pytest.mark.parametrize("name", ["a.jpg", "a.png"])
@pytest.mark.parametrize(
    ("shape", "numbers", "half"),
    [
        pytest.param((24, 36), {"focal": 50}, 12 / 50, id="film, 50 mm"),
        pytest.param((24, 36), {"focal": 50, "orientation": 6}, 18 / 50, id="on its side"),
        pytest.param((240, 360), {"focal": 26, "width": 3600, "height": 2400}, 12 / 26, id="reduced"),
        # 3 : 4 of the film's diagonal, 43.27 mm: 25.96 mm high
        pytest.param((300, 400), {"focal": 26}, 0.6 * 43.2666 / 2 / 26, id="3 : 4"),
    ],
)
def test_angle_by_exif(tmp_path: Path, name: str, shape: tuple[int, int], numbers: dict[str, int], half: float) -> None:
    stated = stated_field_of_view(write(tmp_path / name, blank(*shape), **numbers))
    assert stated == pytest.approx(2 * math.atan(half), abs=1e-5)


@pytest.mark.parametrize(
    "numbers",
    [{}, {"focal": 0}, {"focal": 26, "width": 400, "height": 400}],
    ids=["nothing stated", "unknown", "cut to another shape"],
)
def test_no_angle(tmp_path: Path, numbers: dict[str, int]) -> None:
    assert stated_field_of_view(write(tmp_path / "a.jpg", blank(300, 400), **numbers)) is None


def test_no_angle_in_other_files(tmp_path: Path) -> None:
    (tmp_path / "a.exr").write_bytes(b"no picture")
    assert stated_field_of_view(tmp_path / "a.exr") is None


def traced(lights: Tensor, fov_y: float) -> Tensor:
    """Photographs (K, H, W) of a mirror ball in the lower right corner, by rays through every pixel."""
    slope = math.tan(fov_y / 2) * 2 / SIZE[0]
    row, column = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in SIZE), indexing="ij")
    across, up = slope * (column - (SIZE[1] - 1) / 2), slope * ((SIZE[0] - 1) / 2 - row)
    ray = F.normalize(torch.stack((across, up, -torch.ones_like(up))), dim=0)
    centre = 10 * torch.tensor([slope * 100, slope * -70, -1.0], dtype=torch.float64)
    radius = 10 * slope * 30
    along = (ray * centre[:, None, None]).sum(0)
    root = along**2 - centre @ centre + radius**2
    point = ray * (along - root.clamp_min(0).sqrt())
    normal = (point - centre[:, None, None]) / radius
    mirrored = ray - 2 * (ray * normal).sum(0) * normal
    cosine = torch.einsum("kc,chw->khw", lights.double(), mirrored)
    return torch.where(root > 0, 0.03 + 0.97 * (cosine > math.cos(0.05)), 0.0)


def photographs(folder: Path, fov_y: float, **numbers: int) -> Tensor:
    """Write them; the lights (K, 3)."""
    turn = torch.arange(6) * math.pi / 3
    lights = F.normalize(torch.stack((turn.cos(), turn.sin(), torch.full_like(turn, 1.3)), 1), dim=1)
    for k, picture in enumerate(traced(lights, fov_y)):
        grey = (255 * picture).round().byte().numpy()
        write(folder / f"{k}.png", np.repeat(grey[:, :, None], 3, 2), **numbers)
    return lights


def off(capture: Capture, lights: Tensor) -> float:
    """The mean error of the lights in degrees."""
    return float((capture.lights * lights).sum(1).clamp(-1, 1).acos().rad2deg().mean())


FOV = math.radians(50)


OUTLINE = Ball(260.9, 190.5, 31.8)
"""The circle of the area of the traced ball's outline, around its middle."""


@pytest.mark.parametrize("crop", [None, (100, 60, 220, 180)], ids=["whole", "cut"])
@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_lights_of_a_ball_seen_from_the_side(tmp_path: Path, crop: tuple[int, ...] | None, scale: float) -> None:
    lights = photographs(tmp_path, FOV)
    capture = load_capture(tmp_path, mask="whole", ball=OUTLINE, fov_y=FOV, crop=crop, scale=scale)
    assert off(capture, lights) < 1.5
    assert "off its axis" in next(str(n) for n in capture.notes if n.code == "lights-from-ball")
    assert off(load_capture(tmp_path, mask="whole", ball=OUTLINE, crop=crop, scale=scale), lights) > 15


def test_the_angle_that_files_state_is_taken(tmp_path: Path) -> None:
    """Of a ball that is found, whose outline, an ellipse, is less exact."""
    focal = round(43.2666 / 2 * 0.6 / math.tan(FOV / 2))
    lights = photographs(tmp_path, FOV, focal=focal)
    assert off(load_capture(tmp_path, mask="whole", encoding="linear"), lights) < 5


@pytest.mark.parametrize("angle", [0.0, 12.2, -0.5, math.nan])
def test_an_angle_in_degrees_is_refused(tmp_path: Path, angle: float) -> None:
    with pytest.raises(RangeError, match=r"math\.radians"):
        load_capture(tmp_path, fov_y=angle)


def test_an_angle_without_a_ball_is_refused(tmp_path: Path) -> None:
    photographs(tmp_path, FOV)
    np.savetxt(tmp_path / "light_directions.txt", np.eye(3)[[0, 1, 2, 0, 1, 2]] * 0 + [0, 0, 1])
    with pytest.raises(RangeError, match="mirror ball"):
        load_capture(tmp_path, mask="whole", fov_y=FOV)
