"""Accuracy of light directions and intensities that are found from photographs.

    python -m scripts.benchmarks.evaluate_calibration

On the real captures that `TORCH_ORENNAYAR_DATA` points at. `directions`: lights from the highlights of UW's chrome ball
against those of the data's file, and both against the lights that explain the shading of the grey ball. `grey ball`:
error of its normals by `auto` with either lights, read as linear and as sRGB, since the camera's response is unknown.
`intensities`: those of DiLiGenT's lights found from each capture against those of its file. Recorded in
results/evaluate_calibration.json.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

import torch
from torch import Tensor

from scripts.benchmarks.record import record
from torch_orennayar import angular_error, load_capture, photometric_stereo
from torch_orennayar.geometry.primitives import Ball
from torch_orennayar.io.ball_photographs import load_ball
from torch_orennayar.stereo.calibrate import find_ball, light_directions, own_intensities

GREY_BALL = Ball(244.5, 144.5, 108.0)
"""Of the photographs in ``uw_psm/gray``, as their description says."""
LEAST_FACING = 0.45
"""Cosine to the view below which pixels of the grey ball are not used to find its lights: they lie near the edge."""
LEAST_BRIGHTNESS = 0.1
"""Share of the brightest pixel below which a pixel counts as shadow."""


def shading_lights(images: Tensor, normal: Tensor, inside: Tensor) -> Tensor:
    """The light that explains each photograph of a matt ball best by Lambert's law, (K, 3)."""
    lights = []
    for image in images.mean(1):
        lit = inside & (image > LEAST_BRIGHTNESS * image.max())
        lights.append(torch.linalg.lstsq(normal[:, lit].T, image[lit]).solution)
    return torch.nn.functional.normalize(torch.stack(lights), dim=1)


def angles(a: Tensor, b: Tensor) -> dict[str, float]:
    """Mean, median and largest angle in degrees between directions (K, 3)."""
    angle = angular_error(a, b, dim=1).as_subclass(Tensor)
    return {"mean": angle.mean().item(), "median": angle.median().item(), "most": angle.max().item()}


def evaluate_balls(folder: Path) -> dict[str, dict[str, dict[str, float]]]:
    """Sections `directions` and `grey ball`."""
    images, mask = load_ball(folder / "chrome", encoding="linear")
    if mask is None:
        raise SystemExit("the chrome ball has no mask.png")
    found = light_directions(images, find_ball(mask))
    normal, ball = GREY_BALL.normals((images.shape[2], images.shape[3]))
    file = folder / "light_directions.txt"
    grey = load_capture(folder / "gray", lights=file, encoding="linear")
    shading = shading_lights(grey.images, normal, (ball & (normal[2:] > LEAST_FACING))[0])
    directions = {
        "chrome ball against the file": angles(found, grey.lights),
        "grey ball's shading against the chrome ball": angles(shading, found),
        "grey ball's shading against the file": angles(shading, grey.lights),
    }
    errors: dict[str, dict[str, float]] = {}
    for encoding in ("linear", "srgb"):
        grey = load_capture(folder / "gray", lights=file, encoding=encoding)
        for name, lights in (("chrome ball", found), ("file", grey.lights)):
            solved = photometric_stereo(grey.images, lights, grey.mask)
            error = angular_error(solved.normal, normal, grey.mask & ball).summary()["mean"]
            errors.setdefault(encoding, {})[name] = error
    return {"directions": directions, "grey ball": errors}


def evaluate_intensities(folder: Path) -> dict[str, dict[str, float]]:
    """Mean relative error of the intensities found, and how much the true ones differ, by object."""
    rows = {}
    for place in sorted(folder.iterdir()):
        capture = load_capture(place)
        raw = capture.images * capture.intensities[:, :, None, None]
        known = capture.intensities.mean(1)
        own = own_intensities(raw, capture.lights, capture.mask)[:, 0]
        off = (own / (known / known.mean()) - 1).abs().mean()
        rows[place.name] = {"error": off.item(), "spread": (known / known.mean()).std().item()}
    return rows


def main() -> None:
    """Measure, print and record."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    place = os.environ.get("TORCH_ORENNAYAR_DATA")
    if not place:
        sys.exit("point TORCH_ORENNAYAR_DATA at the real captures")
    sections = evaluate_balls(Path(place) / "uw_psm") | {"intensities": evaluate_intensities(Path(place) / "diligent")}
    for title, rows in sections.items():
        print(title)
        for name, row in rows.items():
            print(f"  {name:46}" + "  ".join(f"{k} {v:.3f}" for k, v in row.items()))
    record("evaluate_calibration", sections)


if __name__ == "__main__":
    main()
