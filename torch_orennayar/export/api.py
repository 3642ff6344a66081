"""Write ONNX graphs and prove that they compute what torch computes."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .._version import __version__
from ..core.errors import ExportError
from ..core.files import atomic_path
from ..core.optional import require
from ..geometry.camera import Camera
from ..reflectance.models import get_model
from ..render.normal_map import check_size
from ..shading.layer import oren_nayar
from ..stereo.closed_form import CANDIDATES, solve_closed_form
from ..stereo.network_solver import NETWORK, TRAINED_LIGHTS, solve_network
from ..stereo.set_network import load_network
from .module_graph import hold, module_graph, other_sizes, to_half
from .network_graph import network_graph
from .pixel_graph import STEREO_INPUTS
from .renderer_graph import Renderer, renderer_graph, renderer_inputs, renderer_trials
from .shading_graph import BAND, INPUTS, shading_graph
from .stereo_graph import stereo_graph, stereo_trials

if TYPE_CHECKING:
    import onnx

TOLERANCE = 1e-5
"""Largest difference from torch that a written graph may show, for values up to about 1."""
STEPS = {torch.float32: 0.0, torch.float16: 2.0**-11}
"""What rounding the answer to a format costs, as a share of it."""


def export_onnx(
    what: str | nn.Module,
    path: str | os.PathLike[str],
    *,
    model: str = "qualitative",
    per_pixel_directions: bool = False,
    camera: Camera | None = None,
    size: tuple[int, int] | None = None,
    example_inputs: tuple[Tensor, ...] | None = None,
    input_names: Sequence[str] | None = None,
    output_names: Sequence[str] | None = None,
    dtype: torch.dtype = torch.float32,
) -> Path:
    """Write a graph as an ONNX file and verify it against torch in ONNX Runtime before returning.

    ``"shading"`` takes ``normal`` (B, 3, H, W), ``light`` and ``view`` (B, 3, 1, 1), or (B, 3, H, W) with
    ``per_pixel_directions``, ``albedo`` (B, C, H, W) and ``roughness`` (B, 1, H, W) and returns
    ``shading`` (B, C, H, W). B >= 1, C, H, W are dynamic, and each input may have 1 where it is constant.

    ``"renderer"`` takes ``vertices`` (V, 3) and ``faces`` (F, 3) int64 and returns ``normal`` (1, 3, H, W), ``mask``
    (1, 1, H, W) bool, ``depth`` (1, 1, H, W) and ``face`` (1, 1, H, W) int64 of `render_normals`, the same faces to the
    last pixel; V and F >= 1 are dynamic, the camera and H, W are in the file. Faces must name vertices that exist and
    vertices must be finite: a graph cannot check. Tracing takes about half a minute.

    ``"shaded_mesh"`` also takes ``light`` (K, 3) in the camera frame, ``albedo`` (C,) and ``roughness`` (1,) and
    returns ``shading`` (K, C, H, W) before those; K and C are dynamic.

    ``"stereo"`` takes ``images`` (K, C, H, W) of linear light, ``lights`` (K, 3), unit, and ``mask`` (1, H, W) bool and
    returns ``normal`` (3, H, W), ``albedo`` (C, H, W) and ``roughness`` (1, H, W), 0 outside the mask; all axes are
    dynamic. It is robust least squares in closed form with one roughness for the object (`stereo_graph`), less exact
    than `photometric_stereo`. K >= 3, and the mask must hold a pixel. With ``model="network"`` the normals are those of
    the network that ships, K >= 12 for what it was trained on, and ``error`` (1, H, W), radians, is returned too; light
    between parts of the surface, which `photometric_stereo` takes away first, stays.

    A module of your own, with `OrenNayar` in it or without, takes ``example_inputs``; every axis that it allows to
    differ is dynamic, but for those of size 1 in the example. It is exported in evaluation mode.

    Linear light, roughness in radians; opset 18. Meaning and units are in the file's metadata.

    Args:
        what: ``"shading"``, ``"renderer"``, ``"shaded_mesh"``, ``"stereo"`` or a module.
        path: the file; it appears whole and verified, or not at all.
        model: a name in ``MODELS``, registered ones too, or ``"network"`` (``"stereo"``); neither ``"renderer"`` nor a
            module uses one.
        per_pixel_directions: light and view as maps (``"shading"``).
        camera: one camera (``"renderer"``, ``"shaded_mesh"``).
        size: (H, W) of the pictures (the same).
        example_inputs: positional inputs of a module.
        input_names: of a module; default ``input_0``, ``input_1`` ...
        output_names: of a module; default ``output_0`` ...
        dtype: of floating inputs and outputs, float32 or float16; the graph computes in float32.

    Returns:
        ``path``.

    Raises:
        ExportError: unknown ``what`` or ``dtype``, no camera, size or example where one is needed, a model or module
            that does not export, or a graph that differs from torch: in a face at all, in other values by more than
            1e-5 and rounding.
        ModelError: unknown model.

    Example:
        >>> import tempfile, pathlib, torch_orennayar as ton
        >>> path = ton.export_onnx("shading", pathlib.Path(tempfile.mkdtemp()) / "lambert.onnx", model="lambert")
        >>> path.stat().st_size > 0
        True
    """
    require("onnx", "onnxscript", "onnxruntime")
    if dtype not in (torch.float32, torch.float16):
        raise ExportError("dtype", expected="float32 or float16", got=str(dtype), mend="choose one")
    if isinstance(what, nn.Module):
        task = _module_task(what, example_inputs, input_names, output_names)
    elif what == "shading":
        task = _shading_task(get_model(model).name, per_pixel_directions)
    elif what == "stereo":
        task = _network_task() if model == NETWORK else _stereo_task(get_model(model).name)
    elif what in ("renderer", "shaded_mesh"):
        if camera is None or size is None or len(camera.eye) != 1:
            got = "none" if camera is None or size is None else f"{len(camera.eye)} cameras"
            raise ExportError("camera, size", expected="one camera and (H, W)", got=got, mend="give camera= and size=")
        check_size(size)
        camera.rays(size)  # raises where they do not fit
        task = _renderer_task(Renderer(camera, size, get_model(model).name if what == "shaded_mesh" else None))
    else:
        expected = "'shading', 'renderer', 'shaded_mesh', 'stereo' or a module"
        raise ExportError("what", expected=expected, got=repr(what), mend="choose one")
    if dtype == torch.float16:
        to_half(task.graph)
        task = task._replace(trials=[tuple(_in(dtype, t) for t in trial) for trial in task.trials])
    name = what if isinstance(what, str) else type(what).__name__
    _describe(task.graph, {"graph": name, "precision": str(dtype).removeprefix("torch.")} | task.meaning)
    target = Path(path)
    with atomic_path(target) as temporary:
        import onnx

        onnx.save(task.graph, temporary)
        _verify(temporary, task, dtype)
    return target


def _in(dtype: torch.dtype, value: Tensor) -> Tensor:
    return value.to(dtype) if value.is_floating_point() else value


class _Task(NamedTuple):
    """A graph, what it means, and what it must compute: float32 ``function`` of ``trials``, exact in integers."""

    graph: onnx.ModelProto
    meaning: dict[str, str]
    inputs: Sequence[str]
    trials: list[tuple[Tensor, ...]]
    function: Callable[..., tuple[Tensor, ...]]


def _shading_task(name: str, per_pixel: bool) -> _Task:
    # The last one takes two bands of rows.
    sizes = ((2, 3, 5, 7), (1, 1, 1, 1), (3, 1, 4, 9), (2, 2, 16, 3), (1, 1, 300, BAND // 200))
    trials = [_shading_inputs(*size, seed, per_pixel) for seed, size in enumerate(sizes)]
    trials += [_broadcast(trials[0]), _broadcast(trials[-1])]
    meaning = _shading_meaning(name) | {"axes": "every axis of size 1 broadcasts"}
    graph = shading_graph(name, per_pixel=per_pixel)
    return _Task(graph, meaning, INPUTS, trials, lambda *inputs: (oren_nayar(*inputs, model=name),))


def _renderer_task(renderer: Renderer) -> _Task:
    camera, (height, width) = renderer.camera, renderer.size
    kind = "perspective" if camera.is_perspective else "orthographic"
    meaning = {
        "camera": f"{kind}, eye {camera.eye[0].tolist()}, rotation {camera.rotation[0].tolist()}, "
        f"focal {camera.focal[0].tolist()} and centre {camera.centre[0].tolist()} in half image heights",
        "size": f"{height} x {width}",
        "depth": "distance along the viewing axis, infinite where nothing is seen",
        "face": "index of the visible face, -1 for none",
    }
    if renderer.model is not None:
        meaning |= _shading_meaning(renderer.model)
    inputs = renderer_inputs(renderer.model)
    return _Task(renderer_graph(renderer), meaning, inputs, renderer_trials(renderer), renderer)


_CAPTURE = {
    "images": "linear light, each divided by the intensity of its light",
    "lights": "unit, away from the surface, toward the source",
    "mask": "true where there is an object; at least one pixel",
    "albedo": "in the unit of the images; 1 is a white surface under a light of irradiance pi",
}


def _network_task() -> _Task:
    meaning = _CAPTURE | {
        "model": NETWORK,
        "roughness": "always 0: the network tells none",
        "error": "what the network expects its normal to err by, radians",
        "method": "a set network trained on made-up pixels, 12 to 100 lights; albedo is Lambert's; light between parts "
        "of the surface is not taken away",
    }

    def solve(images: Tensor, lights: Tensor, mask: Tensor) -> tuple[Tensor, ...]:
        found = solve_network(images, lights, mask[0], load_network().to(images.dtype))
        return found["normal"], found["albedo"], found["roughness"], found["error"]

    return _Task(network_graph(), meaning, STEREO_INPUTS, stereo_trials(TRAINED_LIGHTS), solve)


def _stereo_task(name: str) -> _Task:
    tried = ", ".join(f"{math.degrees(c):g}" for c in CANDIDATES)
    meaning = _CAPTURE | {
        "model": name,
        "source": get_model(name).source,
        "roughness": "one for the object: standard deviation of the facet slope angle, radians; "
        + ("always 0" if name == "lambert" else f"found between {tried} degrees"),
        "method": "trimmed, then reweighted (Geman-McClure) least squares, 10 closed-form solutions",
    }

    def solve(images: Tensor, lights: Tensor, mask: Tensor) -> tuple[Tensor, ...]:
        return solve_closed_form(images, lights, mask, name)

    return _Task(stereo_graph(name), meaning, STEREO_INPUTS, stereo_trials(), solve)


def _module_task(
    module: nn.Module,
    example: tuple[Tensor, ...] | None,
    input_names: Sequence[str] | None,
    output_names: Sequence[str] | None,
) -> _Task:
    if not example or not all(isinstance(t, Tensor) for t in example):
        got = "none" if not example else "values that are no tensors"
        raise ExportError("example_inputs", expected="a tuple of tensors", got=got, mend="give what forward takes")
    held = hold(module, example)
    inputs = list(input_names) if input_names is not None else [f"input_{k}" for k in range(len(example))]
    graph = module_graph(held, example, inputs, output_names)
    return _Task(graph, {}, inputs, [example, *other_sizes(graph, held, example)], held)


def describe_onnx(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Inputs, outputs, opset, operators, size and metadata of an ONNX file.

    Raises:
        ExportError: the file is missing or no ONNX graph.
    """
    require("onnx")
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


