"""Speed and accuracy of the renderer beside others, measured in the same run.

    python -m scripts.benchmarks.benchmark_renderer [--sections NAME...] [--quick]

`comparison`: a sphere of 20,480 triangles at 512 x 512 (the target is OpenGL on the processor) and of 327,680 at 1024 x
1024 (the target is Mitsuba), with back faces and without; all renderers use the same vertex normals and run in a
process of their own, since idle threads of one disturb another. `accuracy`: error against time, normals of an analytic
sphere and torus at the points that were drawn, for meshes of several sizes. `costs`: time against triangles from 12 to
5 million and against pixels from 64 to 2048 squared. `batches`: 64 views of 128 x 128, also with gradients. `steps`:
where the time goes. `memory`: the peak of a fresh process over what it held before. Recorded in
results/benchmark_renderer.json, from which `scripts.benchmarks.charts` draws. `peers.py` says how to install the other
renderers.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from statistics import median
from typing import Any, TypedDict

import numpy as np
import torch
import trimesh
from torch import Tensor

from scripts.benchmarks.peers import PEERS, Floats, Picture, View
from scripts.benchmarks.record import record
from scripts.benchmarks.timing import Call, alone, interleave, peak_bytes
from torch_orennayar import Camera, render_normals, vertex_normals
from torch_orennayar.core.progress import track
from torch_orennayar.render import interpolate, raster
from torch_orennayar.render import normal_map as render

HALF_HEIGHT = 1.1
"""Half the height of the orthographic picture; meshes have radius 1."""
OURS, OURS_FRONT = "this package", "this package, front faces"
"""Names of this package in tables: with both sides of faces, and with front faces only."""
RENDERERS = [(OURS, False), (OURS, True), *((name, False) for name in PEERS)]
"""Name, and whether back faces are culled."""
RING, TUBE = 0.7, 0.3
"""Radii of the torus."""
REHEARSAL = 16
"""Size of the picture by which `peak_bytes` loads code before it measures."""
Mesh = tuple[Tensor, Tensor]
Truth = Callable[[Floats], Floats]


class Timed(TypedDict):
    """Times of one renderer's runs and the error of its normals in degrees."""

    triangles: int
    times: list[float]
    ms: float
    degrees: float


def sphere(triangles: int) -> Mesh:
    """An icosphere of about that many triangles: 20 times a power of 4 below a million, else a fine grid."""
    if triangles < 20:
        box = trimesh.creation.box((1.0, 1.0, 1.0))
        return torch.tensor(box.vertices).float(), torch.tensor(box.faces)
    if triangles <= 330_000:
        ball = trimesh.creation.icosphere(round(np.log(triangles / 20) / np.log(4)))
        return torch.tensor(ball.vertices).float(), torch.tensor(ball.faces)
    rows = round((triangles / 4) ** 0.5)
    return revolve(rows, 2 * rows, lambda t, p: torch.stack((t.sin() * p.cos(), t.sin() * p.sin(), t.cos()), -1), np.pi)


def torus(triangles: int) -> Mesh:
    """A grid around a ring, tilted."""
    rows = round((triangles / 4) ** 0.5)

    def place(t: Tensor, p: Tensor) -> Tensor:
        wide = RING + TUBE * t.cos()
        return torch.stack((wide * p.cos(), wide * p.sin(), TUBE * t.sin()), -1)

    vertices, faces = revolve(rows, 2 * rows, place, 2 * np.pi)
    return (vertices.double() @ tilt().T).float().contiguous(), faces.flip(1)


def tilt() -> Tensor:
    """The torus's rotation."""
    return torch.tensor(trimesh.transformations.rotation_matrix(0.9, (1.0, 0.4, 0.2))[:3, :3])


def revolve(rows: int, columns: int, place: Callable[[Tensor, Tensor], Tensor], top: float) -> Mesh:
    """A grid of quadrilaterals over two angles, cut in triangles."""
    t, p = torch.meshgrid(
        torch.linspace(0, top, rows + 1).double(), torch.linspace(0, 2 * np.pi, columns + 1).double(), indexing="ij"
    )
    index = torch.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    a, b, c, d = (i.flatten() for i in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    return place(t, p).reshape(-1, 3).float(), torch.cat((torch.stack((a, b, c), 1), torch.stack((a, c, d), 1)))


def sphere_truth(points: Floats) -> Floats:
    """Normals (N, 3) at points of the unit sphere, or near it."""
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))


def torus_truth(points: Floats) -> Floats:
    """Normals (N, 3) at points of the torus."""
    turn = tilt().numpy()
    own = points @ turn
    ring = own * [1, 1, 0]
    ring *= RING / np.linalg.norm(ring, axis=1, keepdims=True)
    away = own - ring
    return np.asarray((away / np.linalg.norm(away, axis=1, keepdims=True)) @ turn.T)


