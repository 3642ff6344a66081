"""What every kind of export hands to `export_onnx`: a graph and what it must compute."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

from torch import Tensor

if TYPE_CHECKING:
    import onnx


class ExportTask(NamedTuple):
    """A graph with its documentation and its reference.

    Attributes:
        graph: the graph, with float32 inputs and outputs.
        metadata: meaning and units by the name of the input, output or property that they describe.
        inputs: names of the inputs, in the order in which ``function`` takes them.
        trials: inputs on which the graph is compared with ``function``; float32 where they are floating point.
        function: the same computation in torch, for float32 and for float64 inputs; outputs in the graph's order.
    """

    graph: onnx.ModelProto
    metadata: Mapping[str, str]
    inputs: Sequence[str]
    trials: Sequence[tuple[Tensor, ...]]
    function: Callable[..., tuple[Tensor, ...]]
