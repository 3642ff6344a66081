from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from torch_orennayar import save_mesh
from torch_orennayar.cli import app
from torch_orennayar.geometry.primitives import bumpy_ball

ROOT = Path(__file__).parent.parent


def test_python_blocks_run_in_order(
    tmp_path: Path, capture_folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    save_mesh(tmp_path / "mesh.obj", *bumpy_ball())
    shutil.copytree(capture_folder, tmp_path / "photographs")
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    names: dict[str, object] = {}
    for block in blocks:
        exec(block, names)
    assert len(blocks) == 6
    assert names["choice"] == "fujii"
    assert tuple(names["images"].shape) == (2, 7, 1, 64, 64)  # type: ignore[attr-defined]
    assert tuple(names["pictures"].shape) == (1, 12, 1, 512, 512)  # type: ignore[attr-defined]
    assert names["sigma"].grad.isfinite()  # type: ignore[attr-defined]
    assert capsys.readouterr().out.startswith("vcavity 1.0 () {'lambert'")


def test_commands_and_files_exist() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    commands = {command.name or command.callback.__name__ for command in app.registered_commands if command.callback}
    assert set(re.findall(r"^orennayar (\w+)|`orennayar (\w+)", text, re.MULTILINE)) <= {
        *((c, "") for c in commands),
        *(("", c) for c in commands),
    }
    for place in re.findall(r"\((\.github/[^)]+)\)|`((?:scripts|tests|examples)/[\w./]*)`", text):
        assert (ROOT / "".join(place)).exists()
