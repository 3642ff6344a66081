"""``orennayar info``."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated

import typer

from ..core.errors import FileError

SHOWN = ("torch_orennayar", "torch", "kornia", "opencv-contrib-python-headless", "trimesh", "onnxruntime", "onnx")
"""Packages whose versions a report of a mistake should name."""


def info(
    path: Annotated[Path | None, typer.Argument(help="An .onnx file; default: versions and models.")] = None,
) -> None:
    """Versions and models, or what is inside an ONNX file."""
    if path is not None:
        _describe_graph(path)
        return
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


def _describe_graph(path: Path) -> None:
    from ..export.describe import describe_onnx

    if path.suffix.lower() != ".onnx":
        raise FileError(str(path), expected="an .onnx file", got=path.suffix or "no suffix", mend="give a graph")
    for key, value in describe_onnx(path).items():
        if isinstance(value, dict):
            typer.echo(f"{key}:")
            for name, entry in value.items():
                typer.echo(f"  {name}: {', '.join(entry) if isinstance(entry, list) else entry}")
        else:
            typer.echo(f"{key}: {value}")
