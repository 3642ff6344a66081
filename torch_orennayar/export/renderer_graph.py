"""The renderer as an ONNX graph, alone or followed by shading; camera and size are inputs or part of the file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.errors import ExportError
from ..core.optional import require
from ..geometry.camera import Camera
from ..reflectance.models import get_model
from ..render.normal_map import MAX_SIDE, check_size, rasterise
from ..shading.functional import oren_nayar
from .formula import Shading, trace_formula
from .nodes import Nodes, as_model, floats, inline
from .shading_graph import shading_metadata
from .task import ExportTask
from .traced_steps import load_step

if TYPE_CHECKING:
    import onnx

MAPS: tuple[str, ...] = ("normal", "mask", "depth", "face")
"""Names of the renderer's outputs, fields of `NormalMap`."""
MESH: tuple[str, ...] = ("vertices", "faces")
"""Names of the inputs that every call gives."""
CAMERA: tuple[str, ...] = ("rotation", "eye", "focal", "centre")
"""Names of the inputs that are the camera, fields of `Camera` without the batch."""
VIEW: tuple[str, ...] = (*CAMERA, "size")
"""Names of the inputs that are part of the file unless the view is an input."""
SHADING: tuple[str, ...] = ("light", "albedo", "roughness")
"""Names of the inputs that shading adds."""


def view_maps(vertices: Tensor, faces: Tensor, camera: Camera, size: tuple[int, int]) -> tuple[Tensor, ...]:
    """The maps in the order of `MAPS` of one mesh (V, 3), then (1, 3, H, W) view directions."""
    seen = rasterise(vertices[None], faces, camera, size)
    return seen.normal, seen.mask, seen.depth, seen.face, camera.view_directions(size).to(vertices)


def renderer_task(
    camera: Camera | None, size: tuple[int, int] | None, model: str | None, *, view_inputs: bool
) -> ExportTask:
    """`render_normals` of one mesh, followed by shading with ``model`` unless that is None.

    With ``view_inputs`` the graph takes camera and size as inputs; otherwise those given are part of it.

    Raises:
        ExportError: there is not one camera and a size.
        ShapeError: a size that `render_normals` refuses.
    """
    if camera is None or size is None or len(camera.eye) != 1:
        got = "none" if camera is None or size is None else f"{len(camera.eye)} cameras"
        raise ExportError("camera, size", expected="one camera and (H, W)", got=got, mend="give camera= and size=")
    check_size(size)
    camera.rays(size)  # raises where camera and size do not fit
    model = None if model is None else get_model(model).name

    own = [*(getattr(camera, name)[0].detach().cpu().float() for name in CAMERA), torch.tensor(size)]

    def render(*inputs: Tensor) -> tuple[Tensor, ...]:
        vertices, faces = inputs[:2]
        rotation, eye, focal, centre, canvas = inputs[2:7] if view_inputs else own
        placed = rotation[None], eye[None], focal[None], centre[None]
        height, width = canvas.tolist()
        *maps, view = view_maps(vertices, faces, Camera(*placed, camera.is_perspective, camera.near), (height, width))
        if model is None:
            return tuple(maps)
        light, albedo, roughness = inputs[-3:]
        toward, paint = light[:, :, None, None], albedo.reshape(1, -1, 1, 1)
        return (oren_nayar(maps[0], toward, view, paint, roughness.reshape(1, 1, 1, 1), model=model), *maps)

    inputs = (*MESH, *(VIEW if view_inputs else ()), *(() if model is None else SHADING))
    graph = renderer_graph(camera, model, None if view_inputs else own)
    trials = renderer_trials(camera, own, model, view_inputs=view_inputs)
    return ExportTask(
        graph, _metadata(camera, own[-1].tolist(), model, view_inputs=view_inputs), inputs, trials, render
    )


def _metadata(camera: Camera, size: list[int], model: str | None, *, view_inputs: bool) -> dict[str, str]:
    """Meaning and units."""
    kind = "perspective" if camera.is_perspective else "orthographic"
    extent = "per unit tangent" if camera.is_perspective else "per world unit"
    near = f"near plane at {camera.near:g} world units" if camera.is_perspective else "clips nothing"
    metadata = {
        "vertices": "world frame",
        "faces": "corners, counter-clockwise as seen from the front; each must name a vertex",
        "normal": "camera frame, unit, 0 where nothing is seen",
        "depth": "distance along the viewing axis, world units, infinite where nothing is seen",
        "face": "index of the visible face, -1 for none",
    }
    if view_inputs:
        metadata |= {
            "camera": f"{kind}, {near}",
            "rotation": "world to camera; rows are right, up and back",
            "eye": "position of the camera in the world",
            "focal": f"half image heights {extent}, x and y",
            "centre": "principal point from the image centre in half heights, right and up",
            "size": f"height and width in pixels, 1 to {MAX_SIDE}",
        }
    else:
        metadata |= {
            "camera": f"{kind}, {near}, eye {camera.eye[0].tolist()}, rotation {camera.rotation[0].tolist()}, "
            f"focal {camera.focal[0].tolist()} half image heights {extent}, "
            f"centre {camera.centre[0].tolist()} half image heights",
            "size": f"{size[0]} x {size[1]}",
        }
    return metadata if model is None else metadata | shading_metadata(model)