def _shading_meaning(model: str) -> dict[str, str]:
    return {
        "model": model,
        "source": get_model(model).source,
        "directions": "unit, away from the surface: light to the source, view to the camera",
        "roughness": "standard deviation of the facet slope angle, radians, 0 to pi/2",
        "shading": "pi f_r max(0, n.l), linear light; a white Lambertian pixel facing the light is 1",
    }


def _describe(graph: onnx.ModelProto, meaning: dict[str, str]) -> None:
    """Write meaning and units into the file."""
    import onnx

    frame = "camera: x right, y up, z toward the viewer; row 0 is the top"
    onnx.helper.set_model_props(graph, {"torch_orennayar": __version__, "frame": frame} | meaning)
    graph.producer_name = "torch_orennayar"
    graph.producer_version = __version__


def _verify(file: Path, task: _Task, dtype: torch.dtype) -> None:
    """ONNX Runtime's answers against torch's on every trial, twice."""
    import onnx
    import onnxruntime

    try:
        onnx.checker.check_model(str(file), full_check=True)
        session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
        for trial in task.trials:
            feeds = {name: value.numpy() for name, value in zip(task.inputs, trial, strict=True)}
            answers, again = session.run(None, feeds), session.run(None, feeds)
            wanted = task.function(*(_in(torch.float32, t) for t in trial))
            exact = task.function(*(_in(torch.float64, t) for t in trial))
            for name, *values in zip(
                (o.name for o in session.get_outputs()), answers, again, wanted, exact, strict=True
            ):
                _compare(name, *(torch.as_tensor(v) for v in values), step=STEPS[dtype])
    except ExportError:
        raise
    except Exception as error:  # checker and runtime errors share no base
        raise ExportError(
            "graph",
            expected="a graph that ONNX Runtime runs",
            got=f"{type(error).__name__}: {error}",
            mend="report this with the versions that `orennayar info` prints",
        ) from error


