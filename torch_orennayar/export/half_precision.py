"""Half precision at the inputs and outputs of a graph, and of weights that lose nothing by it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from .nodes import every_node

if TYPE_CHECKING:
    import onnx

LARGE = 256
"""Number of values from which a constant is worth a node that widens it; set by hand."""


def to_half(graph: onnx.ModelProto) -> None:
    """Make floating-point inputs and outputs float16, in place; the nodes between them compute in float32.

    Weights that were trained or stored in half precision take half the space; runtimes widen them when they load.
    """
    from onnx import TensorProto, helper

    weights = _narrow_constants(graph.graph)
    inputs, outputs = _narrow(graph.graph.input), _narrow(graph.graph.output)
    _rename(graph.graph.node, inputs | outputs)
    before = [
        helper.make_node("Cast", [half], [single], name=f"widen_{half}", to=TensorProto.FLOAT)
        for half, single in inputs.items()
    ]
    after = [
        helper.make_node("Cast", [single], [half], name=f"narrow_{half}", to=TensorProto.FLOAT16)
        for half, single in outputs.items()
    ]
    before += [
        helper.make_node("Cast", [half], [single], name=f"widen_{single}", to=TensorProto.FLOAT)
        for single, half in weights.items()
    ]
    nodes = [*before, *graph.graph.node, *after]
    del graph.graph.node[:]
    graph.graph.node.extend(nodes)


def _narrow_constants(graph: onnx.GraphProto) -> dict[str, str]:
    """Store large constants that float16 holds exactly as such; the new name of each by its name."""
    import numpy as np
    from onnx import TensorProto, numpy_helper

    renamed: dict[str, str] = {}
    for constant in graph.initializer:
        if constant.data_type != TensorProto.FLOAT:
            continue
        values = numpy_helper.to_array(constant)
        if values.size < LARGE or np.abs(values).max() > np.finfo(np.float16).max:
            continue
        narrow = values.astype(np.float16)
        if np.array_equal(narrow, values):
            renamed[constant.name] = f"{constant.name}_float16"
            constant.CopyFrom(numpy_helper.from_array(narrow, renamed[constant.name]))
    return renamed


def _narrow(values: Iterable[onnx.ValueInfoProto]) -> dict[str, str]:
    """Declare float32 values as float16; the name of each with the new name of its float32 counterpart."""
    from onnx import TensorProto

    single = [v for v in values if v.type.tensor_type.elem_type == TensorProto.FLOAT]
    for value in single:
        value.type.tensor_type.elem_type = TensorProto.FLOAT16
    return {v.name: f"{v.name}_float32" for v in single}


def _rename(nodes: Iterable[onnx.NodeProto], names: Mapping[str, str]) -> None:
    """Rename the values that nodes read and write, in the bodies of loops too, which can read outer values."""
    for node in every_node(nodes):
        for listed in (node.input, node.output):
            for k, name in enumerate(listed):
                listed[k] = names.get(name, name)
