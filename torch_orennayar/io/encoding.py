"""What a picture file says about its encoding: curves and primaries that are obeyed, not guessed."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..core.optional import require
from .icc import ProfileError, read_profile

Floats = npt.NDArray[np.float32]

ADOBE_RGB_GAMMA = 563 / 256
"""Exponent of Adobe RGB (1998), section 4.3.4.2 of its specification."""
LINEAR_WITHIN = 0.02
"""A PNG's gAMA this near to 1 says linear light."""
_EXIF_COLOUR_SPACE, _EXIF_INTEROPERABILITY = 0xA001, 0xA005
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
    """The sRGB curve undone (IEC 61966-2-1)."""
    bright = np.maximum((samples + 0.055) / 1.055, 0) ** 2.4
    return np.where(samples <= 0.04045, samples / 12.92, bright).astype(np.float32)


def stated_encoding(data: bytes) -> StatedEncoding | None:
    """What the header of a PNG, JPEG, TIFF, WebP, Radiance or OpenEXR file says; None where it says nothing.

    Of a PNG's chunks cICP counts before iCCP, iCCP before sRGB, sRGB before gAMA (section 4.3 of PNG, third edition).

    Raises:
        EncodingError: an encoding that cannot be obeyed: look-up tables, CMYK profiles, HDR transfers.
    """
    if data[:4] == b"\x76\x2f\x31\x01" or data[:2] == b"#?":
        return _linear("its format")
    header = _header(data)
    if header is None:
        return None
    info, kind = header
    if kind == "PNG" and (transfer := _png_transfer(data)) is not None:
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


def _header(data: bytes) -> tuple[dict[object, object], str] | None:
    """Pillow's view of the header; None for formats that it does not know."""
    require("PIL")
    import PIL.Image

    try:
        with PIL.Image.open(io.BytesIO(data)) as picture:
            info = dict(picture.info)
            exif = picture.getexif()
            names = {exif.get(_EXIF_COLOUR_SPACE), exif.get_ifd(0x8769).get(_EXIF_COLOUR_SPACE)}
            index = exif.get_ifd(_EXIF_INTEROPERABILITY).get(1)
            info["exif"] = (1 in names, str(index).strip("\0") == "R03")
            return info, str(picture.format)
    except (
        Exception
    ):  # Pillow raises many kinds for headers it does not know; whether the file is whole is read elsewhere
        return None


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


def _png_transfer(data: bytes) -> int | None:
    """Transfer characteristics of the cICP chunk, which Pillow does not read."""
    at = 8
    while at + 12 <= len(data):
        length, name = struct.unpack_from(">I4s", data, at)
        if name == b"cICP" and length >= 2 and at + 10 <= len(data):
            return data[at + 9]
        if name == b"IDAT":
            return None
        at += 12 + length
    return None
