#!/usr/bin/env python3
"""Trace the renderer into the two ONNX graphs that the package ships.

    .venv/bin/python -m scripts.fit.trace_renderer

To be run again when a change to the renderer makes the tests of its export fail. Takes a minute and a half.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import torch
from torch import Tensor, nn

from torch_orennayar import Camera
from torch_orennayar.core.files import atomic_path
from torch_orennayar.export.nodes import TraceError, trace
from torch_orennayar.export.renderer_graph import CAMERA, GRAPHS, MAPS, MESH, view_maps
from torch_orennayar.render.normal_map import MAX_FACES, MAX_SIDE

if TYPE_CHECKING:
    import onnx

MOST_VERTICES = 1 << 31
"""Bound that the exporter is told, so that products of sizes fit into 64 bits."""
ERROR = TraceError("renderer", "a graph that torch.onnx can write", "change the renderer or the version of torch")
"""What is raised where the exporter fails."""


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


def traced_renderer(*, perspective: bool) -> onnx.ModelProto:
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


if __name__ == "__main__":
    for kind, path in GRAPHS.items():
        model = traced_renderer(perspective=kind == "perspective")
        with atomic_path(path) as temporary:
            temporary.write_bytes(model.SerializeToString(deterministic=True))
        print(f"{path.name}: {len(model.graph.node)} nodes, {path.stat().st_size // 1000} kB", flush=True)
