"""Accuracy and speed of `shape_from_shading`.

    python -m scripts.benchmarks.evaluate_shape_from_shading [--data FOLDER] [--sections NAME...] [--quick]

Sections: `surfaces` are pictures of five analytic surfaces and of the meshes of FOLDER/meshes (`height_fields.py`),
shaded by the V-cavity theory rather than by the models that are fitted, with 1 % noise. `pictures` are real: single
photographs of DiLiGenT's objects, UW's grey ball and MIT-Berkeley objects from FOLDER (default: $TORCH_ORENNAYAR_DATA),
each under a light that is known or, for MIT-Berkeley, fitted to the true normals together with the ambient light.
Beside every result stand a plane, the inflated silhouette, the network that the solver starts from, Lambert's and the
classic model by the same solver, and "vcavity, ambient found", not given the ambient light. `steps` gives error and
time by optimiser steps, `ambient` the error under ambient light, `failures` the error by light and roughness, `sizes`
two picture sizes, `counts` the error of 1 to 6 pictures of a surface, by this solver and by photometric stereo.
What is measured is recorded in results/evaluate_shape_from_shading.json. ``--quick`` takes smaller pictures and fewer
roughnesses.
"""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
import scipy.io
import scipy.optimize
import torch
from torch import Tensor

from scripts.benchmarks.evaluate_calibration import GREY_BALL
from scripts.benchmarks.markdown import aligned, mean_of
from scripts.benchmarks.record import record
from tests.support import height_fields
from tests.support.height_fields import light_at, photograph
from torch_orennayar import (
    CaptureError,
    Reconstruction,
    angular_error,
    depth_to_normals,
    load_capture,
    photometric_stereo,
    shape_from_shading,
)
from torch_orennayar.core.progress import track
from torch_orennayar.geometry.height_field import silhouette_normals
from torch_orennayar.io.images import read_image
from torch_orennayar.shape import surface_fit
from torch_orennayar.shape.picture_network import learned_normals

METHODS = (
    *("plane", "inflated", "network", "lambert alone", "classic alone", "vcavity alone", "vcavity, silhouette"),
    *("vcavity", "vcavity, ambient found"),
)
"""Solvers called alone trust the picture everywhere (``silhouette=0``); "vcavity, silhouette" starts from the inflated
silhouette and falls back on it, the others on the normals of the network, which stands for itself too."""
ALBEDO = 0.8
"""Albedo of the analytic surfaces and meshes."""
AMBIENT = 0.1
"""Ambient light of the `ambient` section, as a share of the light."""
FAILURE_SIZE = 128
"""Height and width of the pictures of the `failures` section."""
Rows = dict[str, dict[str, float]]


@dataclass(frozen=True)
class Case:
    """A picture with true normals, and the roughness that rough models are given."""

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
    if method == "network":
        return learned_normals(case.image, case.light.reshape(3, 1, 1), case.mask).normal
    name, alone = method.split()[0].rstrip(","), method.endswith("alone")
    model = {"classic": "qualitative"}.get(name, name)
    found = shape_from_shading(
        case.image, case.light, case.mask, albedo=case.albedo, roughness=case.roughness, model=model,
        ambient=None if method.endswith("found") else case.ambient, contour=case.contour,
        silhouette=0.0 if alone else 0.1, prior="silhouette" if alone or method.endswith("silhouette") else "learned",
    )  # fmt: skip
    return found.normal


def measure(case: Case) -> Rows:
    """Median and mean error and seconds by method."""
    rows = {}
    for method in METHODS:
        begun = time.perf_counter()
        found = solve(case, method)
        seconds = time.perf_counter() - begun
        error = angular_error(found, case.normal.float(), case.mask).summary()
        rows[method] = {"median": error["median"], "mean": error["mean"], "seconds": seconds}
    return rows


def surfaces(size: int, quick: bool, meshes: Path) -> list[Case]:
    """Every surface, and every mesh in a folder, at several roughnesses; light 30 degrees off the view."""
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


