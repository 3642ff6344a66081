"""The ONNX graph of photometric stereo in closed form: the steps of `stereo.closed_form`, traced and joined."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from torch import Tensor

from ..reflectance.models import get_model
from ..stereo.closed_form import CANDIDATES, REFITS, TURNS, solve_closed_form
from .formula import Value, trace_formula
from .nodes import Nodes, repeated
from .pixel_graph import CAPTURE_METADATA, INPUTS, PixelGraph, capture_trials
from .task import ExportTask
from .traced_steps import load_step

if TYPE_CHECKING:
    import onnx

OUTPUTS: dict[str, int | str] = {"normal": 3, "albedo": "channels", "roughness": 1, "error": 1}
"""Names of the graph's outputs with their number of channels, as `solve_closed_form` orders them."""
FEWEST_LIGHTS = 3
"""Unknowns of a pixel: the graph refuses fewer lights."""


def stereo_task(model: str) -> ExportTask:
    """`solve_closed_form` with the reflectance ``model``."""
    model = get_model(model).name
    tried = ", ".join(f"{math.degrees(c):g}" for c in CANDIDATES)
    metadata = CAPTURE_METADATA | {
        "model": model,
        "source": get_model(model).source,
        "roughness": "one for the object: standard deviation of the facet slope angle, radians; "
        + ("always 0" if model == "lambert" else f"found between {tried} degrees"),
        "lights": CAPTURE_METADATA["lights"] + "; 3 or more, fewer end in an error",
        "limits": "no near or unknown lights, no light between parts of the surface, no highlights; "
        "what lights in one plane leave open shows in the error alone",
        "normal": "camera frame, unit, 0 outside the mask",
        "error": "standard error of the normal by residuals and lights, radians, at most a right angle",
        "method": "trimmed, then reweighted (Geman-McClure) least squares, 10 closed-form solutions",
    }

    def solve(images: Tensor, lights: Tensor, mask: Tensor) -> tuple[Tensor, ...]:
        return solve_closed_form(images, lights, mask, model)

    return ExportTask(stereo_graph(model), metadata, INPUTS, capture_trials(), solve)


def stereo_graph(model: str) -> onnx.ModelProto:
    """The graph: pixels of the mask are gathered, solved step by step and scattered again; all axes are dynamic."""
    graph = PixelGraph({"turns": TURNS, "last_axes": [2, 3]}, FEWEST_LIGHTS)
    value = trace_formula(Value(get_model(model).function))
    begin, angles, update = load_step("begin"), load_step("angles"), load_step("update")

    def evaluate(vector: str, level: str, roughness: str, prefix: str, inner: Nodes | None = None) -> list[str]:
        """Names of the normal, the cosines, the albedo and the model's value."""
        found = graph.inline(angles, f"{prefix}angles_", (vector, level, graph.lights), inner)
        return found + graph.inline(value, f"{prefix}value_", (*found[1:], roughness), inner)

    def solve(grey: str, level: str, roughness: str, prefix: str) -> list[str]:
        middle, vector = graph.inline(begin, f"{prefix}begin_", (grey, graph.lights))

        def turn(inner: Nodes, vector: str, _: str) -> list[str]:
            _, ci, co, _, albedo, shown = evaluate(vector, level, roughness, f"{prefix}turn_", inner)
            inputs = (grey, graph.lights, middle, vector, ci, co, albedo, shown)
            return graph.inline(update, f"{prefix}update_", inputs, inner)

        # The weights need initial values: the trimming weights have the right shape.
        return repeated(graph.add, "turns", f"{prefix}turn_", (vector, middle), turn)

    grey, level = graph.inline(load_step("prepare"), "prepare_", (graph.observations,))
    roughness = graph.add("Mul", level, "float_zero")
    if model != "lambert":
        few, few_level, tried = graph.inline(load_step("sample"), "sample_", (grey, level))
        tried = graph.add("Unsqueeze", tried, "last_axes")
        vector, _ = solve(few, few_level, tried, "few_")
        _, ci, co, _, albedo, shown = evaluate(vector, few_level, tried, "few_chosen_")
        (best,) = graph.inline(load_step("choose"), "choose_", (few, graph.lights, vector, ci, co, albedo, shown))
        roughness = graph.add("Add", roughness, best)
    every = graph.add("Unsqueeze", roughness, "last_axes")
    vector, weight = solve(grey, level, every, "")
    normal, ci, co, lv, albedo, shown = evaluate(vector, level, every, "solved_")
    (error,) = graph.inline(load_step("expect"), "expect_", (grey, graph.lights, vector, weight, ci, co, albedo, shown))
    refit = load_step("refit")
    paint = albedo
    for step in range(REFITS):
        if step:
            (shown,) = graph.inline(value, f"refit_value_{step}_", (ci, co, lv, albedo, every))
        inputs = (graph.observations, weight, ci, co, albedo, shown)
        paint, albedo = graph.inline(refit, f"refit_{step}_", inputs)
    maps = [graph.scatter(values) for values in (normal, paint, roughness, error)]
    return graph.finish({name: (m, OUTPUTS[name]) for name, m in zip(OUTPUTS, maps, strict=True)})
