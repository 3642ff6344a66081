"""Build the ONNX graph of shading: a formula traced from torch, and around it what makes a runtime fast.

A runtime writes the result of every node to memory. So the cosines of one direction per image are products of matrices,
one node each, and the formula runs in a loop over bands of image rows whose temporaries fit in cache.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..reflectance.models import ModelFunction, get_model
from ..shading.evaluate import above_horizon, facing_both
from ..shading.functional import oren_nayar
from .nodes import REFLECTANCE_ERROR, Nodes, as_model, inline, trace
from .task import ExportTask

if TYPE_CHECKING:
    import onnx

ROW_BAND_ELEMENTS = 1 << 17
"""Elements of the broadcast output in a band of rows. Set by hand between what is fastest on one thread (fewer) and on
several (more); `scripts/benchmarks/benchmark_onnx.py` times it."""
INPUTS = ("normal", "light", "view", "albedo", "roughness")
"""Names of the graph's inputs, as `oren_nayar` orders them."""
_FORMULA_INPUTS = ("ci", "co", "lv", "albedo", "roughness")
"""Inputs of `Formula`: cosines normal-light, normal-view and light-view, then the parameters."""
_INDICES = {"zero": 0, "one": 1, "two": 2, "three": 3, "four": 4}
"""Axes and bounds of slices, by the name of the initializer."""
_TRIAL_SIZES = ((2, 3, 5, 7), (1, 1, 1, 1), (3, 1, 4, 9), (2, 2, 16, 3), (1, 1, 300, ROW_BAND_ELEMENTS // 200))
"""(B, C, H, W) of the trials; the last one takes two bands of rows."""


class Formula(nn.Module):
    """Shading from cosines."""

    def __init__(self, function: ModelFunction) -> None:
        super().__init__()
        self.function = function

    def forward(self, ci: Tensor, co: Tensor, lv: Tensor, albedo: Tensor, roughness: Tensor) -> Tensor:
        """Shading from the cosines normal-light ``ci``, normal-view ``co`` and light-view ``lv``."""
        value = above_horizon(self.function, ci, co, lv, albedo, roughness)
        return torch.where(facing_both(ci, co), value * ci, 0.0)


def shading_task(model: str, *, per_pixel: bool) -> ExportTask:
    """`oren_nayar` with ``model``; light and view are maps if ``per_pixel``."""
    model = get_model(model).name
    trials = [_random_scene(*size, seed, per_pixel) for seed, size in enumerate(_TRIAL_SIZES)]
    trials += [_constant_parameters(trials[0]), _constant_parameters(trials[-1])]
    metadata = shading_metadata(model) | {"axes": "every axis of size 1 broadcasts"}

    def shade(*inputs: Tensor) -> tuple[Tensor, ...]:
        return (oren_nayar(*inputs, model=model),)

    return ExportTask(shading_graph(model, per_pixel=per_pixel), metadata, INPUTS, trials, shade)


def shading_metadata(model: str) -> dict[str, str]:
    """Meaning and units of a graph that shades with ``model``."""
    return {
        "model": model,
        "source": get_model(model).source,
        "directions": "unit, away from the surface: light to the source, view to the camera",
        "roughness": "standard deviation of the facet slope angle, radians, 0 to pi/2",
        "shading": "pi f_r max(0, n.l), linear light; a white Lambertian pixel facing the light is 1",
    }


def shading_graph(model: str, *, per_pixel: bool) -> onnx.ModelProto:
    """The graph of ``model``; light and view are (B, 3, 1, 1), or maps if ``per_pixel``. Every axis is dynamic."""
    from onnx import helper, numpy_helper

    formula = _trace_formula(get_model(model).function).graph
    add = Nodes("")
    maps = _formula_maps(add, per_pixel)
    row_bands = _cut_into_row_bands(add, maps)
    inner = Nodes("band_")
    body, formula_constants = _row_band_body(inner, formula, maps, row_bands)
    shaded_bands = add("Loop", row_bands.number, "", add("SequenceEmpty"), body=body)
    add.nodes.append(helper.make_node("ConcatFromSequence", [shaded_bands], ["shading"], axis=2))

    used = {name for node in (*add.nodes, *inner.nodes) for name in node.input}
    constants = _INDICES | {"band_size": ROW_BAND_ELEMENTS}
    initializers = [numpy_helper.from_array(torch.tensor([v]).numpy(), n) for n, v in constants.items() if n in used]
    initializers += formula_constants
    return as_model(helper.make_graph(add.nodes, "shading", _signature(per_pixel), [_picture("shading")], initializers))


def _formula_maps(add: Nodes, per_pixel: bool) -> dict[str, str]:
    """Names of the inputs of the formula: cosines appended to the graph, and the parameters as they are."""
    maps = {"albedo": "albedo", "roughness": "roughness", "lv": _cosine(add, "light", "view")}
    for name, direction in (("ci", "light"), ("co", "view")):
        maps[name] = _cosine(add, "normal", direction) if per_pixel else _cosine_of_one_direction(add, direction)
    return maps


def _cosine(add: Nodes, a: str, b: str) -> str:
    """Inner product of two maps of directions, (B, 1, H, W)."""
    return add("ReduceSum", add("Mul", a, b), "one", keepdims=1)


def _cosine_of_one_direction(add: Nodes, direction: str) -> str:
    """Normals times one direction per image: (B, 1, 3) times (B, 3, H W), as (B, 1, H, W)."""
    area = add("Shape", "normal", start=2)
    pixels = add("Mul", add("Slice", area, "zero", "one", "zero"), add("Slice", area, "one", "two", "zero"))
    planes = _reshape(add, "normal", add("Shape", "normal", end=2), pixels)
    row_vector = _reshape(add, direction, add("Shape", direction, end=1), "one", "three")
    product = add("MatMul", row_vector, planes)
    return _reshape(add, product, add("Shape", product, end=2), area)


def _reshape(add: Nodes, value: str, *sizes: str) -> str:
    """Reshape to the sizes, concatenated."""
    # The maximum keeps ONNX Runtime from inferring a size of -1, which fails where another size is 0.
    return add("Reshape", value, add("Max", add("Concat", *sizes, axis=0), "zero"), allowzero=1)


class _RowBands(NamedTuple):
    """Names of values in the graph: rows in a band, number of bands, and the last row of every map."""

    rows: str
    number: str
    last_row: dict[str, str]


def _cut_into_row_bands(add: Nodes, maps: Mapping[str, str]) -> _RowBands:
    """As many rows in a band as make `ROW_BAND_ELEMENTS` elements of the broadcast output, at least one."""
    heights = {n: add("Shape", value, start=2, end=3) for n, value in maps.items()}
    sizes = add("Max", *(add("Shape", value) for value in maps.values()))
    row = add("Mul", add("Slice", sizes, "zero", "one", "zero"), add("Slice", sizes, "three", "four", "zero"))
    rows = add("Max", add("Div", "band_size", add("Max", row, "one")), "one")
    # The sum of one column of each map fails where heights do not broadcast, which slicing into bands would hide.
    columns = [add("Slice", value, "zero", "one", "three") for value in maps.values()]
    columns = [add("Slice", column, "zero", "one", "one") for column in columns]
    height = add("Shape", add("Sum", *columns), start=2, end=3)
    rounded_up = add("Div", add("Sub", add("Add", height, rows), "one"), rows)
    number = add("Squeeze", add("Max", rounded_up, "one"), "zero")
    return _RowBands(rows, number, {n: add("Sub", value, "one") for n, value in heights.items()})


def _row_band_body(
    inner: Nodes, formula: onnx.GraphProto, maps: Mapping[str, str], row_bands: _RowBands
) -> tuple[onnx.GraphProto, list[onnx.TensorProto]]:
    """The body of the loop, which slices one band of every map, shades it and appends it to the sequence of bands.

    Returns the body and the initializers of the formula.
    """
    from onnx import TensorProto, helper

    start = inner("Mul", "index", row_bands.rows)
    stop = inner("Add", start, row_bands.rows)
    # A map of a single row is the same in every band.
    cut = {
        n: inner("Slice", value, inner("Min", start, row_bands.last_row[n]), stop, "two") for n, value in maps.items()
    }
    (shading,), formula_constants = inline(inner, formula, "formula_", cut)
    bands = inner("SequenceInsert", "bands_before", shading)
    condition = inner("Identity", "condition_before")
    sequence = helper.make_sequence_type_proto(helper.make_tensor_type_proto(TensorProto.FLOAT, None))
    inputs = [
        helper.make_tensor_value_info("index", TensorProto.INT64, []),
        helper.make_tensor_value_info("condition_before", TensorProto.BOOL, []),
        helper.make_value_info("bands_before", sequence),
    ]
    outputs = [
        helper.make_tensor_value_info(condition, TensorProto.BOOL, []),
        helper.make_value_info(bands, sequence),
    ]
    return helper.make_graph(inner.nodes, "band", inputs, outputs), formula_constants


def _signature(per_pixel: bool) -> list[onnx.ValueInfoProto]:
    """Inputs broadcast, so each axis that may differ has a name of its own: ``light_batch``, ``albedo_height``."""
    return [
        _picture("normal", "3"),
        *(_picture(name, "3", *(() if per_pixel else ("1", "1"))) for name in ("light", "view")),
        _picture("albedo"),
        _picture("roughness", "1"),
    ]


def _picture(name: str, *fixed: str) -> onnx.ValueInfoProto:
    """Float (B, C, H, W) with ``fixed`` sizes from C on."""
    from onnx import TensorProto, helper

    axes = [f"{name}_{axis}" for axis in ("batch", "channels", "height", "width")]
    sizes = [axes[0], *(int(size) for size in fixed), *axes[1 + len(fixed) :]]
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, sizes)


def _trace_formula(function: ModelFunction) -> onnx.ModelProto:
    """A reflectance function as element-wise nodes."""
    batch, channels, height, width = (torch.export.Dim(n) for n in ("batch", "channels", "height", "width"))
    area: dict[int, Any] = {0: batch, 2: height, 3: width}
    shapes = {name: area | ({1: channels} if name == "albedo" else {}) for name in _FORMULA_INPUTS}
    example = tuple(torch.rand(2, 3 if name == "albedo" else 1, 5, 7) for name in _FORMULA_INPUTS)
    return trace(lambda: Formula(function), example, _FORMULA_INPUTS, ("shading",), shapes, REFLECTANCE_ERROR)


def _random_scene(batch: int, channels: int, height: int, width: int, seed: int, per_pixel: bool) -> tuple[Tensor, ...]:
    """Random inputs in the order of `INPUTS`; some pixels face away from light or view."""
    generator = torch.Generator().manual_seed(seed)
    area = (height, width) if per_pixel else (1, 1)

    def directions(*size: int) -> Tensor:
        return F.normalize(torch.randn(batch, 3, *size, generator=generator), dim=1)

    return (
        directions(height, width),
        directions(*area),
        directions(*area),
        torch.rand(batch, channels, height, width, generator=generator),
        torch.rand(batch, 1, height, width, generator=generator) * (math.pi / 2),
    )


def _constant_parameters(scene: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    """The normals of a scene under one light, view, albedo and roughness for the whole batch."""
    return scene[0], *(t[:1, :, :1, :1].contiguous() for t in scene[1:])
