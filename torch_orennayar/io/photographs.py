"""Read the photographs of a capture to linear light, all of one size and bit depth."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from ..core.errors import FileError
from ..core.progress import track
from .images import read_image, srgb_to_linear, to_unit

HALF_FROM = 1 << 29
"""Samples of a capture from which images are kept in half precision: 0.05 % of each value, half the memory."""


def read_photographs(
    files: list[Path], encoding: str, notes: list[str], intensities: Tensor, ambient: Path | None
) -> Tensor:
    """(K, 3, H, W) linear, over the intensities; all of one size and bit depth."""
    if not files:
        raise FileError("images", expected="image files in the folder", got="none", mend="check the folder")
    first = read_image(files[0])
    curved = encoding == "srgb" or (encoding == "auto" and first.dtype == np.uint8)
    guess = "; if they are not, load them with encoding='linear' (--encoding linear)" if encoding == "auto" else ""
    notes.append(f"{first.dtype} images read as {f'sRGB-encoded{guess}' if curved else 'linear light'}.")

    def decode(file: Path) -> Tensor:
        array = read_image(file)
        _check_alike(file, array, files[0], first)
        unit = torch.from_numpy(to_unit(array))
        image = unit.expand(3, -1, -1) if unit.ndim == 2 else unit.permute(2, 0, 1)
        return srgb_to_linear(image) if curved else image

    shape = (len(files), 3, *first.shape[:2])
    large = len(files) * 3 * first.shape[0] * first.shape[1] > HALF_FROM
    if large:
        notes.append("a large capture: its images are kept in half precision, 0.05 % of each value.")
    result = torch.empty(shape, dtype=torch.float16 if large else torch.float32)
    dark = None if ambient is None else decode(ambient)
    if ambient is not None:
        notes.append(f"{ambient.name}, taken with all lights off, was subtracted.")

    def fill(index: int) -> None:
        image = decode(files[index])
        if dark is not None:
            image = (image - dark).clamp_min(0)
        result[index] = image / intensities[index][:, None, None]

    workers = min(1 if large else 4, os.cpu_count() or 1)  # a reader holds its image several times over
    with ThreadPoolExecutor(workers) as pool:
        try:
            list(track(pool.map(fill, range(len(files))), "reading images", len(files)))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return result


def _check_alike(file: Path, array: npt.NDArray[np.generic], first_file: Path, first: npt.NDArray[np.generic]) -> None:
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
