"""The documentation: code blocks run in order, and commands, options, files and links exist."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
import typer.main

from torch_orennayar import save_mesh
from torch_orennayar.cli import app
from torch_orennayar.geometry.primitives import bumpy_ball

ROOT = Path(__file__).parent.parent
GUIDES = sorted((ROOT / "examples" / "guides").glob("*.md"))
DOCUMENTS = [ROOT / "README.md", ROOT / "scripts" / "benchmarks" / "README.md", *GUIDES]

FOLLOWED = {"near-lamps.md"}
"""Guides whose Python continues their commands: tests/examples/test_guides.py runs both."""
WITH_PYTHON = [
    path
    for path in (ROOT / "README.md", *GUIDES)
    if "```python" in path.read_text(encoding="utf-8") and path.name not in FOLLOWED
]

Names = dict[str, Any]


def blocks(document: Path, language: str) -> list[str]:
    text = document.read_text(encoding="utf-8")
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def check_readme(names: Names, printed: str) -> None:
    assert tuple(names["images"].shape) == (2, 7, 1, 64, 64)
    assert tuple(names["pictures"].shape) == (1, 12, 1, 256, 256)
    assert names["sigma"].grad.isfinite()
    assert tuple(names["sample"]["images"].shape) == (4, 3, 64, 64)
    assert printed.startswith("vcavity 1.0 ()")


def check_shading(names: Names, printed: str) -> None:
    assert names["choice"] == "fujii"
    assert tuple(names["images"].shape) == (2, 2, 3, 32, 32)
    assert names["near"].isfinite().all()


def check_stereo(names: Names, printed: str) -> None:
    assert printed.startswith("vcavity 1.0 () {'lambert'")
    assert tuple(names["relit"].shape[2:]) == tuple(names["capture"].mask.shape[1:])


def check_errors(names: Names, printed: str) -> None:
    assert printed.startswith("RangeError")


def check_elsewhere(names: Names, printed: str) -> None:
    """The camera sees a point where PyTorch3D's projection puts it."""
    size, world = (names["height"], names["width"]), torch.tensor([[0.2, -0.1, 0.3]])
    view = world @ names["rotation"] + names["translation"]
    wanted = torch.tensor([size[1] / 2, size[0] / 2]) - names["half"] * names["focal"] * view[0, :2] / view[0, 2]
    seen = names["camera"].to_image(names["camera"].to_camera_frame(world[None].double()), size)[0, 0]
    torch.testing.assert_close((seen[:2] / seen[2]).float(), wanted)


CHECKS: dict[str, Callable[[Names, str], None]] = {
    "README.md": check_readme,
    "shading.md": check_shading,
    "photometric-stereo.md": check_stereo,
    "conventions-and-errors.md": check_errors,
    "coming-from-elsewhere.md": check_elsewhere,
}


@pytest.mark.parametrize("document", WITH_PYTHON, ids=lambda path: path.name)
@pytest.mark.slow
def test_python_blocks_run_in_order(
    document: Path,
    tmp_path: Path,
    capture_folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    save_mesh(tmp_path / "mesh.obj", *bumpy_ball())
    shutil.copytree(capture_folder, tmp_path / "photographs")
    monkeypatch.chdir(tmp_path)
    names: Names = {}
    for block in blocks(document, "python"):
        exec(block, names)
    if document.name in CHECKS:
        CHECKS[document.name](names, capsys.readouterr().out)


def test_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 150
    assert all(block.count("\n") <= 10 for block in blocks(ROOT / "README.md", "python"))


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_commands_and_options_exist(document: Path) -> None:
    group = typer.main.get_command(app)
    commands: dict[str, Any] = group.commands  # type: ignore[attr-defined]
    shell = "\n".join(blocks(document, "sh"))
    for name, rest in re.findall(r"^orennayar (\w+)([^#\n]*)", shell, re.MULTILINE):
        known = {
            option for parameter in commands[name].params for option in (*parameter.opts, *parameter.secondary_opts)
        }
        assert {word.partition("=")[0] for word in re.findall(r"(?<=\s)--?[a-z][\w-]*", rest)} <= known, name
    for name in re.findall(r"`orennayar (\w+)", document.read_text(encoding="utf-8")):
        assert name in commands


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_and_links_exist(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    for place in re.findall(r"\]\((?!https?://)([^)#]*)(?:#[^)]*)?\)", text):
        assert (document.parent / place).exists(), place
    for place in re.findall(r"`((?:scripts|tests|examples|torch_orennayar)/[\w./]*)`", text):
        assert (ROOT / place).exists(), place
    for place, anchor in re.findall(r"\]\((?!https?://)([^)#]*)#([^)]*)\)", text):
        headings = re.findall(r"^#+ (.*)$", (document.parent / place).read_text(encoding="utf-8"), re.MULTILINE)
        assert anchor in {re.sub(r"[^\w -]", "", h.lower()).replace(" ", "-") for h in headings}
