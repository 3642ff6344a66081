"""The ONNX graph of a user's own module."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from ..core.errors import ExportError
from .nodes import TraceError, trace
from .task import ExportTask

if TYPE_CHECKING:
    import onnx


MODULE_ERROR = TraceError(
    "what",
    "a module that torch.onnx can export",
    "replace Python branches on values, and operations that ONNX lacks",
)
"""Where the exporter fails on a user's module."""


@dataclass(frozen=True)
class EvaluationCopy:
    """Copies of a module in evaluation mode on the CPU, one for float32 and one for float64 inputs."""

    single: nn.Module
    double: nn.Module

    def __call__(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """The module's outputs as a tuple, also where it returns one tensor or a list."""
        is_double = any(t.dtype == torch.float64 for t in inputs)
        with torch.no_grad():
            outputs = (self.double if is_double else self.single)(*inputs)
        return tuple(outputs) if isinstance(outputs, (tuple, list)) else (outputs,)


def module_task(
    module: nn.Module,
    example: tuple[Tensor, ...] | None,
    input_names: Sequence[str] | None,
    output_names: Sequence[str] | None,
) -> ExportTask:
    """A user's module, compared with itself.

    Raises:
        ExportError: there is no example, the module does not take it, or it does not export.
    """
    if not example or not all(isinstance(t, Tensor) for t in example):
        got = "none" if not example else "values that are not tensors"
        raise ExportError("example_inputs", expected="a tuple of tensors", got=got, mend="give what forward takes")
    example = tuple(t.detach().cpu().contiguous() for t in example)
    copied = evaluation_copy(module, example)
    inputs = _names("input", input_names, len(example))
    graph = module_graph(copied, example, inputs, output_names)
    return ExportTask(graph, {}, inputs, [example, *_trials_of_other_sizes(graph, copied, example)], copied)


def evaluation_copy(module: nn.Module, example: tuple[Tensor, ...]) -> EvaluationCopy:
    """A copy of ``module`` that takes ``example``.

    Raises:
        ExportError: it cannot be copied, does not take ``example``, or returns something other than tensors.
    """
    try:
        single = copy.deepcopy(module).cpu().float().eval()
        copied = EvaluationCopy(single, copy.deepcopy(single).double())
        outputs = copied(*example)
    except Exception as error:  # a user's code raises anything
        raise ExportError(
            "example_inputs",
            expected=f"what {type(module).__name__} takes",
            got=f"{type(error).__name__}: {error}",
            mend="try module(*example_inputs) on the CPU",
        ) from error
    if not all(isinstance(t, Tensor) for t in outputs):
        got = ", ".join(type(t).__name__ for t in outputs)
        raise ExportError("what", expected="a module that returns tensors", got=got, mend="wrap it")
    return copied


def module_graph(
    module: EvaluationCopy, example: tuple[Tensor, ...], inputs: Sequence[str], outputs: Sequence[str] | None
) -> onnx.ModelProto:
    """The graph of a module; axes longer than 1 are dynamic where the module allows it."""
    names = _names("output", outputs, len(module(*example)))
    if set(names) & set(inputs):
        both = ", ".join(sorted(set(names) & set(inputs)))
        raise ExportError("output_names", expected="other names than the inputs'", got=both, mend="rename them")
    auto = torch.export.Dim.AUTO
    shapes = tuple({a: auto for a, size in enumerate(t.shape) if size > 1} for t in example)
    graph = trace(lambda: module.single, example, inputs, names, shapes, MODULE_ERROR)
    _fix_axes(graph, module, example)
    _name_axes(graph)
    return graph


def _names(kind: str, given: Sequence[object] | None, count: int) -> list[str]:
    """The names of ``count`` inputs or outputs."""
    if given is None:
        return [f"{kind}_{k}" for k in range(count)]
    names = [given] if isinstance(given, str) else list(given)
    words = [name for name in names if isinstance(name, str) and name]
    if len(names) != count:
        raise ExportError(
            f"{kind}_names",
            expected=f"{count} names, one per {kind}",
            got=f"{len(names)}: {', '.join(map(str, names))}",
            mend=f"give one name per {kind}",
        )
    if len(set(words)) < count:
        raise ExportError(f"{kind}_names", expected="different words", got=str(names), mend="rename them")
    return words


def _fix_axes(graph: onnx.ModelProto, module: EvaluationCopy, example: tuple[Tensor, ...]) -> None:
    """Give axes that the exporter left dynamic, although the module refuses other sizes, their size in the example."""
    sizes = [v.type.tensor_type.shape.dim for v in (*graph.graph.input, *graph.graph.output)]
    for symbol in sorted({size.dim_param for shape in sizes for size in shape if size.dim_param}):
        trial = _lengthened(graph, example, {symbol})
        try:
            module(*trial)
        except Exception:  # whatever a module raises on shapes that it does not take
            lengths = [t.shape for t in (*example, *module(*example))]
            for shape, length in zip(sizes, lengths, strict=True):
                for axis, size in enumerate(shape):
                    if size.dim_param == symbol:
                        size.dim_value = length[axis]


def _name_axes(graph: onnx.ModelProto) -> None:
    """Name dynamic axes after the first input that has them."""
    named: dict[str, str] = {}
    for value in graph.graph.input:
        for axis, size in enumerate(value.type.tensor_type.shape.dim):
            if size.dim_param:
                named.setdefault(size.dim_param, f"{value.name}_axis{axis}")
    del graph.graph.value_info[:]
    for value in (*graph.graph.input, *graph.graph.output):
        for size in value.type.tensor_type.shape.dim:
            if size.dim_param:
                size.dim_param = re.sub(r"[A-Za-z_]\w*", lambda m: named.get(m[0], m[0]), size.dim_param)


def _trials_of_other_sizes(
    graph: onnx.ModelProto, module: EvaluationCopy, example: tuple[Tensor, ...]
) -> list[tuple[Tensor, ...]]:
    """The example with every dynamic axis longer; nothing if the module refuses to have all of them longer at once."""
    symbols = {d.dim_param for v in graph.graph.input for d in v.type.tensor_type.shape.dim if d.dim_param}
    trial = _lengthened(graph, example, symbols)
    try:
        module(*trial)
    except Exception:  # sizes depend on each other in a way that the graph does not state
        return []
    return [trial]


def _lengthened(graph: onnx.ModelProto, example: tuple[Tensor, ...], symbols: set[str]) -> tuple[Tensor, ...]:
    """The example with its values repeated along the axes called ``symbols``."""

    def repeat(value: Tensor, axes: Iterable[Any]) -> Tensor:
        for axis, size in enumerate(axes):
            if size.dim_param in symbols:
                value = value.index_select(axis, torch.arange(2 * value.shape[axis] + 1) % value.shape[axis])
        return value

    shapes = (v.type.tensor_type.shape.dim for v in graph.graph.input)
    return tuple(repeat(value, axes) for value, axes in zip(example, shapes, strict=True))
