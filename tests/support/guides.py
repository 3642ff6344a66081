"""Run the commands of a guide as its reader would."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from torch_orennayar import angular_error

from .example_code import EXAMPLES, load

GUIDES = EXAMPLES / "guides"


def blocks(guide: str, language: str) -> list[str]:
    """The guide's blocks of code in a language, in order."""
    return re.findall(rf"```{language}\n(.*?)```", (GUIDES / guide).read_text(encoding="utf-8"), re.DOTALL)


def commands(guide: str) -> list[list[str]]:
    """The words of every command in the guide's shell blocks, in order."""
    lines = [line for block in blocks(guide, "sh") for line in block.splitlines()]
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


def normal_error(results: str) -> float:
    """Mean error in degrees of a folder of results for what ``photograph_scene.py`` photographed in ``truth``."""
    normal, part = np.load("truth/normal.npy"), np.load("truth/part.npy")
    found = torch.from_numpy(np.load(Path(results, "normal.npy")))
    inside = torch.from_numpy(part == load("photograph_scene").OBJECT) & (found != 0).any(0)
    return angular_error(found, torch.from_numpy(normal), inside[None]).summary()["mean"]
