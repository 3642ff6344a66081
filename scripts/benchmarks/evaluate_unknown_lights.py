"""What it costs not to know the lights: errors of lights and normals, and seconds, with lights known and found.

    python -m scripts.benchmarks.evaluate_unknown_lights [FOLDER...] [--sections NAME...]

`photographs`: every FOLDER with true normals is solved by `auto` under the lights of its file, under lights found for
equal brightness, and from the photographs as they were taken, under lights whose brightness is found too. `rendered`:
rough objects under 16 lights with cast shadows and 1 % noise, whose brightness differs by 20 % where it is to be found.
`few`: the lights of the second FOLDER found from fewer of its photographs. `wrong`: what is left of errors of a light
file after it was refined. Recorded in results/evaluate_unknown_lights.json.
"""

from __future__ import annotations

import argparse
import math
import time
import warnings
from typing import Any, Literal

import torch
import torch.nn.functional as F
from torch import Tensor

from scripts.benchmarks.evaluate_stereo import Photographs, from_capture, from_rendered
from scripts.benchmarks.record import record
from tests.support import rendered_captures
from torch_orennayar import (
    CaptureError,
    FoundLights,
    find_lights,
    load_capture,
    photometric_stereo,
)
from torch_orennayar.stereo.light_refinement import refine_lights

Row = dict[str, Any]
COUNTS = (6, 8, 10, 12, 16, 24, 48, 96)
"""Numbers of photographs from which lights are found."""
SPREAD = 0.2
"""Standard deviation of the logarithm of the brightness of rendered lights, where it is to be found."""
ROUGHNESSES = (20, 30, 45)
"""Of the rendered objects, degrees."""


def apart(found: Tensor, lights: Tensor) -> float:
    """Mean angle between directions, degrees."""
    cosine = (F.normalize(found.double(), dim=1) * F.normalize(lights.double(), dim=1)).sum(1)
    return float(torch.rad2deg(cosine.clamp(-1, 1).acos()).mean())


def lights_row(found: FoundLights, lights: Tensor, brightness: Tensor) -> Row:
    """Errors of lights found, and what they were expected to be."""
    return {
        "lights": apart(found.directions, lights),
        "expected": found.uncertainty,
        "brightness": float((found.brightness.double() / brightness.double()).log().std()),
        "findings": [finding.code for finding in found.findings],
    }


def solved_row(case: Photographs, images: Tensor, intensities: Literal["equal", "unknown"], gain: Tensor) -> Row:
    """Lights found, then normals under them."""
    begun = time.perf_counter()
    try:
        found = find_lights(images, case.mask, intensities=intensities)
    except CaptureError as refusal:
        return {"refused": refusal.got}
    finding = time.perf_counter() - begun
    divided = images / found.brightness[:, None, None, None]
    solved = photometric_stereo(divided, found.directions, case.mask)
    row = lights_row(found, case.lights, gain)
    error = case.error(solved.normal).nanmean().item()
    roughness = math.degrees(solved.roughness.max().item())
    seconds = time.perf_counter() - begun
    return row | {"normals": error, "roughness": roughness, "finding seconds": finding, "seconds": seconds}


def known_row(case: Photographs) -> Row:
    """Normals under the true lights."""
    begun = time.perf_counter()
    solved = photometric_stereo(case.images, case.lights, case.mask)
    error, roughness = case.error(solved.normal).nanmean().item(), math.degrees(solved.roughness.max().item())
    return {"normals": error, "roughness": roughness, "seconds": time.perf_counter() - begun}


def photographs(folder: str) -> tuple[str, dict[str, Row]]:
    """A capture under known lights, under found ones, and as it was taken."""
    capture = load_capture(folder)
    case = from_capture(capture, folder)
    gain = capture.intensities.mean(1)
    taken = capture.images * capture.intensities[:, :, None, None]
    unequal = find_lights(taken, capture.mask)
    return case.name, {
        "known": known_row(case),
        "equal": solved_row(case, capture.images, "equal", torch.ones(len(gain))),
        "unknown": solved_row(case, taken, "unknown", gain),
        "wrongly equal": lights_row(unequal, capture.lights, gain),
    }


