from __future__ import annotations

import io
import sys
from collections.abc import Callable

import pytest

from torch_orennayar.core import progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> Callable[[io.StringIO], str]:
    """What progress writes to a given stderr."""

    def run(stderr: io.StringIO) -> str:
        monkeypatch.setattr(sys, "stderr", stderr)
        progress.say("solving")
        assert list(progress.track(iter(range(3)), "pixels", 3)) == [0, 1, 2]
        return stderr.getvalue()

    return run


def test_a_bar_on_a_terminal(shown: Callable[[io.StringIO], str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(progress.SWITCH, raising=False)
    text = shown(Terminal())
    assert text.startswith("solving\n")
    assert "pixels" in text


def test_nothing_where_stderr_is_no_terminal(
    shown: Callable[[io.StringIO], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(progress.SWITCH, raising=False)
    assert shown(io.StringIO()) == ""


def test_nothing_where_it_is_switched_off(shown: Callable[[io.StringIO], str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(progress.SWITCH, "0")
    assert shown(Terminal()) == ""


def test_one_line_without_rich(shown: Callable[[io.StringIO], str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(progress.SWITCH, raising=False)
    monkeypatch.setitem(sys.modules, "rich.console", None)
    monkeypatch.setitem(sys.modules, "rich.progress", None)
    assert shown(Terminal()) == "solving\npixels\n"
