"""The pictures of a capture: found in its folder, read to linear light, all of one size and bit depth; its mask."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from ..core.errors import FileError
from ..core.findings import Finding
from ..core.progress import track
from .images import IMAGE_SUFFIXES, read_image, srgb_to_linear, to_unit
from .light_files import read_words

HALF_FROM = 1 << 29
"""Number of samples of a capture (K x 3 x H x W) from which images are kept in half precision, which rounds each value
by at most 0.05 % and halves the memory; set by hand: 2 GiB in float32."""
AMBIENT = "ambient"
"""Name, without suffix, of a photograph taken with all lights off; a convention of this package."""
READERS = 4
"""Threads that decode photographs, at most; set by hand. Each holds its image several times over."""


def list_photographs(folder: Path, others: Sequence[Path]) -> list[Path]:
    """Photographs of a capture in natural order: those in ``filenames.txt``, else all images but masks and ``others``.

    Raises:
        FileError: a listed name that leads out of the folder.
    """
    listing = folder / "filenames.txt"
    if listing.is_file():
        return [path_inside(folder, " ".join(row)) for row in read_words(listing)]

    def natural(file: Path) -> list[tuple[int, str]]:
        return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", file.name)]

    def is_photograph(file: Path) -> bool:
        hidden = file.name.startswith(".") or file.stem.lower() == "mask"
        hidden = hidden or file.resolve() in {other.resolve() for other in others}
        return file.suffix.lower() in IMAGE_SUFFIXES and not hidden

    return sorted(filter(is_photograph, folder.iterdir()), key=natural)


def path_inside(folder: Path, name: str) -> Path:
    """``folder / name``; links are followed.

    Raises:
        FileError: that is not inside the folder.
    """
    file = folder / name.replace("\\", "/")
    if not file.resolve().is_relative_to(folder.resolve()):
        raise FileError(
            name, expected=f"a file inside {folder}", got="a path that leaves it", mend="move the image into the folder"
        )
    return file


def find_ambient(folder: Path) -> Path | None:
    """The photograph with all lights off in ``folder``, if it has one."""
    found = [f for f in sorted(folder.iterdir()) if f.stem.lower() == AMBIENT and f.suffix.lower() in IMAGE_SUFFIXES]
    return found[0] if found else None


def read_photographs(
    files: Sequence[Path], encoding: str, intensities: Tensor, ambient: Path | None = None
) -> tuple[Tensor, tuple[Finding, ...]]:
    """Images (K, 3, H, W) in linear light divided by ``intensities`` (K, 3), and what was decided on the way.

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
    first = read_image(files[0])
    encoded = encoding == "srgb" or (encoding == "auto" and first.dtype == np.uint8)
    large = len(files) * 3 * first.shape[0] * first.shape[1] > HALF_FROM

    def decode(file: Path) -> Tensor:
        array = read_image(file)
        _check_same_kind(file, array, files[0], first)
        unit = torch.from_numpy(to_unit(array))
        image = unit.expand(3, -1, -1) if unit.ndim == 2 else unit.permute(2, 0, 1)
        return srgb_to_linear(image) if encoded else image

    dark = None if ambient is None else decode(ambient)
    result = torch.empty((len(files), 3, *first.shape[:2]), dtype=torch.float16 if large else torch.float32)

    def fill(index: int) -> None:
        image = decode(files[index])
        if dark is not None:
            image = (image - dark).clamp_min(0)
        result[index] = image / intensities[index][:, None, None]

    with ThreadPoolExecutor(min(1 if large else READERS, os.cpu_count() or 1)) as pool:
        try:
            list(track(pool.map(fill, range(len(files))), "reading images", len(files)))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return result, tuple(_decisions(first.dtype, encoding, encoded, large, ambient))


def _decisions(
    dtype: npt.DTypeLike, encoding: str, encoded: bool, large: bool, ambient: Path | None
) -> Sequence[Finding]:
    decisions = []
    if encoded:
        guess = "; if they are not, load them with encoding='linear' (--encoding linear)" if encoding == "auto" else ""
        decisions.append(Finding(f"{dtype} images read as sRGB-encoded{guess}.", "read-as-srgb"))
    else:
        decisions.append(Finding(f"{dtype} images read as linear light.", "read-as-linear"))
    if large:
        text = "a large capture: its images are kept in half precision, 0.05 % of each value."
        decisions.append(Finding(text, "half-precision"))
    if ambient is not None:
        text = f"{ambient.name}, taken with all lights off, was subtracted."
        decisions.append(Finding(text, "ambient-subtracted"))
    return decisions


def _check_same_kind(
    file: Path, array: npt.NDArray[np.generic], first_file: Path, first: npt.NDArray[np.generic]
) -> None:
    """All images of a capture have one size and bit depth."""
    if array.shape[:2] != first.shape[:2]:
        raise FileError(
            str(file),
            expected=f"{first.shape[1]} x {first.shape[0]} pixels as in {first_file.name}",
            got=f"{array.shape[1]} x {array.shape[0]}",
            mend="bring all images of a capture to one size",
        )
    if array.dtype != first.dtype:
        raise FileError(
            str(file),
            expected=f"{first.dtype} samples as in {first_file.name}",
            got=str(array.dtype),
            mend="export all images of a capture with one bit depth",
        )


def read_mask(file: Path, size: tuple[int, int], *, required: bool) -> tuple[Tensor, tuple[Finding, ...]]:
    """The mask (1, H, W) bool, where the file is brighter than half its maximum, and what was assumed.

    Without the file every pixel is the object, unless it is ``required``.

    Raises:
        FileError: a missing, damaged or empty mask, or one of another size.
    """
    if not file.is_file() and not required:
        text = "no mask.png: every pixel is taken as the object."
        return torch.ones(1, *size, dtype=torch.bool), (Finding(text, "no-mask"),)
    array = to_unit(read_image(file))
    array = array if array.ndim == 2 else array.max(axis=2)
    if array.shape != size:
        raise FileError(
            str(file),
            expected=f"{size[1]} x {size[0]} pixels as the images have",
            got=f"{array.shape[1]} x {array.shape[0]}",
            mend="crop or resize the mask",
        )
    mask = torch.from_numpy(array > array.max() / 2)[None]  # relative to the maximum: some masks hold 0 and 1
    if not bool(mask.any()):
        raise FileError(str(file), expected="some white pixels", got="an empty mask", mend="paint the object white")
    return mask, ()
