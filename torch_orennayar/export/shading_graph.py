"""Build the ONNX graph of shading: a formula traced from torch, and around it what a runtime needs to be fast.

A runtime writes the result of every node to memory. So the cosines of one direction per image are products of matrices,
a node each, and the formula runs in a loop over bands of rows whose temporaries fit in cache.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from ..reflectance.models import ModelFunction, get_model
from ..shading.evaluate import above_horizon, facing_both
from .nodes import Nodes, as_model, inline, write_graph

if TYPE_CHECKING:
    import onnx

BAND = 1 << 17
"""Elements of a band of rows: for one thread fewer would be faster, for several more."""
INPUTS = ("normal", "light", "view", "albedo", "roughness")
_MAPS = ("ci", "co", "lv", "albedo", "roughness")


class Formula(nn.Module):
    """Shading from cosines."""

    def __init__(self, function: ModelFunction) -> None:
        super().__init__()
        self.function = function

    def forward(self, ci: Tensor, co: Tensor, lv: Tensor, albedo: Tensor, roughness: Tensor) -> Tensor:
        """Cosines of light and view to the normal and to each other in, shading out."""
        value = above_horizon(self.function, ci, co, lv, albedo, roughness)
        return torch.where(facing_both(ci, co), value * ci, 0.0)


def shading_graph(model: str, *, per_pixel: bool) -> onnx.ModelProto:
    """The graph of ``model``; light and view are (B, 3, 1, 1), or maps if ``per_pixel``. Every axis is dynamic."""
    import onnx
    from onnx import helper

    formula = _trace(get_model(model).function).graph
    constants = {"zero": [0], "one": [1], "two": [2], "three": [3], "four": [4], "band_size": [BAND]}
    add = Nodes("")

    def cosine(a: str, b: str) -> str:
        return add("ReduceSum", add("Mul", a, b), "one", keepdims=1)

    def cosine_of_one(direction: str) -> str:
        """(B, 1, 3) times (B, 3, H W), as (B, 1, H, W)."""
        area = add("Shape", "normal", start=2)
        pixels = add("Mul", add("Slice", area, "zero", "one", "zero"), add("Slice", area, "one", "two", "zero"))
        planes = reshape("normal", add("Shape", "normal", end=2), pixels)
        product = add("MatMul", reshape(direction, add("Shape", direction, end=1), "one", "three"), planes)
        return reshape(product, add("Shape", product, end=2), area)

    def reshape(value: str, *sizes: str) -> str:
        # The maximum keeps ONNX Runtime from guessing a size by -1, which fails where another one is 0.
        return add("Reshape", value, add("Max", add("Concat", *sizes, axis=0), "zero"), allowzero=1)

    maps = {"albedo": "albedo", "roughness": "roughness", "lv": cosine("light", "view")}
    for name, direction in (("ci", "light"), ("co", "view")):
        maps[name] = cosine("normal", direction) if per_pixel else cosine_of_one(direction)

    # Bands: as many rows as make BAND elements of the broadcast picture.
    heights = {n: add("Shape", value, start=2, end=3) for n, value in maps.items()}
    sizes = add("Max", *(add("Shape", value) for value in maps.values()))
    row = add("Mul", add("Slice", sizes, "zero", "one", "zero"), add("Slice", sizes, "three", "four", "zero"))
    rows = add("Max", add("Div", "band_size", add("Max", row, "one")), "one")
    # One column of each map: their sum fails where heights do not fit, which a cut into bands would hide.
    columns = [add("Slice", value, "zero", "one", "three") for value in maps.values()]
    columns = [add("Slice", column, "zero", "one", "one") for column in columns]
    height = add("Shape", add("Sum", *columns), start=2, end=3)
    every_row = add("Div", add("Sub", add("Add", height, rows), "one"), rows)
    bands = add("Squeeze", add("Max", every_row, "one"), "zero")
    lasts = {n: add("Sub", value, "one") for n, value in heights.items()}

    # The body: cut every map, run the formula, keep the band. A map of one row is the same in every band.
    inner = Nodes("band_")
    start = inner("Mul", "index", rows)
    stop = inner("Add", start, rows)
    cut = {n: inner("Slice", value, inner("Min", start, lasts[n]), stop, "two") for n, value in maps.items()}
    (shading,), formula_constants = inline(inner, formula, "formula_", cut)
    kept = inner("SequenceInsert", "so_far", shading)
    goes_on = inner("Identity", "go_on")
    pictures = helper.make_sequence_type_proto(helper.make_tensor_type_proto(onnx.TensorProto.FLOAT, None))
    body = helper.make_graph(
        inner.nodes,
        "band",
        [
            helper.make_tensor_value_info("index", onnx.TensorProto.INT64, []),
            helper.make_tensor_value_info("go_on", onnx.TensorProto.BOOL, []),
            helper.make_value_info("so_far", pictures),
        ],
        [
            helper.make_tensor_value_info(goes_on, onnx.TensorProto.BOOL, []),
            helper.make_value_info(kept, pictures),
        ],
    )
    all_bands = add("Loop", bands, "", add("SequenceEmpty"), body=body)
    add.nodes.append(helper.make_node("ConcatFromSequence", [all_bands], ["shading"], axis=2))

    used = {name for node in (*add.nodes, *inner.nodes) for name in node.input}
    initializers = [onnx.numpy_helper.from_array(torch.tensor(v).numpy(), n) for n, v in constants.items() if n in used]
    initializers += formula_constants
    return as_model(helper.make_graph(add.nodes, "shading", _signature(per_pixel), [_picture("shading")], initializers))


def _signature(per_pixel: bool) -> list[Any]:
    """Inputs broadcast, so each axis that may differ has a name of its own: ``light_batch``, ``albedo_height``."""
    return [
        _picture("normal", "3"),
        *(_picture(name, "3", *(() if per_pixel else ("1", "1"))) for name in ("light", "view")),
        _picture("albedo"),
        _picture("roughness", "1"),
    ]


def _picture(name: str, *fixed: str) -> Any:
    """Float (B, C, H, W) with ``fixed`` sizes from C on."""
    from onnx import TensorProto, helper

    axes = [f"{name}_{axis}" for axis in ("batch", "channels", "height", "width")]
    sizes = [axes[0], *(int(size) for size in fixed), *axes[1 + len(fixed) :]]
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, sizes)


def _trace(function: ModelFunction) -> onnx.ModelProto:
    """A reflectance function as element-wise nodes."""
    batch, channels, height, width = (torch.export.Dim(n) for n in ("batch", "channels", "height", "width"))
    area: dict[int, object] = {0: batch, 2: height, 3: width}
    shapes = {name: area | ({1: channels} if name == "albedo" else {}) for name in _MAPS}
    example = tuple(torch.rand(2, 3 if name == "albedo" else 1, 5, 7) for name in _MAPS)
    return write_graph(
        lambda: Formula(function),
        example,
        (_MAPS, ("shading",)),
        shapes,
        ("model", "a reflectance function that torch.onnx can export"),
        "build it from element-wise torch operations without Python branches on values",
    )
