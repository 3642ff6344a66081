"""Made-up meshes, and what stands around their pixels: which lights reach them, and what other parts send on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from ..core.errors import RangeError
from ..core.optional import require
from ..geometry.camera import Camera
from ..geometry.mesh import normalise_mesh
from ..render.normal_map import render_normals
from ..render.radiosity import SeenSurface, light_between
from ..render.shadow import cast_shadows
from .pixels import Draw, draw_lights

Mesh = tuple[Tensor, Tensor]

SIDE, SCENE_LIGHTS, KEPT = 80, 48, 1500
"""Of a scene's picture, in pixels; most lights; pixels that are kept."""
TRIES = 8
"""At drawing a mesh that shows something."""
STEEPEST = 0.1
"""Least cosine of a kept pixel's normal to the view."""


class Scene(NamedTuple):
    """P pixels of one mesh under K lights, seen along z.

    Attributes:
        lights: (K, 3).
        normal: (P, 3).
        reached: (P, K), the share of each light that is not blocked.
        sent: (P, K), irradiance from other parts of the mesh; 1 is a light head on.
    """

    lights: Tensor
    normal: Tensor
    reached: Tensor
    sent: Tensor


def draw_scene(draw: Draw, count: int, meshes: Sequence[Mesh] | None) -> Scene:
    """A mesh of one albedo that casts shadows on itself and lights itself, under ``count`` lights.

    Raises:
        RangeError: meshes drawn one after the other show no pixel.
    """
    for _ in range(TRIES):
        scene = _render_scene(draw, count, *draw_mesh(draw, meshes))
        if len(scene.normal):
            return scene
    raise RangeError("meshes", expected="faces to see", got=f"none in {TRIES} tries", mend="leave such meshes out")


def _render_scene(draw: Draw, count: int, vertices: Tensor, faces: Tensor) -> Scene:
    seen = render_normals(vertices, faces, Camera.orthographic(1.0), (SIDE, SIDE))
    lights, surface = draw_lights(draw, 1, count)[0], SeenSurface.of(seen)
    reached = cast_shadows(vertices, faces, seen, lights, resolution=2 * SIDE)[:, 0, seen.mask[0, 0]].T
    irradiance = (surface.normal @ lights.T).clamp_min(0) * reached
    albedo = draw.uniform(1, 1, low=0.2, high=0.95).expand(len(reached), 1)
    sent = light_between(surface, albedo, irradiance, draw.generator)[:, 0]
    order = torch.randperm(len(reached), generator=draw.generator, device=draw.device)
    kept = order[surface.normal[order, 2] > STEEPEST][:KEPT]
    return Scene(lights, *(part[kept].contiguous() for part in (surface.normal, reached, sent)))


def draw_mesh(draw: Draw, meshes: Sequence[Mesh] | None = None) -> Mesh:
    """One of the given meshes, or one made up, in the unit sphere and turned at random."""
    if meshes:
        choice = min(int(draw.uniform(1).item() * len(meshes)), len(meshes) - 1)
        vertices, faces = (part.to(draw.device) for part in meshes[choice])
        vertices = vertices.float()
    else:
        vertices, faces = _made_mesh(draw)
    turn = torch.linalg.qr(draw.normal(3, 3).cpu())[0].to(vertices)
    turn = turn * torch.linalg.det(turn.cpu()).sign().to(turn)
    vertices = normalise_mesh(vertices @ turn)
    return vertices / vertices.norm(dim=1).amax().clamp_min(1e-9), faces


def _made_mesh(draw: Draw) -> Mesh:
    """A bumpy ball, a bumpy ring, or a heap of balls."""
    require("trimesh")
    import trimesh

    kind = int(draw.uniform(1).item() * 3)
    if kind == 2:
        parts = []
        for _ in range(4):
            x, y, z, radius = draw.uniform(4, low=-0.5, high=0.5).tolist()
            parts.append(trimesh.creation.icosphere(3, radius=0.3 + 0.3 * abs(radius)).apply_translation((x, y, z)))
        mesh = trimesh.util.concatenate(parts)
    else:
        mesh = trimesh.creation.icosphere(4) if kind == 0 else trimesh.creation.torus(0.65, 0.3)
    vertices = torch.tensor(mesh.vertices, dtype=torch.float32, device=draw.device)
    waves = draw.normal(6, 3) * draw.uniform(6, 1, low=1, high=6)
    push = (torch.sin(vertices @ waves.T + draw.uniform(6, high=6.3)) * draw.uniform(6, low=0.0, high=0.1)).sum(1)
    return vertices * (1 + push[:, None]), torch.tensor(mesh.faces, device=draw.device)
