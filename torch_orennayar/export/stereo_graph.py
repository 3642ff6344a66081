"""Photometric stereo in a fixed number of closed-form steps, and its ONNX graph.

What a graph can do: weighted linear least squares, again and again, with the weights and the reflectance of the answer
before. No search, no neighbours and no highlights: `photometric_stereo` does better, where torch is to be had.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from ..geometry.primitives import Ball, spiral_lights
from ..reflectance.models import get_model
from ..shading.functional import oren_nayar
from ..stereo.closed_form import CANDIDATES, SAMPLES, TURNS, Begin, Choose, Finish, Prepare, Sample, Turn
from .nodes import Nodes
from .pixel_graph import PixelGraph

if TYPE_CHECKING:
    import onnx

STEREO_OUTPUTS = ("normal", "albedo", "roughness")


def stereo_graph(model: str) -> onnx.ModelProto:
    """The graph: pixels of the mask are gathered, solved in the steps above and laid out again; all axes dynamic."""
    function, graph = get_model(model).function, PixelGraph({"turns": TURNS})
    turn = graph.trace(Turn(function), ("grey", "level", "lights", "roughness", "middle", "vector"), 2)
    begin = graph.trace(Begin(), ("grey", "lights"), 2)

    def solve(grey: str, level: str, roughness: str, prefix: str) -> list[str]:
        middle, vector = graph.inline(begin, f"{prefix}begin_", (grey, "lights"))
        return _loop(graph, turn, f"{prefix}turn_", (grey, level, "lights", roughness, middle, vector))

    grey, level = graph.inline(graph.trace(Prepare(), ("seen",), 2), "prepare_", (graph.seen,))
    roughness = graph.add("Mul", level, "nothing")
    if model != "lambert":
        few, few_level, tried = graph.inline(graph.trace(Sample(), ("grey", "level"), 3), "sample_", (grey, level))
        vector, _ = solve(few, few_level, tried, "few_")
        names = ("grey", "level", "lights", "roughness", "vector")
        choose = graph.trace(Choose(function), names, 1, len(CANDIDATES) * SAMPLES)
        (best,) = graph.inline(choose, "choose_", (few, few_level, "lights", tried, vector))
        roughness = graph.add("Add", roughness, best)
    vector, weight = solve(grey, level, roughness, "")
    finish = graph.trace(Finish(function), ("seen", "level", "lights", "roughness", "vector", "weight"), 2)
    normal, albedo = graph.inline(finish, "finish_", (graph.seen, level, "lights", roughness, vector, weight))
    laid = (graph.lay(values) for values in (normal, albedo, roughness))
    return graph.finish(dict(zip(STEREO_OUTPUTS, zip(laid, (3, "channels", 1), strict=True), strict=True)))


def _loop(graph: PixelGraph, turn: onnx.ModelProto, prefix: str, given: Sequence[str]) -> list[str]:
    """``TURNS`` turns; vector and weight go round, all else is seen from outside."""
    from onnx import TensorProto, helper

    *fixed, middle, vector = given
    inner = Nodes(prefix)
    found = graph.inline(turn, prefix, (*fixed, middle, f"{prefix}vector"), inner)
    go_on = inner("Identity", f"{prefix}go_on")

    def value(name: str, kind: int = TensorProto.FLOAT, shape: list[object] | None = None) -> Any:
        return helper.make_tensor_value_info(name, kind, shape)

    names = (f"{prefix}vector", f"{prefix}weight")
    body = helper.make_graph(
        inner.nodes,
        f"{prefix}body",
        [
            value(f"{prefix}index", TensorProto.INT64, []),
            value(f"{prefix}go_on", TensorProto.BOOL, []),
            *map(value, names),
        ],
        [value(go_on, TensorProto.BOOL, []), *map(value, found)],
    )
    return graph.add.many("Loop", ("turns", "", vector, middle), 2, body=body)


def stereo_trials(fewest: int = 3) -> list[tuple[Tensor, ...]]:
    """Rough and smooth balls under few (from ``fewest`` on) and many lights, with noise, to try a graph on."""
    trials: list[tuple[Tensor, ...]] = []
    generator = torch.Generator().manual_seed(0)
    for count, channels, size, roughness in ((3, 1, 24, 0.0), (5, 2, 20, 0.0), (24, 3, 40, 0.5), (13, 1, 33, 0.9)):
        normal, mask = Ball(size / 2, size / 2, 0.45 * size).normals((size, size + 5))
        lights = spiral_lights(max(count, fewest), math.radians(45))
        albedo = torch.linspace(0.3, 0.8, channels).reshape(1, -1, 1, 1)
        images = oren_nayar(
            normal[None], lights[:, :, None, None], torch.tensor([0.0, 0, 1]).reshape(1, 3, 1, 1), albedo, roughness
        )
        images = images * (1 + 0.01 * torch.randn(images.shape, generator=generator))
        trials.append((images.contiguous(), lights, mask))
    return trials
