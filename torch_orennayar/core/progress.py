"""Progress bars for long work: on a terminal a bar on stderr, or one line without rich; elsewhere silence."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import TypeVar

T = TypeVar("T")


def say(text: str) -> None:
    """Tell a person at a terminal what happens now; quiet when stderr is not a terminal."""
    if sys.stderr.isatty():
        print(text, file=sys.stderr, flush=True)


def track(items: Iterable[T], description: str, total: int | None = None) -> Iterator[T]:
    """Yield ``items`` and show how far they are; quiet when stderr is not a terminal."""
    if not sys.stderr.isatty():
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
