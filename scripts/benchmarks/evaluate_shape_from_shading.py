"""Accuracy and speed of `shape_from_shading`.

    python -m scripts.benchmarks.evaluate_shape_from_shading [--data FOLDER] [--output out/shape] [--quick]

Made pictures: five surfaces and the meshes of FOLDER/meshes (`height_fields.py`), shaded by the theory, not by the
models that are fitted, with 1 % noise. Real ones, where FOLDER (default: $TORCH_ORENNAYAR_DATA) holds them: single
pictures of DiLiGenT's objects, UW's grey ball, MIT-Berkeley objects, each under lights that are known or, for
MIT-Berkeley, estimated from the truth together with the ambient light. Beside every result stand a plane, the inflated
silhouette, Lambert's and the classic form by the same solver, and "vcavity, ambient found", which is told nothing of
ambient light. Prints tables, writes shape.json, a speed-accuracy chart and a map of failures (light x roughness).
"""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
import scipy.optimize
import torch
from torch import Tensor

from tests.support import height_fields
from tests.support.height_fields import light_at, photograph
from torch_orennayar import angular_error, depth_to_normals, load_capture, photometric_stereo, shape_from_shading
from torch_orennayar.core.progress import track
from torch_orennayar.io.images import read_image
from torch_orennayar.shape import surface_fit
from torch_orennayar.shape.height_field import silhouette_normals

METHODS = (
    *("plane", "inflated", "lambert alone", "classic alone", "vcavity alone", "lambert", "classic", "vcavity"),
    "vcavity, ambient found",
)
"""Solvers called alone believe the picture whatever happens; the others fall back on the silhouette."""
ALBEDO = 0.8


@dataclass(frozen=True)
class Case:
    """A picture with true normals; roughness is what the models with one are told."""

    name: str
    image: Tensor
    light: Tensor
    mask: Tensor
    normal: Tensor
    roughness: float
    albedo: float | None
    contour: bool = True
    ambient: float = 0.0


def solve(case: Case, method: str) -> Tensor:
    """Normals (3, H, W) by one method."""
    mask = case.mask.float()
    if method == "plane":
        return torch.tensor((0.0, 0.0, 1.0)).reshape(3, 1, 1) * mask
    if method == "inflated":
        return silhouette_normals(case.mask)
    name = method.split()[0].rstrip(",")
    model = {"classic": "qualitative"}.get(name, name)
    found = shape_from_shading(
        case.image, case.light, case.mask, albedo=case.albedo, roughness=case.roughness, model=model,
        ambient=None if method.endswith("found") else case.ambient, contour=case.contour,
        silhouette=0.0 if method.endswith("alone") else 0.1,
    )  # fmt: skip
    return found.normal


def measure(case: Case) -> dict[str, dict[str, float]]:
    """Median and mean error and seconds by method."""
    rows = {}
    for method in METHODS:
        begun = time.perf_counter()
        found = solve(case, method)
        seconds = time.perf_counter() - begun
        error = angular_error(found, case.normal.float(), case.mask).summary()
        rows[method] = {"median": error["median"], "mean": error["mean"], "seconds": seconds}
    return rows


def made(size: int, quick: bool, meshes: Path) -> list[Case]:
    """Every surface, and every mesh in a folder, at several roughnesses; light 30 degrees off."""
    light = light_at(30)
    cases = []
    fields = [height_fields.make(name, size) for name in height_fields.SURFACES]
    fields += [height_fields.from_mesh(file, size) for file in sorted(meshes.glob("*.obj"))]
    for field in fields:
        for degrees in (30,) if quick else (0, 15, 30, 45):
            sigma = math.radians(degrees)
            image = photograph(field, light, sigma, albedo=ALBEDO)
            title = f"{field.name}, {degrees} degrees"
            cases.append(Case(title, image, light, field.mask, field.normal, sigma, ALBEDO, field.contour))
    return cases


