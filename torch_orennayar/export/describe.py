"""The metadata of a graph: written at export, and read back from a file."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

from .._version import __version__
from ..core.errors import ExportError
from ..core.optional import require
from .nodes import every_node

if TYPE_CHECKING:
    import onnx

FRAME = "camera: x right, y up, z toward the viewer; row 0 is the top"
"""The coordinate frame of every graph, as its metadata states it (design page 1)."""


class GraphDescription(TypedDict):
    """What an ONNX file contains.

    Attributes:
        bytes: size of the file.
        opset: version of the operator set.
        inputs: sizes by name, a name for each dynamic axis.
        outputs: as ``inputs``.
        types: type of the elements by the name of the input or output, such as ``float32``.
        meanings: meaning, unit and range by the name of the input or output, "" where the file does not say.
        operators: how often each operator occurs, inside loops too.
        metadata: meaning and units.
    """

    bytes: int
    opset: int
    inputs: dict[str, list[str]]
    outputs: dict[str, list[str]]
    types: dict[str, str]
    meanings: dict[str, str]
    operators: dict[str, int]
    metadata: dict[str, str]


def describe_onnx(path: str | os.PathLike[str]) -> GraphDescription:
    """Inputs, outputs, opset, operators, size and metadata of an ONNX file.

    Raises:
        ExportError: the file is missing or is not an ONNX graph.
    """
    require("onnx")
    import onnx

    file = Path(path)
    if not file.is_file():
        raise ExportError(str(file), expected="an ONNX file", got="no such file", mend="check the path")
    try:
        model = onnx.load(file)
        onnx.checker.check_model(model)
    except Exception as error:  # protobuf, checker and file errors have no common base class
        raise ExportError(
            str(file), expected="an ONNX file", got=f"{type(error).__name__}: {error}", mend="export it again"
        ) from error
    operators = [node.op_type for node in every_node(model.graph.node)]
    values = [*model.graph.input, *model.graph.output]
    metadata = {entry.key: entry.value for entry in model.metadata_props}
    return {
        "bytes": file.stat().st_size,
        "opset": model.opset_import[0].version,
        "inputs": _axes(model.graph.input),
        "outputs": _axes(model.graph.output),
        "types": {value.name: _type(value) for value in values},
        "meanings": {value.name: value.doc_string or metadata.get(value.name, "") for value in values},
        "operators": {name: operators.count(name) for name in sorted(set(operators))},
        "metadata": metadata,
    }


def write_metadata(graph: onnx.ModelProto, metadata: Mapping[str, str]) -> None:
    """Write ``metadata``, the coordinate frame and the version of this package into ``graph``.

    An input or output that it names carries its meaning with it, where viewers of graphs look for it.
    """
    import onnx

    onnx.helper.set_model_props(graph, {"torch_orennayar": __version__, "frame": FRAME, **metadata})
    for value in (*graph.graph.input, *graph.graph.output):
        value.doc_string = metadata.get(value.name, "")
    graph.producer_name = "torch_orennayar"
    graph.producer_version = __version__


def _type(value: onnx.ValueInfoProto) -> str:
    """Type of the elements, as numpy calls it; "unknown" of an input that is no tensor, or of a type yet to come."""
    import onnx

    try:
        return str(onnx.helper.tensor_dtype_to_np_dtype(value.type.tensor_type.elem_type))
    except (KeyError, ValueError, TypeError):
        return "unknown"


def _axes(values: Iterable[onnx.ValueInfoProto]) -> dict[str, list[str]]:
    """The size of every axis, or its name where it is dynamic."""
    return {v.name: [d.dim_param or str(d.dim_value) for d in v.type.tensor_type.shape.dim] for v in values}
