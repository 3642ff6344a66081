"""The ONNX graph of shading in operators that the runtimes of phones and browsers have: no loop, no comparison."""

from __future__ import annotations

from typing import TYPE_CHECKING

from torch import Tensor

from ..core.errors import ExportError
from ..reflectance.models import get_model
from ..render.normal_map import check_size
from .formula import Value, trace_formula
from .nodes import Nodes, as_model, inline
from .shading_graph import (
    INPUTS,
    LIMITS,
    TRIAL_SIZES,
    constant_parameters,
    cosine,
    out_of_range,
    random_scene,
    shade_anything,
    shading_metadata,
    signature,
)
from .task import ExportTask

if TYPE_CHECKING:
    import onnx

OPSET = 17
"""Version of the operator set; everything in `PORTABLE` is the same in 17 and 18."""
PORTABLE = frozenset({"Add", "Clip", "Div", "Mul", "Pow", "ReduceSum", "Relu", "Sqrt", "Sub"})
"""Operators that all have in ONNX Runtime 1.30: CoreML as an ML program (``coreml_supported_mlprogram_ops.md``), WebGPU
and WebNN (``webgpu-operators.md`` and ``webnn-operators.md`` of ``onnxruntime-web``)."""
STEEP = 1e30
"""Factor that makes a step of a clamped cosine: 1 from 1e-30 on."""


class PortableShading(Value):
    """`Shading` without comparisons: pixels that face away from the light or the view are 0 by products."""

    def forward(self, ci: Tensor, co: Tensor, lv: Tensor, albedo: Tensor, roughness: Tensor) -> Tensor:
        """Value of the model times the positive part of ``ci``, and 0 where ``co`` is not positive."""
        return super().forward(ci, co, lv, albedo, roughness) * ci.relu() * (co * STEEP).clamp(0.0, 1.0)


def portable_task(model: str, *, per_pixel: bool, size: tuple[int, int] | None) -> ExportTask:
    """`oren_nayar` with ``model`` in `PORTABLE` operators; axes are dynamic, or fixed if there is a ``size``."""
    model = get_model(model).name
    if size is not None:
        check_size(size)
    sizes = TRIAL_SIZES if size is None else ((1, 3, *size),)
    trials = [random_scene(*shape, seed, per_pixel) for seed, shape in enumerate(sizes)]
    trials.append(out_of_range(trials[0]))
    if size is None:
        trials.append(constant_parameters(trials[0]))
    metadata = shading_metadata(model) | {
        "axes": "every axis of size 1 broadcasts",
        "portable": f"only operators {', '.join(sorted(PORTABLE))}; a normal that is no number gives no number",
    }

    def shade(*inputs: Tensor) -> tuple[Tensor, ...]:
        return (shade_anything(*inputs, model=model),)

    return ExportTask(portable_graph(model, per_pixel=per_pixel, size=size), metadata, INPUTS, trials, shade)


def portable_graph(model: str, *, per_pixel: bool, size: tuple[int, int] | None) -> onnx.ModelProto:
    """The graph of ``model``; light and view are (B, 3, 1, 1), or maps if ``per_pixel``."""
    import numpy as np
    from onnx import helper, numpy_helper

    formula = trace_formula(PortableShading(get_model(model).function)).graph
    add = Nodes("")
    lengths = {n: add("Clip", add("Sqrt", cosine(add, n, n)), "tiny") for n in ("light", "view", "normal")}
    light, view, normal = (add("Div", name, long) for name, long in lengths.items())
    cosines = [cosine(add, *pair) for pair in ((normal, light), (normal, view), (light, view))]
    inputs = (*cosines, "albedo", add("Clip", "roughness", "smooth", "roughest"))
    names = dict(zip((value.name for value in formula.input), inputs, strict=True))
    traced = Nodes("")
    (value,), constants = inline(traced, formula, "formula_", names)
    for node in traced.nodes:
        _append(add, node)
    last = next(node for node in reversed(add.nodes) if value in node.output)
    last.output[:] = ["shading"]
    other = sorted({node.op_type for node in add.nodes} - PORTABLE)
    if other:
        raise ExportError(
            "model",
            expected=f"a reflectance function in the operators {', '.join(sorted(PORTABLE))}",
            got=f"{model} with {', '.join(other)}",
            mend="take another model, or leave portable out",
        )
    constants += [numpy_helper.from_array(np.float32(v), n) for n, v in LIMITS.items()]
    constants.append(numpy_helper.from_array(np.array([1]), "one"))
    used = {name for node in add.nodes for name in node.input}
    initializers = [constant for constant in constants if constant.name in used]
    inputs_of_graph, output = signature(per_pixel, size)
    return as_model(helper.make_graph(add.nodes, "shading", inputs_of_graph, [output], initializers), OPSET)


def _append(add: Nodes, node: onnx.NodeProto) -> None:
    """Append a node of a formula, or what computes the same without comparing."""
    if node.op_type == "Min":
        first, second = node.input
        add.named(node.output[0], "Sub", first, add("Relu", add("Sub", first, second)))
    elif node.op_type == "Max":
        first, second = node.input
        add.named(node.output[0], "Add", first, add("Relu", add("Sub", second, first)))
    elif node.op_type == "Reciprocal":  # CoreML adds 1e-4 to what it inverts
        add.named(node.output[0], "Div", "unit", node.input[0])
    else:
        add.nodes.append(node)