def real(data: Path, step: int) -> list[Case]:
    """Single photographs, every ``step``-th pixel; albedo is estimated, roughness 0, the grey ball's measured."""
    cases = []
    for name in ("ball", "cat", "reading"):
        capture = load_capture(data / "diligent" / f"{name}PNG")
        if capture.normal is None:
            continue
        off = torch.rad2deg(capture.lights[:, 2].acos())
        index = int((off - 30).abs().argmin())
        image = capture.images[index].mean(0, keepdim=True)
        cases.append(Case(f"DiLiGenT {name}", image, capture.lights[index], capture.mask, capture.normal, 0.0, None))
    capture = load_capture(data / "uw_psm" / "gray", encoding="linear", lights=data / "uw_psm" / "light_directions.txt")
    row, column = torch.meshgrid(*[torch.arange(n).float() for n in capture.mask.shape[1:]], indexing="ij")
    x, y = (column - 244.5) / 108, -(row - 144.5) / 108
    inside = (x * x + y * y < 1)[None]
    normal = torch.stack((x, y, (1 - x * x - y * y).clamp_min(0).sqrt())) * inside
    index = int((torch.rad2deg(capture.lights[:, 2].acos()) - 30).abs().argmin())
    image = capture.images[index].mean(0, keepdim=True)
    roughness = float(photometric_stereo(capture.images, capture.lights, inside, seed=0).roughness[inside].median())
    cases.append(Case("UW grey ball", image, capture.lights[index], inside, normal, roughness, None))
    folders = [folder for folder in sorted((data / "sfs_mit_berkeley").iterdir()) if folder.is_dir()]
    cases += [mit(folder) for folder in folders]
    maps = ("image", "mask", "normal")
    return [replace(c, **{name: getattr(c, name)[:, ::step, ::step] for name in maps}) for c in cases]


def mit(folder: Path) -> Case:
    """One MIT-Berkeley object: the light and ambient light that explain its picture of even albedo best by Lambert."""
    depth = torch.from_numpy(scipy.io.loadmat(folder / "Z.mat")["depth"]).double()[None]
    mask = torch.from_numpy(read_image(folder / "mask.png") > 0)
    mask = (mask if mask.ndim == 2 else mask[..., 0])[None] & depth.isfinite()
    normal = depth_to_normals(depth, mask=mask)
    mask &= (normal != 0).any(0, keepdim=True)
    pixels = read_image(folder / "shading.png").astype(np.float64)
    image = torch.from_numpy(pixels / pixels.max()).reshape(*mask.shape[1:], -1).mean(-1)[None].float()
    seen, brightness = normal[:, mask[0]].numpy(), image[mask].double().numpy()
    start = np.append(np.linalg.lstsq(seen.T, brightness, rcond=None)[0], 0.05)
    light = scipy.optimize.least_squares(lambda x: np.maximum(x[:3] @ seen, 0) + max(x[3], 0) - brightness, start).x
    strength = float(np.linalg.norm(light[:3]))
    direction, ambient = torch.from_numpy(light[:3] / strength).float(), max(float(light[3]) / strength, 0.0)
    return Case(f"MIT-Berkeley {folder.name}", image, direction, mask, normal, 0.0, None, ambient=ambient)


def bumpy(size: int) -> Case:
    """The surface by which methods are timed: a bumpy ellipsoid of roughness 30 degrees, its light 30 degrees off."""
    field, light, sigma = height_fields.make("bumpy ellipsoid", size), light_at(30), math.radians(30)
    return Case("", photograph(field, light, sigma, albedo=ALBEDO), light, field.mask, field.normal, sigma, ALBEDO)


def failures(size: int, quick: bool) -> dict[str, dict[str, float]]:
    """Median error of `vcavity` by slant of the light and roughness, with and without the contour."""
    field = height_fields.make("bumpy ellipsoid", size)
    slants, angles = ((0, 30, 60), (0, 30)) if quick else ((0, 15, 30, 45, 60), (0, 15, 30, 45))
    cells: dict[str, dict[str, float]] = {"contour": {}, "no contour": {}}
    grid = [(c, s, a) for c in cells for s in slants for a in angles]
    for kind, slant, degrees in track(grid, "failure map", len(grid)):
        image = photograph(field, light_at(slant), math.radians(degrees), albedo=ALBEDO)
        case = Case("", image, light_at(slant), field.mask, field.normal, math.radians(degrees), ALBEDO)
        case = replace(case, contour=kind == "contour")
        found = angular_error(solve(case, "vcavity"), field.normal.float(), field.mask).summary()
        cells[kind][f"light {slant}, roughness {degrees}"] = found["median"]
    return cells


def under_ambient(size: int) -> dict[str, dict[str, float]]:
    """Error of `vcavity` with a tenth of the light from all around, which is ignored, told or found."""
    case = bumpy(size)
    case = replace(case, image=case.image + 0.1 * ALBEDO * case.mask, ambient=0.1)
    cases = {"ignored": replace(case, ambient=0.0), "told": case, "found": case}
    rows = {}
    for name, each in cases.items():
        found = solve(each, "vcavity, ambient found" if name == "found" else "vcavity")
        rows[name] = angular_error(found, case.normal.float(), case.mask).summary()
    return rows


