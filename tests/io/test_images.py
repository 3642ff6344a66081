from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torch_orennayar import (
    FileError,
    RangeError,
    ShapeError,
    decode_normals,
    encode_normals,
    linear_to_srgb,
    srgb_to_linear,
)
from torch_orennayar.io import picture
from torch_orennayar.io.images import read_image, write_animation, write_image
from torch_orennayar.io.picture import to_unit


@pytest.mark.parametrize("suffix", [".png", ".tiff"])
@pytest.mark.parametrize(("bits", "channels"), [(8, 1), (8, 3), (16, 1), (16, 3)])
def test_round_trip_keeps_bit_depth_channels_and_order(tmp_path: Path, suffix: str, bits: int, channels: int) -> None:
    image = torch.rand(channels, 5, 7, generator=torch.Generator().manual_seed(0))
    file = tmp_path / f"picture{suffix}"
    write_image(file, image, bits=bits)
    array = read_image(file)
    assert array.dtype == (np.uint8 if bits == 8 else np.uint16)
    back = torch.from_numpy(to_unit(array))
    back = back[None] if channels == 1 else back.permute(2, 0, 1)
    assert (back - image).abs().max() <= 0.5001 / (2**bits - 1)


def test_alpha_is_dropped_and_float_is_kept(tmp_path: Path) -> None:
    rgba = np.zeros((4, 5, 4), np.uint8)
    rgba[..., 2], rgba[..., 3] = 200, 7
    cv2.imwrite(str(tmp_path / "a.png"), rgba)
    assert (read_image(tmp_path / "a.png") == (200, 0, 0)).all()
    cv2.imwrite(str(tmp_path / "f.tiff"), np.full((4, 5, 3), 2.5, np.float32))
    assert (to_unit(read_image(tmp_path / "f.tiff")) == 2.5).all()


@pytest.mark.filterwarnings("ignore:Corrupt EXIF data")  # from Pillow
@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tiff"])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.97])
def test_truncated_files_are_refused(tmp_path: Path, suffix: str, share: float) -> None:
    noise = (torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(0)) * 255).byte().permute(1, 2, 0).numpy()
    file = tmp_path / f"whole{suffix}"
    cv2.imwrite(str(file), noise)
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(FileError, match="again"):
        read_image(file)


def test_damaged_png_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "whole.png"
    write_image(file, torch.rand(3, 64, 64))
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0xFF
    file.write_bytes(data)
    with pytest.raises(FileError, match="again"):
        read_image(file)


def test_what_is_no_image_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.png").write_text("not an image")
    with pytest.raises(FileError, match=r"text\.png"):
        read_image(tmp_path / "text.png")
    with pytest.raises(FileError, match="nothing there"):
        read_image(tmp_path / "absent.png")


def test_decompression_bombs_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "large.png"
    write_image(file, torch.zeros(1, 20, 20))
    monkeypatch.setattr(picture, "MAX_PIXELS", 399)
    with pytest.raises(FileError, match="399 pixels"):
        read_image(file)


def test_writing_leaves_no_part_behind(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="png"):
        write_image(tmp_path / "picture.xyz", torch.zeros(3, 2, 2))
    for name, bits in (("picture.jpg", 16), ("picture.bmp", 16), ("picture.png", 12)):
        with pytest.raises(FileError, match="bits"):
            write_image(tmp_path / name, torch.zeros(3, 2, 2), bits=bits)
    with pytest.raises(ShapeError, match="image"):
        write_image(tmp_path / "picture.png", torch.zeros(2, 2, 2))
    assert list(tmp_path.iterdir()) == []


@given(st.floats(0, 1, width=32))
def test_srgb_round_trip(value: float) -> None:
    light = torch.full((3, 1, 1), value)
    assert torch.allclose(srgb_to_linear(linear_to_srgb(light)), light, atol=1e-6)


def test_srgb_values_of_the_standard() -> None:
    encoded = linear_to_srgb(torch.tensor([0.0, 0.002, 0.18, 1.0, 2.0]).reshape(1, 1, 5)).flatten()
    assert torch.allclose(encoded, torch.tensor([0.0, 0.02584, 0.46136, 1.0, 1.0]), atol=1e-4)


def test_tone_map_keeps_order_and_stays_in_range() -> None:
    light = torch.linspace(0, 50, 100).reshape(1, 1, 100)
    mapped = linear_to_srgb(light, tone_map="reinhard").flatten()
    assert (mapped.diff() > 0).all()
    assert mapped.max() < 1
    with pytest.raises(RangeError, match="reinhard"):
        linear_to_srgb(light, tone_map="filmic")


@pytest.mark.parametrize("green", ["up", "down"])
@given(seed=st.integers(0, 1000))
def test_normal_map_png_round_trip(tmp_path_factory: pytest.TempPathFactory, green: str, seed: int) -> None:
    normal = torch.randn(3, 4, 5, generator=torch.Generator().manual_seed(seed))
    normal = torch.nn.functional.normalize(normal, dim=0)
    normal[:, 0, 0] = 0
    file = tmp_path_factory.mktemp("normals") / "n.png"
    write_image(file, encode_normals(normal, green=green), bits=16)
    image = torch.from_numpy(to_unit(read_image(file))).permute(2, 0, 1)
    assert (decode_normals(image, green=green) - normal).abs().max() < 1e-4
    assert (decode_normals(image, green=green)[:, 0, 0] == 0).all()