def renderer_graph(camera: Camera, model: str | None, view: list[Tensor] | None) -> onnx.ModelProto:
    """The graph; the numbers of vertices, faces, lights and channels are dynamic.

    Args:
        camera: its kind and its near plane are part of the graph.
        model: the model to shade with, or None.
        view: values of `VIEW` to store in the graph, or None where they are inputs.
    """
    from onnx.utils import Extractor

    shipped = load_step("renderer_perspective" if camera.is_perspective else "renderer_orthographic")
    if camera.is_perspective:
        _store(shipped.graph, {"near": torch.tensor(camera.near, dtype=torch.float64)})
    if model is not None:
        model_graph = _with_shading(shipped, model)
    else:
        model_graph = Extractor(shipped).extract_model([*MESH, *VIEW], list(MAPS))
    if view is not None:
        _store(model_graph.graph, dict(zip(VIEW, view, strict=True)))
        for value in model_graph.graph.output:
            for axis, length in zip(value.type.tensor_type.shape.dim[-2:], view[-1].tolist(), strict=True):
                axis.dim_value = length
    return model_graph


def _store(graph: onnx.GraphProto, values: dict[str, Tensor]) -> None:
    """Turn the inputs named by ``values`` into constants of the graph."""
    from onnx import numpy_helper

    graph.initializer.extend(numpy_helper.from_array(value.numpy(), name) for name, value in values.items())
    inputs = [value for value in graph.input if value.name not in values]
    del graph.input[:]
    graph.input.extend(inputs)


def _with_shading(shipped: onnx.ModelProto, model: str) -> onnx.ModelProto:
    """The renderer's graph with the inputs of `SHADING`, and ``shading`` (K, C, H, W) before its other outputs."""
    from onnx import helper, numpy_helper

    add = Nodes("shading_")
    toward = add("Unsqueeze", "light", "last_axes")
    pairs = (("normal", toward), ("normal", "view"), (toward, "view"))
    cosines = [add("ReduceSum", add("Mul", *pair), "channel", keepdims=1) for pair in pairs]
    paint, rough = (add("Reshape", name, "over_channels") for name in ("albedo", "roughness"))
    formula = trace_formula(Shading(get_model(model).function)).graph
    names = dict(zip((v.name for v in formula.input), (*cosines, paint, rough), strict=True))
    (value,), constants = inline(add, formula, "formula_", names)
    add.nodes.append(helper.make_node("Identity", [value], ["shading"], name="output_shading"))
    shapes = {"last_axes": [2, 3], "channel": [1], "over_channels": [1, -1, 1, 1]}
    constants += [numpy_helper.from_array(torch.tensor(v).numpy(), name) for name, v in shapes.items()]

    graph = shipped.graph
    inputs = floats("light", ["lights", 3]), floats("albedo", ["channels"]), floats("roughness", [1])
    outputs = floats("shading", ["lights", "channels", "height", "width"]), *graph.output[:-1]
    return as_model(
        helper.make_graph(
            [*graph.node, *add.nodes],
            "shaded_mesh",
            [*graph.input, *inputs],
            outputs,
            [*graph.initializer, *constants],
        )
    )


def renderer_trials(
    camera: Camera, own: list[Tensor], model: str | None, *, view_inputs: bool
) -> list[tuple[Tensor, ...]]:
    """A sphere in view, and random triangles of all sizes around the eye, some of them behind it.

    If the view is an input, the triangles are seen by another camera, in pictures of other sizes.
    """
    require("trimesh")
    import trimesh

    far = max(4.0, 20 * camera.near) if camera.is_perspective else 2.0
    reach = (far if camera.is_perspective else 1.0) / float(camera.focal.min())
    ball = trimesh.creation.icosphere(2, radius=min(0.9 * reach, 0.9 * far))
    meshes = [(torch.tensor(ball.vertices) - torch.tensor([0.0, 0, far]), torch.tensor(ball.faces))]
    generator = torch.Generator().manual_seed(0)
    for count, spread in ((7, 3.0), (300, 0.2)):
        centre = torch.randn(count, 1, 3, generator=generator) * reach - torch.tensor([0.0, 0, far / 2])
        corners = centre + torch.randn(count, 3, 3, generator=generator) * spread * reach
        meshes.append((corners.reshape(-1, 3), torch.arange(3 * count).reshape(-1, 3)))
    turned = torch.linalg.qr(torch.randn(3, 3, generator=generator))[0]
    lens = own[2] * torch.tensor([0.8, 0.9]), own[3] + 0.1
    others = [[turned, own[1] + reach, *lens, torch.tensor(size)] for size in ((37, 53), (64, 1))]
    trials: list[tuple[Tensor, ...]] = []
    for (local, faces), view in zip(meshes, (own, *(others if view_inputs else (own, own))), strict=True):
        world = (local.double() @ view[0].double() + view[1]).float()
        trials.append((world, faces, *(view if view_inputs else ())))
    if model is None:
        return trials
    shaded: list[tuple[Tensor, ...]] = []
    for trial, lights, channels in zip(trials, (1, 3, 2), (3, 1, 2), strict=True):
        light = F.normalize(torch.randn(lights, 3, generator=generator), dim=1)
        shaded.append((*trial, light, torch.rand(channels, generator=generator), torch.tensor([0.6])))
    return shaded