def show(results: dict[str, dict[str, dict[str, float]]]) -> None:
    """Median / mean error by case and method, and means over cases."""
    print(f"{'median / mean error, degrees':34}" + "".join(f"{m[-14:]:>15}" for m in METHODS))
    for name, rows in results.items():
        print(f"{name:34}" + "".join(f"{rows[m]['median']:8.2f}/{rows[m]['mean']:6.2f}" for m in METHODS))
    means = {
        m: [float(np.mean([r[m][k] for r in results.values()])) for k in ("median", "mean", "seconds")] for m in METHODS
    }
    print(f"{'mean':34}" + "".join(f"{means[m][0]:8.2f}/{means[m][1]:6.2f}" for m in METHODS))
    print(f"{'seconds':34}" + "".join(f"{means[m][2]:15.2f}" for m in METHODS))


def draw(folder: Path, document: dict[str, Any]) -> None:
    """The speed-accuracy chart and the map of failures."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axis = figure.subplots()
    for steps, row in document["by steps"].items():
        axis.plot(row["seconds"], row["median"], "o", color="#1f77b4")
        axis.annotate(f"{steps} steps", (row["seconds"], row["median"]), (5, 4), textcoords="offset points", fontsize=8)
    for method in METHODS[1:-2]:
        x, y = (document["made"]["bumpy ellipsoid, 30 degrees"][method][k] for k in ("seconds", "median"))
        axis.plot(x, y, "s", color="#888")
        axis.annotate(method, (x, y), (5, 4), textcoords="offset points", fontsize=8)
    axis.set(xscale="log", yscale="log", xlabel="seconds", ylabel="median error, degrees")
    axis.set_title("bumpy ellipsoid: vcavity by L-BFGS steps per level, and the others", fontsize=10)
    axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(folder / "speed_accuracy.png", dpi=130)

    figure = Figure(figsize=(9, 3.4), layout="constrained")
    for axis, (kind, cells) in zip(figure.subplots(1, 2), document["failures"].items(), strict=True):
        slants = sorted({int(k.split()[1].rstrip(",")) for k in cells})
        angles = sorted({int(k.split()[3]) for k in cells})
        values = np.array([[cells[f"light {s}, roughness {a}"] for a in angles] for s in slants])
        axis.imshow(values, cmap="viridis", vmin=0, vmax=20, aspect="auto")
        for i, j in np.ndindex(values.shape):
            axis.text(j, i, f"{values[i, j]:.1f}", ha="center", va="center", color="w" if values[i, j] < 12 else "k")
        axis.set_xticks(range(len(angles)), [f"{a}°" for a in angles])
        axis.set_yticks(range(len(slants)), [f"{s}°" for s in slants])
        axis.set(xlabel="roughness", ylabel="light off the view", title=f"median error, {kind}")
    figure.savefig(folder / "failures.png", dpi=130)


def by_steps(size: int) -> dict[int, dict[str, float]]:
    """Error and seconds of `vcavity` against steps per level."""
    case = bumpy(size)
    curve, kept = {}, surface_fit.STEPS
    for steps in (10, 20, 40, 100, 250):
        surface_fit.STEPS = steps
        curve[steps] = measure(case)["vcavity"]
    surface_fit.STEPS = kept
    return curve


def main() -> None:
    """Measure, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("TORCH_ORENNAYAR_DATA", "none")))
    parser.add_argument("--output", type=Path, default=Path("out/shape"))
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    size = 128 if options.quick else 256
    document: dict[str, Any] = {}
    for title, cases in (
        ("made", made(size, options.quick, options.data / "meshes")),
        ("real", real(options.data, 2 if options.quick else 1) if (options.data / "diligent").is_dir() else []),
    ):
        if cases:
            print(title)
            document[title] = {c.name: measure(c) for c in track(cases, title, len(cases))}
            show(document[title])
    document["by steps"] = by_steps(size)
    listed = "; ".join(f"{k}: {v['median']:.2f} in {v['seconds']:.1f} s" for k, v in document["by steps"].items())
    print(f"vcavity, median error by steps per level: {listed}")
    document["ambient"] = under_ambient(size)
    listed = "; ".join(f"{k}: {v['median']:.2f} / {v['mean']:.2f}" for k, v in document["ambient"].items())
    print(f"vcavity under ambient light of 0.1, median / mean error: {listed}")
    document["failures"] = failures(128, options.quick)
    for kind, cells in document["failures"].items():
        print(f"median error, {kind}: " + "; ".join(f"{k}: {v:.1f}" for k, v in cells.items()))
    for side in (256, 1024):
        case = bumpy(side)
        begun = time.perf_counter()
        found = angular_error(solve(case, "vcavity"), case.normal.float(), case.mask).summary()
        document[str(side)] = {"seconds": time.perf_counter() - begun, "median": found["median"]}
        print(f"{side} x {side}: {document[str(side)]['seconds']:.1f} s, median {found['median']:.2f} degrees")
    (options.output / "shape.json").write_text(json.dumps(document, indent=2) + "\n")
    draw(options.output, document)


if __name__ == "__main__":
    main()
