"""The formula of a reflectance model as ONNX nodes, traced from torch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from ..core.errors import ExportError
from ..reflectance.models import ModelFunction
from ..shading.evaluate import above_horizon, facing_both
from .nodes import REFLECTANCE_ERROR, trace

if TYPE_CHECKING:
    import onnx

INPUTS = ("ci", "co", "lv", "albedo", "roughness")
"""Inputs of a formula: cosines normal-light, normal-view and light-view, then the parameters."""
ELEMENTWISE = frozenset({
    "Abs", "Acos", "Add", "And", "Asin", "Atan", "Cast", "Ceil", "Clip", "Constant", "Cos", "Div", "Equal", "Erf",
    "Exp", "Floor", "Greater", "GreaterOrEqual", "Identity", "IsInf", "IsNaN", "Less", "LessOrEqual", "Log", "Max",
    "Min", "Mul", "Neg", "Not", "Or", "Pow", "Reciprocal", "Relu", "Round", "Sigmoid", "Sign", "Sin", "Sqrt", "Sub",
    "Tan", "Tanh", "Where", "Xor",
})  # fmt: skip
"""Operators of ONNX that treat every element alike and broadcast: a graph of these alone serves every size."""


class Value(nn.Module):
    """pi times the bidirectional reflectance from cosines, evaluated above the horizon."""

    def __init__(self, function: ModelFunction) -> None:
        super().__init__()
        self.function = function

    def forward(self, ci: Tensor, co: Tensor, lv: Tensor, albedo: Tensor, roughness: Tensor) -> Tensor:
        """The model's function, with ``ci`` and ``co`` kept positive."""
        return above_horizon(self.function, ci, co, lv, albedo, roughness)


class Shading(Value):
    """Shading from cosines."""

    def forward(self, ci: Tensor, co: Tensor, lv: Tensor, albedo: Tensor, roughness: Tensor) -> Tensor:
        """Value of the model times ``ci``, 0 where the surface faces away from light or view."""
        return torch.where(facing_both(ci, co), super().forward(ci, co, lv, albedo, roughness) * ci, 0.0)


def trace_formula(formula: Value) -> onnx.ModelProto:
    """The graph of a formula, for cosines and parameters of any sizes that broadcast.

    Tracing with sizes that vary takes three times as long, and is left to functions that look at sizes.
    """
    example = tuple(torch.rand(2, 3 if name == "albedo" else 1, 5, 7) for name in INPUTS)

    def traced(sizes: dict[str, dict[int, Any]]) -> onnx.ModelProto:
        return trace(lambda: formula, example, INPUTS, ("value",), sizes, REFLECTANCE_ERROR)

    try:
        graph = traced({name: {} for name in INPUTS})
        if serves_every_size(graph.graph):
            return graph
    except ExportError:
        pass  # the second attempt says why
    batch, channels, height, width = (torch.export.Dim(n) for n in ("batch", "channels", "height", "width"))
    area: dict[int, Any] = {0: batch, 2: height, 3: width}
    return traced({name: area | ({1: channels} if name == "albedo" else {}) for name in INPUTS})


def serves_every_size(graph: onnx.GraphProto) -> bool:
    """Whether a graph that was traced with fixed sizes does not depend on them: no operator and no constant does."""
    constants = (len(value.dims) == 0 for value in graph.initializer)
    return all(node.op_type in ELEMENTWISE for node in graph.node) and all(constants)
