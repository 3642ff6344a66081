"""Random meshes rendered as scenes: which lights reach each pixel, and what light other parts reflect to it."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from ..core.errors import RangeError
from ..core.optional import require
from ..geometry.camera import Camera
from ..geometry.mesh import normalise_mesh
from ..render.normal_map import render_normals
from ..render.radiosity import SeenSurface, light_between
from ..render.shadow import cast_shadows
from .draw import Draw
from .figures import draw_figure
from .pixels import draw_lights

MeshTensors = tuple[Tensor, Tensor]
Meshes = Sequence[MeshTensors] | Literal["figures"] | None
"""Meshes to draw from; ``"figures"`` are those of `draw_figure`, None bumpy balls, rings and heaps of balls."""

SIDE = 80
"""Pixels; side of the picture that a scene is rendered as. Set by hand, for half a second a scene."""
SCENE_LIGHTS = 48
"""Largest number of lights of a scene. Set by the error of trained networks on held-out renders: 4.79 degrees, against
4.89 without the limit."""
SCENE_PIXELS = 1500
"""Largest number of pixels that a scene keeps, for .6 MB a scene. Set by hand."""
MAX_TRIES = 8
"""Meshes that are drawn before giving up on finding one that shows a pixel. Set by hand."""
MIN_COSINE = 0.1
"""Smallest cosine between the normal of a kept pixel and the view. Set by hand."""


class RenderedScene(NamedTuple):
    """P pixels of one mesh under K lights, seen along z.

    Attributes:
        lights: (K, 3) unit directions.
        normal: (P, 3) unit normals.
        reached: (P, K), share of each light that is not blocked.
        reflected: (P, K), irradiance from other parts of the mesh; 1 is a light that is faced.
    """

    lights: Tensor
    normal: Tensor
    reached: Tensor
    reflected: Tensor


def draw_scene(draw: Draw, count: int, meshes: Meshes) -> RenderedScene:
    """A mesh of one albedo that casts shadows on itself and reflects light onto itself, under ``count`` lights.

    Raises:
        RangeError: of `MAX_TRIES` meshes none shows a pixel.
    """
    for _ in range(MAX_TRIES):
        scene = _render_scene(draw, count, *draw_mesh(draw, meshes))
        if len(scene.normal):
            return scene
    raise RangeError("meshes", expected="faces to see", got=f"none in {MAX_TRIES} tries", mend="leave such meshes out")


def _render_scene(draw: Draw, count: int, vertices: Tensor, faces: Tensor) -> RenderedScene:
    seen = render_normals(vertices, faces, Camera.orthographic(1.0), (SIDE, SIDE))
    lights, surface = draw_lights(draw, 1, count)[0], SeenSurface.of(seen)
    reached = cast_shadows(vertices, faces, seen, lights, resolution=2 * SIDE)[:, 0, seen.mask[0, 0]].T
    irradiance = (surface.normal @ lights.T).clamp_min(0) * reached
    albedo = draw.uniform(1, 1, low=0.2, high=0.95).expand(len(reached), 1)
    reflected = light_between(surface, albedo, irradiance, draw.generator)[:, 0]
    order = torch.randperm(len(reached), generator=draw.generator, device=draw.device)
    kept = order[surface.normal[order, 2] > MIN_COSINE][:SCENE_PIXELS]
    return RenderedScene(lights, *(part[kept].contiguous() for part in (surface.normal, reached, reflected)))


def draw_mesh(draw: Draw, meshes: Meshes = None) -> MeshTensors:
    """One of the given meshes, or a random one, in the unit sphere and turned at random."""
    if meshes == "figures":
        vertices, faces = draw_figure(draw)
    elif meshes:
        choice = min(int(draw.uniform(1).item() * len(meshes)), len(meshes) - 1)
        vertices, faces = (part.to(draw.device) for part in meshes[choice])
        vertices = vertices.float()
    else:
        vertices, faces = _random_mesh(draw)
    turn = torch.linalg.qr(draw.normal(3, 3).cpu())[0].to(vertices)
    turn = turn * torch.linalg.det(turn.cpu()).sign().to(turn)
    vertices = normalise_mesh(vertices @ turn)
    return vertices / vertices.norm(dim=1).amax().clamp_min(1e-9), faces


def _random_mesh(draw: Draw) -> MeshTensors:
    """A bumpy ball, a bumpy ring, or a heap of balls."""
    kind = int(draw.uniform(1).item() * 3)
    if kind == 2:
        ball, faces = _unit_shape("small ball")
        parts = []
        for _ in range(4):
            *place, radius = draw.uniform(4, low=-0.5, high=0.5).tolist()
            parts.append(ball * (0.3 + 0.3 * abs(radius)) + ball.new_tensor(place))
        vertices = torch.cat(parts)
        faces = torch.cat([faces + k * len(ball) for k in range(len(parts))])
    else:
        vertices, faces = _unit_shape("ball" if kind == 0 else "ring")
    vertices = vertices.float().to(draw.device)
    waves = draw.normal(6, 3) * draw.uniform(6, 1, low=1, high=6)
    displacement = (torch.sin(vertices @ waves.T + draw.uniform(6, high=6.3)) * draw.uniform(6, low=0.0, high=0.1)).sum(
        1
    )
    return vertices * (1 + displacement[:, None]), faces.to(draw.device)


@functools.cache
def _unit_shape(name: str) -> MeshTensors:
    """A ball of radius 1, coarse or fine, or a ring: float64 vertices and faces; made once, for time."""
    require("trimesh")
    import trimesh

    if name == "ring":
        mesh = trimesh.creation.torus(0.65, 0.3)
    else:
        mesh = trimesh.creation.icosphere(3 if name == "small ball" else 4)
    return torch.tensor(mesh.vertices), torch.tensor(mesh.faces)
