"""Accuracy and speed of photometric stereo on captures with true normals, photographed and rendered.

    python -m scripts.benchmarks.evaluate_stereo [FOLDER...] [--sections NAME...] [--quick]

Sections: `photographs` solves every FOLDER by every method, `rendered` a set of rendered captures (objects x measured
materials x cast shadows, `tests/support/rendered_captures.py`). Beside this package's solvers stand other people's,
written from their papers (`robust_baselines.py`). `few lights` and `wrong calibration` take the second folder, or the
first rendered capture: error with fewer lights, with wrong light directions and with wrong intensities. `confidence`
compares error with predicted error. `near lights`, `light positions`, `two roughnesses` and `light between parts`
render captures of their own; `memory` is the peak of a process that solves a folder. Default: all of them; what is
measured is recorded in results/evaluate_stereo.json section by section. ``--quick`` renders fewer and smaller captures
and draws each set of few lights once.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import torch
import torch.nn.functional as F
from scipy.stats import spearmanr
from torch import Tensor

from scripts.benchmarks.markdown import aligned, mean_of
from scripts.benchmarks.record import record
from scripts.benchmarks.robust_baselines import SOLVERS
from scripts.benchmarks.timing import alone, forget_peak, peak_memory
from tests.support import rendered_captures
from torch_orennayar import (
    Capture,
    CaptureError,
    Reconstruction,
    angular_error,
    find_light_positions,
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
Rows = dict[str, dict[str, object]]
Curves = dict[str, dict[float, float]]
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
"""This package's solvers by the name that tables print."""
SHOWN = ("alumina-oxide", "blue-rubber")
"""Measured materials of the quick set: a glossy one and a rough one."""
LARGEST_CONDITION = 8
"""Condition number above which a random draw of lights does not span space well enough to compare solvers with."""


class Photographs(NamedTuple):
    """Images (K, C, H, W), lights (K, 3), mask (1, H, W) and true normals (3, H, W) of one object."""

    name: str
    images: Tensor
    lights: Tensor
    mask: Tensor
    normal: Tensor

    def error(self, found: Tensor) -> Tensor:
        """Angles in degrees between normals (3, H, W) and the true ones, inside the mask."""
        return angular_error(found, self.normal, self.mask).as_subclass(Tensor)[self.mask]

    def mean_error(self, method: str, images: Tensor | None = None, lights: Tensor | None = None) -> float:
        """Mean error of a method on this object, with other images or lights if given."""
        given = self.images if images is None else images, self.lights if lights is None else lights
        return self.error(METHODS[method](*given, self.mask).normal).nanmean().item()


def from_capture(capture: Capture, folder: str) -> Photographs:
    """A capture with true normals, of a folder."""
    if capture.normal is None:
        raise SystemExit(f"{folder} has no true normals")
    name = Path(folder).name.removesuffix("PNG")
    return Photographs(name, capture.images, capture.lights, capture.mask, capture.normal)


def from_rendered(name: str, capture: rendered_captures.Rendered) -> Photographs:
    """A rendered capture under a name."""
    return Photographs(name, capture.images, capture.lights, capture.mask, capture.normal)


def rendered_set(quick: bool) -> list[Photographs]:
    """Every object in every material, or fewer and smaller ones."""
    objects = rendered_captures.objects()
    materials = {k: v for k, v in rendered_captures.MATERIALS.items() if not quick or k in SHOWN}
    materials |= {
        f"V-cavity {s}": rendered_captures.Surface("vcavity", s, 0.6) for s in ((30,) if quick else (15, 30, 45))
    }
    cases = [(o, m) for o in objects for m in materials]
    return [
        from_rendered(f"{o}, {m}", rendered_captures.capture(objects[o], materials[m], size=64 if quick else 96))
        for o, m in track(cases, "rendering", len(cases))
    ]


def measure(case: Photographs) -> Rows:
    """Errors, seconds and the material chosen, by method."""
    rows: Rows = {}
    for name, solve in METHODS.items():
        begun = time.perf_counter()
        found = solve(case.images, case.lights, case.mask)
        seconds = time.perf_counter() - begun
        error = case.error(found.normal)
        rows[name] = {
            "mean": error.nanmean().item(),
            "median": error.nanmedian().item(),
            "seconds": seconds,
            "model": str(found.model),
            "falloff": found.falloff,
            "exponents": list(found.exponents),
            "roughness": math.degrees(found.roughness.max().item()),
            "findings": [f.code for f in found.report if hasattr(f, "code")],
            "rank": float(spearmanr(found.confidence[case.mask], error, nan_policy="omit")[0]),
        }
    grey = case.images.mean(1)[:, case.mask[0]].T.contiguous()
    for name, solver in SOLVERS.items():
        begun = time.perf_counter()
        normal = torch.zeros_like(case.normal)
        normal[:, case.mask[0]] = F.normalize(solver(grey, case.lights), dim=1).T
        seconds = time.perf_counter() - begun
        error = case.error(normal)
        rows[name] = {"mean": error.nanmean().item(), "median": error.nanmedian().item(), "seconds": seconds}
    return rows