def _compare(name: str, answer: Tensor, again: Tensor, wanted: Tensor, exact: Tensor, *, step: float) -> None:
    """What float32 itself costs shows in torch, ``wanted`` against ``exact``: a runtime may round as far elsewhere."""
    if answer.shape != exact.shape:
        difference, allowed = f"shape {tuple(answer.shape)}", False
    elif not answer.is_floating_point():
        wrong = int((answer != wanted).sum())
        difference, allowed = f"{wrong} other values", wrong == 0
    else:
        exact = torch.where(exact == wanted, wanted, exact)  # infinite where nothing is seen
        rounding = (wanted - exact).nan_to_num(0.0).abs().max().item()
        error = torch.where(answer == exact, 0.0, (answer - exact).abs())
        limit = TOLERANCE + (TOLERANCE + step) * exact.abs().nan_to_num(posinf=0.0) + 4 * rounding
        difference, allowed = f"difference {error.max().item():g}", bool((error <= limit).all())
    if not allowed or not torch.equal(answer.nan_to_num(), again.nan_to_num()):
        raise ExportError(
            "graph",
            expected=f"torch's {name} within {TOLERANCE:g} and rounding, shape {tuple(exact.shape)}, and no change",
            got=difference if not allowed else "another answer in a second run",
            mend="if the model is your own, look for steps that lose float32's digits; otherwise report it",
        )
