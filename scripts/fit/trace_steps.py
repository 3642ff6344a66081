#!/usr/bin/env python3
"""Trace the steps of the graphs that the package ships: the renderer, photometric stereo and integration.

    .venv/bin/python -m scripts.fit.trace_steps          # all of them, three minutes
    .venv/bin/python -m scripts.fit.trace_steps update expect

To be run again when a change to such a step makes the tests of its graph fail.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from torch_orennayar import Camera
from torch_orennayar.core.files import atomic_path
from torch_orennayar.export.nodes import TraceError, trace
from torch_orennayar.export.renderer_graph import CAMERA, MAPS, MESH, view_maps
from torch_orennayar.export.traced_steps import FOLDER
from torch_orennayar.geometry import smooth_integration
from torch_orennayar.render.normal_map import MAX_FACES, MAX_SIDE
from torch_orennayar.stereo import closed_form, network_solver
from torch_orennayar.stereo.set_network import load_network

if TYPE_CHECKING:
    import onnx

ERROR = TraceError("step", "a step that torch.onnx can write", "change the step or the version of torch")
"""What is raised where the exporter fails."""
MOST_VERTICES = 1 << 31
"""Bound that the exporter is told, so that products of sizes fit into 64 bits."""
EVALUATED = ("ci", "co", "albedo", "value")
"""Inputs of the steps that know what the model said: two cosines, the albedo and the value."""
STATE = ("depth", "residual", "direction", "before")
"""What `smooth_integration.Advance` replaces in every step."""


class Step(NamedTuple):
    """A module, the names of its inputs and the number of its outputs; of ``rows`` pixels, or of any number."""

    module: nn.Module
    inputs: tuple[str, ...]
    outputs: int
    rows: int = 0


def pixel_steps() -> dict[str, Step]:
    """The steps of photometric stereo, of pixels, channels and lights whose number is dynamic."""
    candidates = len(closed_form.CANDIDATES) * closed_form.SAMPLES
    return {
        "clean": Step(closed_form.Clean(), ("seen", "lights"), 2),
        "prepare": Step(closed_form.Prepare(), ("seen",), 2),
        "begin": Step(closed_form.Begin(), ("grey", "lights"), 2),
        "angles": Step(closed_form.Angles(), ("vector", "level", "lights"), 5),
        "update": Step(closed_form.Update(), ("grey", "lights", "middle", "vector", *EVALUATED), 2),
        "sample": Step(closed_form.Sample(), ("grey", "level"), 3),
        "choose": Step(closed_form.Choose(), ("grey", "lights", "vector", *EVALUATED), 1, candidates),
        "expect": Step(closed_form.Expect(), ("grey", "lights", "vector", "weight", *EVALUATED), 1),
        "refit": Step(closed_form.Refit(), ("seen", "weight", *EVALUATED), 2),
        "network": Step(load_network(), ("grey", "lights"), 2),
        "smooth_normals": Step(network_solver.Smooth(), ("normal_map", "error_map"), 1),
        "paint": Step(network_solver.Paint(), ("seen", "lights", "vector"), 2),
    }


def integration_steps() -> dict[str, Step]:
    """The steps of integration, of pictures whose height and width are dynamic."""
    return {
        "integration_begin": Step(smooth_integration.Begin(), ("normal", "mask"), 2),
        "integration_coarsen": Step(smooth_integration.Coarsen(), ("weight",), 1),
        "integration_smooth": Step(smooth_integration.Smooth(), ("weight", "residual"), 2),
        "integration_spread": Step(smooth_integration.Spread(), ("coarse",), 1),
        "integration_correct": Step(smooth_integration.Correct(), ("weight", "residual", "depth", "found"), 1),
        "integration_advance": Step(smooth_integration.Advance(), ("weight", *STATE, "guess"), 4),
        "integration_centre": Step(smooth_integration.Centre(), ("depth", "mask"), 1),
    }


def trace_pixel_step(step: Step) -> onnx.ModelProto:
    """The graph of a step of photometric stereo, without the weights of a network."""
    pixels, channels, count, height, width = (
        torch.export.Dim(n) for n in ("pixels", "channels", "count", "height", "width")
    )
    lights = F.normalize(torch.rand(7, 3) + torch.tensor([0.0, 0, 1]), dim=1)
    row: dict[int, Any] = {} if step.rows else {0: pixels}
    number, area = step.rows or 11, {1: height, 2: width}
    examples: dict[str, tuple[Tensor, dict[int, Any]]] = {
        "seen": (torch.rand(number, 3, 7), row | {1: channels, 2: count}),
        "lights": (lights, {0: count}),
        "vector": (torch.rand(number, 3), row),
        "normal_map": (torch.rand(3, 9, 8), area),
        "error_map": (torch.rand(1, 9, 8), area),
        **{n: (torch.rand(number, 7), row | {1: count}) for n in ("grey", "middle", "weight")},
        "level": (torch.rand(number, 1), row),
        "ci": (torch.rand(number, 1, 1, 7), row | {3: count}),
        "co": (torch.rand(number, 1, 1, 1), row),
        "albedo": (torch.rand(number, 3, 1, 1), row | {1: channels}),
        "value": (torch.rand(number, 3, 1, 7), row | {1: channels, 3: count}),
    }
    traced = _trace(step, examples)
    shipped = [v for v in traced.graph.initializer if v.name not in step.module.state_dict()]
    del traced.graph.initializer[:]
    traced.graph.initializer.extend(shipped)
    return traced


def trace_integration_step(step: Step) -> onnx.ModelProto:
    """The graph of a step of integration."""
    area: dict[int, Any] = {1: torch.export.Dim("height"), 2: torch.export.Dim("width")}
    grids = ("residual", "depth", "direction", "guess", "found", "coarse")
    examples: dict[str, tuple[Tensor, dict[int, Any]]] = {
        **{name: (torch.rand(1, 12, 10), area) for name in grids},
        "normal": (torch.rand(3, 12, 10), area),
        "mask": (torch.ones(1, 12, 10, dtype=torch.bool), area),
        "weight": (torch.rand(2, 12, 10), area),
        "before": (torch.ones(1, 1, 1), {}),
    }
    return _trace(step, examples)


def _trace(step: Step, examples: dict[str, tuple[Tensor, dict[int, Any]]]) -> onnx.ModelProto:
    """The graph of a step; ``examples`` hold a value and the dynamic axes of every input that a step may have."""
    values, sizes = zip(*(examples[name] for name in step.inputs), strict=True)
    outputs = [f"found_{k}" for k in range(step.outputs)]
    return trace(step.module.eval, values, step.inputs, outputs, sizes, ERROR)


class Renderer(nn.Module):
    """`view_maps` of tensors."""

    def __init__(self, *, perspective: bool) -> None:
        super().__init__()
        self.perspective = perspective

    def forward(
        self,
        vertices: Tensor,
        faces: Tensor,
        rotation: Tensor,
        eye: Tensor,
        focal: Tensor,
        centre: Tensor,
        canvas: Tensor,
        near: Tensor,
    ) -> tuple[Tensor, ...]:
        """``canvas`` (H, W) has only a size; ``near`` () takes the place of a number, so that it becomes an input."""
        placed = rotation[None], eye[None], focal[None], centre[None]
        camera = Camera(*placed, is_perspective=self.perspective, near=cast(float, near))
        return view_maps(vertices, faces, camera, (canvas.shape[0], canvas.shape[1]))


def trace_renderer(*, perspective: bool) -> onnx.ModelProto:
    """The graph of `Renderer` with an input ``size`` (2,) int64 in place of the canvas."""
    from onnx import TensorProto, helper, numpy_helper

    dim = torch.export.Dim
    example = (
        torch.rand(5, 3),
        torch.tensor([[0, 1, 2], [1, 2, 3], [2, 3, 4]]),
        torch.eye(3),
        *(torch.rand(n) for n in (3, 2, 2)),
        torch.zeros(9, 8),
        torch.tensor(0.01, dtype=torch.float64),
    )
    sizes: tuple[dict[int, Any], ...] = (
        {0: dim("vertices", max=MOST_VERTICES)},
        {0: dim("faces", max=MAX_FACES)},
        *({},) * len(CAMERA),
        {0: dim("height", max=MAX_SIDE), 1: dim("width", max=MAX_SIDE)},
        {},
    )
    renderer = Renderer(perspective=perspective)
    inputs, outputs = (*MESH, *CAMERA, "canvas", "near"), (*MAPS, "view")
    traced = trace(lambda: renderer, example, inputs, outputs, sizes, ERROR)
    graph = traced.graph
    for node in graph.node:
        if "canvas" in node.input:  # its shape is all that is read
            first, last = _range_of_shape(node)
            node.op_type, node.input[:] = "Slice", ["size", f"axis_{first}", f"axis_{last}"]
            del node.attribute[:]
    graph.initializer.extend(numpy_helper.from_array(torch.tensor([k]).numpy(), f"axis_{k}") for k in range(3))
    near = graph.input.pop()
    graph.input.pop()
    graph.input.append(helper.make_tensor_value_info("size", TensorProto.INT64, [2]))
    if perspective:
        graph.input.append(near)
    return traced


def _range_of_shape(node: onnx.NodeProto) -> tuple[int, int]:
    """First and last axis, the latter excluded, of a node ``Shape`` of two axes."""
    limits = {attribute.name: attribute.i for attribute in node.attribute}
    return limits.get("start", 0), limits.get("end", 2)


def every_step() -> dict[str, Callable[[], onnx.ModelProto]]:
    """How each file is made, by its name."""
    return {
        "renderer_perspective": partial(trace_renderer, perspective=True),
        "renderer_orthographic": partial(trace_renderer, perspective=False),
        **{name: partial(trace_pixel_step, step) for name, step in pixel_steps().items()},
        **{name: partial(trace_integration_step, step) for name, step in integration_steps().items()},
    }


def main() -> None:
    """Write the files."""
    made = every_step()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(made)}; default: all")
    names = parser.parse_args().names or list(made)
    for name in names:
        step = made[name]()
        path = FOLDER / f"{name}.onnx"
        with atomic_path(path) as temporary:
            temporary.write_bytes(step.SerializeToString(deterministic=True))
        print(f"{path.name}: {len(step.graph.node)} nodes, {path.stat().st_size / 1000:.0f} kB", flush=True)


if __name__ == "__main__":
    main()
