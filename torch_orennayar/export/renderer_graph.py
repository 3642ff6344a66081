"""Trace the renderer, alone or followed by shading, into an ONNX graph."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from ..core import torch_private
from ..core.errors import ExportError
from ..core.optional import require
from ..geometry.camera import Camera
from ..reflectance.models import get_model
from ..render.normal_map import check_size, rasterise
from .nodes import TraceError, trace
from .shading_graph import Formula, shading_metadata
from .task import ExportTask

if TYPE_CHECKING:
    import onnx

MAPS: tuple[str, ...] = ("normal", "mask", "depth", "face")
"""Names of the renderer's outputs, fields of `NormalMap`."""
MESH: tuple[str, ...] = ("vertices", "faces")
"""Names of the inputs of both graphs."""
SHADING: tuple[str, ...] = ("light", "albedo", "roughness")
"""Names of the inputs that shading adds."""


class Renderer(nn.Module):
    """From a mesh to the maps of `NormalMap`; with a ``model``, shading is returned before them."""

    def __init__(self, camera: Camera, size: tuple[int, int], model: str | None) -> None:
        super().__init__()
        self.camera, self.size, self.model = camera, size, model

    def forward(
        self,
        vertices: Tensor,
        faces: Tensor,
        light: Tensor | None = None,
        albedo: Tensor | None = None,
        roughness: Tensor | None = None,
    ) -> tuple[Tensor, ...]:
        """Maps of `NormalMap`; with a model ``light`` (K, 3), ``albedo`` (C,), ``roughness`` (1,) give (K, C, H, W)."""
        # A factor that depends on an input: maps made from the camera are computed when the graph runs, where the
        # exporter would otherwise store them in the file.
        one = (faces[0, 0] * 0 + 1).to(self.camera.focal)
        camera = dataclasses.replace(self.camera, focal=self.camera.focal * one)
        seen = rasterise(vertices[None], faces, camera, self.size)
        maps = (seen.normal, seen.mask, seen.depth, seen.face)
        if self.model is None or light is None or albedo is None or roughness is None:
            return maps
        if self.camera.is_perspective:
            view = camera.view_directions(self.size).to(vertices)
        else:
            view = vertices.new_tensor((0.0, 0.0, 1.0)).reshape(1, 3, 1, 1)
        toward = light[:, :, None, None]
        cosines = [
            (a * b).sum(1, keepdim=True) for a, b in ((seen.normal, toward), (seen.normal, view), (toward, view))
        ]
        formula = Formula(get_model(self.model).function)
        shading = formula(*cosines, albedo.reshape(1, -1, 1, 1), roughness.reshape(1, 1, 1, 1))
        return (shading, *maps)


def renderer_task(camera: Camera | None, size: tuple[int, int] | None, model: str | None) -> ExportTask:
    """`render_normals` of one mesh, followed by shading with ``model`` unless that is None.

    Raises:
        ExportError: there is not one camera and a size.
        ShapeError: a size that `render_normals` refuses.
    """
    if camera is None or size is None or len(camera.eye) != 1:
        got = "none" if camera is None or size is None else f"{len(camera.eye)} cameras"
        raise ExportError("camera, size", expected="one camera and (H, W)", got=got, mend="give camera= and size=")
    check_size(size)
    camera.rays(size)  # raises where camera and size do not fit
    renderer = Renderer(camera, size, None if model is None else get_model(model).name)
    inputs = MESH if model is None else MESH + SHADING
    return ExportTask(renderer_graph(renderer), _metadata(renderer), inputs, renderer_trials(renderer), renderer)


