"""Run the commands of a guide as its reader would."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path

from .example_code import EXAMPLES, load

GUIDES = EXAMPLES / "guides"


def commands(guide: str) -> list[list[str]]:
    """The words of every command in the guide's shell blocks, in order."""
    blocks = re.findall(r"```sh\n(.*?)```", (GUIDES / guide).read_text(encoding="utf-8"), re.DOTALL)
    lines = [line for block in blocks for line in block.splitlines()]
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def follow(guide: str, orennayar: Callable[..., object]) -> None:
    """Run the commands of a guide in the current folder.

    Args:
        guide: its file name.
        orennayar: runs the command with the given words.
    """
    for program, *words in commands(guide):
        if program == "orennayar":
            orennayar(*words)
            continue
        assert program == "python", program
        load(Path(words[0]).stem).main(words[1:])
