"""Commands whose results lie among other files."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.command_line import Run
from torch_orennayar import load_capture


@pytest.mark.slow
def test_results_beside_the_photographs_do_not_become_photographs(orennayar: Run, capture_folder: Path) -> None:
    (capture_folder / "filenames.txt").unlink()
    before = load_capture(capture_folder)
    for _ in range(2):
        assert orennayar("stereo", capture_folder, "-o", capture_folder, "--least-squares").status == 0
    after = load_capture(capture_folder)
    assert after.names == before.names
    assert after.mask.equal(before.mask)


def test_render_overwrites_nothing_of_others(orennayar: Run, tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "normal.png").write_text("mine")
    result = orennayar("render", tmp_path / "m.obj", "-o", tmp_path, "--size", 8)
    assert result.status == 1
    assert "normal.png" in result.err
    assert (tmp_path / "normal.png").read_text() == "mine"
    (tmp_path / "normal.png").unlink()
    for _ in range(2):
        assert orennayar("render", tmp_path / "m.obj", "-o", tmp_path, "--size", 8).status == 0
