"""`orennayar inspect` and `orennayar batch`."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.support.command_line import Run
from torch_orennayar.cli.batch import name_folders
from torch_orennayar.io.images import read_image


def test_a_folder_is_inspected_before_it_is_solved(orennayar: Run, capture_folder: Path, tmp_path: Path) -> None:
    shutil.copy(capture_folder / "001.png", capture_folder / "ref.png")
    (capture_folder / "filenames.txt").unlink()
    result = orennayar("inspect", capture_folder, "-o", tmp_path / "seen")
    assert result.status == 0, result.err
    for words in ("12 from a light file", "mask.png", "ref.png", "32 x 32 pixels"):
        assert words in result.out, words
    page = (tmp_path / "seen" / "inspection.html").read_text()
    assert page.count('<svg class="dial"') == 12
    assert not (tmp_path / "seen" / "result.json").exists()
    assert not (tmp_path / "seen" / "object_mask.png").exists()  # a file holds it
    assert read_image(tmp_path / "seen" / "outline.png").shape == (32, 32, 3)
    mask = read_image(capture_folder / "mask.png")
    (capture_folder / "mask.png").unlink()
    result = orennayar("inspect", capture_folder, "-o", tmp_path / "seen")
    assert "object_mask.png" in result.out
    assert read_image(tmp_path / "seen" / "object_mask.png").shape == mask.shape


def test_a_folder_without_photographs_cannot_be_inspected(orennayar: Run, tmp_path: Path) -> None:
    result = orennayar("inspect", tmp_path, "-o", tmp_path / "seen")
    assert result.status != 0
    assert "expected photographs" in result.err


@pytest.mark.slow
def test_many_captures_go_on_after_a_bad_one_and_are_not_solved_twice(
    orennayar: Run, capture_folder: Path, tmp_path: Path
) -> None:
    for day in ("monday", "tuesday"):
        shutil.copytree(capture_folder, tmp_path / day / "vase")
    (tmp_path / "monday" / "empty").mkdir()
    (tmp_path / "list.txt").write_text("# comment\nmonday/empty\ntuesday/vase\nmonday/vase\n")
    command = ("batch", tmp_path / "monday" / "vase", tmp_path / "list.txt", "-o", tmp_path / "out")
    options = ("--model", "lambert", "--no-report")
    result = orennayar(*command, *options)
    assert result.status == 1  # one failed
    assert "failed" in result.out
    assert "expected photographs" in result.out
    first, second = (tmp_path / "out" / name / "result.json" for name in ("monday--vase", "tuesday--vase"))
    assert json.loads(first.read_text())["model"] == json.loads(second.read_text())["model"] == "lambert"
    before = first.stat().st_mtime_ns
    (tmp_path / "list.txt").write_text("tuesday/vase\n")
    result = orennayar(*command, *options)
    assert result.status == 0, result.err
    assert result.out.count("has a result") == 2
    assert first.stat().st_mtime_ns == before


def test_files_outside_the_folders_hold_for_all_of_a_batch(
    orennayar: Run, capture_folder: Path, tmp_path: Path
) -> None:
    """One rig, one light file and one mask; results with other options are not taken for these."""
    for name in ("light_directions.txt", "mask.png"):
        shutil.move(capture_folder / name, tmp_path / name)
    (capture_folder / "filenames.txt").unlink()
    files = ("--lights", tmp_path / "light_directions.txt", "--mask", tmp_path / "mask.png")
    seen = orennayar("inspect", capture_folder, *files, "-o", tmp_path / "seen")
    assert "12 from a light file" in seen.out
    assert f"mask.png: {read_image(tmp_path / 'mask.png').mean() / 255:.0%}" in seen.out
    command = ("batch", capture_folder, "-o", tmp_path / "out", "--no-report", "--model", "lambert")
    assert orennayar(*command, *files, "--scale", "0.5").status == 0
    numbers = json.loads((tmp_path / "out" / capture_folder.name / "result.json").read_text())
    alone = orennayar("stereo", capture_folder, *files, "--scale", "0.5", "--model", "lambert", "-o", tmp_path / "one")
    assert alone.status == 0, alone.err
    assert numbers["pixels"] == json.loads((tmp_path / "one" / "result.json").read_text())["pixels"] < 300
    assert "--again" in orennayar(*command, *files).err  # not at half the size


def test_a_batch_of_nothing_is_refused(orennayar: Run, tmp_path: Path) -> None:
    (tmp_path / "list.txt").write_text("# none\n")
    result = orennayar("batch", tmp_path / "list.txt", "-o", tmp_path / "out")
    assert "at least one folder" in result.err
    result = orennayar("batch", tmp_path / "nothing", "-o", tmp_path / "out")
    assert "a folder, or a file that lists folders" in result.err


def test_results_of_different_captures_have_different_names(tmp_path: Path) -> None:
    """Also where folders have dots or are called like the results of others, and in any order."""
    places = ["monday/vase", "tuesday/vase", "monday-vase", "monday/jug.1", "monday/jug.2", "cup"]
    for place in places:
        (tmp_path / place).mkdir(parents=True)
    (tmp_path / "cup.lp").touch()
    folders = [tmp_path / place for place in [*places, "cup.lp"]]
    names = name_folders(folders)
    assert len(set(names.values())) == len(folders)
    assert names == name_folders(folders[::-1])
    assert {names[f.resolve()] for f in folders[3:5]} == {"jug.1", "jug.2"}


def test_results_of_another_capture_are_not_taken_for_its_own(
    orennayar: Run, capture_folder: Path, tmp_path: Path
) -> None:
    for day in ("monday", "tuesday"):
        (tmp_path / day / "vase").mkdir(parents=True)
    assert "expected photographs" in orennayar("batch", tmp_path / "monday" / "vase", "-o", tmp_path / "out").out
    result = orennayar("batch", tmp_path / "tuesday" / "vase", "-o", tmp_path / "out")
    assert result.status == 1
    assert "use another -o" in result.err


def test_damaged_files_are_named_and_torn_results_made_again(
    orennayar: Run, capture_folder: Path, tmp_path: Path
) -> None:
    command = ("batch", capture_folder, "-o", tmp_path / "out", "--no-report", "--model")
    assert orennayar(*command, "lambert").status == 0
    result = tmp_path / "out" / capture_folder.name / "result.json"
    result.write_text("")
    assert orennayar(*command, "lambert").status == 0
    assert json.loads(result.read_text())["model"] == "lambert"
    assert "--again" in orennayar(*command, "vcavity").err
    for text in ("{", "[]"):
        (tmp_path / "out" / "captures.json").write_text(text)
        assert "remove it" in orennayar(*command, "lambert").err
    assert "list in UTF-8" in orennayar("batch", capture_folder / "001.png", "-o", tmp_path / "out").err
