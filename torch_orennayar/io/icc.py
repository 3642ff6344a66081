"""Linear light from the colour profile that a picture carries (ICC.1:2022, matrix and grey profiles).

Pillow's LittleCMS transforms 8-bit samples only; photographs for photometric stereo have 16, so the curves and the
matrix are read from the profile's tags and applied in floating point.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]

CURVE_SAMPLES = 1 << 16
"""Entries of the table that stands for a curve: one for each 16-bit sample."""
SRGB_TO_XYZ = np.array([
    [0.43606567, 0.38514709, 0.14306641],
    [0.22248840, 0.71687317, 0.06060791],
    [0.01391602, 0.09707642, 0.71409607],
])  # fmt: skip
"""Columns: XYZ of sRGB's primaries, adapted to D50 as profiles hold them (sRGB IEC61966-2.1 profile of the ICC)."""


class ProfileError(ValueError):
    """The profile is damaged, or of a kind that is not matrix or grey (with what it is)."""


@dataclass(frozen=True)
class ColourProfile:
    """What turns stored samples into linear light.

    Attributes:
        name: the profile's description.
        curves: (1 | 3, CURVE_SAMPLES) linear light by sample, for grey or for red, green and blue.
        to_srgb: (3, 3) from the profile's linear primaries to those of sRGB; None for grey.
    """

    name: str
    curves: Floats
    to_srgb: Floats | None

    def to_linear(self, samples: Floats) -> Floats:
        """Samples (H, W) or (H, W, 3) in [0, 1] to linear light of sRGB's primaries, at least 0."""
        index = np.rint(np.clip(samples, 0, 1) * (CURVE_SAMPLES - 1)).astype(np.uint16)
        if samples.ndim == 2:
            grey: Floats = self.curves[len(self.curves) // 2][index]  # of three curves green's
            return grey
        linear = np.stack([self.curves[min(c, len(self.curves) - 1)][index[..., c]] for c in range(3)], -1)
        return linear if self.to_srgb is None else np.maximum(linear @ self.to_srgb.T, 0)


def read_profile(data: bytes) -> ColourProfile:
    """Curves and primaries of an ICC profile.

    Args:
        data: the profile's bytes.

    Raises:
        ProfileError: damaged, not for RGB or grey pictures, or by look-up tables alone.
    """
    try:
        space = data[16:20].decode("ascii")
        tags = _tags(data)
        if space == "GRAY":
            return ColourProfile(_name(tags), _curve(tags["kTRC"])[None], None)
        if space != "RGB ":
            raise ProfileError(f"a profile for {space.strip()} pictures")
        if "rTRC" not in tags:
            raise ProfileError("a profile by look-up tables")
        curves = np.stack([_curve(tags[f"{c}TRC"]) for c in "rgb"])
        primaries = np.stack([_xyz(tags[f"{c}XYZ"]) for c in "rgb"], 1)
    except (KeyError, IndexError, struct.error, UnicodeDecodeError) as error:
        raise ProfileError(f"a damaged profile ({type(error).__name__}: {error})") from error
    to_srgb = np.linalg.solve(SRGB_TO_XYZ, primaries)
    alike = np.abs(to_srgb - np.eye(3)).max() < 2e-3  # profiles round their primaries to 1/65536 and adapt differently
    return ColourProfile(_name(tags), curves, None if alike else to_srgb.astype(np.float32))


def _tags(data: bytes) -> dict[str, bytes]:
    """The profile's tags by signature."""
    (count,) = struct.unpack_from(">I", data, 128)
    if count > 200:
        raise ProfileError(f"a damaged profile ({count} tags)")
    entries = (struct.unpack_from(">4sII", data, 132 + 12 * k) for k in range(count))
    return {name.decode("ascii"): data[start : start + size] for name, start, size in entries}


def _xyz(tag: bytes) -> npt.NDArray[np.float64]:
    return np.array(struct.unpack_from(">3i", tag, 8)) / 65536


def _curve(tag: bytes) -> Floats:
    """The curve as a table over all 16-bit samples (sections 10.6 and 10.18)."""
    x = np.linspace(0, 1, CURVE_SAMPLES)
    kind = tag[:4]
    if kind == b"curv":
        (count,) = struct.unpack_from(">I", tag, 8)
        if count == 0:
            return x.astype(np.float32)
        values = np.array(struct.unpack_from(f">{count}H", tag, 12))
        if count == 1:
            gamma = float(values[0]) / 256
            return np.power(x, gamma).astype(np.float32)
        return np.interp(x, np.linspace(0, 1, count), values / 65535).astype(np.float32)
    if kind != b"para":
        raise ProfileError(f"a curve of kind {kind!r}")
    (form,) = struct.unpack_from(">H", tag, 8)
    if form > 4:
        raise ProfileError(f"a parametric curve of form {form}")
    g, a, b, c, d, e, f = _parameters(tag, form)
    power = np.maximum(a * x + b, 0) ** g
    return np.where(x >= d, power + e, c * x + f).astype(np.float32)


def _parameters(tag: bytes, form: int) -> tuple[float, ...]:
    """``(a x + b)^g + e`` from ``d`` on, ``c x + f`` below, for the five forms of table 68."""
    read = [v / 65536 for v in struct.unpack_from(f">{(1, 3, 4, 5, 7)[form]}i", tag, 12)]
    defaults = (1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    g, a, b, c, d, e, f = read + list(defaults[len(read) :])
    if form in (1, 2):  # the border is where a x + b is 0; below it the offset alone
        offset = c if form == 2 else 0.0
        return g, a, b, 0.0, -b / a, offset, offset
    return g, a, b, c, d, e, f


def _name(tags: dict[str, bytes]) -> str:
    """The description, of either version of the format; empty where there is none."""
    tag = tags.get("desc", b"")
    if tag[:4] == b"desc":
        (length,) = struct.unpack_from(">I", tag, 8)
        return tag[12 : 12 + length].rstrip(b"\0").decode("latin-1")
    if tag[:4] == b"mluc":
        length, start = struct.unpack_from(">II", tag, 20)
        return tag[start : start + length].decode("utf-16-be", "replace")
    return ""