def few_lights(case: Photographs, trials: int) -> Curves:
    """Mean error with K lights drawn at random, over ``trials`` draws."""
    generator = torch.Generator().manual_seed(0)
    curves: Curves = {}
    counts = [k for k in (3, 4, 5, 6, 8, 10, 12, 16, 24, 48, 96) if k <= len(case.lights)]
    draws = {k: [_spread_draw(case.lights, k, generator) for _ in range(trials if k < 48 else 1)] for k in counts}
    for name in ("least squares", "lambert", "network", "auto"):
        curves[name] = {}
        for k in track(counts, f"few lights, {name}", len(counts)):
            errors = []
            for kept in draws[k]:
                with suppress(CaptureError):  # too few lights for this method
                    errors.append(case.mean_error(name, case.images[kept], case.lights[kept]))
            if errors:
                curves[name][k] = sum(errors) / len(errors)
    return curves


def _spread_draw(lights: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """Indices of ``count`` lights that span space."""
    kept = torch.arange(count)
    for _ in range(200):
        kept = torch.randperm(len(lights), generator=generator)[:count]
        if condition(lights[kept]) < LARGEST_CONDITION:
            break
    return kept


def wrong_calibration(case: Photographs) -> Curves:
    """Mean error of `lambert` with wrong directions, with wrong intensities, and with intensities found again."""
    generator = torch.Generator().manual_seed(0)
    turn = torch.randn(case.lights.shape, generator=generator) / math.sqrt(2)
    factor = torch.randn(len(case.lights), generator=generator)
    curves: Curves = {"directions, degrees": {}, "intensities, percent": {}, "intensities found again, percent": {}}
    for off in (0.0, 1.0, 2.0, 5.0, 10.0):
        lights = F.normalize(case.lights + math.radians(off) * turn, dim=1)
        curves["directions, degrees"][off] = case.mean_error("lambert", lights=lights)
    for off in (0.0, 1.0, 5.0, 10.0, 20.0):
        images = case.images * (1 + off / 100 * factor).clamp_min(0.1)[:, None, None, None]
        curves["intensities, percent"][off] = case.mean_error("lambert", images)
        images = images / own_intensities(images, case.lights, case.mask)[:, :, None, None]
        curves["intensities found again, percent"][off] = case.mean_error("lambert", images)
    return curves


def wrong_distance() -> dict[float, float]:
    """Mean error of near-light stereo with the object's distance wrong by so many percent."""
    case, curve = rendered_captures.near_capture(rendered_captures.objects()["bumps"]), {}
    for off in (0.0, 1.0, 2.0, 5.0, 10.0, 20.0):
        found = near_light_stereo(
            case.images, case.positions, case.mask, camera=case.camera, distance=case.distance * (1 + off / 100),
            model="vcavity",
        )  # fmt: skip
        curve[off] = angular_error(found.normal, case.normal, case.mask).summary()["mean"]
    return curve


def light_positions() -> dict[str, dict[str, float]]:
    """Mean error of rough objects under near lights by what is known of these, and how far off their distance is."""
    rows = {}
    for name, mesh in rendered_captures.objects().items():
        case = rendered_captures.near_capture(mesh)
        apart = case.positions + torch.tensor([0.0, 0.0, case.distance])
        lights = F.normalize(apart, dim=1)
        lamps = find_light_positions(case.images, lights, case.mask)
        pixel = 2 * case.distance / (case.camera.focal[0, 1].item() * case.mask.shape[1])
        seen = case.images / lamps.positions.square().sum(1).mean()
        solved = {
            "as distant": photometric_stereo(case.images, lights, case.mask, model="vcavity"),
            "distance found": near_light_stereo(seen, lamps.positions, case.mask, model="vcavity"),
            "positions known": near_light_stereo(
                case.images, case.positions, case.mask, camera=case.camera, distance=case.distance, model="vcavity"
            ),
        }
        errors = {k: angular_error(r.normal, case.normal, case.mask).summary()["mean"] for k, r in solved.items()}
        ratio = lamps.positions.norm(dim=1).mean() * pixel / apart.norm(dim=1).mean()
        rows[name] = errors | {"distance found / true": float(ratio)}
    return rows


def two_roughnesses() -> dict[str, dict[str, float]]:
    """Mean error on objects of two roughnesses, solved with one roughness (`vcavity`) and by `auto`."""
    rows = {}
    for left, right in ((10, 45), (20, 35), (0, 50), (30, 30)):
        case = from_rendered("", rendered_captures.patched_capture(left, right)[0])
        error = {name: METHODS[name](case.images, case.lights, case.mask).normal for name in ("vcavity", "auto")}
        rows[f"{left} and {right} degrees"] = {
            name: angular_error(normal, case.normal, case.mask).summary()["mean"] for name, normal in error.items()
        }
    return rows


def light_between() -> dict[str, dict[str, float]]:
    """Mean error on balls that illuminate each other, and the albedo that is estimated from their light."""
    rows = {}
    for albedo in (0.2, 0.5, 0.8):
        case = from_rendered("", rendered_captures.hollow_capture(rendered_captures.objects()["balls"], albedo))
        row = {m: case.mean_error(m) for m in ("lambert", "auto")}
        interreflected, _ = choose_interreflected_light(case.images, case.lights, case.mask[0], Material(), 0)
        rows[f"albedo {albedo}"] = row | {"albedo found": interreflected.strength if interreflected else 0.0}
    return rows


def calibration(cases: list[Photographs]) -> Curves:
    """RMS error in eight groups of pixels by the error that the confidence of `auto` predicts, degrees."""
    curves = {}
    for case in cases:
        found = METHODS["auto"](case.images, case.lights, case.mask)
        error = case.error(found.normal)
        predicted = 2 * (1 / found.confidence[case.mask].clamp_min(1e-6) - 1).clamp_min(0).sqrt()
        order = predicted.argsort()
        curves[case.name] = {
            predicted[part].median().item(): error[part].square().nanmean().sqrt().item() for part in order.chunk(8)
        }
    return curves


def peak(folder: str) -> float:
    """Peak memory in MB of a process that loads and solves a folder with `auto`."""
    forget_peak()
    case = from_capture(load_capture(folder), folder)
    METHODS["auto"](case.images, case.lights, case.mask)
    return peak_memory() / 2**20


def print_errors(results: dict[str, Rows]) -> None:
    """Mean error by object and method, means over objects, and mean seconds."""
    methods = [*METHODS, *SOLVERS]
    body = [[name, *(f"{rows[m]['mean']:.2f}" for m in methods)] for name, rows in results.items()]
    body += [
        [f"{key} over objects", *(f"{mean_of(results, m, key):.2f}" for m in methods)] for key in ("mean", "seconds")
    ]
    print(aligned(["mean error, degrees", *methods], body))


def solve_all(title: str, cases: list[Photographs], quick: bool) -> None:
    """Solve every case by every method, print, and record: each photographed object as a section of its own."""
    results = {}
    for case in track(cases, title, len(cases)):
        results[case.name] = measure(case)
        if title == "photographs":
            row = {"pixels": int(case.mask.sum()), "lights": len(case.lights), "methods": results[case.name]}
            record("evaluate_stereo", {f"photographs, {case.name}": row})
    print_errors(results)
    if title == "rendered":
        record("evaluate_stereo", {title: results}, quick=[title] if quick else [])


def print_curves(title: str, curves: dict[str, dict[str, float]] | Curves) -> None:
    """One line per curve."""
    print(title)
    for line, curve in curves.items():
        points = ((x if isinstance(x, str) else f"{x:.3g}", y) for x, y in curve.items())
        print(f"  {line:36}" + "  ".join(f"{x}: {y:.2f}" for x, y in points))


ON_FIRST: dict[str, Callable[[Photographs, bool], Curves]] = {
    "few lights": lambda case, quick: few_lights(case, 1 if quick else 3),
    "wrong calibration": lambda case, quick: wrong_calibration(case),
}
"""Curves of one object: the second folder, or the first rendered capture."""
ON_ITS_OWN: dict[str, Callable[[], dict[str, dict[str, float]] | Curves]] = {
    "near lights": lambda: {"distance, percent": wrong_distance()},
    "light positions": light_positions,
    "two roughnesses": two_roughnesses,
    "light between parts": light_between,
}
"""What renders captures of its own."""
SECTIONS = ("photographs", "rendered", *ON_FIRST, *ON_ITS_OWN, "confidence", "memory")
"""What can be measured."""


def main() -> None:
    """Measure, print and record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="*")
    parser.add_argument("--sections", nargs="+", choices=SECTIONS, default=SECTIONS)
    parser.add_argument("--quick", action="store_true", help="fewer and smaller rendered captures")
    options = parser.parse_args()
    wanted, quick = options.sections, options.quick
    real = [from_capture(load_capture(folder), folder) for folder in options.folders]
    rendered = rendered_set(quick) if "rendered" in wanted or not real else []
    if "photographs" in wanted and real:
        solve_all("photographs", real, quick)
    if "rendered" in wanted:
        solve_all("rendered", rendered, quick)
    first = real[1] if len(real) > 1 else (real or rendered)[0]
    where = "" if real else ", rendered"  # curves of rendered captures do not replace those of photographs
    for name in (name for name in ON_FIRST if name in wanted):
        curves = ON_FIRST[name](first, quick)
        print_curves(f"{name}, {first.name}", curves)
        partial = [name + where] if quick and name == "few lights" else []
        record("evaluate_stereo", {name + where: {"object": first.name, "curves": curves}}, quick=partial)
    for name in (name for name in ON_ITS_OWN if name in wanted):
        found = ON_ITS_OWN[name]()
        print_curves(name, found)
        record("evaluate_stereo", {name: found})
    if "confidence" in wanted:
        curves = calibration(real or rendered[:3])
        print_curves("RMS error by predicted error, degrees", curves)
        record("evaluate_stereo", {"confidence" + where: curves})
    if "memory" in wanted and real:
        peaks = {Path(folder).name: alone(peak, folder) for folder in options.folders}
        print("peak memory, MB:", peaks)
        record("evaluate_stereo", {"memory": {"MB": peaks}})


if __name__ == "__main__":
    main()
