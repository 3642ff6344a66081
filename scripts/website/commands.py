"""The page of the command line: what every command's ``--help`` says."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from torch_orennayar.cli import application

COMMANDS = tuple(function.__name__ for function, _ in application.COMMANDS)
"""Commands in the order of `orennayar --help`."""
COLUMNS = 100
"""Width of the text in characters."""


def write(page: Path) -> None:
    """Write the page as Markdown."""
    text = "# Command line\n\nVectors take commas or blanks: `--light 0.3,0.4,0.86` is `--light 0.3 0.4 0.86`.\n"
    for name in COMMANDS:
        text += f"\n## orennayar {name}\n\n```text\n{help_of(name)}\n```\n"
    page.write_text(text, encoding="utf-8")


def help_of(*command: str) -> str:
    """What the command's ``--help`` prints."""
    plain = {"COLUMNS": str(COLUMNS), "TERM": "dumb", "NO_COLOR": "1", "PYTHONIOENCODING": "utf-8"}
    code = "import sys; from torch_orennayar.cli import main; sys.argv[0] = 'orennayar'; main()"
    run = [sys.executable, "-c", code, *command, "--help"]
    shown = subprocess.run(run, capture_output=True, check=True, encoding="utf-8", env={**os.environ, **plain})
    return shown.stdout.strip()
