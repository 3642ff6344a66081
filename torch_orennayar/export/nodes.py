"""Assemble ONNX graphs: append nodes, trace torch modules, and copy the traced nodes in."""

from __future__ import annotations

import io
import logging
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor, nn

from ..core.errors import ExportError

if TYPE_CHECKING:
    import onnx

OPSET = 18
"""Version of the ONNX operator set: the one that torch's exporter implements (``TORCHLIB_OPSET`` of ``torch.onnx``)."""
TERMINAL_COLOURS = re.compile(r"\x1b[^m]*m")
"""Escape sequences in the exporter's error messages."""


class Nodes:
    """A growing list of nodes whose names begin with ``prefix``; calling it appends a node with one output."""

    def __init__(self, prefix: str) -> None:
        self.prefix, self.nodes = prefix, list["onnx.NodeProto"]()

    def __call__(self, operator: str, *inputs: str, **attributes: object) -> str:
        """Append a node; returns the name of its output."""
        return self.with_outputs(1, operator, *inputs, **attributes)[0]

    def with_outputs(self, count: int, operator: str, *inputs: str, **attributes: object) -> list[str]:
        """Append a node that has ``count`` outputs; returns their names."""
        import onnx

        name = f"{self.prefix}{operator.lower()}_{len(self.nodes)}"
        outputs = [name if not k else f"{name}_{k}" for k in range(count)]
        self.nodes.append(onnx.helper.make_node(operator, list(inputs), outputs, name=name, **attributes))
        return outputs

    def named(self, output: str, operator: str, *inputs: str) -> None:
        """Append a node whose output is called ``output``."""
        import onnx

        name = f"{self.prefix}{operator.lower()}_{len(self.nodes)}"
        self.nodes.append(onnx.helper.make_node(operator, list(inputs), [output], name=name))


def inline(
    add: Nodes, graph: onnx.GraphProto, prefix: str, inputs: Mapping[str, str]
) -> tuple[list[str], list[onnx.TensorProto]]:
    """Copy the nodes of ``graph`` to ``add``, reading ``inputs`` (names outside by names in ``graph``).

    All other names get ``prefix``. Returns the names of the outputs, and the initializers that the nodes need.
    """
    import onnx

    names = {"": ""} | dict(inputs)  # "" is an optional input left out
    for node in graph.node:
        copied = onnx.NodeProto()
        copied.CopyFrom(node)
        for listed in (copied.input, copied.output):
            for k, name in enumerate(listed):
                listed[k] = names.get(name, f"{prefix}{name}")
        copied.name = f"{prefix}{node.name}"
        add.nodes.append(copied)
    initializers = []
    for value in graph.initializer:
        initializer = onnx.TensorProto()
        initializer.CopyFrom(value)
        initializer.name = f"{prefix}{value.name}"
        initializers.append(initializer)
    return [f"{prefix}{value.name}" for value in graph.output], initializers


def repeated(
    add: Nodes, times: str, prefix: str, state: Sequence[str], step: Callable[..., Sequence[str]]
) -> list[str]:
    """A loop of ``times`` steps; returns the names of the last state.

    Args:
        add: where the loop is appended.
        times: name of the number of steps.
        prefix: of all names inside.
        state: names of float values to begin with.
        step: called with the `Nodes` of the body and the names of the state before; returns those after.
    """
    from onnx import TensorProto, helper

    index, condition_before, *before = (f"{prefix}{k}" for k in ("index", "condition", *range(len(state))))
    inner = Nodes(prefix)
    after = step(inner, *before)
    condition = inner("Identity", condition_before)

    inputs = [
        helper.make_tensor_value_info(index, TensorProto.INT64, []),
        helper.make_tensor_value_info(condition_before, TensorProto.BOOL, []),
        *map(floats, before),
    ]
    outputs = [helper.make_tensor_value_info(condition, TensorProto.BOOL, []), *map(floats, after)]
    body = helper.make_graph(inner.nodes, f"{prefix}body", inputs, outputs)
    return add.with_outputs(len(state), "Loop", times, "", *state, body=body)


def floats(name: str, sizes: Sequence[int | str] | None = None) -> onnx.ValueInfoProto:
    """An input or output of float32 numbers; of any number of axes where no ``sizes`` are given."""
    from onnx import TensorProto, helper

    return helper.make_tensor_value_info(name, TensorProto.FLOAT, sizes)


def every_node(nodes: Iterable[onnx.NodeProto]) -> Iterator[onnx.NodeProto]:
    """The nodes, and those in the bodies of loops."""
    for node in nodes:
        yield node
        for attribute in node.attribute:
            if attribute.HasField("g"):
                yield from every_node(attribute.g.node)


def as_model(graph: onnx.GraphProto, opset: int = OPSET) -> onnx.ModelProto:
    """The graph as a model of the operator set ``opset``."""
    from onnx import helper

    opsets = [helper.make_opsetid("", opset)]
    return helper.make_model(graph, opset_imports=opsets, ir_version=helper.find_min_ir_version_for(opsets))


class TraceError(NamedTuple):
    """What the `ExportError` says where tracing fails: the argument, what it should be, and the remedy."""

    argument: str
    expected: str
    mend: str


REFLECTANCE_ERROR = TraceError(
    "model",
    "a reflectance function that torch.onnx can export",
    "build it from element-wise torch operations without Python branches on values",
)
"""Where a graph holds the function of a reflectance model, which may be a user's."""


def trace(
    make: Callable[[], nn.Module | torch.export.ExportedProgram],
    example: tuple[Tensor, ...],
    inputs: Sequence[str],
    outputs: Sequence[str],
    dynamic_shapes: dict[str, Any] | tuple[Any, ...],
    error: TraceError,
) -> onnx.ModelProto:
    """The module or program that ``make`` returns as a graph, without the paths and code that the exporter adds.

    Args:
        make: called inside, so that its own failure is reported as ``error`` too.
        example: inputs to trace with.
        inputs: names of the inputs.
        outputs: names of the outputs.
        dynamic_shapes: as ``torch.onnx.export`` takes them.
        error: what an `ExportError` says.
    """
    try:
        with quiet():
            program = torch.onnx.export(
                make(),
                example,
                input_names=list(inputs),
                output_names=list(outputs),
                dynamic_shapes=dynamic_shapes,
                opset_version=OPSET,
                dynamo=True,
                verbose=False,
            )
        assert program is not None
        model: onnx.ModelProto = program.model_proto
    except Exception as failure:  # the exporter raises many kinds
        cause: BaseException = failure
        while cause.__cause__ is not None:  # the exporter wraps what failed in a page of advice
            cause = cause.__cause__
        first_line = TERMINAL_COLOURS.sub("", str(cause)).partition("\n")[0]
        raise ExportError(
            error.argument, expected=error.expected, got=f"{type(cause).__name__}: {first_line}", mend=error.mend
        ) from failure
    for node in model.graph.node:  # paths and code of the exporting machine
        del node.metadata_props[:]
        node.doc_string = ""
    return model


@contextmanager
def quiet() -> Iterator[None]:
    """Silence the exporter, which prints and logs its steps."""
    loggers = [logging.getLogger(name) for name in ("torch.onnx", "onnxscript", "onnx_ir")]
    levels = [logger.level for logger in loggers]
    try:
        for logger in loggers:
            logger.setLevel(logging.ERROR)
        with warnings.catch_warnings(), redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