def error(picture: Picture, truth: Truth) -> float:
    """Mean angle in degrees between drawn and true normals."""
    normal, depth = (np.asarray(p, np.float64) for p in picture)
    seen = np.isfinite(depth) & (depth > 0) & (depth < 3.5) & (np.abs(normal).sum(2) > 0.1)
    centre = ((np.arange(len(depth)) + 0.5) / len(depth) * 2 - 1) * HALF_HEIGHT
    x, y = np.meshgrid(centre, -centre)
    wanted = truth(np.stack((x, y, 2 - depth), -1)[seen])
    drawn = normal[seen] / np.linalg.norm(normal[seen], axis=1, keepdims=True)
    gap = np.linalg.norm(drawn - wanted, axis=1)
    return float(np.degrees(2 * np.arcsin(np.clip(gap / 2, 0, 1))).mean())


def ours(mesh: Mesh, normals: Tensor, size: int, *, cull: str | None = None) -> Callable[[], Picture]:
    """A call that renders everything that a `NormalMap` holds with this package."""
    camera = Camera.orthographic(HALF_HEIGHT)

    def draw() -> Picture:
        seen = render_normals(*mesh, camera, (size, size), vertex_normals=normals, cull=cull)
        return seen.normal[0].permute(1, 2, 0).numpy(), seen.depth[0, 0].numpy()

    return draw


def timed(name: str, shape: str, triangles: int, size: int, cull: bool, runs: int) -> Timed:
    """Time one renderer, in a process of its own."""
    make, truth = (sphere, sphere_truth) if shape == "sphere" else (torus, torus_truth)
    mesh = make(triangles)
    normals = vertex_normals(*mesh)
    if name == OURS:
        call = ours(mesh, normals, size, cull="back" if cull else None)
    else:
        arrays = (mesh[0].numpy(), normals.numpy(), mesh[1].numpy().astype(np.int32))
        call = PEERS[name](View(*arrays, HALF_HEIGHT, size, cull))
    times = interleave({name: call}, runs, warm=3)[name]
    return {"triangles": len(mesh[1]), "times": times, "ms": median(times), "degrees": error(call(), truth)}


def compare(triangles: int, size: int, runs: int, *, cull: bool) -> dict[str, dict[str, float | str]]:
    """Milliseconds of every renderer, each in a process of its own, twice in turn; and ours over each.

    A renderer that could not run has the reason under ``"missing"``.
    """
    taken: dict[str, list[float]] = {}
    found: dict[str, dict[str, float | str]] = {}
    for name in track([OURS, *PEERS] * 2, f"{triangles} triangles, {size} squared"):
        result = alone(timed, name, "sphere", triangles, size, cull, runs)
        if isinstance(result, Exception):
            found[name] = {"missing": str(result)}
        else:
            taken.setdefault(name, []).extend(result["times"])
    for name, times in taken.items():
        low, high = (float(q) for q in np.quantile(times, (0.1, 0.9)))
        over = median(taken[OURS]) / median(times)
        found[name] = {"ms": median(times), "10 %": low, "90 %": high, "ours over it": over}
    return found


def accuracy(runs: int, quick: bool) -> list[dict[str, Any]]:
    """Error and time of every renderer on spheres and tori of several sizes at 512 squared."""
    sizes = (1280, 20_480) if quick else (1280, 20_480, 327_680)
    jobs = [(s, n, name, cull) for s in ("sphere", "torus") for n in sizes for name, cull in RENDERERS]
    rows = []
    for shape, triangles, name, cull in track(jobs, "error and time"):
        result = alone(timed, name, shape, triangles, 512, cull, runs)
        if not isinstance(result, Exception):
            label = OURS_FRONT if cull else name
            rows.append({"shape": shape, "renderer": label} | {k: result[k] for k in ("triangles", "ms", "degrees")})
    return rows


def both_sides(mesh: Mesh, size: int) -> dict[str, Call]:
    """Calls that render with both sides of faces and with front faces only."""
    normals = vertex_normals(*mesh)
    return {"all": ours(mesh, normals, size), "front": ours(mesh, normals, size, cull="back")}


