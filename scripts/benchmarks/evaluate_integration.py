"""Accuracy, speed and memory of `integrate_normals`.

    python -m scripts.benchmarks.evaluate_integration [FOLDER...] [--output out/integration] [--megapixels 4]

Each FOLDER holds `normal_map.png`, `mask.png`, `K.txt` and `depth_gt.npz` in millimetres. `objects` are the mean
absolute depth error up to scale, that of plain least squares (no depth edges), and what bilateral normal integration is
reported to reach. With $TORCH_ORENNAYAR_DATA set, the `meshes` there are rendered from ten sides too, and `sharpness`
is the error by the constant that was chosen on them. `large` is one map of a number of megapixels. Recorded in
results/evaluate_integration.json; pictures of the errors go to the output folder.
"""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from scripts.benchmarks.record import record
from scripts.benchmarks.timing import alone, forget_peak, peak_memory
from torch_orennayar import Camera, decode_normals, integrate_normals, load_mesh, render_normals
from torch_orennayar.geometry import integrate
from torch_orennayar.io.figures import save_maps
from torch_orennayar.io.images import read_image

QUOTED = {"cat": 0.074, "pot1": 0.635, "reading": 0.257}
"""Millimetres, bilateral normal integration (Cao et al. 2022) as quoted with the data."""
VIEWS = (
    ("stanford-bunny", 23, 17), ("stanford-bunny", 143, 6), ("suzanne", 34, 11), ("suzanne", -52, -11),
    ("teapot", 46, 23), ("teapot", 126, 40), ("spot", 52, 11), ("spot", 149, 17), ("nefertiti", 40, 6),
    ("nefertiti", 103, 11),
)  # fmt: skip
"""Mesh, azimuth and elevation in degrees."""


COARSE = 20_000
"""Faces below which a mesh is subdivided."""


class Case:
    """Normals, mask, camera and true depth of one object."""

    def __init__(self, name: str, normal: Tensor, mask: Tensor, camera: Camera, depth: Tensor) -> None:
        self.name, self.normal, self.mask, self.camera, self.depth = name, normal, mask, camera, depth

    def error(self, found: Tensor) -> Tensor:
        """Absolute error of depth after the best scale, 0 outside the mask."""
        scale = (self.depth[self.mask] / found[self.mask]).median()
        return torch.where(self.mask, (found * scale - self.depth).abs(), 0)


def from_folder(folder: Path) -> Case:
    """A capture with true depth."""
    colours = torch.from_numpy(read_image(folder / "normal_map.png").astype(np.float64) / 65535).permute(2, 0, 1)
    mask = torch.from_numpy(np.asarray(read_image(folder / "mask.png")) > 0)[None]
    depth = torch.from_numpy(np.load(folder / "depth_gt.npz")["depth_gt"])[None].double()
    camera = Camera.from_intrinsics(torch.from_numpy(np.loadtxt(folder / "K.txt")), (mask.shape[1], mask.shape[2]))
    return Case(folder.name, decode_normals(colours), mask, camera, depth)


def from_mesh(file: Path, azimuth: float, elevation: float, size: int = 256) -> Case:
    """A mesh scaled to radius 1, seen from 20 radii away; depth in pixels at that distance."""
    vertices, faces = load_mesh(file, crease=math.pi)
    if len(faces) < COARSE:  # on coarse meshes, smooth normals are not those of the surface
        import trimesh

        fine = trimesh.Trimesh(vertices.numpy(), faces.numpy()).subdivide_loop(2)
        vertices, faces = torch.from_numpy(fine.vertices).to(vertices), torch.from_numpy(fine.faces).to(faces)
    vertices = vertices - (vertices.amax(0) + vertices.amin(0)) / 2
    vertices = vertices / vertices.norm(dim=1).max()
    a, e = math.radians(azimuth), math.radians(elevation)
    eye = (20 * math.sin(a) * math.cos(e), 20 * math.sin(e), 20 * math.cos(a) * math.cos(e))
    camera = Camera.perspective(2 * math.atan(1 / 20), eye=eye)
    seen = render_normals(vertices, faces, camera, (size, size))
    depth = torch.where(seen.mask[0], seen.depth[0].double() * size / 2, 0)
    return Case(f"{file.stem}, {azimuth:.0f} degrees", seen.normal[0].double(), seen.mask[0], camera, depth)


