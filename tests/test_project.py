from __future__ import annotations

import re
from pathlib import Path

import torch_orennayar as ton

ROOT = Path(__file__).parent.parent


def test_the_changelogs_newest_release_is_this_version() -> None:
    text = (ROOT / ".github/CHANGELOG.md").read_text(encoding="utf-8")
    headings = re.findall(r"^## \[(.+?)\](?: - \d{4}-\d{2}-\d{2})?$", text, re.MULTILINE)
    assert headings[:2] == ["Unreleased", ton.__version__]
    assert set(headings) == set(re.findall(r"^\[(.+?)\]: https://", text, re.MULTILINE))


def test_workflows_run_the_python_versions_that_the_package_claims() -> None:
    claimed = re.findall(r"Python :: (3\.\d+)", (ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    (matrix,) = re.findall(r"python: \[(.+)\]", (ROOT / ".github/workflows/tests.yml").read_text(encoding="utf-8"))
    assert re.findall(r"3\.\d+", matrix) == claimed
