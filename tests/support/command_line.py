"""The command ``orennayar`` run inside the test's process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Result:
    """Exit status and what was printed."""

    status: int
    out: str
    err: str


Run = Callable[..., Result]
"""Runs ``orennayar`` with the given words, the type of the fixture `orennayar`."""
