"""The ONNX graph of a user's own module, and half precision at the ends of any graph."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from ..core.errors import ExportError
from .nodes import write_graph

if TYPE_CHECKING:
    import onnx


@dataclass(frozen=True)
class Held:
    """A module in evaluation mode on the processor, for float32 and for float64 inputs."""

    single: nn.Module
    double: nn.Module

    def __call__(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """A tuple, whatever the module returns."""
        wide = any(t.dtype == torch.float64 for t in inputs)
        with torch.no_grad():
            found = (self.double if wide else self.single)(*inputs)
        return tuple(found) if isinstance(found, (tuple, list)) else (found,)


def hold(module: nn.Module, example: tuple[Tensor, ...]) -> Held:
    """A copy of ``module`` that takes ``example``.

    Raises:
        ExportError: it cannot be copied, does not take ``example``, or returns something else than tensors.
    """
    try:
        single = copy.deepcopy(module).cpu().float().eval()
        held = Held(single, copy.deepcopy(single).double())
        found = held(*example)
    except Exception as error:  # a user's code raises anything
        raise ExportError(
            "example_inputs",
            expected=f"what {type(module).__name__} takes",
            got=f"{type(error).__name__}: {error}",
            mend="try module(*example_inputs) on the processor",
        ) from error
    if not all(isinstance(t, Tensor) for t in found):
        got = ", ".join(type(t).__name__ for t in found)
        raise ExportError("what", expected="a module that returns tensors", got=got, mend="wrap it")
    return held


def module_graph(
    held: Held, example: tuple[Tensor, ...], inputs: Sequence[str], outputs: Sequence[str] | None
) -> onnx.ModelProto:
    """The graph of what `hold` gave; axes longer than 1 are dynamic where the module allows it."""
    names = list(outputs) if outputs is not None else [f"output_{k}" for k in range(len(held(*example)))]
    auto = torch.export.Dim.AUTO
    shapes = tuple({a: auto for a, size in enumerate(t.shape) if size > 1} for t in example)
    graph = write_graph(
        lambda: held.single,
        example,
        (inputs, names),
        shapes,
        ("what", "a module that torch.onnx can export"),
        "replace Python branches on values, and operations that ONNX lacks",
    )
    _fix_axes(graph, held, example)
    _name_axes(graph)
    return graph


def _fix_axes(graph: onnx.ModelProto, held: Held, example: tuple[Tensor, ...]) -> None:
    """Axes that the exporter left open although the module refuses other sizes get their size."""
    sizes = [v.type.tensor_type.shape.dim for v in (*graph.graph.input, *graph.graph.output)]
    for symbol in sorted({size.dim_param for shape in sizes for size in shape if size.dim_param}):
        trial = _longer(graph, example, {symbol})
        try:
            held(*trial)
        except Exception:  # whatever a module raises on shapes that it does not take
            lengths = [t.shape for t in (*example, *held(*example))]
            for shape, length in zip(sizes, lengths, strict=True):
                for axis, size in enumerate(shape):
                    if size.dim_param == symbol:
                        size.dim_value = length[axis]


def _name_axes(graph: onnx.ModelProto) -> None:
    """Dynamic axes are called by the first input that has them."""
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


def other_sizes(graph: onnx.ModelProto, held: Held, example: tuple[Tensor, ...]) -> list[tuple[Tensor, ...]]:
    """The example with every dynamic axis longer; none where torch refuses them all at once."""
    symbols = {d.dim_param for v in graph.graph.input for d in v.type.tensor_type.shape.dim if d.dim_param}
    trial = _longer(graph, example, symbols)
    try:
        held(*trial)
    except Exception:  # sizes depend on each other in a way that the graph does not tell
        return []
    return [trial]


def _longer(graph: onnx.ModelProto, example: tuple[Tensor, ...], symbols: set[str]) -> tuple[Tensor, ...]:
    """The example, its values repeated along the axes called ``symbols``."""

    def grow(value: Tensor, sizes: Iterable[Any]) -> Tensor:
        for axis, size in enumerate(sizes):
            if size.dim_param in symbols:
                value = value.index_select(axis, torch.arange(2 * value.shape[axis] + 1) % value.shape[axis])
        return value

    shapes = (v.type.tensor_type.shape.dim for v in graph.graph.input)
    return tuple(grow(value, sizes) for value, sizes in zip(example, shapes, strict=True))


def to_half(graph: onnx.ModelProto) -> None:
    """Floating inputs and outputs become float16, in place; what lies between stays float32."""
    from onnx import TensorProto, helper

    float32, float16 = TensorProto.FLOAT, TensorProto.FLOAT16

    def ends(values: Any) -> dict[str, str]:
        wide = [v for v in values if v.type.tensor_type.elem_type == float32]
        for value in wide:
            value.type.tensor_type.elem_type = float16
        return {v.name: f"{v.name}_float32" for v in wide}

    inputs, outputs = ends(graph.graph.input), ends(graph.graph.output)
    _rename(graph.graph.node, inputs | outputs)
    before = [helper.make_node("Cast", [n], [w], name=f"widen_{n}", to=float32) for n, w in inputs.items()]
    after = [helper.make_node("Cast", [w], [n], name=f"narrow_{n}", to=float16) for n, w in outputs.items()]
    nodes = [*before, *graph.graph.node, *after]
    del graph.graph.node[:]
    graph.graph.node.extend(nodes)


def _rename(nodes: Iterable[Any], names: dict[str, str]) -> None:
    """Values in nodes, and in the bodies of loops, which see those around them."""
    for node in nodes:
        for listed in (node.input, node.output):
            for k, name in enumerate(listed):
                listed[k] = names.get(name, name)
        for attribute in node.attribute:
            if attribute.HasField("g"):
                _rename(attribute.g.node, names)
