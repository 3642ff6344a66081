from __future__ import annotations

import sys

import pytest

from tests.support.command_line import Result, Run
from torch_orennayar.cli import main


@pytest.fixture
def orennayar(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    """Run the command with the given words."""

    def run(*arguments: object) -> Result:
        monkeypatch.setattr(sys, "argv", ["orennayar", *(str(a) for a in arguments)])
        capfd.readouterr()
        try:
            main()
            status = 0
        except SystemExit as leave:
            status = int(leave.code or 0)
        captured = capfd.readouterr()
        return Result(status, captured.out, captured.err)

    return run
