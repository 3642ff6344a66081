"""What a picture file says about its encoding: curves and primaries that are obeyed, not guessed."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
import numpy.typing as npt
import torch

from ..core.errors import RangeError
from ..core.optional import require
from .icc import ProfileError, read_profile
from .srgb import srgb_to_linear

if TYPE_CHECKING:
    import PIL.Image

Floats = npt.NDArray[np.float32]

ADOBE_RGB_GAMMA = 563 / 256
"""Exponent of Adobe RGB (1998), section 4.3.4.2 of its specification."""
LINEAR_WITHIN = 0.02
"""A PNG's gAMA this near to 1 says linear light."""
_EXIF_COLOUR_SPACE, EXIF_FOLDER, _EXIF_INTEROPERABILITY = 0xA001, 0x8769, 0xA005
_PNG_TRANSFERS = {1: "BT.709", 8: "linear", 13: "sRGB"}
"""Transfer characteristics of a PNG's cICP chunk (ITU-T H.273, table 3) that are understood."""


class EncodingError(ValueError):
    """The file states an encoding that cannot be obeyed; the text says which."""


@dataclass(frozen=True)
class StatedEncoding:
    """The encoding that a file states.

    Attributes:
        words: what it is and where it stands, for people.
        linear: whether samples are linear light as they are.
        to_linear: samples (H, W) or (H, W, 3) in [0, 1] to linear light.
    """

    words: str
    linear: bool
    to_linear: Callable[[Floats], Floats]


def srgb_curve(samples: Floats) -> Floats:
    """The sRGB curve undone, `srgb_to_linear` of samples (H, W) or (H, W, 3)."""
    picture = torch.from_numpy(samples)
    planes = picture[None] if picture.ndim == 2 else picture.permute(2, 0, 1)
    light: Floats = srgb_to_linear(planes).permute(1, 2, 0).numpy()
    return light[..., 0] if samples.ndim == 2 else light


def stated_encoding(file: BinaryIO) -> StatedEncoding | None:
    """What the header of a PNG, JPEG, TIFF, WebP, Radiance or OpenEXR file says; None where it says nothing.

    Of a PNG's chunks cICP counts before iCCP, iCCP before sRGB, sRGB before gAMA (section 4.3 of PNG, third edition).

    Raises:
        EncodingError: an encoding that cannot be obeyed: look-up tables, CMYK profiles, HDR transfers.
    """
    start = file.read(4)
    if start == b"\x76\x2f\x31\x01" or start[:2] == b"#?":
        return _linear("its format")
    header = _header(file)
    if header is None:
        return None
    info, kind = header
    if kind == "PNG" and (transfer := _png_transfer(file)) is not None:
        return _by_transfer(transfer)
    profile = info.get("icc_profile")
    if isinstance(profile, bytes) and profile:
        return _by_profile(profile)
    if kind == "PNG":
        if "srgb" in info:
            return StatedEncoding("sRGB (chunk sRGB)", False, srgb_curve)
        gamma = info.get("gamma")
        if isinstance(gamma, float):
            return _by_gamma(gamma)
    return _by_exif(info.get("exif"))


def _header(file: BinaryIO) -> tuple[dict[object, object], str] | None:
    """Pillow's view of the header; None for formats that it does not know."""
    require("PIL")
    import PIL.Image

    file.seek(0)
    try:
        with PIL.Image.open(file) as picture:
            return dict(picture.info) | {"exif": _exif_says(picture)}, str(picture.format)
    except Exception:  # Pillow raises many kinds for headers it does not know; damage is found while decoding
        return None


def _exif_says(picture: PIL.Image.Image) -> tuple[bool, bool]:
    """Whether the Exif data name sRGB as the colour space, and Adobe RGB by the index of interoperability."""
    exif = picture.getexif()
    names = {exif.get(_EXIF_COLOUR_SPACE), exif.get_ifd(EXIF_FOLDER).get(_EXIF_COLOUR_SPACE)}
    try:
        index = exif.get_ifd(_EXIF_INTEROPERABILITY).get(1)
    except KeyError:  # Pillow before 13, where there is no such folder
        index = None
    return 1 in names, str(index).strip("\0") == "R03"


def _linear(where: str) -> StatedEncoding:
    return StatedEncoding(f"linear light ({where})", True, lambda samples: samples)


def _by_profile(profile: bytes) -> StatedEncoding:
    try:
        found = read_profile(profile)
    except ProfileError as error:
        raise EncodingError(str(error)) from error
    straight = bool(np.abs(found.curves - np.linspace(0, 1, found.curves.shape[1])).max() < 1e-3)
    return StatedEncoding(f"the colour profile {found.name!r}", straight and found.to_srgb is None, found.to_linear)


def _by_gamma(gamma: float) -> StatedEncoding:
    """``gamma`` is the encoding exponent: samples are light to that power."""
    if not 0.1 < gamma < 10:
        raise EncodingError(f"a gAMA chunk of {gamma:g}")
    if abs(gamma - 1) < LINEAR_WITHIN:
        return _linear("chunk gAMA")
    return StatedEncoding(f"gamma {1 / gamma:.3g} (chunk gAMA)", False, lambda s: _power(s, 1 / gamma))


def _by_transfer(transfer: int) -> StatedEncoding:
    name = _PNG_TRANSFERS.get(transfer)
    if name is None:
        raise EncodingError(f"a cICP chunk with transfer {transfer} (an HDR or television curve)")
    if name == "linear":
        return _linear("chunk cICP")
    curve = srgb_curve if name == "sRGB" else _bt709
    return StatedEncoding(f"{name} (chunk cICP)", False, curve)


def _by_exif(exif: object) -> StatedEncoding | None:
    srgb, adobe = exif if isinstance(exif, tuple) else (False, False)
    if adobe:
        return StatedEncoding("Adobe RGB (Exif)", False, lambda s: _power(s, ADOBE_RGB_GAMMA))
    return StatedEncoding("sRGB (Exif)", False, srgb_curve) if srgb else None


def _power(samples: Floats, exponent: float) -> Floats:
    return (np.maximum(samples, 0) ** exponent).astype(np.float32)


def _bt709(samples: Floats) -> Floats:
    """The curve of ITU-R BT.709-6 undone, section 1.2."""
    bright = np.maximum((samples + 0.099) / 1.099, 0) ** (1 / 0.45)
    return np.where(samples < 0.081, samples / 4.5, bright).astype(np.float32)


def _png_transfer(file: BinaryIO) -> int | None:
    """Transfer characteristics of the cICP chunk, which Pillow does not read."""
    file.seek(8)
    while len(head := file.read(8)) == 8:
        length, name = struct.unpack(">I4s", head)
        if name == b"cICP":
            content = file.read(2)
            return content[1] if len(content) == 2 else None
        if name == b"IDAT":
            return None
        file.seek(length + 4, os.SEEK_CUR)
    return None


def check_encoding(encoding: str) -> None:
    """Check that ``encoding`` is a choice of `load_capture`."""
    if encoding not in ("auto", "linear", "srgb"):
        raise RangeError("encoding", expected="'auto', 'linear' or 'srgb'", got=repr(encoding), mend="choose one")