def least_squares(case: Case) -> Tensor:
    """The same equations, all with the same weight."""
    kept = integrate.SHARPNESS, integrate.STEPS, integrate.LAST_STEPS
    integrate.SHARPNESS, integrate.STEPS, integrate.LAST_STEPS = (1e-12, 1e-12), 1, 1
    try:
        return integrate_normals(case.normal, case.mask, camera=case.camera)
    finally:
        integrate.SHARPNESS, integrate.STEPS, integrate.LAST_STEPS = kept


def measure(case: Case) -> dict[str, float]:
    """Errors and seconds."""
    begun = time.perf_counter()
    found = integrate_normals(case.normal, case.mask, camera=case.camera)
    seconds = time.perf_counter() - begun
    error, plain = case.error(found)[case.mask], case.error(least_squares(case))[case.mask]
    return {
        "pixels": int(case.mask.sum()),
        "error": error.mean().item(),
        "median": error.median().item(),
        "least squares": plain.mean().item(),
        "seconds": seconds,
    }


def by_sharpness(cases: Sequence[Case]) -> dict[float, float]:
    """Geometric mean of the errors by the last value of `integrate.SHARPNESS`, which was chosen by it."""
    curve, kept = {}, integrate.SHARPNESS
    for sharpness in (1.0, 2.0, 4.0, 8.0, 16.0, 32.0):
        integrate.SHARPNESS = (kept[0], sharpness)
        errors = [c.error(integrate_normals(c.normal, c.mask, camera=c.camera))[c.mask].mean().item() for c in cases]
        curve[sharpness] = math.exp(float(np.mean(np.log(errors))))
    integrate.SHARPNESS = kept
    return curve


def large(megapixels: float) -> dict[str, float]:
    """Seconds, peak memory in GB and largest error in pixels on a wavy sheet."""
    size = round(math.sqrt(megapixels * 1e6))
    row, column = torch.meshgrid(*[torch.linspace(-1, 1, size, dtype=torch.float64)] * 2, indexing="ij")
    w, amplitude = 4.0, size / 30
    height = amplitude * torch.sin(w * column) * torch.cos(w * row)
    right = 2 / size * amplitude * w * torch.cos(w * column) * torch.cos(w * row)
    down = -2 / size * amplitude * w * torch.sin(w * column) * torch.sin(w * row)
    normal = torch.nn.functional.normalize(torch.stack((-right, down, torch.ones_like(right))), dim=0).float()
    forget_peak()
    begun = time.perf_counter()
    found = integrate_normals(normal)[0]
    seconds = time.perf_counter() - begun
    error = (found - found.mean()) - (height - height.mean())
    memory = peak_memory() / 2**30
    return {"megapixels": megapixels, "seconds": seconds, "GB": memory, "error": error.abs().max().item()}


def measure_all(cases: Sequence[Case]) -> dict[str, dict[str, float]]:
    """Errors and seconds by case; printed."""
    rows = {}
    for case in cases:
        row = rows[case.name] = measure(case)
        print(f"{case.name:30}" + "  ".join(f"{key} {value:.4g}" for key, value in row.items()))
    return rows


def draw_errors(folder: Path, case: Case) -> None:
    """A picture of the depth errors of one object."""
    found = case.error(integrate_normals(case.normal, case.mask, camera=case.camera))
    maps = {"least squares": case.error(least_squares(case)), "integrate_normals": found}
    save_maps(folder / f"{case.name}.png", maps, case.mask, unit="mm", top=2 * found[case.mask].mean().item())


def main() -> None:
    """Measure, print, record and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--output", type=Path, default=Path("out/integration"))
    parser.add_argument("--megapixels", type=float, default=4.0)
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    sections: dict[str, object] = {}
    real = [from_folder(folder) for folder in options.folders]
    if real:
        rows = measure_all(real)
        quoted = {name: {"reported": value} for name, value in QUOTED.items()}
        sections["objects"] = {name: row | quoted.get(name, {}) for name, row in rows.items()}
    meshes = Path(os.environ.get("TORCH_ORENNAYAR_DATA", "none")) / "meshes"
    if meshes.is_dir():
        views = [from_mesh(meshes / f"{name}.obj", *angles) for name, *angles in VIEWS]
        sections["meshes"] = measure_all(views)
        sections["sharpness"] = curve = by_sharpness(views)
        print("geometric mean of the meshes' errors by the last sharpness:", curve)
    sections["large"] = found = alone(large, options.megapixels)
    print("  ".join(f"{key} {value:.4g}" for key, value in found.items()))
    record("evaluate_integration", sections)
    for case in real:
        draw_errors(options.output, case)


if __name__ == "__main__":
    main()
