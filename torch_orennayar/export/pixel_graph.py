"""ONNX graphs that gather the pixels of a mask, compute per pixel and scatter the results; every axis is dynamic."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from ..geometry.primitives import Ball, spiral_lights
from ..shading.functional import oren_nayar
from .nodes import Nodes, as_model, every_node, floats, inline
from .traced_steps import load_step

if TYPE_CHECKING:
    import onnx

INPUTS = ("images", "lights", "mask")
"""Names of the inputs of both graphs of photometric stereo."""
CAPTURE_METADATA = {
    "images": "linear light, each divided by the intensity of its light; in the unit of the albedo, so not 0 to 255; "
    "samples that are not finite count as dark, clipped ones are taken at their word",
    "lights": "away from the surface, toward the source; scaled to unit length",
    "mask": "true where there is an object; without a pixel the runtime ends in an error",
    "albedo": "in the unit of the images; 1 is a white surface under a light of irradiance pi",
}
"""Meaning and units of what both graphs of photometric stereo take and return."""


class PixelGraph:
    """A graph in the making with inputs ``images`` (K, C, H, W), ``lights`` (K, 3) and ``mask`` (1, H, W) bool.

    Attributes:
        add: appends nodes.
        observations: name of the images' values inside the mask, (P, C, K).
        lights: name of the unit directions to the lights, (K, 3).
    """

    def __init__(self, constants: Mapping[str, object], fewest_lights: int) -> None:
        self.add = add = Nodes("")
        self._constants: dict[str, object] = {
            "all": [-1],
            "keep_two": [0, 0, -1],
            "keep_one": [0, -1],
            "zero": [0],
            "one": [1],
            "axis": 0,
            "float_zero": [0.0],
            "step": 1,
            "last_needed": fewest_lights - 1,
            "one_number": 1,
            **constants,
        }
        self._traced_constants: list[onnx.TensorProto] = []
        lights, images = (add("Squeeze", add("Shape", name, end=1), "zero") for name in ("lights", "images"))
        pixels = add("Squeeze", add("Shape", add("NonZero", add("Reshape", "mask", "all")), start=1), "zero")
        refused = [
            self._refuse(f"refuse_fewer_than_{fewest_lights}_lights", lights, "last_needed"),
            self._refuse("refuse_more_images_than_lights", lights, add("Sub", images, "one_number")),
            self._refuse("refuse_more_lights_than_images", images, add("Sub", lights, "one_number")),
            self._refuse("refuse_an_empty_mask", pixels, "axis"),
        ]
        shape = "all"
        for nothing in refused:
            shape = add("Add", shape, nothing)
        self._inside = add("Reshape", "mask", shape)
        self._positions = add("Squeeze", add("NonZero", self._inside), "zero")
        inside = add("Gather", add("Reshape", "images", "keep_two"), self._positions, axis=2)
        seen = add("Transpose", inside, perm=[2, 1, 0])
        self.observations, self.lights = self.inline(load_step("clean"), "clean_", (seen, "lights"))
        self._pixel_of_position = ""

    def _refuse(self, name: str, count: str, index: str) -> str:
        """A number that is 0, and that a runtime cannot compute where ``index`` is not below ``count``.

        ONNX has no assertion; the runtime's error names the node.
        """
        from onnx import helper

        numbers = self.add("Range", "axis", count, "step")
        self.add.nodes.append(helper.make_node("Gather", [numbers, index], [name], name=name))
        return self.add("Sub", name, index)

    def inline(
        self, traced: onnx.ModelProto, prefix: str, inputs: Sequence[str], add: Nodes | None = None
    ) -> list[str]:
        """Copy the nodes of ``traced``, reading ``inputs``, to ``add`` or the graph; returns its outputs."""
        names = (value.name for value in traced.graph.input)
        outputs, constants = inline(add or self.add, traced.graph, prefix, dict(zip(names, inputs, strict=True)))
        self._traced_constants += constants
        return outputs

    def scatter(self, values: str) -> str:
        """Values of the pixels, (P, C), as a map (C, H, W) that is 0 outside the mask."""
        from onnx import TensorProto

        add = self.add
        if not self._pixel_of_position:  # every position looks up its pixel, which needs no ScatterND and has no races
            pixels_up_to = add("CumSum", add("Cast", self._inside, to=TensorProto.INT64), "axis")
            self._pixel_of_position = add("Max", add("Sub", pixels_up_to, "one"), "zero")
        inside = add("Unsqueeze", self._inside, "one")
        everywhere = add("Where", inside, add("Gather", values, self._pixel_of_position), "float_zero")
        planes = add("Transpose", everywhere, perm=[1, 0])
        sizes = add("Concat", add("Shape", planes, end=1), add("Shape", "mask", start=1), axis=0)
        return add("Reshape", planes, sizes)

    def gather(self, values: str) -> str:
        """The inverse of `scatter`: a map (C, H, W) at the pixels inside the mask, (P, C)."""
        add = self.add
        inside = add("Gather", add("Reshape", values, "keep_one"), self._positions, axis=1)
        return add("Transpose", inside, perm=[1, 0])

    def finish(self, outputs: Mapping[str, tuple[str, int | str]]) -> onnx.ModelProto:
        """The model; ``outputs`` are maps (C, H, W) with their C, by the name of the output."""
        import numpy as np
        from onnx import TensorProto, helper, numpy_helper

        for name, (value, _) in outputs.items():
            self.add.nodes.append(helper.make_node("Identity", [value], [name], name=f"output_{name}"))
        used = {name for node in every_node(self.add.nodes) for name in node.input}
        arrays = {name: np.asarray(value) for name, value in self._constants.items() if name in used}
        constants = [
            numpy_helper.from_array(array.astype(np.float32 if array.dtype.kind == "f" else np.int64), name)
            for name, array in arrays.items()
        ]

        signature = [
            floats("images", ["lights", "channels", "height", "width"]),
            floats("lights", ["lights", 3]),
            helper.make_tensor_value_info("mask", TensorProto.BOOL, [1, "height", "width"]),
        ]
        maps = [floats(name, [channels, "height", "width"]) for name, (_, channels) in outputs.items()]
        initializers = [*constants, *self._traced_constants]
        return as_model(helper.make_graph(self.add.nodes, "stereo", signature, maps, initializers))


def capture_trials(fewest_lights: int = 3) -> list[tuple[Tensor, ...]]:
    """Captures of rough and smooth balls with 1 % noise under few lights, from ``fewest_lights`` on, and many."""
    trials: list[tuple[Tensor, ...]] = []
    generator = torch.Generator().manual_seed(0)
    view = torch.tensor([0.0, 0, 1]).reshape(1, 3, 1, 1)
    for count, channels, size, roughness in ((3, 1, 24, 0.0), (5, 2, 20, 0.0), (24, 3, 40, 0.5), (13, 1, 33, 0.9)):
        normal, mask = Ball(size / 2, size / 2, 0.45 * size).normals((size, size + 5))
        lights = spiral_lights(max(count, fewest_lights), math.radians(45))
        albedo = torch.linspace(0.3, 0.8, channels).reshape(1, -1, 1, 1)
        images = oren_nayar(normal[None], lights[:, :, None, None], view, albedo, roughness)
        images = images * (1 + 0.01 * torch.randn(images.shape, generator=generator))
        trials.append((images.contiguous(), lights, mask))
    return trials
