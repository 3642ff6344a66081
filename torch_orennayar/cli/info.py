"""``orennayar info``."""

from __future__ import annotations

import json
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated

import typer

from ..core.errors import FileError

SHOWN = ("torch_orennayar", "torch", "kornia", "opencv-contrib-python-headless", "trimesh", "onnxruntime", "onnx")
"""Packages whose versions a report of a mistake should name."""


def info(
    path: Annotated[Path | None, typer.Argument(help="An .onnx file; default: versions and models.")] = None,
    operators: Annotated[bool, typer.Option("--operators", help="Also how often a graph has each operator.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Everything about a graph, for programs.")] = False,
) -> None:
    """Versions and models, or what an ONNX file takes, returns and is."""
    if path is not None:
        _describe_graph(path, operators=operators, as_json=as_json)
        return
    if operators or as_json:
        raise FileError("path", expected="an .onnx file to describe", got="none", mend="give a graph")
    from ..reflectance.models import MODELS
    from .tables import print_table

    print_table(("package", "version"), [(name, _version(name)) for name in SHOWN])
    print_table(
        ("model", "RMS error", "cost", "gradients", "source"),
        [(m.name, _short(m.error), _short(m.cost), m.gradients, m.source) for m in MODELS.values()],
    )


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _short(number: float | None) -> str:
    return "" if number is None else f"{number:.3g}"


def _describe_graph(path: Path, *, operators: bool, as_json: bool) -> None:
    from ..export.describe import describe_onnx
    from .tables import print_table

    if path.suffix.lower() != ".onnx":
        raise FileError(str(path), expected="an .onnx file", got=path.suffix or "no suffix", mend="give a graph")
    found = describe_onnx(path)
    if as_json:
        typer.echo(json.dumps(found, indent=2))
        return
    for kind, values in (("input", found["inputs"]), ("output", found["outputs"])):
        rows = [(n, found["types"][n], " x ".join(axes), found["meanings"][n]) for n, axes in values.items()]
        print_table((kind, "type", "shape", "meaning, unit, range"), rows)
    shown = {key: text for key, text in found["metadata"].items() if key not in found["meanings"]}
    for key, text in {**shown, "bytes": found["bytes"], "opset": found["opset"]}.items():
        typer.echo(f"{key}: {text}")
    if operators:
        print_table(("operator", "times"), [(name, str(count)) for name, count in found["operators"].items()])
