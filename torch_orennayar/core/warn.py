"""Warnings that point at the user's line, whatever decorators and calls of this package and of torch lie between."""

from __future__ import annotations

import sys
import warnings

_SKIPPED_PACKAGES = ("torch_orennayar", "torch", "contextlib")
"""Top-level packages whose frames are not the user's; `contextlib` holds the frame of a decorator."""


def warn(message: str) -> None:
    """Issue a ``UserWarning`` attributed to the nearest caller outside this package and torch."""
    level, frame = 1, sys._getframe(0)
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in _SKIPPED_PACKAGES:
        level, frame = level + 1, frame.f_back
    warnings.warn(message, stacklevel=level)
