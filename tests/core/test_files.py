from __future__ import annotations

from pathlib import Path

import pytest

from torch_orennayar import FileError
from torch_orennayar.core.files import atomic_directory, atomic_path, check_output


def test_files_appear_together_and_others_stay(tmp_path: Path) -> None:
    target = tmp_path / "out"
    target.mkdir()
    (target / "kept.txt").write_text("kept")
    (target / "old.txt").write_text("old")
    with atomic_directory(target) as folder:
        (folder / "old.txt").write_text("new")
        (folder / "deep").mkdir()
        (folder / "deep" / "file.txt").write_text("deep")
        assert (target / "old.txt").read_text() == "old"
    found = {str(p.relative_to(tmp_path)): p.read_text() for p in tmp_path.rglob("*.txt")}
    assert found == {"out/kept.txt": "kept", "out/old.txt": "new", "out/deep/file.txt": "deep"}
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def write_half(target: Path, interruption: BaseException) -> None:
    with atomic_directory(target) as folder:
        (folder / "half.txt").write_text("half")
        raise interruption


@pytest.mark.parametrize(
    "interruption", [KeyboardInterrupt(), ValueError("wrong"), FileError("a", expected="b", got="c", mend="d")]
)
def test_nothing_stays_of_interrupted_work(tmp_path: Path, interruption: BaseException) -> None:
    with pytest.raises(type(interruption)):
        write_half(tmp_path / "out", interruption)
    assert list(tmp_path.iterdir()) == []


def test_one_file(tmp_path: Path) -> None:
    with atomic_path(tmp_path / "new" / "file.txt") as temporary:
        temporary.write_text("whole")
    assert (tmp_path / "new" / "file.txt").read_text() == "whole"
    with pytest.raises(ValueError, match="wrong"):
        write_half(tmp_path / "new", ValueError("wrong"))
    assert (tmp_path / "new" / "file.txt").read_text() == "whole"
    assert len(list((tmp_path / "new").iterdir())) == 1


def test_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="a folder"), atomic_directory(tmp_path / "file"):
        pass
    with pytest.raises(FileError, match="writable"), atomic_directory(tmp_path / "file" / "below"):
        pass


def test_a_full_disk_is_one_error(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="space"), atomic_directory(tmp_path / "out"):
        raise OSError(28, "No space left on device")


def test_a_folder_where_a_file_must_go_stops_all_of_it(tmp_path: Path) -> None:
    (tmp_path / "out" / "b.txt").mkdir(parents=True)

    def write_three() -> None:
        with atomic_directory(tmp_path / "out") as folder:
            for name in ("a.txt", "b.txt", "c.txt"):
                (folder / name).write_text("")

    with pytest.raises(FileError, match=r"b\.txt"):
        write_three()
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["b.txt"]


def test_outputs_are_checked_before_the_work(tmp_path: Path) -> None:
    check_output(tmp_path / "new")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="a folder"):
        check_output(tmp_path / "file")
