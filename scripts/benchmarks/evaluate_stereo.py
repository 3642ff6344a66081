"""Accuracy and speed of photometric stereo, on captures that come with true normals and on rendered ones.

    python -m scripts.benchmarks.evaluate_stereo [FOLDER...] [--output out/stereo] [--quick]

Per object and method: mean and median angular error, seconds, and what `auto` chose. Without folders,
and with them too, a rendered benchmark (`rendered_captures.py`: objects x measured materials x shadows). Beside this
package's own solvers stand those of others, written from their papers (`robust_baselines.py`). Then, on the first
folder or the first rendered capture: error with few lights, with wrong lights and with wrong intensities, and error
against predicted error. Writes stereo.json and pictures, prints tables.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from scipy.stats import spearmanr
from torch import Tensor

from scripts.benchmarks.robust_baselines import SOLVERS
from scripts.benchmarks.timing import alone, forget_peak, peak_memory
from tests.support import rendered_captures
from torch_orennayar import (
    CaptureError,
    Reconstruction,
    angular_error,
    load_capture,
    near_light_stereo,
    photometric_stereo,
)  # fmt: skip
from torch_orennayar.core.progress import track
from torch_orennayar.stereo.calibrate import own_intensities
from torch_orennayar.stereo.interreflection import choose_interreflected_light
from torch_orennayar.stereo.material import Material
from torch_orennayar.stereo.material_selection import condition

Solve = Callable[[Tensor, Tensor, Tensor], Reconstruction]
METHODS: dict[str, Solve] = {
    "least squares": lambda images, lights, mask: photometric_stereo(
        images, lights, mask, model="lambert", robust=False
    ),
    "lambert": lambda images, lights, mask: photometric_stereo(images, lights, mask, model="lambert"),
    "qualitative": lambda images, lights, mask: photometric_stereo(images, lights, mask, model="qualitative"),
    "vcavity": lambda images, lights, mask: photometric_stereo(images, lights, mask, model="vcavity"),
    "network": lambda images, lights, mask: photometric_stereo(images, lights, mask, model="network"),
    "auto": lambda images, lights, mask: photometric_stereo(images, lights, mask),
}
QUOTED = {
    "ball": {"ST14": 1.74, "neural 2018": 1.47, "CNN-PS": 2.2, "LINO": 1.74},
    "cat": {"ST14": 6.12, "neural 2018": 5.44, "CNN-PS": 4.6, "LINO": 3.38},
    "reading": {"ST14": 13.63, "neural 2018": 11.03, "CNN-PS": 12.6, "LINO": 6.67},
}
"""Mean angular errors in degrees as published: CNN-PS and LINO are trained, the others are not."""
SHOWN = ("alumina-oxide", "blue-rubber", "gold-metallic-paint", "laika_ceiling_paint_18_gray", "satin_white")


class Photographs:
    """Images, lights, mask and truth of one object."""

    def __init__(self, name: str, images: Tensor, lights: Tensor, mask: Tensor, normal: Tensor) -> None:
        self.name, self.images, self.lights, self.mask, self.normal = name, images, lights, mask, normal

    def error(self, found: Reconstruction) -> Tensor:
        """Degrees inside the mask."""
        return angular_error(found.normal, self.normal, self.mask).as_subclass(Tensor)[self.mask]


def from_folder(folder: str) -> Photographs:
    """A capture with true normals."""
    capture = load_capture(folder)
    if capture.normal is None:
        raise SystemExit(f"{folder} has no true normals")
    name = Path(folder).name.removesuffix("PNG")
    return Photographs(name, capture.images, capture.lights, capture.mask, capture.normal)


def rendered_set(quick: bool) -> list[Photographs]:
    """Every object in every material."""
    objects = rendered_captures.objects()
    materials = {k: v for k, v in rendered_captures.MATERIALS.items() if not quick or k in SHOWN[:2]}
    materials |= {
        f"V-cavity {s}": rendered_captures.Surface("vcavity", s, 0.6) for s in ((30,) if quick else (15, 30, 45))
    }
    cases = [(o, m) for o in objects for m in materials]
    found = []
    for o, m in track(cases, "rendering", len(cases)):
        c = rendered_captures.capture(objects[o], materials[m], size=64 if quick else 96)
        found.append(Photographs(f"{o}, {m}", c.images, c.lights, c.mask, c.normal))
    return found


def measure(case: Photographs, methods: dict[str, Solve]) -> dict[str, dict[str, Any]]:
    """Errors, seconds and the material chosen, by method."""
    rows = {}
    for name, solve in methods.items():
        begun = time.perf_counter()
        found = solve(case.images, case.lights, case.mask)
        seconds = time.perf_counter() - begun
        error = case.error(found)
        rows[name] = {
            "mean": error.nanmean().item(),
            "median": error.nanmedian().item(),
            "seconds": seconds,
            "model": found.model,
            "falloff": found.falloff,
            "exponents": list(found.exponents),
            "roughness": math.degrees(found.roughness.max().item()),
            "rank": float(spearmanr(found.confidence[case.mask], error, nan_policy="omit")[0]),
        }
    grey = case.images.mean(1)[:, case.mask[0]].T.contiguous()
    for name, solver in SOLVERS.items():
        begun = time.perf_counter()
        normal = torch.zeros_like(case.normal)
        normal[:, case.mask[0]] = F.normalize(solver(grey, case.lights), dim=1).T
        seconds = time.perf_counter() - begun
        error = angular_error(normal, case.normal, case.mask).as_subclass(Tensor)[case.mask]
        rows[name] = {"mean": error.nanmean().item(), "median": error.nanmedian().item(), "seconds": seconds}
    return rows


def few_lights(case: Photographs, trials: int) -> dict[str, dict[int, float]]:
    """Mean error with K lights drawn at random, over ``trials`` draws."""
    generator = torch.Generator().manual_seed(0)
    curves: dict[str, dict[int, float]] = {}
    counts = [k for k in (3, 4, 5, 6, 8, 10, 12, 16, 24, 48, 96) if k <= len(case.lights)]
    draws = {k: [_spread_draw(case.lights, k, generator) for _ in range(trials if k < 48 else 1)] for k in counts}
    for name in ("least squares", "lambert", "network", "auto"):
        curves[name] = {}
        for k in track(counts, f"few lights, {name}", len(counts)):
            errors = []
            for kept in draws[k]:
                try:
                    found = METHODS[name](case.images[kept], case.lights[kept], case.mask)
                except CaptureError:
                    continue
                errors.append(case.error(found).nanmean().item())
            if errors:
                curves[name][k] = sum(errors) / len(errors)
    return curves


def _spread_draw(lights: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """``count`` lights that span space."""
    for _ in range(200):
        kept = torch.randperm(len(lights), generator=generator)[:count]
        if condition(lights[kept]) < 8:
            break
    return kept


def wrong_calibration(case: Photographs) -> dict[str, dict[float, float]]:
    """Mean error of `lambert` with directions, then intensities, off by so much; and intensities found again."""
    generator = torch.Generator().manual_seed(0)
    turn = torch.randn(case.lights.shape, generator=generator) / math.sqrt(2)
    factor = torch.randn(len(case.lights), generator=generator)
    curves: dict[str, dict[float, float]] = {"directions, degrees": {}, "intensities, percent": {}, "found again": {}}
    for off in (0.0, 1.0, 2.0, 5.0, 10.0):
        lights = F.normalize(case.lights + math.radians(off) * turn, dim=1)
        found = METHODS["lambert"](case.images, lights, case.mask)
        curves["directions, degrees"][off] = case.error(found).nanmean().item()
    for off in (0.0, 1.0, 5.0, 10.0, 20.0):
        images = case.images * (1 + off / 100 * factor).clamp_min(0.1)[:, None, None, None]
        curves["intensities, percent"][off] = (
            case.error(METHODS["lambert"](images, case.lights, case.mask)).nanmean().item()
        )
        images = images / own_intensities(images, case.lights, case.mask)[:, :, None, None]
        curves["found again"][off] = case.error(METHODS["lambert"](images, case.lights, case.mask)).nanmean().item()
    return curves


def wrong_distance() -> dict[float, float]:
    """Mean error of near-light stereo with the object's distance off by so many percent."""
    case, curve = rendered_captures.near_capture(rendered_captures.objects()["bumps"]), {}
    for off in (0.0, 1.0, 2.0, 5.0, 10.0, 20.0):
        found = near_light_stereo(
            case.images, case.positions, case.mask, camera=case.camera, distance=case.distance * (1 + off / 100),
            model="vcavity",
        )  # fmt: skip
        curve[off] = angular_error(found.normal, case.normal, case.mask).summary()["mean"]
    return curve


