from __future__ import annotations

import io
import struct

import numpy as np
import PIL.Image
import PIL.ImageCms
import pytest

from torch_orennayar.io.icc import ProfileError, read_profile


def profile(curves: bytes, primaries: tuple[tuple[float, float, float], ...] | None = None) -> bytes:
    """A version 4 RGB profile with one curve for all channels, primaries in XYZ of D50."""
    primaries = primaries or ((0.51512, 0.24120, -0.00105), (0.29198, 0.69225, 0.04189), (0.15710, 0.06657, 0.78407))
    xyz = [b"XYZ \0\0\0\0" + struct.pack(">3i", *(round(v * 65536) for v in p)) for p in primaries]
    text = "Test".encode("utf-16-be")
    name = b"mluc\0\0\0\0" + struct.pack(">II2s2sII", 1, 12, b"en", b"US", len(text), 28) + text
    white = b"XYZ \0\0\0\0" + struct.pack(">3i", 63190, 65536, 54061)
    parts = {b"desc": name, b"wtpt": white, b"cprt": name}
    parts |= {f"{c}XYZ".encode(): xyz[k] for k, c in enumerate("rgb")} | {f"{c}TRC".encode(): curves for c in "rgb"}
    start, table, body = 132 + 12 * len(parts), b"", b""
    for key, value in parts.items():
        value += b"\0" * (-len(value) % 4)
        table += struct.pack(">4sII", key, start + len(body), len(value))
        body += value
    head = struct.pack(">I4sI4s4s4s", start + len(body), b"none", 0x04200000, b"mntr", b"RGB ", b"XYZ ")
    head += struct.pack(">6H4s", 2026, 1, 1, 0, 0, 0, b"acsp") + b"\0" * 28 + struct.pack(">3i", 63190, 65536, 54061)
    return head.ljust(128, b"\0") + struct.pack(">I", len(parts)) + table + body


def para(form: int, *values: float) -> bytes:
    return (
        b"para\0\0\0\0"
        + struct.pack(">HH", form, 0)
        + struct.pack(f">{len(values)}i", *(round(v * 65536) for v in values))
    )


SRGB = (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
CURVES = {
    "identity": b"curv\0\0\0\0" + struct.pack(">I", 0),
    "gamma 2.2": b"curv\0\0\0\0" + struct.pack(">IH", 1, 563),
    "table": b"curv\0\0\0\0" + struct.pack(">I1024H", 1024, *(round(65535 * (k / 1023) ** 1.8) for k in range(1024))),
    "parametric 0": para(0, 1.8),
    "parametric 1": para(1, 2.0, 1.1, -0.1),
    "parametric 2": para(2, 2.0, 1.0, -0.1, 0.1),
    "parametric 3": para(3, *SRGB),
    "parametric 4": para(4, 2.2, 0.9, 0.1, 0.2, 0.05, 0.0, 0.0),
}


@pytest.mark.parametrize("kind", CURVES)
def test_linear_light_is_that_of_littlecms(kind: str) -> None:
    data = profile(CURVES[kind])
    samples = np.random.default_rng(0).integers(0, 256, (40, 40, 3)).astype(np.uint8)
    found = read_profile(data).to_linear((samples / 255).astype(np.float32))
    # LittleCMS to sRGB, whose curve is undone by its formula; 8 bits of its answer allow half a step.
    transform = PIL.ImageCms.buildTransform(
        PIL.ImageCms.ImageCmsProfile(io.BytesIO(data)),
        PIL.ImageCms.createProfile("sRGB"),
        "RGB",
        "RGB",
        PIL.ImageCms.Intent.RELATIVE_COLORIMETRIC,
    )
    picture = PIL.ImageCms.applyTransform(PIL.Image.fromarray(samples), transform)
    assert picture is not None
    encoded = np.where(found <= 0.0031308, 12.92 * found, 1.055 * np.maximum(found, 1e-9) ** (1 / 2.4) - 0.055)
    inside = (encoded > 0.02) & (encoded < 0.98)
    assert inside.mean() > 0.4
    assert np.abs(encoded * 255 - np.asarray(picture))[inside].max() < 1.6


def test_srgb_profile_of_pillow_is_the_srgb_curve_without_a_matrix() -> None:
    found = read_profile(PIL.ImageCms.ImageCmsProfile(PIL.ImageCms.createProfile("sRGB")).tobytes())
    x = np.linspace(0, 1, 4096, dtype=np.float32)
    wanted = np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)
    assert found.to_srgb is None
    assert np.abs(found.to_linear(np.tile(x[:, None], (1, 2))) - wanted[:, None]).max() < 2e-4
    assert "sRGB" in found.name


def test_grey_and_other_profiles() -> None:
    grey = profile(CURVES["gamma 2.2"]).replace(b"RGB XYZ ", b"GRAYXYZ ").replace(b"gTRC", b"kTRC")
    assert read_profile(grey).to_linear(np.full((1, 1), 0.5, np.float32)).item() == pytest.approx(
        0.5 ** (563 / 256), abs=1e-4
    )
    with pytest.raises(ProfileError, match="CMYK"):
        read_profile(profile(CURVES["identity"]).replace(b"RGB XYZ ", b"CMYKXYZ "))
    with pytest.raises(ProfileError, match="look-up tables"):
        read_profile(profile(CURVES["identity"]).replace(b"rTRC", b"A2B0"))


@pytest.mark.parametrize("length", [0, 20, 131, 140, 200, 300])
def test_damaged_profiles_are_refused(length: int) -> None:
    with pytest.raises(ProfileError):
        read_profile(profile(CURVES["table"])[:length])
