"""How good found lights are, on the real captures that `TORCH_ORENNAYAR_DATA` points at.

    python -m scripts.benchmarks.evaluate_calibration

The UW chrome ball: its lights against the file's, and which of them the grey ball's shading sides with. The grey
ball's normals by `auto` with either, read as linear and as sRGB (the camera's response is unknown). DiLiGenT:
intensities found from each capture itself against the file's.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import torch
from torch import Tensor

from torch_orennayar import angular_error, load_capture, photometric_stereo
from torch_orennayar.geometry.primitives import Ball
from torch_orennayar.io.capture import load_ball
from torch_orennayar.stereo.calibrate import find_ball, light_directions, own_intensities

GREY_BALL = Ball(244.5, 144.5, 108.0)
"""Of the photographs in ``uw_psm/gray``, as their description says."""


def shading_lights(images: Tensor, normal: Tensor, inside: Tensor) -> Tensor:
    """The light that explains each photograph of a matt ball best, by Lambert, (K, 3)."""
    lights = []
    for image in images.mean(1):
        lit = inside & (image > 0.1 * image.max())
        lights.append(torch.linalg.lstsq(normal[:, lit].T, image[lit]).solution)
    return torch.nn.functional.normalize(torch.stack(lights), dim=1)


def main(data: Path) -> None:
    """Print everything."""
    folder = data / "uw_psm"
    images, mask = load_ball(folder / "chrome", encoding="linear")
    if mask is None:
        raise SystemExit("the chrome ball has no mask.png")
    found = light_directions(images, find_ball(mask))
    normal, ball = GREY_BALL.normals((images.shape[2], images.shape[3]))
    file = folder / "light_directions.txt"
    grey = load_capture(folder / "gray", lights=file, encoding="linear")

    def apart(a: Tensor, b: Tensor) -> str:
        angle = angular_error(a, b, dim=1).as_subclass(Tensor)
        return f"mean {angle.mean():.1f}, median {angle.median():.1f}, most {angle.max():.1f} degrees"

    print(f"chrome ball against the file: {apart(found, grey.lights)}")
    shading = shading_lights(grey.images, normal, (ball & (normal[2:] > 0.45))[0])
    print(f"shading of the grey ball against the chrome ball: {apart(shading, found)}")
    print(f"shading of the grey ball against the file: {apart(shading, grey.lights)}")
    for encoding in ("linear", "srgb"):
        grey = load_capture(folder / "gray", lights=file, encoding=encoding)
        for name, lights in (("chrome ball's", found), ("file's", grey.lights)):
            solved = photometric_stereo(grey.images, lights, grey.mask)
            error = angular_error(solved.normal, normal, grey.mask & ball).summary()["mean"]
            print(f"grey ball, {encoding}, the {name} lights: {error:.2f} degrees with {solved.model}")
    for place in sorted((data / "diligent").iterdir()):
        capture = load_capture(place)
        raw = capture.images * capture.intensities[:, :, None, None]
        known = capture.intensities.mean(1)
        own = own_intensities(raw, capture.lights, capture.mask)[:, 0]
        off = (own / (known / known.mean()) - 1).abs().mean()
        print(f"{place.name}: intensities found again within {off:.1%}, spread {(known / known.mean()).std():.0%}")


if __name__ == "__main__":
    if "TORCH_ORENNAYAR_DATA" not in os.environ:
        sys.exit("point TORCH_ORENNAYAR_DATA at the real captures")
    main(Path(os.environ["TORCH_ORENNAYAR_DATA"]))
