"""Masks as people have them: found beside the photographs, read from alpha, labels or brightness."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from ..core.errors import FileError
from ..core.files import written_files
from ..core.findings import Finding
from .picture import IMAGE_SUFFIXES, Picture, read_picture, to_unit

MASK_WORD = "mask"
"""A picture with this word in its name, in any letter case, is a mask and no photograph."""
MASK_FOLDERS = ("mask", "masks")
"""Folders beside the photographs in which a mask may lie."""
MAX_LABEL = 64
"""Grey integers up to this one are labels, not brightness: annotation tools count from 1, painters use white."""
VARIES = 0.02
"""Alpha whose least and largest value differ by more than this cuts out an object; set by hand, above rounding."""


def is_mask(file: Path) -> bool:
    """Whether a file's name says that it is a mask."""
    return MASK_WORD in file.stem.lower() and file.suffix.lower() in IMAGE_SUFFIXES | {".gif"}


def find_mask(folder: Path) -> Path | None:
    """The mask of a capture: the picture called ``mask``, else the only one with that word in its name.

    Raises:
        FileError: several, none of which is called ``mask``.
    """
    places = [folder, *(f for f in sorted(folder.iterdir()) if f.is_dir() and f.name.lower() in MASK_FOLDERS)]
    for place in places:
        results = written_files(place)
        masks = (f for f in place.iterdir() if f.is_file() and is_mask(f) and not f.name.startswith("."))
        found = sorted(f for f in masks if f.name not in results)
        exact = [f for f in found if f.stem.lower() == MASK_WORD]
        if len(exact or found) > 1:
            listed = ", ".join(f.name for f in exact or found)
            mend = "give the right one as mask= (--mask)"
            raise FileError(str(place), expected="one mask", got=listed[:200], mend=mend)
        if exact or found:
            return (exact or found)[0]
    return None


def read_mask(file: Path | None, size: tuple[int, int]) -> tuple[Tensor, tuple[Finding, ...]]:
    """The mask (1, H, W) bool and what was assumed; without a file every pixel is the object.

    The object is the opaque part where alpha varies, every label but 0 in a picture of labels (small integers, or flat
    colours), and else what is brighter than half the maximum.

    Raises:
        FileError: a missing, damaged or empty mask, or one of another size.
    """
    if file is None:
        text = "no mask: every pixel is taken as the object."
        return torch.ones(1, *size, dtype=torch.bool), (Finding(text, "no-mask"),)
    picture = read_picture(file)
    if picture.samples.shape[:2] != size:
        raise FileError(
            str(file),
            expected=f"{size[1]} x {size[0]} pixels as the images have",
            got=f"{picture.samples.shape[1]} x {picture.samples.shape[0]}",
            mend="crop or resize the mask",
        )
    inside, findings = _object(file, picture)
    if not inside.any():
        raise FileError(str(file), expected="some white pixels", got="an empty mask", mend="paint the object white")
    if inside.all():
        findings.append(Finding(f"{file.name} leaves no pixel out.", "mask-covers-everything"))
    elif inside[[0, 0, -1, -1], [0, -1, 0, -1]].all():
        text = f"{file.name} holds all four corners: if the object is the dark part, invert it."
        findings.append(Finding(text, "mask-may-be-inverted"))
    return torch.from_numpy(np.ascontiguousarray(inside))[None], tuple(findings)


def read_mask_alone(file: Path) -> Tensor:
    """The mask (1, H, W) bool, of whatever size it has.

    Raises:
        FileError: a missing, damaged or empty mask.
    """
    height, width = read_picture(file).samples.shape[:2]
    return read_mask(file, (height, width))[0]


def _object(file: Path, picture: Picture) -> tuple[npt.NDArray[np.bool_], list[Finding]]:
    samples, alpha = picture.samples, picture.alpha
    if alpha is not None and alpha.max() - alpha.min() > VARIES:
        return alpha > alpha.max() / 2, [Finding(f"the object is the opaque part of {file.name}.", "mask-from-alpha")]
    grey = samples if samples.ndim == 2 else samples.max(axis=2)
    if _holds_labels(samples, grey):
        found = to_unit(grey) > 0
        count = len(np.unique(samples.reshape(samples.shape[0] * samples.shape[1], -1), axis=0)) - 1
        return found, [Finding(f"the object is every label of {file.name} but 0: {count}.", "mask-from-labels", count)]
    values = to_unit(grey)
    return values > values.max() / 2, []


def _holds_labels(samples: npt.NDArray[np.generic], grey: npt.NDArray[np.generic]) -> bool:
    """Small integers from 0 on, more than one; or a background of 0 and a few flat colours that are not grey."""
    if not np.issubdtype(samples.dtype, np.integer) or int(grey.min()) != 0:
        return False
    if samples.ndim == 2 or bool((samples == samples[..., :1]).all()):
        return 1 < int(grey.max()) <= MAX_LABEL
    colours = np.unique(samples.reshape(-1, 3), axis=0)
    return len(colours) <= MAX_LABEL
