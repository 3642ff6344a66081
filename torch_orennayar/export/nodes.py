"""Assemble ONNX graphs: named nodes, traced modules copied in, and the exporter kept quiet."""

from __future__ import annotations

import io
import logging
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from ..core.errors import ExportError

if TYPE_CHECKING:
    import onnx

OPSET = 18


class Nodes:
    """A list of nodes in the making; every call adds one and gives the name of its output."""

    def __init__(self, prefix: str) -> None:
        self.prefix, self.nodes = prefix, list[Any]()

    def __call__(self, operator: str, *inputs: str, **attributes: object) -> str:
        """A node more."""
        return self.many(operator, inputs, 1, **attributes)[0]

    def many(self, operator: str, inputs: Sequence[str], outputs: int, **attributes: object) -> list[str]:
        """A node more, with several outputs."""
        import onnx

        name = f"{self.prefix}{operator.lower()}_{len(self.nodes)}"
        names = [name if not k else f"{name}_{k}" for k in range(outputs)]
        self.nodes.append(onnx.helper.make_node(operator, list(inputs), names, name=name, **attributes))
        return names


def inline(add: Nodes, graph: onnx.GraphProto, prefix: str, given: Mapping[str, str]) -> tuple[list[str], list[Any]]:
    """Copy the nodes of ``graph`` in, its inputs called as ``given``; names of its outputs, and its constants."""
    import onnx

    names = {"": ""} | dict(given)
    for node in graph.node:
        copied = onnx.NodeProto()
        copied.CopyFrom(node)
        for listed in (copied.input, copied.output):
            for k, name in enumerate(listed):
                listed[k] = names.get(name, f"{prefix}{name}")
        copied.name = f"{prefix}{node.name}"
        add.nodes.append(copied)
    constants = []
    for value in graph.initializer:
        constant = onnx.TensorProto()
        constant.CopyFrom(value)
        constant.name = f"{prefix}{value.name}"
        constants.append(constant)
    return [f"{prefix}{value.name}" for value in graph.output], constants


def as_model(graph: onnx.GraphProto) -> onnx.ModelProto:
    """The graph with its opset."""
    from onnx import helper

    opsets = [helper.make_opsetid("", OPSET)]
    return helper.make_model(graph, opset_imports=opsets, ir_version=helper.find_min_ir_version_for(opsets))


def write_graph(
    make: Callable[[], Any],
    example: tuple[Tensor, ...],
    names: tuple[Sequence[str], Sequence[str]],
    shapes: Any,
    subject: tuple[str, str],
    mend: str,
) -> onnx.ModelProto:
    """What ``make`` gives, a module or program, as a graph with ``names`` of inputs and outputs, free of local traces.

    Where that fails the error is about ``subject``, an argument and what was expected of it, and says ``mend``.
    """
    try:
        with quiet():
            program = torch.onnx.export(
                make(),
                example,
                input_names=list(names[0]),
                output_names=list(names[1]),
                dynamic_shapes=shapes,
                opset_version=OPSET,
                dynamo=True,
                verbose=False,
            )
        assert program is not None
        graph: onnx.ModelProto = program.model_proto
    except Exception as error:  # the exporter raises many kinds
        raise ExportError(
            subject[0],
            expected=subject[1],
            got=f"{type(error).__name__}: {re.sub(chr(27) + '[^m]*m', '', str(error)).partition(chr(10))[0]}",
            mend=mend,
        ) from error
    for node in graph.graph.node:  # traces of the exporting machine: paths and code
        del node.metadata_props[:]
        node.doc_string = ""
    return graph


@contextmanager
def quiet() -> Iterator[None]:
    """The exporter prints and logs its steps; a library call should not."""
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
