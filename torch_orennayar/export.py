"""Write ONNX graphs and prove that they compute what torch computes."""

from __future__ import annotations

import io
import json
import logging
import math
import os
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ._version import __version__
from .errors import ExportError
from .files import atomic_path
from .reflectance import get_model
from .shading import oren_nayar

if TYPE_CHECKING:
    import onnx

OPSET = 18
TOLERANCE = 1e-5
"""Largest difference from torch that a written graph may show, for values up to about 1."""
_INPUTS = ("normal", "light", "view", "albedo", "roughness")


def export_onnx(
    what: str, path: str | os.PathLike[str], *, model: str = "qualitative", per_pixel_directions: bool = False
) -> Path:
    """Write a graph as an ONNX file and verify it against torch in ONNX Runtime before returning.

    ``"shading"`` takes ``normal`` (B, 3, H, W), ``light`` and ``view`` (B, 3, 1, 1), or (B, 3, H, W) with
    ``per_pixel_directions``, ``albedo`` (B, C, H, W) and ``roughness`` (B, 1, H, W) and returns
    ``shading`` (B, C, H, W). B, C, H, W are dynamic, and each input may have 1 where it is constant. All
    float32, linear light, roughness in radians; opset 18. Meaning and units are in the file's metadata.

    Args:
        what: ``"shading"``.
        path: the file; it appears whole and verified, or not at all.
        model: a name in ``MODELS``, registered ones too.
        per_pixel_directions: light and view as maps.

    Returns:
        ``path``.

    Raises:
        ExportError: unknown ``what``, a model that does not export, or a graph that differs from torch by
            more than 1e-5.
        ModelError: unknown model.

    Example:
        >>> import tempfile, pathlib, torch_orennayar as ton
        >>> path = ton.export_onnx("shading", pathlib.Path(tempfile.mkdtemp()) / "lambert.onnx", model="lambert")
        >>> path.stat().st_size > 0
        True
    """
    if what != "shading":
        raise ExportError("what", expected="'shading'", got=repr(what), mend="no other graph can be exported yet")
    layer = _Shading(get_model(model).name)
    sizes = ((2, 3, 5, 7), (1, 1, 1, 1), (3, 1, 4, 9), (2, 2, 16, 3))
    trials = [_shading_inputs(*size, seed, per_pixel_directions) for seed, size in enumerate(sizes)]
    trials.append(_broadcast(trials[0]))
    graph = _trace(layer, trials[0], per_pixel_directions)
    _describe(graph, model)
    target = Path(path)
    with atomic_path(target) as temporary:
        import onnx

        onnx.save(graph, temporary)
        _verify(temporary, layer, trials)
    return target


