"""Trace the renderer, alone or with shading behind it, into an ONNX graph."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from ..core import torch_private
from ..core.optional import require
from ..geometry.camera import Camera
from ..reflectance.models import get_model
from ..render.normal_map import rasterise
from .nodes import write_graph
from .shading_graph import Formula

if TYPE_CHECKING:
    import onnx

MAPS = ("normal", "mask", "depth", "face")


class Renderer(nn.Module):
    """Mesh to maps, and with a ``model`` to shaded pictures before them."""

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
        # Depends on an input, so that maps made from it are reckoned when the graph runs and not kept in the file.
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


def renderer_inputs(model: str | None) -> tuple[str, ...]:
    """Names of the graph's inputs."""
    return ("vertices", "faces") if model is None else ("vertices", "faces", "light", "albedo", "roughness")


def renderer_outputs(model: str | None) -> tuple[str, ...]:
    """Names of the graph's outputs."""
    return MAPS if model is None else ("shading", *MAPS)


def renderer_graph(renderer: Renderer) -> onnx.ModelProto:
    """The graph; the numbers of vertices, faces, lights and channels are dynamic."""
    example: tuple[Tensor, ...] = (torch.rand(5, 3), torch.tensor([[0, 1, 2], [1, 2, 3], [2, 3, 4]]))
    shapes: dict[str, dict[int, object]] = {n: {0: torch.export.Dim(n)} for n in ("vertices", "faces")}
    if renderer.model is not None:
        example = (*example, torch.rand(4, 3), torch.rand(2), torch.rand(1))
        shapes |= {
            "light": {0: torch.export.Dim("lights")},
            "albedo": {0: torch.export.Dim("channels")},
            "roughness": {},
        }
    with torch_private.without_runtime_assertions():
        return write_graph(
            lambda: _trace(renderer, example, shapes),
            example,
            (renderer_inputs(renderer.model), renderer_outputs(renderer.model)),
            shapes,
            ("renderer", "a graph that torch.onnx can write"),
            "report this with the versions that `orennayar info` prints",
        )


def _trace(renderer: Renderer, example: tuple[Tensor, ...], shapes: dict[str, dict[int, object]]) -> Any:
    """The renderer as a program without checks of the numbers of faces and pixels, which ONNX cannot write."""
    program = torch.export.export(renderer, example, dynamic_shapes=shapes, strict=False).run_decompositions()
    for node in list(program.graph.nodes):
        if "assert" in str(node.target) or "sym_constrain" in str(node.target):
            program.graph.erase_node(node)
    program.graph.eliminate_dead_code()
    return program


def renderer_trials(renderer: Renderer) -> list[tuple[Tensor, ...]]:
    """Inputs to try a graph on: a sphere in view, and triangles of all sizes around the eye, some behind it."""
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
    shades: list[tuple[Tensor, ...]] = []
    for (vertices, faces), lights, channels in zip(trials, (1, 3, 2), (3, 1, 2), strict=True):
        light = torch.nn.functional.normalize(torch.randn(lights, 3, generator=generator), dim=1)
        shades.append((vertices, faces, light, torch.rand(channels, generator=generator), torch.tensor([0.6])))
    return shades
