"""The ONNX graph of photometric stereo in closed form: the steps of `stereo.closed_form`, traced and joined."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from torch import Tensor

from ..reflectance.models import get_model
from ..stereo.closed_form import (
    CANDIDATES,
    SAMPLES,
    TURNS,
    Begin,
    Choose,
    Finish,
    Prepare,
    Sample,
    Turn,
    solve_closed_form,
)
from .nodes import Nodes
from .pixel_graph import CAPTURE_METADATA, INPUTS, PixelGraph, capture_trials
from .task import ExportTask

if TYPE_CHECKING:
    import onnx

OUTPUTS: dict[str, int | str] = {"normal": 3, "albedo": "channels", "roughness": 1}
"""Names of the graph's outputs with their number of channels, as `solve_closed_form` orders them."""


def stereo_task(model: str) -> ExportTask:
    """`solve_closed_form` with the reflectance ``model``."""
    model = get_model(model).name
    tried = ", ".join(f"{math.degrees(c):g}" for c in CANDIDATES)
    metadata = CAPTURE_METADATA | {
        "model": model,
        "source": get_model(model).source,
        "roughness": "one for the object: standard deviation of the facet slope angle, radians; "
        + ("always 0" if model == "lambert" else f"found between {tried} degrees"),
        "method": "trimmed, then reweighted (Geman-McClure) least squares, 10 closed-form solutions",
    }

    def solve(images: Tensor, lights: Tensor, mask: Tensor) -> tuple[Tensor, ...]:
        return solve_closed_form(images, lights, mask, model)

    return ExportTask(stereo_graph(model), metadata, INPUTS, capture_trials(), solve)


def stereo_graph(model: str) -> onnx.ModelProto:
    """The graph: pixels of the mask are gathered, solved step by step and scattered again; all axes are dynamic."""
    function, graph = get_model(model).function, PixelGraph({"turns": TURNS})
    turn = graph.trace(Turn(function), ("grey", "level", "lights", "roughness", "middle", "vector"), 2)
    begin = graph.trace(Begin(), ("grey", "lights"), 2)

    def solve(grey: str, level: str, roughness: str, prefix: str) -> list[str]:
        middle, vector = graph.inline(begin, f"{prefix}begin_", (grey, "lights"))
        return _loop(graph, turn, f"{prefix}turn_", (grey, level, "lights", roughness, middle), vector)

    grey, level = graph.inline(graph.trace(Prepare(), ("seen",), 2), "prepare_", (graph.observations,))
    roughness = graph.add("Mul", level, "float_zero")
    if model != "lambert":
        few, few_level, tried = graph.inline(graph.trace(Sample(), ("grey", "level"), 3), "sample_", (grey, level))
        vector, _ = solve(few, few_level, tried, "few_")
        names = ("grey", "level", "lights", "roughness", "vector")
        choose = graph.trace(Choose(function), names, 1, len(CANDIDATES) * SAMPLES)
        (best,) = graph.inline(choose, "choose_", (few, few_level, "lights", tried, vector))
        roughness = graph.add("Add", roughness, best)
    vector, weight = solve(grey, level, roughness, "")
    finish = graph.trace(Finish(function), ("seen", "level", "lights", "roughness", "vector", "weight"), 2)
    inputs = (graph.observations, level, "lights", roughness, vector, weight)
    normal, albedo = graph.inline(finish, "finish_", inputs)
    maps = [graph.scatter(values) for values in (normal, albedo, roughness)]
    return graph.finish({name: (m, OUTPUTS[name]) for name, m in zip(OUTPUTS, maps, strict=True)})


def _loop(graph: PixelGraph, turn: onnx.ModelProto, prefix: str, fixed: tuple[str, ...], vector: str) -> list[str]:
    """``TURNS`` repetitions of ``turn``, which replaces ``vector`` and its weights; ``fixed`` is read from outside.

    Returns the names of the last vector and weights.
    """
    from onnx import TensorProto, helper

    names = [f"{prefix}{name}" for name in ("index", "condition_before", "vector", "weight")]
    index, condition_before, vector_before, weight_before = names
    inner = Nodes(prefix)
    updated = graph.inline(turn, prefix, (*fixed, vector_before), inner)
    condition = inner("Identity", condition_before)

    def floats(name: str) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, None)

    inputs = [
        helper.make_tensor_value_info(index, TensorProto.INT64, []),
        helper.make_tensor_value_info(condition_before, TensorProto.BOOL, []),
        floats(vector_before),
        floats(weight_before),
    ]
    outputs = [helper.make_tensor_value_info(condition, TensorProto.BOOL, []), *map(floats, updated)]
    body = helper.make_graph(inner.nodes, f"{prefix}body", inputs, outputs)
    # A loop's state needs initial values: the trimming weights, last of ``fixed``, have the right shape.
    return graph.add.with_outputs(2, "Loop", "turns", "", vector, fixed[-1], body=body)
