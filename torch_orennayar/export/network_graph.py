"""The ONNX graph of photometric stereo by the network that ships with the package."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from torch import Tensor

from ..stereo.network_solver import CHUNK, NETWORK, TRAINED_LIGHTS, solve_network
from ..stereo.set_network import load_network
from .nodes import Nodes, floats
from .pixel_graph import CAPTURE_METADATA, INPUTS, PixelGraph, capture_trials
from .task import ExportTask
from .traced_steps import load_step

if TYPE_CHECKING:
    import onnx


def network_task() -> ExportTask:
    """`solve_network` with the weights that ship."""
    metadata = CAPTURE_METADATA | {
        "model": NETWORK,
        "lights": CAPTURE_METADATA["lights"] + f"; {TRAINED_LIGHTS} or more, fewer end in an error",
        "limits": "no near or unknown lights, no light between parts of the surface; lights in one plane go unnoticed",
        "normal": "camera frame, unit, 0 outside the mask",
        "roughness": "always 0: the network does not estimate it",
        "error": "error of the normal that the network expects, radians",
        "method": "a set network trained on synthetic pixels under 12 to 100 lights; albedo by Lambert's law; "
        "interreflections are not removed",
    }

    def solve(images: Tensor, lights: Tensor, mask: Tensor) -> tuple[Tensor, ...]:
        found = solve_network(images, lights, mask[0], load_network().to(images.dtype))
        return found["normal"], found["albedo"], found["roughness"], found["error"]

    return ExportTask(network_graph(), metadata, INPUTS, capture_trials(TRAINED_LIGHTS), solve)


def network_graph() -> onnx.ModelProto:
    """The graph of `solve_network`; the last output, ``error``, is the error that the network expects, radians."""
    graph = PixelGraph(
        {"chunk": [CHUNK], "rows_of_three": [-1, 3], "column": [-1, 1], "right_angle": [math.pi / 2]},
        TRAINED_LIGHTS,
    )
    add = graph.add
    grey, _ = graph.inline(load_step("prepare"), "prepare_", (graph.observations,))
    normal, error = _predict_in_chunks(graph, grey)
    error_map = add("Min", graph.scatter(error), "right_angle")
    (smoothed,) = graph.inline(load_step("smooth_normals"), "smooth_", (graph.scatter(normal), error_map))
    normal_map = add("Where", "mask", smoothed, "float_zero")
    albedo, _ = graph.inline(load_step("paint"), "paint_", (graph.observations, graph.lights, graph.gather(normal_map)))
    return graph.finish({
        "normal": (normal_map, 3),
        "albedo": (graph.scatter(albedo), "channels"),
        "roughness": (add("Mul", error_map, "float_zero"), 1),
        "error": (error_map, 1),
    })  # fmt: skip


def _predict_in_chunks(graph: PixelGraph, grey: str) -> tuple[str, str]:
    """Normals (P, 3) and errors (P, 1) of the network, which runs on one chunk of pixels after another.

    Chunks have equal sizes; the last one is filled up with copies of the last pixel, cut off again behind the network.
    """
    from onnx import helper

    add = graph.add
    pixels, count = add("Shape", grey, end=1), add("Shape", grey, start=1)
    rows = add("Max", add("Div", "chunk", count), "one")
    number = add("Div", add("Sub", add("Add", pixels, rows), "one"), rows)
    every = add("Range", "axis", add("Squeeze", add("Mul", number, rows), "zero"), "step")
    filled = add("Gather", grey, add("Min", every, add("Sub", pixels, "one")))
    chunks = add("Reshape", filled, add("Concat", number, rows, count, axis=0))
    inner = Nodes("read_")
    network = load_step("network", load_network().state_dict())
    predicted = graph.inline(network, "network_", ("one_chunk", graph.lights), inner)

    body = helper.make_graph(inner.nodes, "read", [floats("one_chunk")], [floats(name) for name in predicted])
    normals, errors = add.with_outputs(2, "Scan", chunks, body=body, num_scan_inputs=1)
    normal = add("Slice", add("Reshape", normals, "rows_of_three"), "zero", pixels, "zero")
    error = add("Slice", add("Reshape", errors, "column"), "zero", pixels, "zero")
    return normal, error
