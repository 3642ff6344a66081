"""The command ``orennayar``. Angles on the command line are degrees."""

from __future__ import annotations

import sys
import warnings
from typing import TYPE_CHECKING

from ..core.errors import TorchOrenNayarError

if TYPE_CHECKING:
    import typer

    from .application import app

__all__ = ["INTERRUPTED", "app", "main"]

INTERRUPTED = 130
"""Exit status of a command that was stopped with Ctrl-C: 128 + SIGINT, the shells' convention."""


def main() -> None:
    """Run the command; a warning is one line on stderr, a user's mistake another and exit status 1."""
    warnings.formatwarning = lambda message, *_, **__: f"warning: {' '.join(str(message).split())}\n"
    try:
        _application()()
    except TorchOrenNayarError as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(1)
    except SystemExit as leave:
        if leave.code == INTERRUPTED:
            print("interrupted; no half-written file is left", file=sys.stderr)
        raise


def _application() -> typer.Typer:
    try:
        from .application import app
    except ModuleNotFoundError:
        from ..core.optional import require  # imports torch, which `orennayar --help` need not wait for

        require("typer", "rich")
        raise
    return app


def __getattr__(name: str) -> object:
    """``app``, the `typer.Typer` object, which needs typer."""
    if name == "app":
        return _application()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