def rendered() -> dict[str, dict[str, Row]]:
    """Rough objects under 16 lights."""
    gain = (SPREAD * torch.randn(16, generator=torch.Generator().manual_seed(1))).exp()
    rows = {}
    for name, mesh in rendered_captures.objects().items():
        for roughness in ROUGHNESSES:
            surface = rendered_captures.Surface("vcavity", roughness, 0.6)
            case = from_rendered(name, rendered_captures.capture(mesh, surface, lights=16, size=128))
            different = case.images * gain[:, None, None, None]
            rows[f"{name}, {roughness} degrees"] = {
                "known": known_row(case),
                "equal": solved_row(case, case.images, "equal", torch.ones(16)),
                "unknown": solved_row(case, different, "unknown", gain),
            }
    return rows


def few(folder: str) -> dict[str, dict[int, float]]:
    """Errors of lights found from K photographs, evenly taken, and of `lambert` under them and under the true ones."""
    capture = load_capture(folder)
    case = from_capture(capture, folder)
    curves: dict[str, dict[int, float]] = {"lights": {}, "expected": {}, "normals": {}, "normals, lights known": {}}
    generator = torch.Generator().manual_seed(0)
    order = torch.randperm(len(case.lights), generator=generator)
    for count in (k for k in COUNTS if k <= len(case.lights)):
        kept = order[:count]
        images, lights = case.images[kept], case.lights[kept]
        known = photometric_stereo(images, lights, case.mask, model="lambert")
        curves["normals, lights known"][count] = case.error(known.normal).nanmean().item()
        try:
            found = find_lights(images, case.mask)
        except CaptureError:
            continue
        solved = photometric_stereo(images, found.directions, case.mask, model="lambert")
        curves["lights"][count] = apart(found.directions, lights)
        curves["expected"][count] = found.uncertainty
        curves["normals"][count] = case.error(solved.normal).nanmean().item()
    return curves


def wrong(folder: str) -> dict[str, dict[str, float]]:
    """Errors of a light file before and after it was refined."""
    capture = load_capture(folder)
    lights = capture.lights
    generator = torch.Generator().manual_seed(0)
    noise = math.radians(5) * torch.randn(lights.shape, generator=generator) / math.sqrt(2)
    cosine, sine = math.cos(math.radians(30)), math.sin(math.radians(30))
    ring = lights @ torch.tensor([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
    one = torch.cat((F.normalize(lights[:1] + torch.tensor([[0.4, -0.3, 0]]), dim=1), lights[1:]))
    given = {
        "right": lights,
        "each wrong by 5 degrees": F.normalize(lights + noise, dim=1),
        "one wrong": one,
        "two swapped": lights[[1, 0, *range(2, len(lights))]],
        "all turned by 30 degrees about the view": ring,
        "in the opposite order": lights.flip(0),
    }
    rows = {}
    for name, value in given.items():
        found = refine_lights(capture.images, value, capture.mask)
        changed = int(((found.directions - value).norm(dim=1) > 0).sum())
        rows[name] = {"given": apart(value, lights), "refined": apart(found.directions, lights), "replaced": changed}
    return rows


SECTIONS = ("photographs", "rendered", "few", "wrong")
"""What can be measured."""


def main() -> None:
    """Measure, print and record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="*")
    parser.add_argument("--sections", nargs="+", choices=SECTIONS, default=SECTIONS)
    options = parser.parse_args()
    warnings.simplefilter("ignore", UserWarning)  # doubts are among the findings
    found: dict[str, Any] = {}
    if "photographs" in options.sections and options.folders:
        found["photographs"] = dict(photographs(folder) for folder in options.folders)
    if "rendered" in options.sections:
        found["rendered"] = rendered()
    for name, measure in (("few", few), ("wrong", wrong)):
        if name in options.sections and options.folders:
            folder = options.folders[min(1, len(options.folders) - 1)]
            found[name] = {"object": folder.rstrip("/").rpartition("/")[2].removesuffix("PNG"), "rows": measure(folder)}
    for section, results in found.items():
        rows = results.get("rows", results)
        print(f"\n{section}")
        for name, row in rows.items():
            print(f"  {name}: {row}")
        record("evaluate_unknown_lights", {section: results})


if __name__ == "__main__":
    main()
