from __future__ import annotations

import io
import os
import struct
import zlib
from pathlib import Path

import numpy as np
import numpy.typing as npt
import PIL.Image
import PIL.ImageCms
import PIL.ImageOps
import pytest
from hypothesis import given
from hypothesis import strategies as st

from torch_orennayar import FileError
from torch_orennayar.io.picture import read_picture, to_unit

PIXELS = np.random.default_rng(0).integers(0, 256, (6, 9, 3)).astype(np.uint8)


def encoded(array: npt.NDArray[np.generic], kind: str, **options: object) -> bytes:
    buffer = io.BytesIO()
    PIL.Image.fromarray(array).save(buffer, kind, **options)
    return buffer.getvalue()


def with_chunk(png: bytes, name: bytes, data: bytes) -> bytes:
    chunk = struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
    return png[:33] + chunk + png[33:]


def turned(kind: str, orientation: int, array: npt.NDArray[np.generic] = PIXELS) -> bytes:
    if kind == "TIFF":
        return encoded(array, kind, tiffinfo={0x0112: orientation})
    exif = PIL.Image.Exif()
    exif[0x0112] = orientation
    return encoded(array, kind, exif=exif.tobytes(), **({"lossless": True} if kind == "WEBP" else {}))


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", ["PNG", "TIFF", "WEBP", "JPEG"])
def test_pictures_are_turned_as_the_file_says(tmp_path: Path, kind: str, orientation: int) -> None:
    data = turned(kind, orientation)
    file = tmp_path / f"picture.{kind.lower()}"
    file.write_bytes(data)
    wanted = np.asarray(PIL.ImageOps.exif_transpose(PIL.Image.open(io.BytesIO(data))).convert("RGB"))
    found = read_picture(file)
    assert found.orientation == orientation
    assert found.samples.shape == wanted.shape
    assert np.abs(found.samples.astype(int) - wanted).max() <= (3 if kind == "JPEG" else 0)  # decoders of JPEG differ


@given(
    st.sampled_from(["PNG", "TIFF", "BMP", "PPM", "TGA", "WEBP"]),
    st.integers(1, 40),
    st.integers(1, 40),
    st.sampled_from([1, 3, 4]),
    st.integers(0, 2**31),
)
def test_samples_are_those_that_were_written(kind: str, height: int, width: int, channels: int, seed: int) -> None:
    array = np.random.default_rng(seed).integers(0, 256, (height, width, channels)).astype(np.uint8)
    array = array[..., 0] if channels == 1 else array
    if (kind in ("BMP", "PPM") and channels == 4) or (kind == "WEBP" and channels == 1):
        return
    folder = Path(os.environ.get("TMPDIR", "/tmp"))
    file = folder / f"torch_orennayar-{os.getpid()}.{kind.lower()}"
    try:
        file.write_bytes(encoded(array, kind, **({"lossless": True, "exact": True} if kind == "WEBP" else {})))
        found = read_picture(file)
    finally:
        file.unlink(missing_ok=True)
    opaque = kind == "WEBP" and channels == 4 and (array[..., 3] == 255).all()
    assert np.array_equal(found.samples, array[..., :3] if channels > 1 else array)
    assert (found.alpha is not None) == (channels == 4 and not opaque)
    if found.alpha is not None:
        assert np.array_equal(found.alpha, to_unit(array[..., 3]))


GREY16 = (np.arange(30, dtype=np.uint16).reshape(5, 6) * 2100).astype(np.uint16)
SRGB = PIL.ImageCms.ImageCmsProfile(PIL.ImageCms.createProfile("sRGB")).tobytes()
PNG16 = encoded(GREY16, "PNG")


