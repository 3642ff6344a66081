"""Rules of the layout that import-linter does not cover; they are checked on the sources, without importing them."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "torch_orennayar"
GENERATED = {PACKAGE / "reflectance" / "coefficients.py"}
"""Written by `scripts/fit`, however long."""
MOST_LINES = 350
MOST_LINES_OF_A_FUNCTION = 60
"""Without its docstring; both limits are those of issue 22."""

Function = ast.FunctionDef | ast.AsyncFunctionDef


def sources(*folders: str) -> list[Path]:
    """Python files, of a command too that has no suffix, in name order."""
    files = [f for folder in folders for f in sorted((ROOT / folder).rglob("*")) if f.is_file()]
    unwanted = {"node_modules", "__pycache__"}
    return [f for f in files if is_python(f) and not unwanted & set(f.parts)]


def is_python(file: Path) -> bool:
    return file.suffix == ".py" or (not file.suffix and file.read_bytes().startswith(b"#!/usr/bin/env python"))


def name(file: Path) -> str:
    return str(file.relative_to(ROOT))


def parse(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"), str(file))


OWN = [f for f in sources("torch_orennayar") if f not in GENERATED]


@pytest.mark.parametrize("file", OWN, ids=name)
def test_files_are_read_in_one_sitting(file: Path) -> None:
    assert len(file.read_text(encoding="utf-8").splitlines()) <= MOST_LINES


def length(function: Function) -> int:
    """Lines from ``def`` on, without the docstring."""
    lines = (function.end_lineno or function.lineno) - function.lineno + 1
    if ast.get_docstring(function, clean=False) is not None:
        docstring = function.body[0]
        lines -= (docstring.end_lineno or docstring.lineno) - docstring.lineno + 1
    return lines


@pytest.mark.parametrize("file", OWN, ids=name)
def test_functions_are_short(file: Path) -> None:
    functions = [node for node in ast.walk(parse(file)) if isinstance(node, Function)]
    assert {f.name: length(f) for f in functions if length(f) > MOST_LINES_OF_A_FUNCTION} == {}


def imported(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """Module and name of every import from this package; the name is empty for ``import module``."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield from ((node.module, alias.name) for alias in node.names if in_package(node.module))
        elif isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names if in_package(alias.name))


def in_package(module: str) -> bool:
    return module.split(".")[0] == "torch_orennayar"


@pytest.mark.parametrize("file", sources("tests", "scripts", "examples"), ids=name)
@pytest.mark.slow
def test_nobody_outside_needs_a_private_module(file: Path) -> None:
    modules = {m for m, _ in imported(parse(file))} | {n for m, n in imported(parse(file)) if m == "torch_orennayar"}
    modules -= set(public_names())
    assert [m for m in modules if any(part.startswith("_") for part in m.split("."))] == []


def public_names() -> list[str]:
    return [str(n) for n in ast.literal_eval(assigned("__all__"))]


def assigned(variable: str) -> ast.expr:
    """The value that the package's ``__init__`` assigns to ``variable``."""
    for node in parse(PACKAGE / "__init__.py").body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and node.targets[0].id == variable:
            return node.value
    raise AssertionError(variable)


@pytest.mark.parametrize("file", sources("examples"), ids=name)
def test_examples_import_public_names_only(file: Path) -> None:
    tree, public = parse(file), public_names()
    assert [m for m, _ in imported(tree) if m != "torch_orennayar"] == []
    assert [n for _, n in imported(tree) if n and n not in public] == []
    aliases = {
        alias.asname or alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.Import)
        for alias in node.names
        if alias.name == "torch_orennayar"
    }
    used = {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in aliases
    }
    assert sorted(used - set(public)) == []


def test_lazy_names_are_those_that_type_checkers_see() -> None:
    homes: dict[str, tuple[str, ...]] = ast.literal_eval(assigned("_HOMES"))
    typed: dict[str, set[str]] = {}
    for node in ast.walk(parse(PACKAGE / "__init__.py")):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            for statement in node.body:
                assert isinstance(statement, ast.ImportFrom)
                typed.setdefault(str(statement.module), set()).update(alias.name for alias in statement.names)
    assert {module: set(names) for module, names in homes.items()} == typed
    lazy = [n for names in homes.values() for n in names]
    assert len(lazy) == len(set(lazy))
    assert set(lazy) == set(public_names()) - {"__version__"}
