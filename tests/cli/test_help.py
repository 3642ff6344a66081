from __future__ import annotations

import os
import shlex
import subprocess
import sys
from typing import get_args

import pytest
import typer.main

from tests.support.command_line import Run
from torch_orennayar import MODELS, __version__
from torch_orennayar.cli import app
from torch_orennayar.cli.application import COMMANDS
from torch_orennayar.cli.calibrate import Kind
from torch_orennayar.cli.export import ExportModel, Graph
from torch_orennayar.cli.options import Encoding, ModelName, ShapeModel, StereoModel

NAMES = [function.__name__ for function, _ in COMMANDS]


def test_models_of_the_help_are_those_of_the_package() -> None:
    assert list(get_args(ModelName)) == list(MODELS)


@pytest.mark.parametrize("flag", ["-h", "--help"])
@pytest.mark.parametrize("command", NAMES)
def test_help_ends_with_an_example(orennayar: Run, command: str, flag: str) -> None:
    result = orennayar(command, flag)
    assert result.status == 0
    lines = result.out.rstrip().splitlines()
    assert lines[-2].strip() == "Example:"
    assert lines[-1].strip().startswith(f"orennayar {command} ")


@pytest.mark.parametrize("example", [example for _, example in COMMANDS])
def test_examples_parse(example: str) -> None:
    name, *words = shlex.split(example)
    group = typer.main.get_command(app)
    command = getattr(group, "commands")[name]  # noqa: B009
    with group.make_context("orennayar", [name]) as parent, command.make_context(name, words, parent=parent) as context:
        assert not context.args


def test_version(orennayar: Run) -> None:
    result = orennayar("--version")
    assert (result.status, result.out.strip()) == (0, __version__)
    assert "--version" in orennayar("-h").out


@pytest.mark.parametrize(
    ("command", "choices"),
    [
        ("render", ModelName),
        ("stereo", StereoModel),
        ("stereo", Encoding),
        ("shape", ShapeModel),
        ("shape", Encoding),
        ("calibrate", Kind),
        ("export", Graph),
        ("export", ExportModel),
    ],
)
def test_help_lists_the_choices(orennayar: Run, command: str, choices: object) -> None:
    assert "|".join(get_args(choices)) in orennayar(command, "--help").out


def test_completion_lists_the_choices() -> None:
    words = "orennayar export --model "
    environment = os.environ | {
        "_ORENNAYAR_COMPLETE": "complete_bash",
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split())),
    }
    code = "import sys; sys.argv = ['orennayar']; from torch_orennayar.cli import app; app(prog_name='orennayar')"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.split() == list(get_args(ExportModel))


def test_help_does_not_wait_for_torch() -> None:
    code = (
        "import sys; from torch_orennayar.cli import app; "
        "print([m for m in ('torch', 'numpy', 'rich.table') if m in sys.modules])"
    )
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"
