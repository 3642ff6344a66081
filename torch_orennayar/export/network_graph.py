"""The ONNX graph of photometric stereo by the network that ships with the package."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from ..stereo.closed_form import Prepare
from ..stereo.network_solver import CHUNK, Paint, Smooth
from ..stereo.set_network import load_network
from .nodes import Nodes
from .pixel_graph import PixelGraph

if TYPE_CHECKING:
    import onnx


def network_graph() -> onnx.ModelProto:
    """The graph: as `solve_network`; ``error``, what the network expects, radians, comes last."""
    from onnx import TensorProto, helper

    graph = PixelGraph(
        {"chunk": [CHUNK], "turn_back": [-1, 3], "column": [-1, 1], "step": 1, "right_angle": [math.pi / 2]}
    )
    add = graph.add
    grey, _ = graph.inline(graph.trace(Prepare(), ("seen",), 2), "prepare_", (graph.seen,))
    # Equal chunks of pixels, the last one filled up with the last pixel, through the network one after the other.
    pixels, count = add("Shape", grey, end=1), add("Shape", grey, start=1)
    rows = add("Max", add("Div", "chunk", count), "one")
    number = add("Div", add("Sub", add("Add", pixels, rows), "one"), rows)
    every = add("Range", "axis", add("Squeeze", add("Mul", number, rows), "zero"), "step")
    filled = add("Gather", grey, add("Min", every, add("Sub", pixels, "one")))
    chunks = add("Reshape", filled, add("Concat", number, rows, count, axis=0))
    inner = Nodes("read_")
    network = graph.trace(load_network(), ("grey", "lights"), 2)
    found = graph.inline(network, "network_", ("one_chunk", "lights"), inner)

    def value(name: str) -> Any:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, None)

    body = helper.make_graph(inner.nodes, "read", [value("one_chunk")], [value(name) for name in found])
    normals, errors = add.many("Scan", (chunks,), 2, body=body, num_scan_inputs=1)
    normal = add("Slice", add("Reshape", normals, "turn_back"), "zero", pixels, "zero")
    error = add("Slice", add("Reshape", errors, "column"), "zero", pixels, "zero")

    error_map = add("Min", graph.lay(error), "right_angle")
    smooth = graph.trace(Smooth(), ("normal_map", "error_map"), 1)
    (smoothed,) = graph.inline(smooth, "smooth_", (graph.lay(normal), error_map))
    normal_map = add("Where", "mask", smoothed, "nothing")
    paint = graph.trace(Paint(), ("seen", "lights", "vector"), 2)
    albedo, _ = graph.inline(paint, "paint_", (graph.seen, "lights", graph.pick(normal_map)))
    return graph.finish({
        "normal": (normal_map, 3),
        "albedo": (graph.lay(albedo), "channels"),
        "roughness": (add("Mul", error_map, "nothing"), 1),
        "error": (error_map, 1),
    })  # fmt: skip
