"""The pages of the site that are documents of the repository: copied, with their links turned to where they lead here.

The README is the first page, `examples/guides` the guides, `scripts/benchmarks/README.md` the measurements.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

from scripts.benchmarks.record import ROOT

REPOSITORY = "https://github.com/torch-orennayar/torch_orennayar"
"""Where a link to a file leads that is no page of the site; the address of pyproject.toml."""
GUIDES = (
    "install", "shading", "rendering", "photometric-stereo", "captures", "mirror-ball", "unknown-lights", "near-lamps",
    "shape-from-shading", "synthetic-data", "onnx", "conventions-and-errors", "what-to-expect", "coming-from-elsewhere",
)  # fmt: skip
"""The guides in the order of the menu."""
DOCUMENTS = {
    "README.md": "index.md",
    "scripts/benchmarks/README.md": "measurements.md",
    ".github/CHANGELOG.md": "changelog.md",
    ".github/CONTRIBUTING.md": "contributing.md",
    ".github/SECURITY.md": "security.md",
    **{f"examples/guides/{name}.md": f"guides/{name}.md" for name in GUIDES},
}
"""Document of the repository and page of the site."""
MENU = {
    "Guides": [f"guides/{name}" for name in GUIDES],
    "Reference": ["reference/index", "commands", "models/index", "gallery/index"],
    "Project": ["measurements", "history", "changelog", "contributing", "security"],
}
"""Captions of the menu and their pages."""
PICTURES = {".png", ".gif", ".jpg", ".svg"}
"""Suffixes of files that a page shows."""
LINK = re.compile(r"(?<=\]\()(?!https?:|#)([^)#\s]+)(#[^)\s]*)?(?=\))")
"""Target and anchor of a link in Markdown that leads to a file."""


def write(source: Path) -> None:
    """Write the documents, and the pictures that they show, into the tree that Sphinx reads."""
    shown: set[Path] = set()
    for document, page in DOCUMENTS.items():
        text = _turn_links(ROOT / document, page, shown)
        if page == "index.md":
            text += "".join(_toctree(caption, entries) for caption, entries in MENU.items())
        (source / page).parent.mkdir(parents=True, exist_ok=True)
        (source / page).write_text(text, encoding="utf-8")
    (source / "images").mkdir()
    for picture in shown:
        shutil.copy(picture, source / "images")


def _toctree(caption: str, entries: list[str]) -> str:
    return f"\n```{{toctree}}\n:hidden:\n:caption: {caption}\n\n" + "\n".join(entries) + "\n```\n"


def _turn_links(document: Path, page: str, shown: set[Path]) -> str:
    """The text of a document with links for its place on the site; ``shown`` gets the pictures that it shows."""

    def turn(found: re.Match[str]) -> str:
        target, anchor = (document.parent / found[1]).resolve(), found[2] or ""
        name = target.relative_to(ROOT).as_posix()
        if target.suffix in PICTURES:
            shown.add(target)
            return _between(page, f"images/{target.name}")
        if name.startswith("examples/gallery"):
            return _between(page, f"gallery/{target.stem if target.suffix else 'index'}.rst")
        if name in DOCUMENTS:
            return _between(page, DOCUMENTS[name]) + anchor
        return f"{REPOSITORY}/{'tree' if target.is_dir() else 'blob'}/main/{name}{anchor}"

    return _outside_code(document.read_text(encoding="utf-8"), lambda text: LINK.sub(turn, text))


def _outside_code(text: str, change: Callable[[str], str]) -> str:
    """``text`` with everything changed but its fenced code."""
    parts = re.split(r"(^```.*?^```$)", text, flags=re.MULTILINE | re.DOTALL)
    return "".join(part if part.startswith("```") else change(part) for part in parts)


def _between(page: str, target: str) -> str:
    """The way from a page to another file of the site."""
    return Path(os.path.relpath(target, Path(page).parent)).as_posix()