def _metadata(renderer: Renderer) -> dict[str, str]:
    """Meaning and units."""
    camera, (height, width) = renderer.camera, renderer.size
    kind = "perspective" if camera.is_perspective else "orthographic"
    metadata = {
        "camera": f"{kind}, eye {camera.eye[0].tolist()}, rotation {camera.rotation[0].tolist()}, "
        f"focal {camera.focal[0].tolist()} and centre {camera.centre[0].tolist()} in half image heights",
        "size": f"{height} x {width}",
        "depth": "distance along the viewing axis, infinite where nothing is seen",
        "face": "index of the visible face, -1 for none",
    }
    return metadata if renderer.model is None else metadata | shading_metadata(renderer.model)


def renderer_graph(renderer: Renderer) -> onnx.ModelProto:
    """The graph; the numbers of vertices, faces, lights and channels are dynamic."""
    shaded = renderer.model is not None
    inputs = MESH + SHADING if shaded else MESH
    outputs = ("shading", *MAPS) if shaded else MAPS
    example: tuple[Tensor, ...] = (torch.rand(5, 3), torch.tensor([[0, 1, 2], [1, 2, 3], [2, 3, 4]]))
    shapes: dict[str, dict[int, Any]] = {n: {0: torch.export.Dim(n)} for n in MESH}
    if shaded:
        example = (*example, torch.rand(4, 3), torch.rand(2), torch.rand(1))
        shapes |= {
            "light": {0: torch.export.Dim("lights")},
            "albedo": {0: torch.export.Dim("channels")},
            "roughness": {},
        }
    error = TraceError(
        "renderer",
        "a graph that torch.onnx can write",
        "report this with the versions that `orennayar info` prints",
    )
    with torch_private.without_runtime_assertions():
        return trace(lambda: _program(renderer, example, shapes), example, inputs, outputs, shapes, error)


def _program(
    renderer: Renderer, example: tuple[Tensor, ...], shapes: dict[str, dict[int, Any]]
) -> torch.export.ExportedProgram:
    """The renderer as a program without the checks of the numbers of faces and pixels, which ONNX cannot express."""
    traced = torch.export.export(renderer, example, dynamic_shapes=shapes, strict=False)
    program: torch.export.ExportedProgram = traced.run_decompositions()
    for node in list(program.graph.nodes):
        if "assert" in str(node.target) or "sym_constrain" in str(node.target):
            program.graph.erase_node(node)
    program.graph.eliminate_dead_code()
    return program


def renderer_trials(renderer: Renderer) -> list[tuple[Tensor, ...]]:
    """A sphere in view, and random triangles of all sizes around the eye, some of them behind it."""
    require("trimesh")
    import trimesh

    camera = renderer.camera
    far = max(4.0, 20 * camera.near) if camera.is_perspective else 2.0
    reach = (far if camera.is_perspective else 1.0) / float(camera.focal.min())
    ball = trimesh.creation.icosphere(2, radius=min(0.9 * reach, 0.9 * far))
    meshes = [(torch.tensor(ball.vertices) - torch.tensor([0.0, 0, far]), torch.tensor(ball.faces))]
    generator = torch.Generator().manual_seed(0)
    for count, spread in ((7, 3.0), (300, 0.2)):
        centre = torch.randn(count, 1, 3, generator=generator) * reach - torch.tensor([0.0, 0, far / 2])
        corners = centre + torch.randn(count, 3, 3, generator=generator) * spread * reach
        meshes.append((corners.reshape(-1, 3), torch.arange(3 * count).reshape(-1, 3)))
    turn, eye = camera.rotation[0].double().cpu(), camera.eye[0].double().cpu()
    trials: list[tuple[Tensor, ...]] = [((v.double() @ turn + eye).float(), f) for v, f in meshes]
    if renderer.model is None:
        return trials
    shaded: list[tuple[Tensor, ...]] = []
    for (vertices, faces), lights, channels in zip(trials, (1, 3, 2), (3, 1, 2), strict=True):
        light = torch.nn.functional.normalize(torch.randn(lights, 3, generator=generator), dim=1)
        shaded.append((vertices, faces, light, torch.rand(channels, generator=generator), torch.tensor([0.6])))
    return shaded
