"""Compare a written graph with torch in ONNX Runtime."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from ..core.errors import ExportError
from .task import ExportTask

TOLERANCE = 1e-5
"""Largest difference from torch, absolute plus relative to the output; what issues and README promise for float32."""
OUTPUT_ROUNDING = {torch.float32: 0.0, torch.float16: 2.0**-11}
"""Relative error of rounding float32 results to the dtype of the outputs: half a unit in the last place."""
FLOAT32_ROUNDING_FACTOR = 4
"""How many times torch's own float32 error, measured against float64, a runtime may add; set by hand, because a runtime
orders sums differently from torch."""


def verify(file: Path, task: ExportTask, dtype: torch.dtype) -> None:
    """Run every trial twice in ONNX Runtime and compare with torch; ``dtype`` is that of the floating inputs.

    Raises:
        ExportError: the file is not a valid graph, does not run, differs from torch, or differs between the runs.
    """
    import onnx
    import onnxruntime

    try:
        onnx.checker.check_model(str(file), full_check=True)
        session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
        names = [output.name for output in session.get_outputs()]
        for trial in task.trials:
            inputs = _to_dtype(trial, dtype)
            feeds = {name: value.numpy() for name, value in zip(task.inputs, inputs, strict=True)}
            first, second = session.run(None, feeds), session.run(None, feeds)
            single = task.function(*_to_dtype(inputs, torch.float32))
            double = task.function(*_to_dtype(inputs, torch.float64))
            for name, *values in zip(names, first, second, single, double, strict=True):
                _compare(name, *(torch.as_tensor(v) for v in values), output_rounding=OUTPUT_ROUNDING[dtype])
    except ExportError:
        raise
    except Exception as error:  # checker and runtime errors have no common base class
        raise ExportError(
            "graph",
            expected="a graph that ONNX Runtime runs",
            got=f"{type(error).__name__}: {error}",
            mend="report this with the versions that `orennayar info` prints",
        ) from error


def _to_dtype(values: tuple[Tensor, ...], dtype: torch.dtype) -> tuple[Tensor, ...]:
    """The floating-point tensors in ``dtype``, others unchanged."""
    return tuple(value.to(dtype) if value.is_floating_point() else value for value in values)


def _compare(
    name: str, first: Tensor, second: Tensor, single: Tensor, double: Tensor, *, output_rounding: float
) -> None:
    """Compare one output of two runs with torch's in float32 and in float64.

    The difference between torch's two results measures how much float32 costs the formula itself; a runtime that
    rounds in other places may err as much elsewhere.
    """
    if first.shape != double.shape:
        difference, allowed = f"shape {tuple(first.shape)}", False
    elif not first.is_floating_point():
        count = int((first != single).sum())
        difference, allowed = f"{count} different values", count == 0
    else:
        exact = torch.where(double == single, single, double)  # equal infinities (depth of the background) match
        rounding = (single - exact).nan_to_num(0.0).abs().max().item()
        error = torch.where(first == exact, 0.0, (first - exact).abs())
        limit = TOLERANCE + (TOLERANCE + output_rounding) * exact.abs().nan_to_num(posinf=0.0)
        difference = f"difference {error.max().item():g}"
        allowed = bool((error <= limit + FLOAT32_ROUNDING_FACTOR * rounding).all())
    if not allowed or not torch.equal(first.nan_to_num(), second.nan_to_num()):
        raise ExportError(
            "graph",
            expected=f"torch's {name} within {TOLERANCE:g} and rounding, shape {tuple(double.shape)}, in every run",
            got=difference if not allowed else "another result in a second run",
            mend="if the model is your own, look for steps that lose float32 precision; otherwise report it",
        )
