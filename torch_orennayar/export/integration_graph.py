"""The ONNX graph that integrates normals to heights: the steps of `geometry.smooth_integration`, traced and joined."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from torch import Tensor

from ..geometry.primitives import Ball
from ..geometry.smooth_integration import LEVELS, STEPS, integrate_smooth
from .nodes import Nodes, as_model, floats, inline, repeated
from .task import ExportTask
from .traced_steps import load_step

if TYPE_CHECKING:
    import onnx

INPUTS = ("normal", "mask")
"""Names of the graph's inputs."""


def integration_task() -> ExportTask:
    """`integrate_smooth`."""
    metadata = {
        "normal": "camera frame, unit; where not finite, nothing joins the pixel to its neighbours",
        "mask": "true where there is a surface; of none heights are 0",
        "depth": "height toward the viewer in pixels, mean 0 over the mask, 0 outside",
        "method": f"least squares on slopes, {STEPS} steps of conjugate gradients with multigrid of {LEVELS} grids",
        "limits": "orthographic view; normals that face away or are 0 count as flat; "
        "steps of depth inside the mask are bridged; regions that do not touch keep any offset",
    }

    def solve(normal: Tensor, mask: Tensor) -> tuple[Tensor, ...]:
        return (integrate_smooth(normal, mask),)

    return ExportTask(integration_graph(), metadata, INPUTS, integration_trials(), solve)


def integration_graph() -> onnx.ModelProto:
    """The graph; height and width are dynamic."""
    import numpy as np
    from onnx import TensorProto, helper, numpy_helper

    add, initializers = Nodes(""), list["onnx.TensorProto"]()
    names = ("begin", "coarsen", "smooth", "spread", "correct", "advance", "centre")
    step_of = {name: load_step(f"integration_{name}").graph for name in names}

    def copy(name: str, prefix: str, inputs: Sequence[str], to: Nodes = add) -> list[str]:
        step = step_of[name]
        outputs, constants = inline(to, step, prefix, dict(zip((v.name for v in step.input), inputs, strict=True)))
        initializers.extend(constants)
        return outputs

    weight, residual = copy("begin", "begin_", INPUTS)
    weights = [weight]
    for level in range(1, LEVELS):
        weights += copy("coarsen", f"grid_{level}_", weights[-1:])

    def cycle(inner: Nodes, level: int, residual: str) -> str:
        depth, left = copy("smooth", f"smooth_{level}_", (weights[level], residual), inner)
        if level == LEVELS - 1:
            return depth
        (wide,) = copy("spread", f"spread_{level}_", (cycle(inner, level + 1, left),), inner)
        found = inner("Slice", wide, "origin", inner("Shape", depth), "axes")
        return copy("correct", f"correct_{level}_", (weights[level], residual, depth, found), inner)[0]

    def step(inner: Nodes, *state: str) -> list[str]:
        return copy("advance", "advance_", (weight, *state, cycle(inner, 0, state[1])), inner)

    nothing, one = add("Mul", residual, "float_zero"), "float_one"
    depth, *_ = repeated(add, "steps", "step_", (nothing, residual, nothing, one), step)
    (centred,) = copy("centre", "centre_", (depth, "mask"))
    add.nodes.append(helper.make_node("Identity", [centred], ["depth"], name="output_depth"))
    constants: dict[str, object] = {
        "steps": STEPS,
        "origin": [0, 0, 0],
        "axes": [0, 1, 2],
        "float_zero": np.float32(0),
        "float_one": np.ones((1, 1, 1), np.float32),
    }
    initializers += [numpy_helper.from_array(np.asarray(value), name) for name, value in constants.items()]
    area: tuple[str, str] = ("height", "width")
    inputs = [
        floats("normal", [3, *area]),
        helper.make_tensor_value_info("mask", TensorProto.BOOL, [1, *area]),
    ]
    return as_model(helper.make_graph(add.nodes, "integration", inputs, [floats("depth", [1, *area])], initializers))


def integration_trials() -> list[tuple[Tensor, ...]]:
    """Balls in pictures of odd and even sizes, cut by the border too, and a single pixel."""
    trials: list[tuple[Tensor, ...]] = []
    for height, width, radius in ((24, 31, 10.0), (65, 40, 30.0), (1, 1, 3.0), (300, 257, 120.0)):
        normal, mask = Ball(width / 2, height / 2, radius).normals((height, width))
        trials.append((normal, mask))
    return trials