def two_roughnesses() -> dict[str, dict[str, float]]:
    """Mean error of objects of two roughnesses, solved with one and by `auto`."""
    rows = {}
    for left, right in ((10, 45), (20, 35), (0, 50), (30, 30)):
        case, _ = rendered_captures.patched_capture(left, right)
        rows[f"{left} and {right} degrees"] = {
            name: angular_error(METHODS[name](case.images, case.lights, case.mask).normal, case.normal, case.mask)
            .summary()["mean"]
            for name in ("vcavity", "auto")
        }  # fmt: skip
    return rows


def light_between() -> dict[str, dict[str, float]]:
    """Mean error in degrees on balls that light each other, and the albedo that their hollows tell."""
    rows = {}
    for albedo in (0.2, 0.5, 0.8):
        scene = rendered_captures.hollow_capture(rendered_captures.objects()["balls"], albedo)
        case = Photographs("", scene.images, scene.lights, scene.mask, scene.normal)
        row = {
            m: case.error(METHODS[m](case.images, case.lights, case.mask)).nanmean().item() for m in ("lambert", "auto")
        }
        interreflected, _ = choose_interreflected_light(scene.images, scene.lights, scene.mask[0], Material(), 0)
        rows[f"albedo {albedo}"] = row | {"albedo told": interreflected.strength if interreflected else 0.0}
    return rows


