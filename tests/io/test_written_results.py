"""Results lie where they are asked for, without harm to what lies there."""

from __future__ import annotations

from pathlib import Path

import pytest

from torch_orennayar import FileError
from torch_orennayar.core.files import check_output, results_directory, written_files


def write(folder: Path, text: str, *names: str) -> None:
    with results_directory(folder) as temporary:
        for name in names:
            (temporary / name).write_text(text)


def test_own_files_are_overwritten_and_those_of_others_are_not(tmp_path: Path) -> None:
    write(tmp_path, "one", "a.txt", "b.txt")
    assert written_files(tmp_path) == {"a.txt", "b.txt"}
    write(tmp_path, "two", "b.txt", "c.txt")
    assert (tmp_path / "b.txt").read_text() == "two"
    assert written_files(tmp_path) == {"a.txt", "b.txt", "c.txt"}
    (tmp_path / "b.txt").write_text("mine, longer")
    (tmp_path / "d.txt").write_text("mine")
    for names in (("b.txt", "e.txt"), ("d.txt",)):
        with pytest.raises(FileError, match="choose another output folder"):
            write(tmp_path, "three", *names)
    assert (tmp_path / "b.txt").read_text() == "mine, longer"
    assert not (tmp_path / "e.txt").exists()
    with pytest.raises(FileError, match=r"d\.txt"):
        check_output(tmp_path, ["d.txt"])


def test_a_torn_list_of_what_was_written_harms_nothing(tmp_path: Path) -> None:
    for text in ("{", "[]", '{"a.txt": 1}'):
        (tmp_path / ".torch_orennayar.json").write_text(text)
        assert written_files(tmp_path) == set()
