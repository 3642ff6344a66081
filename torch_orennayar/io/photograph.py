"""One photograph under one light."""

from __future__ import annotations

import os
from pathlib import Path

import torch
from torch import Tensor

from ..core.defaults import independent_of_defaults
from .capture import Capture
from .encoding import check_encoding
from .masks import read_mask
from .object_mask import find_object
from .photographs import read_photographs


@independent_of_defaults
def load_photograph(
    path: str | os.PathLike[str],
    light: Tensor | None,
    *,
    mask: str | os.PathLike[str] | None = None,
    encoding: str = "auto",
) -> Capture:
    """Read one photograph under one light, for `shape_from_shading`.

    Args:
        path: the picture.
        light: (3,) unit direction to the light; where it is not known, None, the capture states the view's.
        mask: its mask file; white is the object. ``"whole"``: every pixel. Default: what the light reaches before a
            dark background, and every pixel where there is no such background.
        encoding: as in `load_capture`.

    Returns:
        A `Capture` with K = 1.

    Raises:
        FileError: a file is missing, damaged or of another size.
        RangeError: unknown encoding.
    """
    check_encoding(encoding)
    images, _, valid, notes = read_photographs([Path(path)], encoding, torch.ones(1, 3))
    size = (images.shape[2], images.shape[3])
    if mask is None:
        inside, about = find_object(images)
        notes = (*notes, about)
    else:
        inside, about_mask = read_mask(None if mask == "whole" else Path(mask), size)
        notes = (*notes, *about_mask)
    stated = torch.tensor((0.0, 0.0, 1.0)) if light is None else light
    return Capture(images, stated[None], torch.ones(1, 3), inside, None, (Path(path).name,), notes, valid)
