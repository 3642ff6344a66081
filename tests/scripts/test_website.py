"""What the site is generated from: the reference, the documents and the check of its links."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import torch

import torch_orennayar as ton
from scripts.benchmarks.record import ROOT
from scripts.website import commands, formulas, links, models, pages, reference, spheres


def test_every_public_name_is_in_the_reference_once(tmp_path: Path) -> None:
    reference.write(tmp_path / "reference")
    text = "\n".join(page.read_text(encoding="utf-8") for page in (tmp_path / "reference").glob("[!i]*.rst"))
    names = re.findall(r"^\.\. (?:autoclass|autofunction|py:data):: (\w+)$", text, re.MULTILINE)
    assert sorted(names) == sorted(ton.__all__)
    index = (tmp_path / "reference" / "index.rst").read_text(encoding="utf-8")
    assert sorted(re.findall(r"<torch_orennayar\.(\w+)>`", index)) == sorted(ton.__all__)


def test_documents_lead_to_each_other(tmp_path: Path) -> None:
    pages.write(tmp_path)
    wrong = []
    for page in tmp_path.rglob("*.md"):
        for place in re.findall(r"\]\((?!https?:|#)([^)#\s]+)", page.read_text(encoding="utf-8")):
            target = (page.parent / place).resolve()
            if not target.exists() and target.parent.name != "gallery":  # which only the build makes
                wrong.append((page.name, place))
    assert wrong == []
    guides = {file.stem for file in (ROOT / "examples" / "guides").glob("*.md")}
    assert guides == set(pages.GUIDES)
    assert set(pages.DOCUMENTS.values()) - {"index.md"} <= {
        f"{p}.md" for entries in pages.MENU.values() for p in entries
    }


def test_every_command_is_on_the_page_of_commands() -> None:
    listed = re.findall(r"^  (\w+)  ", commands.help_of().partition("Commands:")[2], re.MULTILINE)
    assert sorted(listed) == sorted(commands.COMMANDS)
    assert commands.help_of("stereo").startswith("Usage: orennayar stereo")


@pytest.mark.parametrize(
    ("body", "wrong"),
    [
        ('<a id="here" href="#here">a</a> <a href="https://example.org">b</a>', []),
        ('<a href="other.html">a</a>', ["page.html: other.html does not exist"]),
        ('<a href="page.html#there">a</a>', ["page.html: page.html#there leads to no place on its page"]),
        ('<script src="https://example.org/a.js"></script>', ["page.html: loads https://example.org/a.js"]),
    ],
)
def test_wrong_links_are_found(tmp_path: Path, body: str, wrong: list[str]) -> None:
    (tmp_path / "page.html").write_text(body, encoding="utf-8")
    assert links.check(tmp_path) == wrong


def test_every_model_has_a_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[str] = []
    monkeypatch.setattr(models, "draw", lambda folder, names: drawn.extend(names))
    models.write(tmp_path / "models")
    assert set(drawn) == set(formulas.NOTES) <= set(ton.MODELS)
    for name in drawn:
        page = (tmp_path / "models" / f"{name}.md").read_text(encoding="utf-8")
        assert page.count("```{math}") == len(formulas.NOTES[name].formula)
        assert f"({name}.md)" in (tmp_path / "models" / "index.md").read_text(encoding="utf-8")
        assert all(page.count(f"\n| {copy} |") == 1 for copy in formulas.NOTES[name].copies)


@pytest.mark.slow
def test_the_sphere_of_the_theory_is_the_theory() -> None:
    whole = spheres._sphere("theory", 45, 30)
    fine = spheres._shade("theory", spheres.COARSE, 45, 30)[0].clamp(0, 1)
    step = spheres.SIDE // spheres.COARSE
    seen = torch.from_numpy(whole)[: spheres.SIDE // 2].unfold(0, step, step).unfold(1, step, step).mean((2, 3))
    assert (seen - ton.linear_to_srgb(fine)[0]).abs().mean() < 0.01
