"""Progress of long work on stderr: on a terminal a bar, or one line where ``rich`` is missing; nothing elsewhere.

``TORCH_ORENNAYAR_PROGRESS=0`` in the environment switches it off on a terminal too.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from typing import TypeVar

T = TypeVar("T")

SWITCH = "TORCH_ORENNAYAR_PROGRESS"
"""Environment variable; ``0`` switches progress off. Read at every call."""


def visible() -> bool:
    """Whether progress is shown: stderr is a terminal and `SWITCH` is not 0."""
    return sys.stderr.isatty() and os.environ.get(SWITCH) != "0"


def say(text: str) -> None:
    """Print a line about what happens now, if progress is `visible`."""
    if visible():
        print(text, file=sys.stderr, flush=True)


def track(items: Iterable[T], description: str, total: int | None = None) -> Iterator[T]:
    """Yield ``items`` and show a bar, if progress is `visible`.

    Args:
        items: what to iterate over.
        description: a word or two before the bar.
        total: number of items, where ``len(items)`` does not exist.
    """
    if not visible():
        yield from items
        return
    try:
        from rich.console import Console
        from rich.progress import track as rich_track
    except ModuleNotFoundError:
        say(description)
        yield from items
        return
    yield from rich_track(items, description, total, console=Console(stderr=True), transient=True)