def pictures(data: Path, step: int) -> list[Case]:
    """Single photographs, every ``step``-th pixel; albedo is estimated, roughness 0 except for the grey ball."""
    folders = [folder for folder in sorted((data / "sfs_mit_berkeley").iterdir()) if folder.is_dir()]
    cases = [*diligent(data / "diligent"), grey_ball(data / "uw_psm"), *(mit(folder) for folder in folders)]
    maps = ("image", "mask", "normal")
    return [replace(c, **{name: getattr(c, name)[:, ::step, ::step] for name in maps}) for c in cases]


def _light_near(lights: Tensor, degrees: float) -> int:
    """Index of the light whose angle to the view is nearest to ``degrees``."""
    return int((torch.rad2deg(lights[:, 2].acos()) - degrees).abs().argmin())


def diligent(data: Path) -> list[Case]:
    """One photograph each of DiLiGenT's objects, its light about 30 degrees off the view."""
    cases = []
    for name in ("ball", "cat", "reading"):
        capture = load_capture(data / f"{name}PNG")
        if capture.normal is None:
            continue
        index = _light_near(capture.lights, 30)
        image = capture.images[index].mean(0, keepdim=True)
        cases.append(Case(f"DiLiGenT {name}", image, capture.lights[index], capture.mask, capture.normal, 0.0, None))
    return cases


def grey_ball(data: Path) -> Case:
    """One photograph of UW's grey ball; its roughness is measured by photometric stereo on all of them."""
    capture = load_capture(data / "gray", encoding="linear", lights=data / "light_directions.txt")
    normal, inside = GREY_BALL.normals((capture.mask.shape[1], capture.mask.shape[2]))
    index = _light_near(capture.lights, 30)
    image = capture.images[index].mean(0, keepdim=True)
    roughness = float(photometric_stereo(capture.images, capture.lights, inside, seed=0).roughness[inside].median())
    return Case("UW grey ball", image, capture.lights[index], inside, normal, roughness, None)


