"""Other renderers that install from the package index, drawing normals of a mesh seen along -z by a parallel camera.

``pip install moderngl deodr open3d mitsuba==3.6.4`` brings them (moderngl needs Mesa's libEGL and draws with llvmpipe;
Mitsuba needs a libLLVM, and newer ones than 3.6 need a newer LLVM than Debian 12 has). Renderers that are not installed
are left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.floating[Any]]
Picture = tuple[Floats, Floats]
"""Normals (H, W, 3), not always unit, and depth (H, W); arbitrary where nothing is seen."""


@dataclass(frozen=True)
class View:
    """A mesh with vertex normals, x to the right and y up within ``half_height``, eye at z = 2 looking along -z."""

    vertices: Floats
    normals: Floats
    faces: npt.NDArray[np.int32]
    half_height: float
    size: int
    cull: bool


def llvmpipe(view: View) -> Callable[[], Picture]:
    """OpenGL on the processor: uploads vertices, reads back normals and face ids as float32, and depth."""
    import moderngl

    context = moderngl.create_standalone_context(backend="egl", require=430)
    program = context.program(
        vertex_shader="""
            #version 430
            uniform float extent; in vec3 place; in vec3 normal; out vec3 across;
            void main() { across = normal; gl_Position = vec4(place.xy / extent, -place.z / 2.0, 1.0); }
        """,
        fragment_shader="""
            #version 430
            in vec3 across; layout(location = 0) out vec4 seen;
            void main() { seen = vec4(normalize(across), intBitsToFloat(gl_PrimitiveID)); }
        """,
    )
    program["extent"] = view.half_height
    data = np.hstack((view.vertices, view.normals)).astype("f4")
    vertices, faces = context.buffer(data.tobytes()), context.buffer(view.faces.tobytes())
    array = context.vertex_array(program, [(vertices, "3f 3f", "place", "normal")], faces)
    colour, depth = context.texture((view.size,) * 2, 4, dtype="f4"), context.depth_texture((view.size,) * 2)
    target = context.framebuffer([colour], depth)

    def draw() -> Picture:
        target.use()
        context.enable(moderngl.DEPTH_TEST)
        (context.enable if view.cull else context.disable)(moderngl.CULL_FACE)
        vertices.write(data.tobytes())
        target.clear()
        array.render()
        seen = np.frombuffer(colour.read(), "f4").reshape(view.size, view.size, 4)[::-1]
        far = np.frombuffer(depth.read(), "f4").reshape(view.size, view.size)[::-1]
        return seen[..., :3], far * 4  # -z / 2 from -1 to 1 is stored from 0 to 1, and the eye is at z = 2

    return draw


def deodr(view: View) -> Callable[[], Picture]:
    """DEODR's rasteriser, without its antialiasing."""
    from deodr.differentiable_renderer import Scene2D, renderScene

    place = (view.vertices[:, :2] / view.half_height * [1, -1] + 1) * view.size / 2
    zeros = np.zeros((len(view.faces), 3), bool)
    faces = view.faces.astype(np.uint32)
    scene = Scene2D(
        faces=faces,
        faces_uv=faces,
        ij=np.ascontiguousarray(place, float),
        depths=2 - view.vertices[:, 2].astype(float),
        textured=zeros[:, 0],
        uv=np.zeros((len(place), 2)),
        shade=np.zeros(len(place)),
        colors=view.normals.astype(float),
        shaded=zeros[:, 0],
        edgeflags=zeros,
        height=view.size,
        width=view.size,
        nb_colors=3,
        texture=np.zeros((1, 1, 3)),
        background_color=np.zeros(3),
        clockwise=False,
        backface_culling=view.cull,
        integer_pixel_centers=False,
    )

    def draw() -> Picture:
        image, depth = np.empty((view.size, view.size, 3)), np.empty((view.size, view.size))
        renderScene(scene, 0.0, image, depth)
        return image, depth

    return draw


def _rays(view: View) -> tuple[Floats, Floats]:
    centre = ((np.arange(view.size) + 0.5) / view.size * 2 - 1).astype("f4") * view.half_height
    x, y = np.meshgrid(centre, -centre)
    return x, y


def open3d(view: View) -> Callable[[], Picture]:
    """Embree through Open3D; the tree is built before the time starts."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.core.Tensor(view.vertices), o3d.core.Tensor(view.faces.astype(np.uint32)))
    x, y = _rays(view)
    rays = np.stack((x, y, np.full_like(x, 2), 0 * x, 0 * x, 0 * x - 1), -1)

    def draw() -> Picture:
        hit = scene.cast_rays(o3d.core.Tensor(rays))
        face, uv = hit["primitive_ids"].numpy(), hit["primitive_uvs"].numpy()
        seen = face != scene.INVALID_ID
        corners = view.faces[face[seen]]
        u, v = uv[seen, :1], uv[seen, 1:]
        blend = (view.normals[corners] * np.stack((1 - u - v, u, v), 1)).sum(1)
        normal = np.zeros((view.size, view.size, 3), "f4")
        normal[seen] = blend / np.linalg.norm(blend, axis=1, keepdims=True)
        return normal, hit["t_hit"].numpy()

    return draw


def mitsuba(view: View) -> Callable[[], Picture]:
    """Mitsuba 3's compiled ray caster; the tree is built before the time starts."""
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    mesh = mi.Mesh("mesh", len(view.vertices), len(view.faces), has_vertex_normals=True)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(view.vertices.ravel())
    parameters["vertex_normals"] = mi.Float(view.normals.ravel())
    parameters["faces"] = mi.UInt32(view.faces.astype("u4").ravel())
    parameters.update()
    scene = mi.load_dict({"type": "scene", "mesh": mesh})
    x, y = (mi.Float(axis.ravel()) for axis in _rays(view))

    def draw() -> Picture:
        found = scene.ray_intersect(
            mi.Ray3f(mi.Point3f(x, y, 2), mi.Vector3f(0, 0, -1)), mi.RayFlags.ShadingFrame | mi.RayFlags.Minimal, True
        )
        dr.eval(found.sh_frame.n, found.t, found.prim_index)
        normal = np.array(found.sh_frame.n)
        normal = normal.T if normal.shape[0] == 3 else normal
        np.array(found.prim_index)
        return normal.reshape(view.size, view.size, 3), np.array(found.t).reshape(view.size, view.size)

    return draw


PEERS: dict[str, Callable[[View], Callable[[], Picture]]] = {
    "llvmpipe (OpenGL)": llvmpipe,
    "DEODR": deodr,
    "Open3D (Embree)": open3d,
    "Mitsuba 3 (LLVM)": mitsuba,
}
