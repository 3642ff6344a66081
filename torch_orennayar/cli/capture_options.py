"""Load a capture from the options that name its files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from .options import Encoding, LengthUnit, parse_vector

if TYPE_CHECKING:
    from ..io.capture import Capture


def load_from_options(
    folder: Path,
    *,
    mask: Path | None,
    ball: str | None,
    crop: str | None,
    scale: float,
    encoding: Encoding,
    unit: LengthUnit | None,
    **files: Path | None,
) -> Capture:
    """`load_capture` with vectors and the mask's ``whole`` as they are written on a command line.

    Args:
        folder: the capture.
        mask: a file, or the word ``whole``.
        ball: ``X,Y,RADIUS``.
        crop: ``LEFT,TOP,WIDTH,HEIGHT``.
        scale: as `load_capture` takes it.
        encoding: as `load_capture` takes it.
        unit: as `load_capture` takes it.
        files: the other files that `load_capture` takes, by its names.

    Raises:
        RangeError: numbers that cannot be read.
    """
    from ..io.capture import load_capture

    return load_capture(
        folder,
        mask="whole" if str(mask) == "whole" else mask,
        ball=None if ball is None else parse_vector("--ball", ball, "320,240,55"),
        crop=None if crop is None else [round(n) for n in parse_vector("--crop", crop, "100,50,800,600")],
        scale=scale,
        encoding=encoding,
        unit=unit,
        **files,
    )
