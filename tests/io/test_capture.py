from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
import PIL.ImageCms
import pytest
import torch

from tests.support.objects import Scene
from torch_orennayar import FileError, RangeError, TorchOrenNayarError, load_capture, srgb_to_linear
from torch_orennayar.io.images import write_image


def test_round_trip(capture_folder: Path, rough: Scene) -> None:
    capture = load_capture(capture_folder)
    wanted = rough.images[::2, :, 4:36, 4:36]
    assert capture.images.shape == wanted.shape
    assert (capture.images - wanted).abs().max() < 2e-5
    assert torch.allclose(capture.lights, rough.lights[::2], atol=1e-6)
    assert torch.equal(capture.mask, rough.mask[:, 4:36, 4:36])
    assert capture.normal is not None
    assert torch.equal(capture.normal, rough.normal[:, 4:36, 4:36])
    assert capture.names[0] == "001.png"


def rewrite(file: Path, change: Callable[[list[str]], list[str]], end: str = "\n") -> None:
    file.write_bytes((end.join(change(file.read_text().splitlines())) + end).encode())


def test_text_files_of_other_systems(capture_folder: Path) -> None:
    plain = load_capture(capture_folder)
    lights = capture_folder / "light_directions.txt"
    rewrite(lights, lambda rows: ["# x y z", *rows, ""], end="\r\n")
    lights.write_bytes(b"\xef\xbb\xbf" + lights.read_bytes())
    rewrite(capture_folder / "filenames.txt", lambda rows: rows, end="\r\n")
    assert torch.equal(load_capture(capture_folder).lights, plain.lights)


def test_folder_with_lights_file_only(capture_folder: Path) -> None:
    """No list of names, no intensities, natural order, eight bits."""
    plain = load_capture(capture_folder)
    for name in ("filenames.txt", "light_intensities.txt", "normal_gt.npy"):
        (capture_folder / name).unlink()
    for index in range(12):
        (capture_folder / f"{index + 1:03d}.png").unlink()
        write_image(capture_folder / f"shot{index + 1}.png", plain.images[index] ** (1 / 2.2))
    (capture_folder / "light_directions.txt").rename(capture_folder / "lights.txt")
    capture = load_capture(capture_folder)
    assert capture.names[:3] == ("shot1.png", "shot2.png", "shot3.png")
    assert capture.names[-1] == "shot12.png"
    assert capture.normal is None
    assert (capture.images - plain.images).abs().max() < 0.03
    assert any("sRGB" in note for note in capture.notes)
    assert any("intensities" in note for note in capture.notes)
    linear = load_capture(capture_folder, encoding="linear")
    assert (linear.images - plain.images ** (1 / 2.2)).abs().max() < 0.003


def test_lp_file_matches_by_name(capture_folder: Path) -> None:
    plain = load_capture(capture_folder)
    order = torch.randperm(12, generator=torch.Generator().manual_seed(0)).tolist()
    rows = [f"{plain.names[i]} {' '.join(f'{v:.7f}' for v in plain.lights[i].tolist())}" for i in order]
    lp = capture_folder / "set.lp"
    lp.write_text("12\n" + "\n".join(rows) + "\n")
    for name in ("light_directions.txt", "light_intensities.txt"):
        (capture_folder / name).unlink()
    for source in (lp, capture_folder):
        capture = load_capture(source)
        assert capture.names == tuple(plain.names[i] for i in order)
        assert torch.allclose(capture.lights, plain.lights[order], atol=1e-6)


def test_masks_of_zero_and_one(capture_folder: Path) -> None:
    plain = load_capture(capture_folder).mask
    write_image(capture_folder / "mask.png", plain.float() / 255)
    assert torch.equal(load_capture(capture_folder).mask, plain)


