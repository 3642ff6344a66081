"""Read picture files as stored, upright and whole, with what the file says of its encoding."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..core.errors import FileError
from ..core.files import utf8_path
from ..core.optional import require
from .encoding import EncodingError, StatedEncoding, stated_encoding

IMAGE_SUFFIXES = frozenset({
    ".png", ".jpg", ".jpeg", ".jpe", ".jfif", ".tif", ".tiff", ".bmp", ".dib", ".webp", ".exr", ".hdr", ".tga", ".pnm",
    ".ppm", ".pgm", ".pbm", ".pfm", ".jxl", ".jp2",
})  # fmt: skip
"""Formats that are read, in a folder as well as by name."""
RAW_SUFFIXES = frozenset({
    ".cr2", ".cr3", ".crw", ".nef", ".nrw", ".arw", ".srf", ".sr2", ".dng", ".raf", ".orf", ".rw2", ".pef", ".srw",
    ".raw", ".3fr", ".iiq",
})  # fmt: skip
"""Sensor data of cameras: refused by name, with what to do."""
HEIF_SUFFIXES = frozenset({".heic", ".heif", ".hif", ".avif"})
MAX_PIXELS = 150_000_000
"""Larger pictures are refused as decompression bombs: 150 megapixels are more than cameras take."""
ROTATIONS = {
    1: (0, False), 2: (0, True), 3: (2, False), 4: (2, True), 5: (3, True), 6: (3, False), 7: (1, True), 8: (1, False),
}  # fmt: skip
"""Exif orientation to (quarter turns counter-clockwise, then mirrored left to right): table 4.6.4 of Exif 2.32."""


@dataclass(frozen=True)
class Picture:
    """A picture as people see it: turned upright as its file says.

    Attributes:
        samples: (H, W) or (H, W, 3) RGB as stored: uint8, uint16 or float32.
        alpha: (H, W) in [0, 1], or None.
        orientation: what the file said, 1 to 8; the samples are turned already.
        stated: the encoding that the file states, or None.
    """

    samples: npt.NDArray[np.generic]
    alpha: npt.NDArray[np.float32] | None
    orientation: int
    stated: StatedEncoding | None


def read_picture(path: str | os.PathLike[str]) -> Picture:
    """Read a picture file.

    Args:
        path: any of `IMAGE_SUFFIXES`.

    Raises:
        FileError: missing, damaged, truncated, of a kind that is not read (camera RAW, HEIC), larger than
            `MAX_PIXELS`, or in an encoding that cannot be obeyed.
    """
    file = Path(path)
    _refuse_by_name(file)
    try:
        with file.open("rb") as stream:
            stated = stated_encoding(stream)
    except FileNotFoundError as error:
        raise FileError(str(file), expected="an image file", got="nothing there", mend="check the name") from error
    except IsADirectoryError as error:
        raise FileError(str(file), expected="an image file", got="a folder", mend="give one picture in it") from error
    except OSError as error:
        raise FileError(str(file), expected="a readable file", got=str(error), mend="check its permissions") from error
    except EncodingError as error:
        raise FileError(
            str(file), expected="an encoding by curves", got=str(error), mend="export it with an sRGB profile"
        ) from error
    with utf8_path(file) as named:
        samples, orientation = _decode(file, str(named))
    colour = samples.shape[2] >= 3
    alpha = samples[..., -1] if samples.shape[2] in (2, 4) else None
    samples = samples[..., :3] if colour else samples[..., 0]
    return Picture(
        _upright(samples, orientation),
        None if alpha is None else to_unit(_upright(alpha, orientation)),
        orientation,
        stated,
    )


def to_unit(samples: npt.NDArray[np.generic]) -> npt.NDArray[np.float32]:
    """Samples as float32, integers scaled so that full scale is 1."""
    if np.issubdtype(samples.dtype, np.floating):
        return samples.astype(np.float32, copy=False)
    return samples.astype(np.float32) / np.float32(np.iinfo(samples.dtype).max)  # type: ignore[type-var, no-any-return]


def _refuse_by_name(file: Path) -> None:
    """Files of cameras and phones that are no pictures yet."""
    suffix = file.suffix.lower()
    if suffix in RAW_SUFFIXES:
        mend = "develop it to a linear 16-bit TIFF, e.g. with `dcraw -4 -T` or darktable"
        raise FileError(str(file), expected="a picture", got=f"a camera's RAW file ({suffix})", mend=mend)
    if suffix in HEIF_SUFFIXES:
        mend = "export it as JPEG or TIFF (on a phone: settings, camera, formats, most compatible)"
        raise FileError(str(file), expected="a picture", got=f"a HEIF file ({suffix})", mend=mend)


def _decode(file: Path, name: str) -> tuple[npt.NDArray[np.generic], int]:
    """Samples (H, W, C) as stored, alpha not multiplied in, and the orientation."""
    require("OpenImageIO")
    import OpenImageIO

    settings = OpenImageIO.ImageSpec()
    settings["oiio:UnassociatedAlpha"] = 1
    source = OpenImageIO.ImageInput.open(name, settings)
    if source is None:
        raise _damaged(file, OpenImageIO.geterror, name)
    try:
        spec = source.spec()
        if spec.width * spec.height * max(spec.depth, 1) > MAX_PIXELS:
            got = f"{spec.width} x {spec.height}"
            raise FileError(str(file), expected=f"at most {MAX_PIXELS} pixels", got=got, mend="crop or shrink it")
        stored = str(spec.format)
        kind = {"uint8": "uint8", "uint16": "uint16", "half": "float", "float": "float", "double": "float"}.get(stored)
        if kind is None or spec.depth > 1 or spec.nchannels > 4:
            got = f"{stored} samples, {spec.nchannels} channels" + (", in depth" if spec.depth > 1 else "")
            expected, mend = "8 or 16 bits or floats, 1 to 4 channels", "convert the picture"
            raise FileError(str(file), expected=expected, got=got, mend=mend)
        samples = source.read_image(kind)
        if samples is None or source.has_error:
            raise _damaged(file, source.geterror, name)
        orientation = int(spec.get_int_attribute("Orientation", 1))
        return np.atleast_3d(samples), orientation if orientation in ROTATIONS else 1
    finally:
        source.close()


def _damaged(file: Path, say: Callable[[], str], name: str) -> FileError:
    said = ""
    with suppress(UnicodeDecodeError):  # OpenImageIO quotes bytes of the file
        said = say()
    reason = " ".join(said.replace(name, file.name).split())[:200] or "damaged data"
    return FileError(str(file), expected="a whole image", got=reason.lower(), mend="copy or export it again")


def _upright(samples: npt.NDArray[np.generic], orientation: int) -> npt.NDArray[np.generic]:
    turns, mirrored = ROTATIONS[orientation]
    turned = np.rot90(samples, turns)
    return np.ascontiguousarray(turned[:, ::-1] if mirrored else turned)