def costs(runs: int, quick: bool) -> dict[str, list[dict[str, float]]]:
    """Milliseconds against triangles at 512 squared, and against pixels with 20,480 triangles."""
    by_triangles, by_pixels = [], []
    for triangles in (
        (12, 1280, 20_480) if quick else (12, 320, 1280, 5120, 20_480, 81_920, 327_680, 1_310_720, 5_000_000)
    ):
        mesh = sphere(triangles)
        few = max(3, runs // 4) if triangles > 1e6 else runs
        times = interleave(both_sides(mesh, 512), few, f"{len(mesh[1])} triangles", warm=1)
        by_triangles.append({"triangles": len(mesh[1])} | {k: median(v) for k, v in times.items()})
    mesh = sphere(20_480)
    for size in (64, 256) if quick else (64, 128, 256, 512, 1024, 2048):
        times = interleave(both_sides(mesh, size), max(3, runs // 2), f"{size} squared", warm=1)
        by_pixels.append({"pixels": size * size} | {k: median(v) for k, v in times.items()})
    return {"triangles": by_triangles, "pixels": by_pixels}


def batches(runs: int) -> dict[str, float]:
    """Milliseconds of 64 views of 128 squared: cameras around one mesh of 5120 faces, and 64 meshes; with gradients."""
    vertices, faces = sphere(5120)
    angle = torch.arange(64) / 64 * 2 * np.pi
    eyes = 3 * torch.stack((angle.sin(), torch.full_like(angle, 0.3), angle.cos()), 1)
    cameras, one = Camera.perspective(0.8, eyes), Camera.perspective(0.8)
    meshes = vertices * torch.linspace(0.8, 1.0, 64)[:, None, None]
    scenes = {"64 cameras": (vertices, cameras), "64 meshes": (meshes, one)}

    def forward(mesh: Tensor, camera: Camera) -> Call:
        return lambda: render_normals(mesh, faces, camera, (128, 128))

    def both(mesh: Tensor, camera: Camera) -> Call:
        leaf = mesh.clone().requires_grad_()
        return lambda: torch.autograd.grad(render_normals(leaf, faces, camera, (128, 128)).normal.sum(), leaf)

    calls = {name: forward(*scene) for name, scene in scenes.items()}
    calls |= {f"{name}, with gradients": both(*scene) for name, scene in scenes.items()}
    return {name: median(t) for name, t in interleave(calls, max(3, runs // 3), "batches").items()}


def shares(mesh: Mesh, size: int, runs: int) -> dict[str, float]:
    """Milliseconds of the steps of one picture."""
    normals, camera = vertex_normals(*mesh), Camera.orthographic(HALF_HEIGHT)
    world = mesh[0].double()[None]
    corners = camera.to_camera_frame(world)
    image = camera.to_image(corners, (size, size))
    x, y, w = image.unbind(2)
    points = raster.Projected(x, y, w, -corners[:, :, 2])
    face = raster.visible_faces(points, mesh[1], (size, size), None, None)
    surface = interpolate.VertexAttributes(corners, image, normals.double()[None], True)
    calls: dict[str, Call] = {
        "whole": lambda: render.render_normals(*mesh, camera, (size, size), vertex_normals=normals),
        "visible faces": lambda: raster.visible_faces(points, mesh[1], (size, size), None, None),
        "normals, depth, weights": lambda: interpolate.interpolate(
            surface, mesh[1], face, (size, size), perspective=False, dtype=torch.float32
        ),
        "vertex normals, where not given": lambda: vertex_normals(*mesh),
    }
    return {name: median(t) for name, t in interleave(calls, runs, "steps").items()}


def drawing(size: int, triangles: int) -> Call:
    """The call whose memory is measured in a fresh process; at `REHEARSAL` size it draws a small mesh."""
    mesh = sphere(triangles if size > REHEARSAL else 80)
    return ours(mesh, vertex_normals(*mesh), size)


def memory(quick: bool) -> dict[str, float | None]:
    """Peak megabytes of a picture, most of them its own maps."""
    found: dict[str, float | None] = {}
    for size, triangles in (
        ((512, 20_480),) if quick else ((512, 20_480), (2048, 20_480), (1024, 1_310_720), (1024, 5_000_000))
    ):
        peak = peak_bytes(drawing, size, triangles)
        found[f"{triangles} triangles, {size} squared"] = None if peak is None else peak / 1e6
    return found


def comparisons(runs: int, quick: bool) -> dict[str, object]:
    """`compare` for the meshes and pictures that targets are set for; printed."""
    found: dict[str, object] = {}
    for triangles, size in ((20_480, 512),) if quick else ((20_480, 512), (327_680, 1024)):
        for cull in (False, True):
            title = f"{triangles} triangles, {size} squared, {'front faces' if cull else 'both sides'}"
            found[title] = rows = compare(triangles, size, runs, cull=cull)
            print(f"\n{title}: milliseconds (10 % to 90 %), and ours over it")
            for name, row in rows.items():
                print(f"  {name:24}" + "  ".join(f"{k} {v:.2f}" for k, v in row.items() if not isinstance(v, str)))
    return found


def main() -> None:
    """Measure, print and record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    sections = ("comparison", "steps", "batches", "memory", "accuracy", "costs")
    parser.add_argument("--sections", nargs="+", choices=sections, default=sections)
    parser.add_argument("--quick", action="store_true", help="few runs of few sizes")
    options = parser.parse_args()
    quick, runs = options.quick, 5 if options.quick else 21
    work: dict[str, Callable[[], object]] = {
        "comparison": lambda: comparisons(runs, quick),
        "steps": lambda: shares(sphere(20_480), 512, runs),
        "batches": lambda: batches(runs),
        "memory": lambda: memory(quick),
        "accuracy": lambda: accuracy(max(3, runs // 3), quick),
        "costs": lambda: costs(runs, quick),
    }
    for title in options.sections:
        found = work[title]()
        if title != "comparison":
            rows: Iterable[object] = found.items() if isinstance(found, dict) else found  # type: ignore[assignment]
            print(f"\n{title}", *rows, sep="\n  ")
        record("benchmark_renderer", {title: found}, quick=[title] if quick else [])


if __name__ == "__main__":
    main()