def test_green_conventions() -> None:
    upward = torch.tensor([0.0, 1.0, 0.0]).reshape(3, 1, 1)
    assert encode_normals(upward, green="up").flatten().tolist() == [0.5, 1.0, 0.5]
    assert encode_normals(upward, green="down").flatten().tolist() == [0.5, 0.0, 0.5]
    with pytest.raises(RangeError, match="green"):
        encode_normals(upward, green="left")


def test_animations_hold_their_frames(tmp_path: Path) -> None:
    ramp = torch.linspace(0, 1, 32).expand(1, 24, 32)
    frames = [torch.cat((ramp, ramp * k / 5, torch.full_like(ramp, 0.5))) for k in range(6)]
    write_animation(tmp_path / "a.gif", frames)
    with PIL.Image.open(tmp_path / "a.gif") as gif:
        assert gif.n_frames == 6
        assert gif.info["duration"] == 80  # hundredths of a second: 1 / 12, cut
        for k, frame in enumerate(frames):
            gif.seek(k)
            shown = torch.from_numpy(np.array(gif.convert("RGB"))).permute(2, 0, 1) / 255
            assert (shown - frame).abs().mean() < 0.03
    write_animation(tmp_path / "a.mp4", frames)
    video = cv2.VideoCapture(str(tmp_path / "a.mp4"))
    read = [video.read() for _ in range(7)]
    assert [done for done, _ in read] == [True] * 6 + [False]
    shown = torch.from_numpy(read[5][1][..., ::-1].copy()).permute(2, 0, 1) / 255
    assert (shown - frames[5]).abs().mean() < 0.05


def test_a_colour_of_one_frame_is_kept(tmp_path: Path) -> None:
    frames = [torch.eye(3)[k % 3].reshape(3, 1, 1).expand(3, 8, 8) for k in range(20)]
    frames[1] = torch.tensor([1.0, 0.5, 0.0]).reshape(3, 1, 1).expand(3, 8, 8)
    write_animation(tmp_path / "a.gif", frames)
    with PIL.Image.open(tmp_path / "a.gif") as gif:
        gif.seek(1)
        assert np.abs(np.array(gif.convert("RGB"))[0, 0].astype(int) - [255, 128, 0]).max() < 8


def test_animations_that_cannot_be(tmp_path: Path) -> None:
    frame = torch.zeros(3, 4, 4)
    with pytest.raises(FileError, match="gif"):
        write_animation(tmp_path / "a.avi", [frame])
    for frames in ([], [frame, torch.zeros(3, 4, 6)], [torch.zeros(4, 4)], [frame.byte()]):
        with pytest.raises(ShapeError, match="frames"):
            write_animation(tmp_path / "a.gif", frames)
    with pytest.raises(ShapeError, match="even"):
        write_animation(tmp_path / "a.mp4", [torch.zeros(3, 7, 4)])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("grey", [0, 1, 127, 128, 255])
@pytest.mark.parametrize("bits", [8, 16])
def test_backgrounds_of_normal_maps(tmp_path: Path, grey: int, bits: int) -> None:
    """Black, almost black, both greys and white are no unit vectors; averaged normals are shorter than 1."""
    normal = torch.nn.functional.normalize(torch.randn(3, 8, 8, generator=torch.Generator().manual_seed(0)), dim=0)
    there = torch.arange(8) < 5
    colours = torch.where(there, encode_normals(normal), torch.tensor(grey / 255))
    write_image(tmp_path / "n.png", colours, bits=bits)
    stored = torch.from_numpy(read_image(tmp_path / "n.png").astype(np.float32) / (2**bits - 1)).permute(2, 0, 1)
    found = decode_normals(stored)
    assert (found[:, :, ~there] == 0).all()
    assert torch.allclose(found[:, :, there], normal[:, :, there], atol=0.01)
    assert torch.allclose(decode_normals((0.8 * normal + 1) / 2), normal, atol=1e-5)


@pytest.mark.parametrize("decode", [srgb_to_linear, decode_normals])
def test_what_is_no_picture_in_0_to_1_is_refused(decode: Callable[[torch.Tensor], torch.Tensor]) -> None:
    """Of 8-bit values and of colours in another layout the answer would be wrong without a word."""
    image = torch.rand(3, 5, 7, generator=torch.Generator().manual_seed(0))
    for wrong, error, words in (
        ((255 * image).byte(), ShapeError, "255"),
        (255 * image, RangeError, "255"),
        (2 * image - 1, RangeError, "image"),
        (image.movedim(0, -1), ShapeError, "movedim"),
        (torch.cat((image, image[:1])), ShapeError, "alpha"),
    ):
        with pytest.raises(error, match=words):
            decode(wrong)
    assert decode(1.1 * image).shape == image.shape  # what resizing with a sharp kernel leaves