def test_lights_and_mask_kept_elsewhere(capture_folder: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    for name in ("light_directions.txt", "mask.png"):
        shutil.move(capture_folder / name, elsewhere / name)
    capture = load_capture(capture_folder, lights=elsewhere / "light_directions.txt", mask=elsewhere / "mask.png")
    assert not capture.mask.all()
    assert load_capture(capture_folder, lights=elsewhere / "light_directions.txt").mask.all()


def grey_image(folder: Path, dtype: type = np.uint16, size: tuple[int, ...] = (32, 32)) -> None:
    cv2.imwrite(str(folder / "004.png"), np.full(size, 100, dtype))


def edit(name: str, change: Callable[[list[str]], list[str]]) -> Callable[[Path], None]:
    return lambda folder: rewrite(folder / name, change)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (
            edit("light_directions.txt", lambda r: r[:-1]),
            r"expected 12 lights, one per image \(001.png to 012.png\), got 11; add",
        ),
        (edit("light_directions.txt", lambda r: [*r, r[0]]), "got 13; remove"),
        (edit("light_directions.txt", lambda r: []), "empty file"),
        (edit("light_directions.txt", lambda r: [f"{i + 1:03d}.png {x}" for i, x in enumerate(r)]), "have names"),
        (edit("light_directions.txt", lambda r: ["0 0", *r[1:]]), "line 1.*3 numbers"),
        (edit("light_directions.txt", lambda r: [*r[:4], "a b c", *r[5:]]), "line 5.*3 numbers"),
        (edit("light_directions.txt", lambda r: ["0 0 2", *r[1:]]), "entry 1.*unit.*length 2"),
        (edit("light_directions.txt", lambda r: ["nan 0 1", *r[1:]]), "finite"),
        (edit("light_intensities.txt", lambda r: r[:-1]), "12 lines"),
        (edit("light_intensities.txt", lambda r: ["0 0 0", *r[1:]]), "positive"),
        (edit("filenames.txt", lambda r: ["../../outside.png", *r[1:]]), "leaves it"),
        (edit("filenames.txt", lambda r: ["/etc/hostname", *r[1:]]), "leaves it"),
        (edit("filenames.txt", lambda r: ["..\\outside.png", *r[1:]]), "leaves it"),
        (edit("filenames.txt", lambda r: ["absent.png", *r[1:]]), "absent.png.*nothing there"),
        (lambda f: grey_image(f, np.uint8), "uint16 samples.*one bit depth"),
        (lambda f: grey_image(f, size=(31, 32)), "32 x 32 pixels.*one size"),
        (lambda f: (f / "004.png").write_bytes((f / "004.png").read_bytes()[:900]), "004.png.*again"),
        (lambda f: write_image(f / "mask.png", torch.ones(1, 8, 8)), "mask.*32 x 32"),
        (lambda f: write_image(f / "mask.png", torch.zeros(1, 32, 32)), "empty mask"),
        (lambda f: (f / "light_directions.txt").unlink(), "lights= "),
        (lambda f: (f / "light_directions.txt").write_bytes(b"\x80\xff\x00"), "binary"),
        (lambda f: np.save(f / "normal_gt.npy", np.zeros((3, 3, 3))), r"normal_gt.*shape \(32, 32, 3\)"),
        (lambda f: np.save(f / "normal_gt.npy", np.array([{}]), allow_pickle=True), "normal_gt"),
        (lambda f: (f / "normal_gt.npy").write_bytes(b"no array"), "normal_gt"),
        (shutil.rmtree, "nothing there"),
    ],
)
def test_damage_is_named_with_its_mend(capture_folder: Path, damage: Callable[[Path], object], words: str) -> None:
    damage(capture_folder)
    with pytest.raises(TorchOrenNayarError, match=words):
        load_capture(capture_folder)


def test_a_link_out_of_the_folder_is_refused(capture_folder: Path, tmp_path: Path) -> None:
    shutil.move(capture_folder / "004.png", tmp_path / "secret.png")
    (capture_folder / "004.png").symlink_to(tmp_path / "secret.png")
    with pytest.raises(FileError, match="leaves it"):
        load_capture(capture_folder)


def test_unknown_encoding(capture_folder: Path) -> None:
    with pytest.raises(RangeError, match="srgb"):
        load_capture(capture_folder, encoding="gamma")


def test_diligent_and_other_real_folders(data: Path) -> None:
    ball = load_capture(data / "diligent" / "ballPNG")
    assert ball.images.shape == (96, 3, 154, 154)
    assert ball.normal is not None
    inside = ball.normal[:, ball.mask[0]]
    assert torch.allclose(inside.norm(dim=0), torch.ones(1), atol=1e-2)
    grey = load_capture(data / "uw_psm" / "gray", lights=data / "uw_psm" / "light_directions.txt")
    assert grey.names[0] == "gray.00.png"
    assert len(grey.lights) == 12


def test_names_with_spaces_in_lp_files(capture_folder: Path) -> None:
    plain = load_capture(capture_folder)
    rows = []
    for index, name in enumerate(plain.names):
        (capture_folder / name).rename(capture_folder / f"my shot {index}.png")
        rows.append(f"my shot {index}.png {' '.join(f'{v:.7f}' for v in plain.lights[index].tolist())}")
    (capture_folder / "set.lp").write_text("\n".join([str(len(rows)), *rows]))
    for name in ("filenames.txt", "light_directions.txt", "light_intensities.txt"):
        (capture_folder / name).unlink()
    capture = load_capture(capture_folder)
    assert capture.names[3] == "my shot 3.png"
    assert torch.allclose(capture.lights, plain.lights, atol=1e-6)


@pytest.mark.parametrize("inside", [True, False])
def test_ambient_light_is_subtracted(capture_folder: Path, tmp_path: Path, inside: bool) -> None:
    plain = load_capture(capture_folder)
    for name in ("filenames.txt", "light_intensities.txt"):
        (capture_folder / name).unlink()
    dark = 0.05 * torch.rand(plain.images[0].shape, generator=torch.Generator().manual_seed(0))
    for name, image in zip(plain.names, plain.images, strict=True):
        write_image(capture_folder / name, image * 0.9 + dark, bits=16)
    place = capture_folder / "ambient.png" if inside else tmp_path / "off.png"
    write_image(place, dark, bits=16)
    capture = load_capture(capture_folder, ambient=None if inside else place)
    assert len(capture.images) == len(plain.images)
    assert (capture.images - 0.9 * plain.images).abs().max() < 1e-4
    assert any("lights off" in note for note in capture.notes)


