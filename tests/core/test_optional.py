from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

import pytest

from torch_orennayar import TorchOrenNayarError
from torch_orennayar.core.errors import MissingPackageError
from torch_orennayar.core.optional import PACKAGES, require

ROOT = Path(__file__).parent.parent.parent
ALWAYS = sys.stdlib_module_names | {"torch", "numpy", "torch_orennayar"}
ENTRANCES = {"export": {"onnx", "onnxruntime"}, "cli": {"typer"}, "compiled_coverage": {"numba"}, "compiled": {"numba"}}
"""Folders that `require` guards at their entrance, `export/api.py` and `cli/__init__.py`, and files that are imported
where `available` says so."""


def test_missing_packages_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("matplotlib", "trimesh"):
        monkeypatch.setitem(sys.modules, name, None)
    require("scipy")
    with pytest.raises(MissingPackageError, match=r'pip install matplotlib, or "torch_orennayar\[cli\]"'):
        require("scipy", "matplotlib")
    with pytest.raises(ImportError, match=r"pip install trimesh$"):
        require("trimesh")
    with pytest.raises(TorchOrenNayarError, match="packages matplotlib, trimesh, got none"):
        require("matplotlib", "trimesh")


def test_packages_are_where_the_project_puts_them() -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    base = re.search(r"^dependencies = \[(.*?)^\]", text, re.DOTALL | re.MULTILINE)
    for package, extra in PACKAGES.values():
        place = re.search(rf"^{extra} = \[.*$", text, re.MULTILINE) if extra else base
        assert place is not None
        assert re.search(rf'"{package}>=', place[0]), f"{package} is not in {extra or 'dependencies'}"


@pytest.mark.parametrize(
    "path", sorted((ROOT / "torch_orennayar").rglob("*.py")), ids=lambda path: path.relative_to(ROOT).as_posix()
)
def test_third_party_imports_are_lazy_and_preceded_by_require(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    guarded = ENTRANCES.get(path.parent.name, set()) | ENTRANCES.get(path.stem, set())
    parents = {child: node for node in ast.walk(tree) for child in ast.iter_child_nodes(node)}
    for node in ast.walk(tree):
        names = {name.partition(".")[0] for name in _imported(node)} - ALWAYS - guarded
        above = _ancestors(node, parents)
        if not names or any(isinstance(a, ast.If) and ast.unparse(a.test) == "TYPE_CHECKING" for a in above):
            continue
        if any(isinstance(a, ast.Try) for a in above) and path.name == "progress.py":  # works without
            continue
        functions = [a for a in above if isinstance(a, ast.FunctionDef)]
        assert functions, f"line {node.lineno}: {names} imported at module level"  # type: ignore[attr-defined]
        required = {word for f in functions for word in _required(f)}
        assert names <= required, f"line {node.lineno}: call require() for {names - required}"  # type: ignore[attr-defined]


def _imported(node: ast.AST) -> list[str]:
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    return [node.module or ""] if isinstance(node, ast.ImportFrom) and node.level == 0 else []


def _ancestors(node: ast.AST, parents: dict[ast.AST, ast.AST]) -> list[ast.AST]:
    found = []
    while node in parents:
        node = parents[node]
        found.append(node)
    return found


def _required(function: ast.FunctionDef) -> set[str]:
    calls = (node for node in ast.walk(function) if isinstance(node, ast.Call))
    words = (a for call in calls if ast.unparse(call.func) in ("require", "available") for a in call.args)
    return {a.value for a in words if isinstance(a, ast.Constant) and isinstance(a.value, str)}
