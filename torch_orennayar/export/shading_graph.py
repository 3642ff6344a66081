"""Build the ONNX graph of shading: a formula traced from torch, and around it what makes a runtime fast.

Directions are scaled to unit length and roughness is clamped in the graph, because nobody checks its inputs.

A runtime writes the result of every node to memory. So the cosines of one direction per image are products of matrices,
one node each, and the formula runs in a loop over bands of image rows whose temporaries fit in cache.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.checks import UNIT_TOLERANCE
from ..reflectance.models import get_model
from ..shading.functional import oren_nayar
from .formula import Shading, trace_formula
from .nodes import Nodes, as_model, inline
from .task import ExportTask

if TYPE_CHECKING:
    import onnx

ROW_BAND_ELEMENTS = 1 << 17
"""Elements of the broadcast output in a band of rows. Set by hand between what is fastest on one thread (fewer) and on
several (more); `scripts/benchmarks/benchmark_onnx.py` times it."""
INPUTS = ("normal", "light", "view", "albedo", "roughness")
"""Names of the graph's inputs, as `oren_nayar` orders them."""
LIMITS = {"smooth": 0.0, "roughest": math.pi / 2, "tiny": 1e-12, "unit": 1.0, "unit_tolerance": 2 * UNIT_TOLERANCE}
"""Ends of the range of roughness, radians; the least length to divide by; of a unit vector the squared length and by
how much that may differ; by the name of the initializer."""
_INDICES = {"zero": 0, "one": 1, "two": 2, "three": 3, "four": 4}
"""Axes and bounds of slices, by the name of the initializer."""
TRIAL_SIZES = ((2, 3, 5, 7), (1, 1, 1, 1), (3, 1, 4, 9), (2, 2, 16, 3), (1, 1, 300, ROW_BAND_ELEMENTS // 200))
"""(B, C, H, W) of the trials; the last one takes two bands of rows."""


def shading_task(model: str, *, per_pixel: bool, checked: bool) -> ExportTask:
    """`oren_nayar` with ``model``; light and view are maps if ``per_pixel``, ``valid`` is returned if ``checked``."""
    model = get_model(model).name
    trials = [random_scene(*size, seed, per_pixel) for seed, size in enumerate(TRIAL_SIZES)]
    trials += [constant_parameters(trials[0]), constant_parameters(trials[-1]), out_of_range(trials[0])]
    metadata = shading_metadata(model) | {"axes": "every axis of size 1 broadcasts"}
    if checked:
        metadata["valid"] = "true where directions are unit, albedo is not negative and roughness is in its range; "
        metadata["valid"] += "false where there is no surface"

    def shade(*inputs: Tensor) -> tuple[Tensor, ...]:
        return (shade_anything(*inputs, model=model), *([in_range(*inputs)] if checked else []))

    return ExportTask(shading_graph(model, per_pixel=per_pixel, checked=checked), metadata, INPUTS, trials, shade)


def shade_anything(
    normal: Tensor, light: Tensor, view: Tensor, albedo: Tensor, roughness: Tensor, *, model: str
) -> Tensor:
    """`oren_nayar` of directions scaled to unit length and of the nearest roughness in its range."""
    normal, light, view = (F.normalize(d, dim=1, eps=LIMITS["tiny"]) for d in (normal, light, view))
    return oren_nayar(normal, light, view, albedo, roughness.clamp(0.0, LIMITS["roughest"]), model=model)


def in_range(normal: Tensor, light: Tensor, view: Tensor, albedo: Tensor, roughness: Tensor) -> Tensor:
    """Where the inputs are what `oren_nayar` takes, (B, 1, H, W) bool."""
    unit = [((d * d).sum(1, keepdim=True) - 1).abs() <= LIMITS["unit_tolerance"] for d in (normal, light, view)]
    rough = (roughness >= 0) & (roughness <= LIMITS["roughest"])
    return unit[0] & unit[1] & unit[2] & rough & (albedo.amin(1, keepdim=True) >= 0)


def shading_metadata(model: str) -> dict[str, str]:
    """Meaning and units of a graph that shades with ``model``."""
    return {
        "model": model,
        "source": get_model(model).source,
        "normal": "camera frame, unit; scaled to unit length here, 0 where there is no surface",
        "light": "unit, from the surface to the light; scaled to unit length here",
        "view": "unit, from the surface to the camera; scaled to unit length here",
        "albedo": "not negative; up to 1 for what reflects no more than it gets",
        "roughness": "standard deviation of the facet slope angle, radians, 0 to pi/2; clamped to that here",
        "broken": "albedo or roughness that is no number gives no number",
        "shading": "pi f_r max(0, n.l), linear light; a white Lambertian pixel facing the light is 1",
    }


def shading_graph(model: str, *, per_pixel: bool, checked: bool = False) -> onnx.ModelProto:
    """The graph of ``model``; light and view are (B, 3, 1, 1), or maps if ``per_pixel``. Every axis is dynamic."""
    from onnx import helper, numpy_helper

    formula = trace_formula(Shading(get_model(model).function)).graph
    add = Nodes("")
    maps = _formula_maps(add, per_pixel)
    row_bands = _cut_into_row_bands(add, maps)
    inner = Nodes("band_")
    body, formula_constants = _row_band_body(inner, formula, maps, row_bands)
    shaded_bands = add("Loop", row_bands.number, "", add("SequenceEmpty"), body=body)
    add.nodes.append(helper.make_node("ConcatFromSequence", [shaded_bands], ["shading"], axis=2))
    inputs, shading = signature(per_pixel)
    outputs = [shading]
    if checked:
        add.nodes.append(helper.make_node("Identity", [_valid(add)], ["valid"], name="output_valid"))
        outputs.append(_picture("valid", "B1HW", {}, boolean=True))

    used = {name for node in (*add.nodes, *inner.nodes) for name in node.input}
    constants = {n: torch.tensor([v]) for n, v in (_INDICES | {"band_size": ROW_BAND_ELEMENTS}).items()}
    constants |= {n: torch.tensor(v) for n, v in LIMITS.items()}
    initializers = [numpy_helper.from_array(v.numpy(), n) for n, v in constants.items() if n in used]
    initializers += formula_constants
    return as_model(helper.make_graph(add.nodes, "shading", inputs, outputs, initializers))


def _formula_maps(add: Nodes, per_pixel: bool) -> dict[str, str]:
    """Names of the inputs of the formula: cosines appended to the graph, and the parameters, roughness in its range."""
    light, view = (add("Div", direction, _length(add, direction)) for direction in ("light", "view"))
    long = _length(add, "normal")
    maps = {"albedo": "albedo", "roughness": add("Clip", "roughness", "smooth", "roughest")}
    for name, direction in (("ci", light), ("co", view)):
        value = cosine(add, "normal", direction) if per_pixel else _cosine_of_one_direction(add, direction)
        maps[name] = add("Div", value, long)
    return maps | {"lv": cosine(add, light, view)}


def _length(add: Nodes, direction: str) -> str:
    """Length of a map of directions, (B, 1, H, W), at least `LIMITS` ``tiny``."""
    return add("Max", add("ReduceL2", direction, "one", keepdims=1), "tiny")


def _valid(add: Nodes) -> str:
    """What `in_range` computes."""
    valid = add("And", add("GreaterOrEqual", "roughness", "smooth"), add("LessOrEqual", "roughness", "roughest"))
    least = add("ReduceMin", "albedo", "one", keepdims=1)
    valid = add("And", valid, add("GreaterOrEqual", least, "smooth"))
    for direction in ("normal", "light", "view"):
        excess = add("Abs", add("Sub", cosine(add, direction, direction), "unit"))
        valid = add("And", valid, add("LessOrEqual", excess, "unit_tolerance"))
    return valid


def cosine(add: Nodes, a: str, b: str) -> str:
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


def signature(
    per_pixel: bool, size: tuple[int, int] | None = None
) -> tuple[list[onnx.ValueInfoProto], onnx.ValueInfoProto]:
    """Inputs and the output ``shading``; for a ``size`` of one picture of three channels with one light.

    Inputs broadcast, so each axis that may differ has a name of its own: ``light_batch``, ``albedo_height``.
    """
    sizes = {"normal": "3HW", "light": "311", "view": "311", "albedo": "CHW", "roughness": "1HW", "shading": "CHW"}
    if per_pixel:
        sizes |= {"light": "3HW", "view": "3HW"}
    known = {} if size is None else {"B": 1, "C": 3, "H": size[0], "W": size[1]}
    *inputs, output = (_picture(name, f"B{letters}", known) for name, letters in sizes.items())
    return inputs, output


def _picture(name: str, letters: str, known: Mapping[str, int], *, boolean: bool = False) -> onnx.ValueInfoProto:
    """A map of float32, or of bool, an axis for every letter of BCHW or digit; letters are dynamic unless ``known``."""
    from onnx import TensorProto, helper

    names = {"B": f"{name}_batch", "C": f"{name}_channels", "H": f"{name}_height", "W": f"{name}_width"}
    sizes = [known.get(letter, names[letter]) if letter in names else int(letter) for letter in letters]
    return helper.make_tensor_value_info(name, TensorProto.BOOL if boolean else TensorProto.FLOAT, sizes)


def random_scene(batch: int, channels: int, height: int, width: int, seed: int, per_pixel: bool) -> tuple[Tensor, ...]:
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


def constant_parameters(scene: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    """The normals of a scene under one light, view, albedo and roughness for the whole batch."""
    return scene[0], *(t[:1, :, :1, :1].contiguous() for t in scene[1:])


def out_of_range(scene: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    """A scene with directions of other lengths, some zero, and roughness in degrees, some negative."""
    normal, light, view, albedo, roughness = scene
    scale = torch.linspace(0, 3, roughness.numel()).reshape(roughness.shape)
    return normal * scale, light * 2.5, view * 0.1, albedo, roughness.rad2deg() - 20
