"""The gallery's programs are short and repeatable; the build of the site runs them (`scripts/docs`)."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from tests.support.example_code import EXAMPLES

GALLERY = sorted((EXAMPLES / "gallery").glob("*.py"))
MOST_LINES = 60
"""Of a program that is read from top to bottom."""


@pytest.mark.parametrize("file", GALLERY, ids=lambda file: file.stem)
def test_a_program_is_short_titled_and_seeded(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= MOST_LINES
    lines = (ast.get_docstring(ast.parse(text)) or "").splitlines()
    assert lines[1] == "=" * len(lines[0])
    assert lines[3:]
    assert "# %%" in text
    if re.search(r"torch\.rand|Random", text):
        assert "manual_seed" in text


def test_there_are_a_dozen() -> None:
    assert len(GALLERY) >= 12
