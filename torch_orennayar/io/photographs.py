"""The pictures of a capture: found in its folder, read to linear light, all of one size, orientation and encoding."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from ..core.errors import FileError
from ..core.files import written_files
from ..core.findings import Finding
from ..core.progress import track
from .encoding import srgb_curve
from .light_text import clean_name, read_lines
from .listed_names import path_inside
from .masks import is_mask
from .picture import HEIF_SUFFIXES, IMAGE_SUFFIXES, RAW_SUFFIXES, Picture, read_picture, to_unit

Floats: TypeAlias = npt.NDArray[np.float32]

HALF_FROM = 1 << 29
"""Number of samples of a capture (K x 3 x H x W) from which images are kept in half precision, which rounds each value
by at most 0.05 % and halves the memory; set by hand: 2 GiB in float32."""
AMBIENT = "ambient"
"""Name, without suffix, of a photograph taken with all lights off; a convention of this package."""
READERS = 4
"""Threads that decode photographs, at most; set by hand. Each holds its image several times over."""


def list_photographs(folder: Path, others: Sequence[Path]) -> list[Path]:
    """Photographs of a capture in natural order: those in ``filenames.txt``, else images that are nothing else.

    Masks, ``others`` and results that this package wrote there are something else.

    Raises:
        FileError: a listed name that leads out of the folder, or nothing that can be read.
    """
    listing = folder / "filenames.txt"
    if listing.is_file():
        listed = [path_inside(folder, clean_name(line)) for _, line in read_lines(listing)]
        if not listed:
            raise FileError(str(listing), expected="names of photographs", got="none", mend="fill it, or remove it")
        return listed

    def natural(file: Path) -> list[tuple[int, str]]:
        return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", file.name)]

    results = written_files(folder)

    def is_photograph(file: Path) -> bool:
        hidden = file.name.startswith(".") or file.name in results or is_mask(file)
        hidden = hidden or file.resolve() in {other.resolve() for other in others}
        return file.suffix.lower() in IMAGE_SUFFIXES and not hidden

    found = sorted(filter(is_photograph, folder.iterdir()), key=natural)
    if not found:
        kinds = Counter(f.suffix.lower() or "no suffix" for f in folder.iterdir() if f.is_file())
        got = ", ".join(f"{count} {suffix}" for suffix, count in kinds.most_common(6)) or "no files"
        mend = "check the folder"
        if kinds.keys() & (RAW_SUFFIXES | HEIF_SUFFIXES):
            mend = "convert the camera's files: RAW to linear 16-bit TIFF (dcraw -4 -T), HEIC to TIFF or JPEG"
        raise FileError(str(folder), expected="photographs", got=got, mend=mend)
    return found


def find_ambient(folder: Path) -> Path | None:
    """The photograph with all lights off in ``folder``, if it has one."""
    found = [f for f in sorted(folder.iterdir()) if f.stem.lower() == AMBIENT and f.suffix.lower() in IMAGE_SUFFIXES]
    return found[0] if found else None


class Photographs(NamedTuple):
    """What `read_photographs` found.

    Attributes:
        images: (K, 3, H, W) linear light.
        valid: (K, 1, H, W) bool, where no channel is at full scale; None where that is everywhere.
        findings: what was decided on the way.
    """

    images: Tensor
    valid: Tensor | None
    findings: tuple[Finding, ...]


def read_photographs(
    files: Sequence[Path], encoding: str, intensities: Tensor, ambient: Path | None = None
) -> Photographs:
    """Images in linear light divided by ``intensities`` (K, 3).

    Args:
        files: the photographs.
        encoding: as `load_capture` takes it.
        intensities: RGB irradiance per photograph.
        ambient: a photograph with all lights off, which is subtracted before the division.

    Raises:
        FileError: no files, damaged ones, or images of more than one size or bit depth.
    """
    if not files:
        raise FileError("images", expected="image files in the folder", got="none", mend="check the folder")
    first = read_picture(files[0])
    linear, decisions = _choose_encoding(first, encoding)
    large = len(files) * 3 * first.samples.shape[0] * first.samples.shape[1] > HALF_FROM

    def decode(file: Path) -> tuple[Tensor, Tensor]:
        picture = read_picture(file)
        _check_same_kind(file, picture, files[0], first)
        light = torch.from_numpy(linear(to_unit(picture.samples)))
        return light.expand(3, -1, -1) if light.ndim == 2 else light.permute(2, 0, 1), _below_full_scale(picture)

    dark = None if ambient is None else decode(ambient)[0]
    valid = torch.empty((len(files), 1, *first.samples.shape[:2]), dtype=torch.bool)
    result = torch.empty((len(files), 3, *first.samples.shape[:2]), dtype=torch.float16 if large else torch.float32)

    def fill(index: int) -> None:
        image, valid[index] = decode(files[index])
        if dark is not None:
            image = (image - dark).clamp_min(0)
        result[index] = image / intensities[index][:, None, None]

    with ThreadPoolExecutor(min(1 if large else READERS, os.cpu_count() or 1)) as pool:
        try:
            list(track(pool.map(fill, range(len(files))), "reading images", len(files)))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    findings = (*decisions, *_other_findings(first, large, ambient))
    return Photographs(result, None if bool(valid.all()) else valid, findings)


def _below_full_scale(picture: Picture) -> Tensor:
    """Where no channel has the largest value of its type, (H, W) bool: there the sensor or the file was at its end."""
    samples = picture.samples
    full = {"uint8": 255, "uint16": 65535}.get(samples.dtype.name)
    if full is None:
        return torch.ones(samples.shape[:2], dtype=torch.bool)
    below = np.asarray(samples != full)
    return torch.from_numpy(below if below.ndim == 2 else below.all(2))


def _choose_encoding(picture: Picture, encoding: str) -> tuple[Callable[[Floats], Floats], list[Finding]]:
    """What turns samples into linear light, and why: the caller's word, else the file's, else 8 bits are sRGB."""
    dtype, stated = picture.samples.dtype, picture.stated
    if encoding == "auto" and stated is not None:
        return stated.to_linear, [Finding(f"{dtype} images read as they say: {stated.words}.", "encoding-stated")]
    encoded = encoding == "srgb" or (encoding == "auto" and dtype == np.uint8)
    curve, code, other = (
        ("sRGB-encoded", "read-as-srgb", "linear") if encoded else ("linear light", "read-as-linear", "srgb")
    )
    guess = f"; if they are not, load them with encoding='{other}' (--encoding {other})" if encoding == "auto" else ""
    found = [Finding(f"{dtype} images read as {curve}{guess}.", code)]
    if stated is not None and stated.linear == encoded:
        found.append(Finding(f"the images state another encoding: {stated.words}.", "encoding-overridden"))
    return srgb_curve if encoded else lambda samples: samples, found


def _other_findings(picture: Picture, large: bool, ambient: Path | None) -> list[Finding]:
    found = []
    if picture.orientation != 1:
        said = f"images turned upright as they say (orientation {picture.orientation})"
        text = f"{said}; lights are taken as those of the upright view."
        found.append(Finding(text, "turned-upright", picture.orientation))
    if large:
        text = "a large capture: its images are kept in half precision, 0.05 % of each value."
        found.append(Finding(text, "half-precision"))
    if ambient is not None:
        text = f"{ambient.name}, taken with all lights off, was subtracted."
        found.append(Finding(text, "ambient-subtracted"))
    return found


def _check_same_kind(file: Path, picture: Picture, first_file: Path, first: Picture) -> None:
    """All images of a capture have one size, orientation, bit depth and encoding."""

    def words(one: Picture) -> str:
        return one.stated.words if one.stated is not None else "no encoding"

    kinds = (
        (
            lambda p: f"orientation {p.orientation}",
            "turn all images alike: the camera was turned between photographs, or an editor turned some of them",
        ),
        (lambda p: f"{p.samples.shape[1]} x {p.samples.shape[0]} pixels", "bring all images of a capture to one size"),
        (lambda p: f"{p.samples.dtype} samples", "export all images of a capture with one bit depth"),
        (words, "export all images of a capture in one encoding"),
    )
    for kind, mend in kinds:
        if kind(picture) != kind(first):
            raise FileError(str(file), expected=f"{kind(first)} as in {first_file.name}", got=kind(picture), mend=mend)
