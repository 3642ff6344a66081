"""How fast and how exact the renderer is, beside others in the same run.

    python -m scripts.benchmarks.benchmark_renderer [-o FOLDER] [--quick]

Bars: 512 x 512 with 20,480 triangles against OpenGL on the processor, 1024 x 1024 with 327,680 against Mitsuba; all
draw the same sphere with the same vertex normals, with back faces and without, each in a process of its own, since
idle threads of one disturb another. Error against time: normals of an analytic sphere and torus, at the points that
were drawn, for meshes of several sizes. Cost: against triangles from 12 to 5 million, and against pixels from 64 to
2048 squared. Batches: 64 views of 128 x 128, also with gradients. Where the time goes. Memory: the peak of a fresh
process over what it held before. Writes renderer.json, renderer.png and renderer_cost.png. ``peers.py`` says how to
install the others.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
import trimesh
from torch import Tensor

from scripts.benchmarks.peers import PEERS, Picture, View
from scripts.benchmarks.timing import Call, alone, interleave, peak_bytes
from torch_orennayar import Camera, render_normals, vertex_normals
from torch_orennayar.core.progress import track
from torch_orennayar.render import interpolate, raster
from torch_orennayar.render import normal_map as render

HALF_HEIGHT = 1.1
OURS, OURS_FRONT = "this package", "this package, front faces"
RENDERERS = [(OURS, False), (OURS, True), *((name, False) for name in PEERS)]
RING, TUBE = 0.7, 0.3
Mesh = tuple[Tensor, Tensor]
Truth = Callable[[npt.NDArray[np.float64]], npt.NDArray[np.float64]]


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


def sphere_truth(points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Normals (N, 3) at points of the unit sphere, or near it."""
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def torus_truth(points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Normals (N, 3) at points of the torus."""
    turn = tilt().numpy()
    own = points @ turn
    ring = own * [1, 1, 0]
    ring *= RING / np.linalg.norm(ring, axis=1, keepdims=True)
    away = own - ring
    return (away / np.linalg.norm(away, axis=1, keepdims=True)) @ turn.T


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
    """Draw with this package, everything that a `NormalMap` has."""
    camera = Camera.orthographic(HALF_HEIGHT)

    def draw() -> Picture:
        seen = render_normals(*mesh, camera, (size, size), vertex_normals=normals, cull=cull)
        return seen.normal[0].permute(1, 2, 0).numpy(), seen.depth[0, 0].numpy()

    return draw


def timed(name: str, shape: str, triangles: int, size: int, cull: bool, runs: int) -> dict[str, Any]:
    """Milliseconds of one renderer's runs and the error of its normals; meant for a process of its own."""
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


def compare(triangles: int, size: int, runs: int, *, cull: bool) -> tuple[dict[str, Any], dict[str, str]]:
    """Milliseconds of every renderer, each in a process of its own, twice in turn; and ours over each."""
    taken: dict[str, list[float]] = {}
    missing = {}
    for name in track([OURS, *PEERS] * 2, f"{triangles} triangles, {size} squared"):
        result = alone(timed, name, "sphere", triangles, size, cull, runs)
        if isinstance(result, Exception):
            missing[name] = str(result)
        else:
            taken.setdefault(name, []).extend(result["times"])
    found = {}
    for name, times in taken.items():
        low, high = np.quantile(times, (0.1, 0.9))
        over = median(taken[OURS]) / median(times)
        found[name] = {"ms": median(times), "10 %": low, "90 %": high, "ours over it": over}
    return found, missing


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


def costs(runs: int, quick: bool) -> dict[str, list[dict[str, float]]]:
    """Milliseconds against triangles at 512 squared, and against pixels with 20,480 triangles."""
    by_triangles, by_pixels = [], []
    for triangles in (
        (12, 1280, 20_480) if quick else (12, 320, 1280, 5120, 20_480, 81_920, 327_680, 1_310_720, 5_000_000)
    ):
        mesh = sphere(triangles)
        normals = vertex_normals(*mesh)
        times = interleave(
            {"all": ours(mesh, normals, 512), "front": ours(mesh, normals, 512, cull="back")},
            max(3, runs // 4) if triangles > 1e6 else runs,
            f"{len(mesh[1])} triangles",
            warm=1,
        )
        by_triangles.append({"triangles": len(mesh[1])} | {k: median(v) for k, v in times.items()})
    mesh = sphere(20_480)
    normals = vertex_normals(*mesh)
    for size in (64, 256) if quick else (64, 128, 256, 512, 1024, 2048):
        calls: dict[str, Call] = {
            "all": ours(mesh, normals, size),
            "front": ours(mesh, normals, size, cull="back"),
        }
        times = interleave(calls, max(3, runs // 2), f"{size} squared", warm=1)
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
    """For the measurement of memory in a fresh process; ``size`` 16 is its rehearsal."""
    mesh = sphere(triangles if size > 16 else 80)
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


def draw(document: dict[str, Any], folder: Path) -> None:
    """The two figures."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.8), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for axis, shape in zip(axes, ("sphere", "torus"), strict=True):
        rows = [r for r in document["accuracy"] if r["shape"] == shape]
        for name in dict.fromkeys(r["renderer"] for r in rows):
            own = [r for r in rows if r["renderer"] == name]
            style: dict[str, Any] = {"lw": 2.2 if name == OURS else 1.2, "marker": "o", "ms": 4}
            style |= {"color": "#c2571a", "ls": ":" if name == OURS_FRONT else "-"} if "package" in name else {}
            axis.plot([r["ms"] for r in own], [r["degrees"] for r in own], label=name, **style)
        axis.set(
            xscale="log", yscale="log", xlabel="milliseconds, 512 x 512", title=f"{shape}, 1,280 to 327,680 triangles"
        )
        axis.grid(alpha=0.3, which="both")
    axes[0].set_ylabel("mean error of normals, degrees")
    axes[0].legend(fontsize=7)
    figure.savefig(folder / "renderer.png", dpi=130)

    figure = Figure(figsize=(9, 3.6), layout="constrained")
    axes = figure.subplots(1, 2)
    for axis, kind, unit in zip(
        axes, ("triangles", "pixels"), ("triangles at 512 x 512", "pixels, 20,480 triangles"), strict=True
    ):
        rows = document["costs"][kind]
        for key, label, style in (("all", "both sides", "o-"), ("front", "front faces", "o:")):
            axis.plot([r[kind] for r in rows], [r[key] for r in rows], style, color="#c2571a", ms=4, label=label)
        last = rows[-1]
        axis.plot([last[kind] / 30, last[kind]], [last["all"] / 30, last["all"]], color="grey", lw=1, label="linear")
        axis.set(xscale="log", yscale="log", xlabel=unit, ylabel="milliseconds")
        axis.grid(alpha=0.3, which="both")
        axis.legend(fontsize=8)
    figure.savefig(folder / "renderer_cost.png", dpi=130)


def main() -> None:
    """Measure, print, draw, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("out/benchmark"))
    parser.add_argument("--quick", action="store_true", help="few runs of few sizes")
    arguments = parser.parse_args()
    runs = 5 if arguments.quick else 21
    document: dict[str, Any] = {"threads": torch.get_num_threads(), "torch": torch.__version__, "bars": {}}
    print(
        f"{torch.get_num_threads()} threads, torch {torch.__version__}; milliseconds (10 % to 90 %), and ours over it"
    )
    for triangles, size in ((20_480, 512),) if arguments.quick else ((20_480, 512), (327_680, 1024)):
        for cull in (False, True):
            found, missing = compare(triangles, size, runs, cull=cull)
            title = f"{triangles} triangles, {size} squared, {'front faces' if cull else 'both sides'}"
            document["bars"][title], document["missing"] = found, missing
            print(f"\n{title}")
            for name, row in found.items():
                spread = f"({row['10 %']:.1f} to {row['90 %']:.1f})"
                print(f"  {name:24}{row['ms']:8.1f} {spread:20}{row['ours over it']:8.2f}")
    for name, why in document["missing"].items():
        print(f"  {name} left out: {why}")
    document["shares"] = {"20480, 512": shares(sphere(20_480), 512, runs)}
    document["batches"] = batches(runs)
    document["memory_mb"] = memory(arguments.quick)
    for kind in ("shares", "batches", "memory_mb"):
        values = document[kind]["20480, 512"] if kind == "shares" else document[kind]
        print(f"\n{kind}")
        for name, value in values.items():
            print(f"  {name:40}" + ("not measured here" if value is None else f"{value:8.1f}"))
    document["accuracy"] = accuracy(max(3, runs // 3), arguments.quick)
    print("\nnormals: mean error in degrees, milliseconds")
    for row in document["accuracy"]:
        if row["renderer"] in (OURS, OURS_FRONT) or row["triangles"] == 20_480:
            print(f"  {row['shape']:8}{row['triangles']:8} {row['renderer']:26}{row['degrees']:10.6f}{row['ms']:8.1f}")
    document["costs"] = costs(runs, arguments.quick)
    print("\ncost, milliseconds: both sides, front faces")
    for kind, rows in document["costs"].items():
        for row in rows:
            print(f"  {row[kind]:>10.0f} {kind:10}{row['all']:10.1f}{row['front']:10.1f}")
    arguments.output.mkdir(parents=True, exist_ok=True)
    (arguments.output / "renderer.json").write_text(json.dumps(document, indent=1), encoding="utf-8")
    draw(document, arguments.output)
    print(f"\nwrote {arguments.output / 'renderer.json'}, renderer.png, renderer_cost.png")


if __name__ == "__main__":
    main()