def describe_onnx(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Inputs, outputs, opset, operators, size and metadata of an ONNX file.

    Raises:
        ExportError: the file is missing or no ONNX graph.
    """
    import onnx

    file = Path(path)
    try:
        graph = onnx.load(file)
        onnx.checker.check_model(graph)
    except Exception as error:  # protobuf, checker and file errors share no base
        raise ExportError(
            str(file), expected="an ONNX file", got=f"{type(error).__name__}: {error}", mend="export it again"
        ) from error

    def shapes(values: Any) -> dict[str, list[str]]:
        return {v.name: [d.dim_param or str(d.dim_value) for d in v.type.tensor_type.shape.dim] for v in values}

    operators = [node.op_type for node in graph.graph.node]
    return {
        "bytes": file.stat().st_size,
        "opset": graph.opset_import[0].version,
        "inputs": shapes(graph.graph.input),
        "outputs": shapes(graph.graph.output),
        "operators": {name: operators.count(name) for name in sorted(set(operators))},
        "metadata": {entry.key: entry.value for entry in graph.metadata_props},
    }


class _Shading(nn.Module):
    def __init__(self, model: str) -> None:
        super().__init__()
        self.model = model

    def forward(self, normal: Tensor, light: Tensor, view: Tensor, albedo: Tensor, roughness: Tensor) -> Tensor:
        return oren_nayar(normal, light, view, albedo, roughness, model=self.model)


def _shading_inputs(
    batch: int, channels: int, height: int, width: int, seed: int, per_pixel: bool
) -> tuple[Tensor, ...]:
    """Random scenes in which some pixels face away."""
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


def _broadcast(inputs: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    """One light, view, albedo and roughness for a whole batch of normals."""
    return inputs[0], *(t[:1, :, :1, :1].contiguous() for t in inputs[1:])


def _trace(layer: nn.Module, example: tuple[Tensor, ...], per_pixel: bool) -> onnx.ModelProto:
    """Trace with common axes, then give every axis that may differ a name of its own."""
    axes = torch.export.Dim
    batch, channels, height, width = (axes(n) for n in ("batch", "channels", "height", "width"))
    area = {2: height, 3: width}
    direction = {0: batch} | (area if per_pixel else {})
    dynamic = {
        "normal": {0: batch} | area,
        "light": direction,
        "view": direction,
        "albedo": {0: batch, 1: channels} | area,
        "roughness": {0: batch} | area,
    }
    try:
        with quiet():
            program = torch.onnx.export(
                layer,
                example,
                input_names=list(_INPUTS),
                output_names=["shading"],
                dynamic_shapes=dynamic,
                opset_version=OPSET,
                dynamo=True,
                verbose=False,
            )
            assert program is not None
            graph = program.model_proto
    except Exception as error:  # the exporter raises many kinds
        raise ExportError(
            "model",
            expected="a reflectance function that torch.onnx can export",
            got=f"{type(error).__name__}: {re.sub(chr(27) + '[^m]*m', '', str(error)).partition(chr(10))[0]}",
            mend="build it from element-wise torch operations without Python branches on values",
        ) from error
    _name_axes(graph)
    return graph


@contextmanager
def quiet() -> Iterator[None]:
    """The exporter prints and logs its steps; a library call should not."""
    loggers = [logging.getLogger(name) for name in ("torch.onnx", "onnxscript", "onnx_ir")]
    levels = [logger.level for logger in loggers]
    try:
        for logger in loggers:
            logger.setLevel(logging.ERROR)
        with warnings.catch_warnings(), redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def _name_axes(graph: onnx.ModelProto) -> None:
    """Inputs broadcast, so their axes may differ: ``light_batch``, ``albedo_height``; drop the exporter's notes."""
    for value in (*graph.graph.input, *graph.graph.output):
        for axis in value.type.tensor_type.shape.dim:
            if axis.dim_param:
                axis.dim_param = f"{value.name}_{axis.dim_param}"
    del graph.graph.value_info[:]
    for node in graph.graph.node:  # traces of the exporting machine: paths and code
        del node.metadata_props[:]
        node.doc_string = ""
    del graph.graph.metadata_props[:]


def _describe(graph: onnx.ModelProto, model: str) -> None:
    """Write meaning and units into the file."""
    import onnx

    onnx.helper.set_model_props(
        graph,
        {
            "torch_orennayar": __version__,
            "graph": "shading",
            "model": model,
            "source": get_model(model).source,
            "frame": "camera: x right, y up, z toward the viewer; row 0 is the top",
            "directions": "unit, away from the surface: light to the source, view to the camera",
            "roughness": "standard deviation of the facet slope angle, radians, 0 to pi/2",
            "shading": "pi f_r max(0, n.l), linear light; a white Lambertian pixel facing the light is 1",
            "axes": json.dumps("every axis of size 1 broadcasts"),
        },
    )
    graph.producer_name = "torch_orennayar"
    graph.producer_version = __version__


def _verify(file: Path, layer: nn.Module, trials: list[tuple[Tensor, ...]]) -> None:
    """ONNX Runtime's answers against torch's at several sizes."""
    import onnx
    import onnxruntime

    try:
        onnx.checker.check_model(str(file), full_check=True)
        session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
        for trial in trials:
            feeds = {name: value.numpy() for name, value in zip(_INPUTS, trial, strict=True)}
            (answer,) = session.run(None, feeds)
            with torch.no_grad():
                wanted = layer(*trial)
            shape = tuple(wanted.shape)
            difference = (torch.from_numpy(answer) - wanted).abs().max().item() if answer.shape == shape else math.inf
            if not difference <= TOLERANCE:
                raise ExportError(
                    "graph",
                    expected=f"torch's values within {TOLERANCE:g} at size {shape}",
                    got=f"shape {answer.shape}, difference {difference:g}",
                    mend="report this with the versions that `orennayar info` prints",
                )
    except ExportError:
        raise
    except Exception as error:  # checker and runtime errors share no base
        raise ExportError(
            "graph",
            expected="a graph that ONNX Runtime runs",
            got=f"{type(error).__name__}: {error}",
            mend="report this with the versions that `orennayar info` prints",
        ) from error
