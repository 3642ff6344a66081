"""Graphs that take long to trace are traced once in a run of the suite, whichever of its processes needs them first.

What is done with them, the proof against torch included, stays with every test.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import onnx
import pytest
from filelock import FileLock

from torch_orennayar import MODELS
from torch_orennayar.export import shading_graph

BUILT_IN = frozenset(MODELS)


def share(patch: pytest.MonkeyPatch, folder: Path) -> None:
    """Let the builders of graphs look into ``folder`` first, and leave there what they trace."""
    keys: dict[tuple[str, str], Callable[..., str | None]] = {
        ("shading", "shading_graph"): _shading_key,
        ("stereo", "stereo_graph"): str,
    }
    for (name, builder), key in keys.items():
        module = import_module(f"torch_orennayar.export.{name}_graph")
        patch.setattr(module, builder, _shared(getattr(module, builder), key, folder))


def _shading_key(model: str, *, per_pixel: bool, checked: bool = False) -> str | None:
    """None for a model that a test registers: another test may use the name for another function."""
    return f"{model} {per_pixel} {checked} {shading_graph.ROW_BAND_ELEMENTS}" if model in BUILT_IN else None


def _shared(
    trace: Callable[..., onnx.ModelProto], key: Callable[..., str | None], folder: Path
) -> Callable[..., onnx.ModelProto]:
    def read_or_trace(*what: object, **how: object) -> onnx.ModelProto:
        known = key(*what, **how)
        if known is None:
            return trace(*what, **how)
        name = hashlib.sha256(f"{trace.__name__} {known}".encode()).hexdigest()[:16]
        file = folder / f"{name}.onnx"
        with FileLock(folder / f"{name}.lock"):
            if not file.exists():
                file.write_bytes(trace(*what, **how).SerializeToString())
        return onnx.load_model_from_string(file.read_bytes())

    return read_or_trace