def calibration(cases: list[Photographs]) -> dict[str, dict[float, float]]:
    """RMS error in eight groups of pixels by the error that `auto`'s confidence predicts, degrees."""
    curves = {}
    for case in cases:
        found = METHODS["auto"](case.images, case.lights, case.mask)
        error = case.error(found)
        predicted = 2 * (1 / found.confidence[case.mask].clamp_min(1e-6) - 1).clamp_min(0).sqrt()
        order = predicted.argsort()
        curves[case.name] = {
            predicted[part].median().item(): error[part].square().nanmean().sqrt().item() for part in order.chunk(8)
        }
    return curves


def peak(folder: str) -> float:
    """Peak memory in MB of a process that loads and solves a folder with `auto`."""
    forget_peak()
    case = from_folder(folder)
    METHODS["auto"](case.images, case.lights, case.mask)
    return peak_memory() / 2**20


def draw(path: Path, curves: dict[str, dict[Any, float]], axes: tuple[str, str], *, log: str = "", title: str) -> None:
    """Lines with their names at the end, so that no legend is needed."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axis = figure.subplots()
    for name, curve in curves.items():
        x, y = [float(k) for k in curve], list(curve.values())
        (line,) = axis.plot(x, y, marker="o", markersize=4)
        axis.annotate(name, (x[-1], y[-1]), (5, 3), textcoords="offset points", fontsize=9, color=line.get_color())
    if "x" in log:
        axis.set_xscale("log")
    if "y" in log:
        axis.set_yscale("log")
    if log == "xy":  # what is predicted and what is so
        low, high = axis.get_xlim()
        axis.plot((low, high), (low, high), color="#999", linewidth=0.8, zorder=0)
    axis.set_xlabel(axes[0])
    axis.set_ylabel(axes[1])
    axis.set_title(title, fontsize=10)
    axis.margins(x=0.15)
    axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)


def show(results: dict[str, dict[str, dict[str, Any]]]) -> None:
    """Print errors per object and method, and means."""
    methods = [*METHODS, *SOLVERS]
    print(f"{'mean error, degrees':36}" + "".join(f"{m:>14}" for m in methods) + "  auto chose")
    for name, rows in results.items():
        auto = rows["auto"]
        chosen = f"{auto['model']}" + (f" {auto['roughness']:.0f} deg" if auto["roughness"] else "")
        chosen += f", falloff {auto['falloff']:.2f}" if auto["falloff"] != 1 else ""
        chosen += f", lobes {auto['exponents']}" if auto["exponents"] else ""
        print(f"{name:36}" + "".join(f"{rows[m]['mean']:14.2f}" for m in methods) + f"  {chosen}")
    print(f"{'mean':36}" + "".join(f"{np.mean([r[m]['mean'] for r in results.values()]):14.2f}" for m in methods))
    seconds = {m: np.mean([r[m]["seconds"] for r in results.values()]) for m in methods}
    print(f"{'seconds, mean':36}" + "".join(f"{seconds[m]:14.2f}" for m in methods))


def main() -> None:
    """Measure, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="*")
    parser.add_argument("--output", type=Path, default=Path("out/stereo"))
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    real = [from_folder(folder) for folder in options.folders]
    made = rendered_set(options.quick)
    document: dict[str, Any] = {"quoted": QUOTED}
    for title, cases in (("photographs", real), ("rendered", made)):
        if cases:
            print(title)
            document[title] = {c.name: measure(c, METHODS) for c in track(cases, title, len(cases))}
            show(document[title])
    first = real[1] if len(real) > 1 else (real or made)[0]
    document["few lights"] = few_lights(first, 1 if options.quick else 3)
    document["wrong calibration"] = wrong_calibration(first)
    document["wrong calibration"]["distance of near lights, percent"] = wrong_distance()
    document["two roughnesses"] = two_roughnesses()
    document["light between parts"] = light_between()
    document["confidence"] = calibration(real or made[:3])
    if options.folders:
        document["peak MB"] = {Path(f).name: alone(peak, f) for f in options.folders}
        print("peak memory, MB:", document["peak MB"])
    for name in ("few lights", "wrong calibration", "confidence"):
        print(f"{name} ({first.name})" if name != "confidence" else "RMS error by predicted error, degrees")
        for line, curve in document[name].items():
            print(f"  {line:36}" + "  ".join(f"{x:.3g}: {y:.2f}" for x, y in curve.items()))
    for title in ("two roughnesses", "light between parts"):
        print(f"mean error in degrees, {title}")
        for line, row in document[title].items():
            print(f"  {line:36}" + "  ".join(f"{name}: {value:.2f}" for name, value in row.items()))
    (options.output / "stereo.json").write_text(json.dumps(document, indent=2) + "\n")
    for title, cases in (("photographs", real), ("rendered", made)):
        if cases:
            rows = document[title].values()
            points = {
                m: {float(np.mean([r[m]["seconds"] for r in rows])): float(np.mean([r[m]["mean"] for r in rows]))}
                for m in (*METHODS, *SOLVERS)
            }
            axes = ("seconds, mean over objects", "mean angular error, degrees")
            draw(options.output / f"{title}.png", points, axes, title=title, log="x")
    axes = ("lights", "mean error, degrees")
    draw(options.output / "few_lights.png", document["few lights"], axes, log="x", title=first.name)
    axes = ("off by (degrees or percent)", "mean error, degrees")
    draw(options.output / "wrong_calibration.png", document["wrong calibration"], axes, title=first.name)
    axes = ("predicted error, degrees", "RMS error, degrees")
    draw(options.output / "confidence.png", document["confidence"], axes, log="xy", title="confidence")


if __name__ == "__main__":
    main()
