"""Write ONNX graphs and prove that they compute what torch computes."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
import torch.nn.functional as F
from torch import Tensor

from ._version import __version__
from .errors import ExportError
from .files import atomic_path
from .reflectance import get_model
from .shading import oren_nayar
from .shading_graph import BAND, INPUTS, shading_graph

if TYPE_CHECKING:
    import onnx

TOLERANCE = 1e-5
"""Largest difference from torch that a written graph may show, for values up to about 1."""


def export_onnx(
    what: str, path: str | os.PathLike[str], *, model: str = "qualitative", per_pixel_directions: bool = False
) -> Path:
    """Write a graph as an ONNX file and verify it against torch in ONNX Runtime before returning.

    ``"shading"`` takes ``normal`` (B, 3, H, W), ``light`` and ``view`` (B, 3, 1, 1), or (B, 3, H, W) with
    ``per_pixel_directions``, ``albedo`` (B, C, H, W) and ``roughness`` (B, 1, H, W) and returns
    ``shading`` (B, C, H, W). B >= 1, C, H, W are dynamic, and each input may have 1 where it is constant. All
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
    name = get_model(model).name
    # The last one takes two bands of rows.
    sizes = ((2, 3, 5, 7), (1, 1, 1, 1), (3, 1, 4, 9), (2, 2, 16, 3), (1, 1, 300, BAND // 200))
    trials = [_shading_inputs(*size, seed, per_pixel_directions) for seed, size in enumerate(sizes)]
    trials += [_broadcast(trials[0]), _broadcast(trials[-1])]
    graph = shading_graph(name, per_pixel=per_pixel_directions)
    _describe(graph, name)
    target = Path(path)
    with atomic_path(target) as temporary:
        import onnx

        onnx.save(graph, temporary)
        _verify(temporary, name, trials)
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

    operators = list(_operators(graph.graph))
    return {
        "bytes": file.stat().st_size,
        "opset": graph.opset_import[0].version,
        "inputs": shapes(graph.graph.input),
        "outputs": shapes(graph.graph.output),
        "operators": {name: operators.count(name) for name in sorted(set(operators))},
        "metadata": {entry.key: entry.value for entry in graph.metadata_props},
    }


def _operators(graph: onnx.GraphProto) -> Iterator[str]:
    """The operator of every node, inside loops too."""
    for node in graph.node:
        yield node.op_type
        for attribute in node.attribute:
            if attribute.HasField("g"):
                yield from _operators(attribute.g)


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
            "axes": "every axis of size 1 broadcasts",
        },
    )
    graph.producer_name = "torch_orennayar"
    graph.producer_version = __version__


def _verify(file: Path, model: str, trials: list[tuple[Tensor, ...]]) -> None:
    """ONNX Runtime's answers against torch's at several sizes."""
    import onnx
    import onnxruntime

    try:
        onnx.checker.check_model(str(file), full_check=True)
        session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
        for trial in trials:
            feeds = {name: value.numpy() for name, value in zip(INPUTS, trial, strict=True)}
            (answer,) = session.run(None, feeds)
            wanted = oren_nayar(*(t.double() for t in trial), model=model)
            shape = tuple(wanted.shape)
            # What float32 itself costs a formula shows in torch: a runtime may round as far in other places.
            rounding = (oren_nayar(*trial, model=model) - wanted).abs().max().item()
            allowed = TOLERANCE * (1 + wanted.abs()) + 4 * rounding
            difference = (torch.from_numpy(answer) - wanted).abs() if answer.shape == shape else allowed + math.inf
            if not bool((difference <= allowed).all()):
                raise ExportError(
                    "graph",
                    expected=f"torch's values within {TOLERANCE:g} and rounding at size {shape}",
                    got=f"shape {answer.shape}, difference {difference.max().item():g}",
                    mend="if the model is your own, look for steps that lose float32's digits; otherwise report it",
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
