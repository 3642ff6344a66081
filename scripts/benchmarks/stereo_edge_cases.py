"""What photometric stereo makes of captures that do not determine a surface: an answer, a doubt, or a refusal.

    python -m scripts.benchmarks.stereo_edge_cases

Every case is a rough object (20 degrees of roughness) under 16 lights with 1 % noise, in which one thing is wrong. It
is solved by `auto` under its lights and with the lights unknown. Recorded in results/stereo_edge_cases.json: the mean
error of the normals in degrees and the codes of doubts, or what the error message says was got.
"""

from __future__ import annotations

import argparse
import math
import warnings
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from scripts.benchmarks.record import record
from tests.support import rendered_captures
from torch_orennayar import (
    Camera,
    OrenNayar,
    Reconstruction,
    TorchOrenNayarError,
    angular_error,
    photometric_stereo,
    render_normals,
)
from torch_orennayar.core.progress import track
from torch_orennayar.geometry.primitives import spiral_lights

SIZE, LIGHTS = 64, 16
"""Pixels on a side, and number of photographs."""
ROUGHNESS, ALBEDO, NOISE = math.radians(20), 0.6, 0.01
"""Of every surface, and standard deviation of the noise as a share of white."""
EXPECTED = {
    "model-chosen", "roughness-found", "roughness-map", "falloff-found", "interreflection-kept",
    "interreflection-removed", "lights-found", "brightness-found", "network-beside",
}  # fmt: skip
"""Codes of findings that are no doubts."""


class Case(NamedTuple):
    """Images (K, 1, H, W), lights (K, 3), mask (1, H, W) and true normals (3, H, W)."""

    images: Tensor
    lights: Tensor
    mask: Tensor
    normal: Tensor


def photograph(normal: Tensor, mask: Tensor, lights: Tensor) -> Case:
    """A case without cast shadows."""
    images = OrenNayar("vcavity")(normal[None], lights[None], albedo=ALBEDO, roughness=ROUGHNESS)[0]
    noise = NOISE * torch.randn(images.shape, generator=torch.Generator().manual_seed(0))
    return Case((images + noise).clamp_min(0) * mask, lights, mask, normal)


def cases() -> Iterator[tuple[str, Case]]:
    """By name."""
    objects = rendered_captures.objects()
    bumps, balls = (_seen(objects[name]) for name in ("bumps", "balls"))
    lights = spiral_lights(LIGHTS, math.radians(50))
    usual = photograph(*bumps, lights)
    yield "as usual", usual
    yield "two objects", photograph(*balls, lights)
    one_side = F.normalize(lights + torch.tensor([1.0, 0, 0]), dim=1)
    yield "lights all on one side", photograph(*bumps, one_side)
    yield "lights in one plane", photograph(*bumps, F.normalize(lights * torch.tensor([1.0, 0, 1]), dim=1))
    yield "one light, many times", photograph(*bumps, lights[5:6].repeat(LIGHTS, 1))
    yield "two lights, many times", photograph(*bumps, lights[[4, 11]].repeat(LIGHTS // 2, 1))
    flat = torch.zeros(3, SIZE, SIZE)
    flat[2] = 1
    yield "flat object", photograph(flat, torch.ones(1, SIZE, SIZE, dtype=torch.bool), lights)
    inner = torch.zeros(1, SIZE, SIZE, dtype=torch.bool)
    inner[:, 20:44, 20:44] = True
    yield "no silhouette", usual._replace(mask=inner)
    pixel = torch.zeros(1, SIZE, SIZE, dtype=torch.bool)
    pixel[0, SIZE // 2, SIZE // 2] = True
    yield "one pixel", usual._replace(mask=pixel)
    yield "one photograph black", usual._replace(images=usual.images * (torch.arange(LIGHTS) != 3)[:, None, None, None])
    yield "two photographs swapped", usual._replace(images=usual.images[[1, 0, *range(2, LIGHTS)]])
    yield "all photographs black", usual._replace(images=0 * usual.images)
    yield "all photographs white", usual._replace(images=0 * usual.images + 1)
    yield "not a number in the mask", usual._replace(images=usual.images.where(~pixel, torch.nan))


def _seen(mesh: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    """Normals and mask of a mesh."""
    seen = render_normals(*mesh, Camera.orthographic(1.02), (SIZE, SIZE))
    return seen.normal[0], seen.mask[0]


def outcome(case: Case, solve: Callable[[Case], Reconstruction]) -> dict[str, Any]:
    """The error, the doubts and their number, or the refusal."""
    try:
        found = solve(case)
    except TorchOrenNayarError as refusal:
        return {"refused": f"{refusal.argument}: {refusal.got}"}
    error = angular_error(found.normal, case.normal, case.mask).summary()["mean"]
    doubts = sorted({finding.code for finding in found.report} - EXPECTED)
    return {"normals": error, "findings": doubts}


def main() -> None:
    """Measure, print and record."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    warnings.simplefilter("ignore", UserWarning)  # doubts are among the findings
    rows = {}
    for name, case in track(list(cases()), "captures"):
        known = outcome(case, lambda c: photometric_stereo(c.images, c.lights, c.mask))
        unknown = outcome(case, lambda c: photometric_stereo(c.images, None, c.mask))
        rows[name] = {"known": known, "unknown": unknown}
        print(f"{name}\n  known: {known}\n  unknown: {unknown}")
    record("stereo_edge_cases", {"cases": rows})


if __name__ == "__main__":
    main()