@pytest.mark.parametrize(
    ("data", "words", "half"),
    [
        (PNG16, None, None),
        (with_chunk(PNG16, b"sRGB", b"\0"), "sRGB", 0.21404),
        (with_chunk(PNG16, b"gAMA", struct.pack(">I", 45455)), "gamma 2.2", 0.5**2.2),
        (with_chunk(PNG16, b"gAMA", struct.pack(">I", 100000)), "linear", 0.5),
        (with_chunk(with_chunk(PNG16, b"gAMA", struct.pack(">I", 100000)), b"sRGB", b"\0"), "sRGB", 0.21404),
        (with_chunk(PNG16, b"cICP", bytes((1, 13, 0, 1))), "sRGB", 0.21404),
        (with_chunk(PNG16, b"cICP", bytes((1, 8, 0, 1))), "linear", 0.5),
        (encoded(PIXELS, "PNG", icc_profile=SRGB), "profile", 0.21404),
        (encoded(PIXELS, "JPEG", icc_profile=SRGB), "profile", 0.21404),
        (encoded(PIXELS, "TIFF", icc_profile=SRGB), "profile", 0.21404),
        (encoded(PIXELS, "WEBP", icc_profile=SRGB), "profile", 0.21404),
        (encoded(PIXELS, "JPEG"), None, None),
        (encoded(PIXELS, "BMP"), None, None),
    ],
)
def test_encodings_are_those_that_the_file_states(
    tmp_path: Path, data: bytes, words: str | None, half: float | None
) -> None:
    (tmp_path / "picture.png").write_bytes(data)  # the name does not decide, the contents do
    found = read_picture(tmp_path / "picture.png").stated
    assert (found is None) == (words is None)
    if found is not None and words is not None:
        assert words in found.words
        assert found.linear == (words == "linear")
        assert found.to_linear(np.full((1, 1, 3), 0.5, np.float32))[0, 0].tolist() == pytest.approx(
            [half] * 3, abs=2e-3
        )


def test_adobe_rgb_by_exif(tmp_path: Path) -> None:
    exif = PIL.Image.Exif()
    exif.get_ifd(0x8769)[0xA005] = {1: "R03"}
    (tmp_path / "a.jpg").write_bytes(encoded(PIXELS, "JPEG", exif=exif.tobytes()))
    stated = read_picture(tmp_path / "a.jpg").stated
    assert stated is not None
    assert "Adobe" in stated.words


@pytest.mark.parametrize(("name", "word"), [("a.CR2", "RAW"), ("a.nef", "RAW"), ("a.HEIC", "HEIF"), ("a.avif", "HEIF")])
def test_files_of_cameras_are_refused_by_name_with_what_to_do(tmp_path: Path, name: str, word: str) -> None:
    (tmp_path / name).write_bytes(b"II*\0" + bytes(100))
    with pytest.raises(FileError, match=word) as raised:
        read_picture(tmp_path / name)
    assert "TIFF" in raised.value.mend


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "TIFF", "BMP", "WEBP", "TGA", "PPM"])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.95])
def test_truncated_pictures_are_refused(tmp_path: Path, kind: str, share: float) -> None:
    data = encoded(np.random.default_rng(1).integers(0, 256, (64, 64, 3)).astype(np.uint8), kind)
    file = tmp_path / f"a.{kind.lower()}"
    file.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(FileError):
        read_picture(file)


def test_names_that_are_not_utf8(tmp_path: Path) -> None:
    file = tmp_path / os.fsdecode(b"foto\xe9.png")
    file.write_bytes(PNG16)
    assert np.array_equal(read_picture(file).samples, GREY16)


def test_float_pictures_are_read_as_linear_light(tmp_path: Path) -> None:
    import OpenImageIO

    values = np.random.default_rng(0).random((4, 5, 3)).astype(np.float32) * 3
    for name, kind, tolerance in (("a.exr", "float", 0), ("b.exr", "half", 2e-3), ("c.hdr", "float", 2e-2)):
        output = OpenImageIO.ImageOutput.create(str(tmp_path / name))
        assert output is not None
        output.open(str(tmp_path / name), OpenImageIO.ImageSpec(5, 4, 3, kind))
        output.write_image(values)
        output.close()
        found = read_picture(tmp_path / name)
        assert found.stated is not None
        assert found.stated.linear
        assert np.abs(to_unit(found.samples) - values).max() <= tolerance * 3


def test_a_complaint_that_is_no_text_is_still_a_clean_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenImageIO quotes bytes of damaged files."""
    import OpenImageIO

    def quote() -> str:
        return b"\xe9".decode()

    monkeypatch.setattr(OpenImageIO, "geterror", quote)
    (tmp_path / "a.png").write_bytes(b"no picture")
    with pytest.raises(FileError, match="damaged data"):
        read_picture(tmp_path / "a.png")
