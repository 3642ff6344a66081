"""Write ONNX graphs that compute what torch computes."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor, nn

from ..core.defaults import independent_of_defaults
from ..core.errors import ExportError
from ..core.files import atomic_path
from ..core.optional import require
from ..geometry.camera import Camera
from ..stereo.network_solver import NETWORK
from .describe import write_metadata
from .half_precision import to_half
from .integration_graph import integration_task
from .module_graph import module_task
from .network_graph import network_task
from .portable_graph import portable_task
from .renderer_graph import renderer_task
from .shading_graph import shading_task
from .stereo_graph import stereo_task
from .task import ExportTask
from .verify import verify

RENDERERS = ("renderer", "shaded_mesh")
"""Kinds of graphs that see a mesh with a camera."""


@independent_of_defaults
def export_onnx(
    what: str | nn.Module,
    path: str | os.PathLike[str],
    *,
    model: str = "qualitative",
    per_pixel_directions: bool = False,
    checked: bool = False,
    portable: bool = False,
    camera: Camera | None = None,
    size: tuple[int, int] | None = None,
    view_inputs: bool = False,
    example_inputs: tuple[Tensor, ...] | None = None,
    input_names: Sequence[str] | None = None,
    output_names: Sequence[str] | None = None,
    dtype: torch.dtype = torch.float32,
) -> Path:
    """Write a graph as an ONNX file and verify it against torch in ONNX Runtime before returning.

    ``"shading"`` takes ``normal`` (B, 3, H, W), ``light`` and ``view`` (B, 3, 1, 1), or (B, 3, H, W) with
    ``per_pixel_directions``, ``albedo`` (B, C, H, W) and ``roughness`` (B, 1, H, W) and returns
    ``shading`` (B, C, H, W). B >= 1, C, H, W are dynamic, and each input may have 1 where it is constant. Directions
    are scaled to unit length and roughness is clamped to its range, where `oren_nayar` would raise an error.
    ``portable`` writes element-wise operators and one sum in opset 17, which CoreML, WebNN, WebGPU and mobile
    runtimes have, in place of a loop over bands of rows: slower on processors for large pictures; broken normals do
    not become 0. With ``size`` every axis has a fixed size: one picture of three channels, one light.

    ``"renderer"`` takes ``vertices`` (V, 3) and ``faces`` (F, 3) int64 and returns ``normal`` (1, 3, H, W), ``mask``
    (1, 1, H, W) bool, ``depth`` (1, 1, H, W) and ``face`` (1, 1, H, W) int64 of `render_normals`, the same faces to the
    last pixel; V and F >= 1 are dynamic, the camera and H, W are in the file. With ``view_inputs`` one file serves
    every view: it takes ``rotation`` (3, 3), ``eye`` (3,), ``focal`` (2,) and ``centre`` (2,), the fields of `Camera`,
    and ``size`` (2,) int64, H and W, after the faces; only the kind of camera and its near plane are in the file. Faces
    must name vertices that exist and vertices must be finite: a graph cannot check.

    ``"shaded_mesh"`` also takes ``light`` (K, 3) in the camera frame, ``albedo`` (C,) and ``roughness`` (1,) and
    returns ``shading`` (K, C, H, W) before those; K and C are dynamic.

    ``"stereo"`` takes ``images`` (K, C, H, W) of linear light, ``lights`` (K, 3), unit, and ``mask`` (1, H, W) bool and
    returns ``normal`` (3, H, W), ``albedo`` (C, H, W) and ``roughness`` (1, H, W), 0 outside the mask; all axes are
    dynamic. It solves robust least squares in closed form with one roughness for the object, less accurate than
    `photometric_stereo`. K >= 3 and a mask that contains a pixel; fewer lights, or another number of lights than of
    images, end in an error of the runtime that names what is refused. ``error`` (1, H, W) is the expected error of the
    normal in radians. With ``model="network"`` the normals are predicted by the network that ships with the package,
    trained on K >= 12, fewer are refused; interreflections, which `photometric_stereo` removes first, are not removed.

    ``"integration"`` takes ``normal`` (3, H, W) and ``mask`` (1, H, W) bool and returns ``depth`` (1, H, W), height
    toward the viewer in pixels with mean 0; H and W are dynamic. It bridges the steps of depth that `integrate_normals`
    finds.

    A module of your own, with or without `OrenNayar` inside, needs ``example_inputs``; every axis that the module
    allows to vary is dynamic, except those of size 1 in the example. It is exported in evaluation mode.

    Linear light, roughness in radians; opset 18 unless portable. Meaning and units are in the file's metadata.

    Args:
        what: ``"shading"``, ``"renderer"``, ``"shaded_mesh"``, ``"stereo"``, ``"integration"`` or a module.
        path: the file; it appears whole and verified, or not at all.
        model: a name in ``MODELS``, registered ones too, or ``"network"`` (``"stereo"``); unused by
            ``"renderer"`` and modules.
        per_pixel_directions: light and view as maps (``"shading"``).
        checked: also return ``valid`` (B, 1, H, W) bool: where directions are unit vectors, albedo is not negative and
            roughness is in its range (``"shading"``).
        portable: only operators that runtimes of phones and browsers have (``"shading"``).
        camera: one camera (``"renderer"``, ``"shaded_mesh"``).
        size: (H, W) of the maps (``"renderer"``, ``"shaded_mesh"``, portable ``"shading"``).
        view_inputs: camera and size are inputs of the graph, not part of it (``"renderer"``, ``"shaded_mesh"``).
        example_inputs: positional inputs of a module.
        input_names: of a module; default ``input_0``, ``input_1`` ...
        output_names: of a module; default ``output_0`` ...
        dtype: of floating inputs and outputs, float32 or float16; the graph computes in float32.

    Returns:
        ``path``.

    Raises:
        ExportError: unknown ``what`` or ``dtype``, no camera, size or example where one is needed, a model or module
            that does not export, or a graph that differs from torch: in any integer or bool, or in other values by
            more than 1e-5 and rounding.
        ModelError: unknown model.
        ShapeError: a ``size`` that `render_normals` refuses.

    Example:
        >>> import tempfile, pathlib, torch_orennayar as ton
        >>> path = ton.export_onnx("shading", pathlib.Path(tempfile.mkdtemp()) / "lambert.onnx", model="lambert")
        >>> path.stat().st_size > 0
        True
    """
    require("onnx", "onnxscript", "onnxruntime")
    if dtype not in (torch.float32, torch.float16):
        raise ExportError("dtype", expected="float32 or float16", got=str(dtype), mend="choose one")
    used = {
        "checked": (checked, ("shading",)),
        "portable": (portable, ("shading",)),
        "per_pixel_directions": (per_pixel_directions, ("shading",)),
        "view_inputs": (view_inputs, RENDERERS),
        "camera": (camera is not None, RENDERERS),
        "size": (size is not None, (*RENDERERS, "portable shading")),
        "example_inputs": (example_inputs is not None, ("a module",)),
        f"model={NETWORK!r}": (model == NETWORK, ("stereo",)),
    }
    kind = what if isinstance(what, str) else "a module"
    _check_options(f"portable {kind}" if portable and kind == "shading" else kind, used, Path(path))
    if checked and portable:
        raise ExportError("checked", expected="not with portable", got="both", mend="leave one out")
    if isinstance(what, nn.Module):
        task = module_task(what, example_inputs, input_names, output_names)
    elif what == "shading" and portable:
        task = portable_task(model, per_pixel=per_pixel_directions, size=size)
    elif what == "shading":
        task = shading_task(model, per_pixel=per_pixel_directions, checked=checked)
    elif what == "stereo":
        task = network_task() if model == NETWORK else stereo_task(model)
    elif what == "integration":
        task = integration_task()
    elif what in RENDERERS:
        task = renderer_task(camera, size, model if what == "shaded_mesh" else None, view_inputs=view_inputs)
    else:
        expected = "'shading', 'renderer', 'shaded_mesh', 'stereo', 'integration' or a module"
        raise ExportError("what", expected=expected, got=repr(what), mend="choose one")
    return _write(task, what if isinstance(what, str) else type(what).__name__, dtype, Path(path))


def _write(task: ExportTask, name: str, dtype: torch.dtype, path: Path) -> Path:
    """Write the graph called ``name`` with its metadata, whole and verified, or not at all."""
    import onnx

    if dtype == torch.float16:
        to_half(task.graph)
    write_metadata(task.graph, {"graph": name, "precision": str(dtype).removeprefix("torch."), **task.metadata})
    with atomic_path(path) as temporary:
        onnx.save(task.graph, temporary)
        verify(temporary, task, dtype)
    return path


def _check_options(kind: str, used: Mapping[str, tuple[bool, tuple[str, ...]]], path: Path) -> None:
    """Refuse options that a graph of this kind does not use, and a name that other programs would not take for ONNX.

    Args:
        kind: of the graph.
        used: for every option whether it is given, and the kinds that use it.
        path: of the file.
    """
    for name, (given, kinds) in used.items():
        if given and kind not in kinds and kind.removeprefix("portable ") not in kinds:
            raise ExportError(name, expected=f"with {' or '.join(kinds)}", got=kind, mend="leave it out")
    if path.suffix.lower() != ".onnx":
        raise ExportError("path", expected="a name that ends in .onnx", got=str(path), mend="add the suffix")