def mit(folder: Path) -> Case:
    """One MIT-Berkeley object under the light and ambient light that fit its shading best by Lambert's law."""
    depth = torch.from_numpy(scipy.io.loadmat(folder / "Z.mat")["depth"]).double()[None]
    mask = torch.from_numpy(np.asarray(read_image(folder / "mask.png")) > 0)
    mask = (mask if mask.ndim == 2 else mask[..., 0])[None] & depth.isfinite()
    normal = depth_to_normals(depth, mask=mask)
    mask &= (normal != 0).any(0, keepdim=True)
    pixels = read_image(folder / "shading.png").astype(np.float64)
    image = torch.from_numpy(pixels / pixels.max()).reshape(*mask.shape[1:], -1).mean(-1)[None].float()
    seen, brightness = normal[:, mask[0]].numpy(), image[mask].double().numpy()
    start = np.append(np.linalg.lstsq(seen.T, brightness, rcond=None)[0], 0.05)

    def misfit(x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        return np.asarray(np.maximum(x[:3] @ seen, 0) + max(x[3], 0) - brightness)

    light = scipy.optimize.least_squares(misfit, start).x
    strength = float(np.linalg.norm(light[:3]))
    direction, ambient = torch.from_numpy(light[:3] / strength).float(), max(float(light[3]) / strength, 0.0)
    return Case(f"MIT-Berkeley {folder.name}", image, direction, mask, normal, 0.0, None, ambient=ambient)


def bumpy(size: int) -> Case:
    """The surface that methods are timed on: a bumpy ellipsoid of roughness 30 degrees, its light 30 degrees off."""
    field, light, sigma = height_fields.make("bumpy ellipsoid", size), light_at(30), math.radians(30)
    return Case("", photograph(field, light, sigma, albedo=ALBEDO), light, field.mask, field.normal, sigma, ALBEDO)


def by_steps(size: int) -> dict[int, dict[str, float]]:
    """Error and seconds of `vcavity` against optimiser steps per level."""
    case = bumpy(size)
    curve, kept = {}, surface_fit.STEPS
    for steps in (10, 20, 40, 100, 250):
        surface_fit.STEPS = steps
        curve[steps] = measure(case)["vcavity"]
    surface_fit.STEPS = kept
    return curve


def under_ambient(size: int) -> Rows:
    """Error of `vcavity` under ambient light that is ignored, given or estimated; and estimated where there is none."""
    dark = bumpy(size)
    lit = replace(dark, image=dark.image + AMBIENT * ALBEDO * dark.mask, ambient=AMBIENT)
    cases = {"ignored": replace(lit, ambient=0.0), "given": lit, "estimated": lit}
    rows = {}
    for name, case in cases.items():
        found = solve(case, "vcavity, ambient found" if name == "estimated" else "vcavity")
        rows[name] = angular_error(found, case.normal.float(), case.mask).summary()
    return rows


def failures(quick: bool) -> Rows:
    """Median error of `vcavity` by slant of the light and roughness, with and without the contour."""
    field = height_fields.make("bumpy ellipsoid", FAILURE_SIZE)
    slants, angles = ((0, 30, 60), (0, 30)) if quick else ((0, 15, 30, 45, 60), (0, 15, 30, 45))
    cells: Rows = {"contour": {}, "no contour": {}}
    grid = [(c, s, a) for c in cells for s in slants for a in angles]
    for kind, slant, degrees in track(grid, "failure map", len(grid)):
        image = photograph(field, light_at(slant), math.radians(degrees), albedo=ALBEDO)
        case = Case("", image, light_at(slant), field.mask, field.normal, math.radians(degrees), ALBEDO)
        case = replace(case, contour=kind == "contour")
        found = angular_error(solve(case, "vcavity"), field.normal.float(), field.mask).summary()
        cells[kind][f"light {slant}, roughness {degrees}"] = found["median"]
    return cells


def sizes() -> Rows:
    """Seconds and median error of `vcavity` on a small and a large picture."""
    rows = {}
    for side in (256, 1024):
        case = bumpy(side)
        begun = time.perf_counter()
        found = angular_error(solve(case, "vcavity"), case.normal.float(), case.mask).summary()
        rows[str(side)] = {"seconds": time.perf_counter() - begun, "median": found["median"]}
    return rows


COUNTS = (1, 2, 3, 4, 6)
"""Pictures of one surface that are compared."""
AZIMUTHS = (40.0, 160.0, 280.0, 100.0, 220.0, 340.0)
"""Degrees; of the lights of the first pictures, which lie 30 degrees off the view."""


def by_count(data: Path) -> dict[str, Rows]:
    """Mean error by number of pictures, of shape from shading and of photometric stereo, by object."""
    captures: dict[str, tuple[Tensor, Tensor, Tensor, Tensor, float | None, float]] = {}
    sigma, lights = math.radians(30), torch.stack([light_at(30, azimuth) for azimuth in AZIMUTHS])
    fields = [height_fields.make("bumpy ellipsoid", 128)]
    fields += [height_fields.from_mesh(data / "meshes" / f"{name}.obj", 128) for name in ("spot", "stanford-bunny")]
    for field in fields:
        images = torch.stack([photograph(field, light, sigma, albedo=ALBEDO, seed=k) for k, light in enumerate(lights)])
        captures[f"{field.name}, 30 degrees"] = (images, lights, field.mask, field.normal, ALBEDO, sigma)
    for name in ("ball", "cat", "reading"):
        capture = load_capture(data / "diligent" / f"{name}PNG")
        assert capture.normal is not None
        chosen = [int((capture.lights @ light).argmax()) for light in lights]
        images = capture.images[chosen].mean(1, keepdim=True)
        captures[f"DiLiGenT {name}"] = (images, capture.lights[chosen], capture.mask, capture.normal, None, 0.0)
    rows: dict[str, Rows] = {}
    for title, (images, directions, mask, normal, albedo, roughness) in captures.items():
        rows[title] = {}
        for count in COUNTS:
            few, toward = images[:count], directions[:count]
            found = {
                "shape from shading": shape_from_shading(
                    few[None], toward[None], mask[None], albedo=albedo, roughness=roughness
                ).normal[0]
            }
            if count >= 3:
                found["photometric stereo"] = photometric_stereo(few, toward, mask, model="lambert").normal
            rows[title][str(count)] = {
                name: angular_error(n, normal.float(), mask).summary()["mean"] for name, n in found.items()
            }
        print(title, {k: {m: round(e, 2) for m, e in v.items()} for k, v in rows[title].items()}, flush=True)
    return rows


def without_light(data: Path) -> Rows:
    """Error of the light that is found, what is said of it, and the normals' median error with both lights, degrees."""
    rows: Rows = {}
    for case in track(pictures(data, 2), "unknown lights"):
        unknown = partial(
            shape_from_shading, case.image, mask=case.mask, albedo=case.albedo, roughness=case.roughness,
            ambient=case.ambient, model="vcavity",
        )  # fmt: skip
        given = _median(unknown(case.light), case)
        try:
            found = unknown(None)
        except CaptureError:  # the picture does not determine its light
            rows[case.name] = {"given": given}
            continue
        assert found.lights is not None
        (said,) = (note.value or 0.0 for note in found.report if note.code == "light-found")
        off = torch.rad2deg((found.lights[0] @ case.light).clamp(-1, 1).acos())
        rows[case.name] = {"off": float(off), "said": said, "found": _median(found, case), "given": given}
    return rows


def _median(found: Reconstruction, case: Case) -> float:
    return angular_error(found.normal, case.normal.float(), case.mask).summary()["median"]


def measure_all(title: str, cases: list[Case]) -> dict[str, Rows]:
    """Median and mean error and seconds by case and method; printed."""
    results = {c.name: measure(c) for c in track(cases, title, len(cases))}
    body = [[n, *(f"{rows[m]['median']:.2f} / {rows[m]['mean']:.2f}" for m in METHODS)] for n, rows in results.items()]
    means = {key: [mean_of(results, m, key) for m in METHODS] for key in ("median", "mean", "seconds")}
    body.append(["mean", *(f"{a:.2f} / {b:.2f}" for a, b in zip(means["median"], means["mean"], strict=True))])
    body.append(["seconds", *(f"{seconds:.2f}" for seconds in means["seconds"])])
    print(aligned(["median / mean error, degrees", *METHODS], body))
    return results


def main() -> None:
    """Measure, print and record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    sections = ("surfaces", "pictures", "steps", "ambient", "failures", "sizes", "counts", "light")
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("TORCH_ORENNAYAR_DATA", "none")))
    parser.add_argument("--sections", nargs="+", choices=sections, default=sections)
    parser.add_argument("--quick", action="store_true", help="smaller pictures, fewer roughnesses")
    options = parser.parse_args()
    quick, size = options.quick, 128 if options.quick else 256
    work: dict[str, Callable[[], object]] = {
        "surfaces": lambda: measure_all("surfaces", surfaces(size, quick, options.data / "meshes")),
        "pictures": lambda: measure_all("pictures", pictures(options.data, 2 if quick else 1)),
        "steps": lambda: by_steps(size),
        "ambient": lambda: under_ambient(size),
        "failures": lambda: failures(quick),
        "sizes": sizes,
        "counts": lambda: by_count(options.data),
        "light": lambda: without_light(options.data),
    }
    for title in options.sections:
        if title in ("pictures", "counts", "light") and not (options.data / "diligent").is_dir():
            continue
        found = work[title]()
        if title not in ("surfaces", "pictures"):
            print(f"{title}: {found}")
        quickly = [title] if quick and title not in ("sizes", "light") else []
        record("evaluate_shape_from_shading", {title: {"size": size, "found": found}}, quick=quickly)


if __name__ == "__main__":
    main()
