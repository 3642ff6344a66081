"""Parts of the graphs that were traced from torch once, by ``scripts/fit/trace_steps.py``, and ship as files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from torch import Tensor

if TYPE_CHECKING:
    import onnx

FOLDER = Path(__file__).with_name("traced")
"""Where the files lie. Tracing all of them takes three minutes."""


def load_step(name: str, weights: Mapping[str, Tensor] | None = None) -> onnx.ModelProto:
    """The graph of the step called ``name``; ``weights`` of a network are not in its file."""
    import onnx
    from onnx import numpy_helper

    step = onnx.load(FOLDER / f"{name}.onnx")
    for key, value in (weights or {}).items():
        step.graph.initializer.append(numpy_helper.from_array(value.detach().float().cpu().numpy(), key))
    return step
