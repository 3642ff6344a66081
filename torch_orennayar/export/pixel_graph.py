"""ONNX graphs that gather the pixels of a mask, work on them and lay the answers out again; every axis is dynamic."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .nodes import Nodes, as_model, inline, write_graph

if TYPE_CHECKING:
    import onnx

STEREO_INPUTS = ("images", "lights", "mask")


class PixelGraph:
    """A graph in the making: ``images`` (K, C, H, W), ``lights`` (K, 3) and ``mask`` (1, H, W) bool go in.

    Attributes:
        add: takes nodes.
        seen: name of the pixels inside the mask, (P, C, K).
    """

    def __init__(self, constants: Mapping[str, object]) -> None:
        self.add = add = Nodes("")
        self._constants: dict[str, object] = {
            "all": [-1],
            "keep_two": [0, 0, -1],
            "keep_one": [0, -1],
            "zero": [0],
            "one": [1],
        }
        self._constants |= {"axis": 0, "nothing": [0.0]} | dict(constants)
        self._held: list[Any] = []
        self._flat = add("Reshape", "mask", "all")
        self._place = add("Squeeze", add("NonZero", self._flat), "zero")
        self.seen = add("Transpose", add("Gather", add("Reshape", "images", "keep_two"), self._place, axis=2),
                        perm=[2, 1, 0])  # fmt: skip
        self._row = ""

    def trace(self, module: nn.Module, names: Sequence[str], outputs: int, rows: int | None = None) -> onnx.ModelProto:
        """The graph of one step; pixels, channels and lights are dynamic, pixels not if there are always ``rows``."""
        pixels, channels, count, height, width = (
            torch.export.Dim(n) for n in ("pixels", "channels", "count", "height", "width")
        )
        lights = F.normalize(torch.rand(7, 3) + torch.tensor([0.0, 0, 1]), dim=1)
        row: dict[int, object] = {} if rows else {0: pixels}
        number, area = rows or 11, {1: height, 2: width}
        examples: dict[str, tuple[Tensor, Any]] = {
            "seen": (torch.rand(number, 3, 7), row | {1: channels, 2: count}),
            "lights": (lights, {0: count}),
            "vector": (torch.rand(number, 3), row),
            "normal_map": (torch.rand(3, 9, 8), area),
            "error_map": (torch.rand(1, 9, 8), area),
            **{n: (torch.rand(number, 7), row | {1: count}) for n in ("grey", "middle", "weight")},
            **{n: (torch.rand(number, 1), row) for n in ("level", "roughness")},
        }
        return write_graph(
            module.eval,
            tuple(examples[n][0] for n in names),
            (names, [f"found_{k}" for k in range(outputs)]),
            tuple(examples[n][1] for n in names),
            ("model", "a reflectance function that torch.onnx can export"),
            "build it from element-wise torch operations without Python branches on values",
        )

    def inline(self, traced: onnx.ModelProto, prefix: str, given: Sequence[str], add: Nodes | None = None) -> list[str]:
        """Copy the nodes of ``traced`` in, fed with ``given``; the names of what they find."""
        inputs = (value.name for value in traced.graph.input)
        found, constants = inline(add or self.add, traced.graph, prefix, dict(zip(inputs, given, strict=True)))
        self._held += constants
        return found

    def lay(self, values: str) -> str:
        """Values (P, C) of pixels in the picture, (C, H, W); 0 outside the mask."""
        from onnx import TensorProto

        add = self.add
        if not self._row:  # every pixel of the picture looks up its row
            before = add("CumSum", add("Cast", self._flat, to=TensorProto.INT64), "axis")
            self._row = add("Max", add("Sub", before, "one"), "zero")
        inside = add("Unsqueeze", self._flat, "one")
        laid = add("Transpose", add("Where", inside, add("Gather", values, self._row), "nothing"), perm=[1, 0])
        sizes = add("Concat", add("Shape", laid, end=1), add("Shape", "mask", start=1), axis=0)
        return add("Reshape", laid, sizes)

    def pick(self, picture: str) -> str:
        """The way back: a picture (C, H, W) at the pixels inside the mask, (P, C)."""
        add = self.add
        return add("Transpose", add("Gather", add("Reshape", picture, "keep_one"), self._place, axis=1), perm=[1, 0])

    def finish(self, outputs: Mapping[str, tuple[str, int | str]]) -> onnx.ModelProto:
        """The graph; ``outputs`` are pictures and their numbers of channels by name."""
        import numpy as np
        from onnx import TensorProto, helper, numpy_helper

        for name, (value, _) in outputs.items():
            self.add.nodes.append(helper.make_node("Identity", [value], [name], name=f"give_{name}"))
        used = {name for node in self.add.nodes for name in _inputs(node)}
        arrays = {name: np.asarray(value) for name, value in self._constants.items() if name in used}
        held = [
            numpy_helper.from_array(array.astype(np.float32 if array.dtype.kind == "f" else np.int64), name)
            for name, array in arrays.items()
        ]

        def floats(name: str, sizes: list[object]) -> Any:
            return helper.make_tensor_value_info(name, TensorProto.FLOAT, sizes)

        signature = [
            floats("images", ["lights", "channels", "height", "width"]),
            floats("lights", ["lights", 3]),
            helper.make_tensor_value_info("mask", TensorProto.BOOL, [1, "height", "width"]),
        ]
        results = [floats(name, [channels, "height", "width"]) for name, (_, channels) in outputs.items()]
        return as_model(helper.make_graph(self.add.nodes, "stereo", signature, results, [*held, *self._held]))


def _inputs(node: onnx.NodeProto) -> list[str]:
    """What a node reads, in loops too."""
    bodies = (attribute.g for attribute in node.attribute if attribute.HasField("g"))
    return [*node.input, *(name for body in bodies for inner in body.node for name in _inputs(inner))]