def test_large_captures_are_kept_in_half_precision(capture_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = load_capture(capture_folder)
    monkeypatch.setattr("torch_orennayar.io.photographs.HALF_FROM", 1000)
    half = load_capture(capture_folder)
    assert half.images.dtype == torch.float16
    assert torch.allclose(half.images.float(), plain.images, rtol=1e-3, atol=1e-6)
    assert any("half precision" in note for note in half.notes)


def test_own_intensities_of_a_capture(capture_folder: Path) -> None:
    """Lights 30 % off in the files: the capture finds them from itself."""
    plain = load_capture(capture_folder)
    table = [
        [float(v) for v in row.split()]
        for row in (capture_folder / "light_intensities.txt").read_text().split("\n")
        if row
    ]
    wrong = [1.3 if k % 3 == 0 else 1.0 for k in range(len(table))]
    text = "\n".join(" ".join(str(v * w) for v in row) for row, w in zip(table, wrong, strict=True))
    (capture_folder / "light_intensities.txt").write_text(text)
    found = load_capture(capture_folder).with_own_intensities()
    ratio = found.images.mean((1, 2, 3)) / plain.images.mean((1, 2, 3))
    assert (ratio / ratio.mean() - 1).abs().max() < 0.1


def photographs(folder: Path, orientations: list[int], **options: object) -> torch.Tensor:
    """Photographs of a gradient, stored turned as their Exif orientation says; the upright samples."""
    upright = [np.arange(48, dtype=np.uint8).reshape(8, 6) * 4 + 10 * k for k in range(len(orientations))]
    for k, (shown, orientation) in enumerate(zip(upright, orientations, strict=True)):
        stored = {1: shown, 3: np.rot90(shown, 2), 6: np.rot90(shown), 8: np.rot90(shown, -1)}[orientation]
        exif = PIL.Image.Exif()
        exif[0x0112] = orientation
        PIL.Image.fromarray(np.ascontiguousarray(stored)).save(
            folder / f"{k}.png", "PNG", exif=exif.tobytes(), **options
        )
    directions = torch.nn.functional.normalize(torch.tensor([[0.0, 0, 1], [1, 0, 2], [0, 1, 2], [-1, 0, 2]]), dim=1)
    np.savetxt(folder / "lights.txt", directions[: len(orientations)].numpy())
    return torch.from_numpy(np.stack(upright)).float() / 255


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_photographs_are_turned_upright_and_it_is_said(tmp_path: Path, orientation: int) -> None:
    upright = photographs(tmp_path, [orientation] * 4)
    capture = load_capture(tmp_path, encoding="linear")
    assert torch.allclose(capture.images[:, 0], upright, atol=1e-6)
    turned = [note.value for note in capture.notes if note.code == "turned-upright"]
    assert turned == ([] if orientation == 1 else [orientation])


def test_photographs_turned_differently_are_refused(tmp_path: Path) -> None:
    photographs(tmp_path, [1, 1, 3, 3])
    with pytest.raises(FileError, match="orientation 3"):
        load_capture(tmp_path)


def test_the_encoding_that_files_state_is_obeyed_unless_the_caller_says_another(tmp_path: Path) -> None:
    srgb = PIL.ImageCms.ImageCmsProfile(PIL.ImageCms.createProfile("sRGB")).tobytes()
    upright = photographs(tmp_path, [1] * 4, icc_profile=srgb)
    stated, told = load_capture(tmp_path), load_capture(tmp_path, encoding="linear")
    assert torch.allclose(stated.images, srgb_to_linear(upright[:, None].expand(-1, 3, -1, -1)), atol=1e-3)
    assert "encoding-stated" in {note.code for note in stated.notes}
    assert torch.allclose(told.images[:, 0], upright, atol=1e-6)
    assert {"read-as-linear", "encoding-overridden"} <= {note.code for note in told.notes}
    PIL.Image.fromarray(np.zeros((8, 6), np.uint8)).save(tmp_path / "2.png")
    with pytest.raises(FileError, match="no encoding"):
        load_capture(tmp_path)


def test_a_folder_of_raw_files_says_what_it_found(tmp_path: Path) -> None:
    for name in ("a.CR2", "b.cr2", "c.heic"):
        (tmp_path / name).write_bytes(b"x")
    (tmp_path / "lights.txt").write_text("0 0 1\n")
    with pytest.raises(FileError, match=r"2 \.cr2, 1 \.heic") as raised:
        load_capture(tmp_path)
    assert "TIFF" in raised.value.mend


def test_photographs_whose_names_are_not_utf8(tmp_path: Path) -> None:
    upright = photographs(tmp_path, [1] * 4)
    for k in range(4):
        (tmp_path / f"{k}.png").rename(tmp_path / os.fsdecode(b"foto\xe9_%d.png" % k))
    capture = load_capture(tmp_path, encoding="linear")
    assert torch.allclose(capture.images[:, 0], upright, atol=1e-6)
