"""Time and peak memory of `orennayar stereo` on a capture of 24-megapixel photographs that it makes itself.

    python -m scripts.benchmarks.large_capture FOLDER [--lights 20] [--height 4000] [--width 6000] [--model auto]

FOLDER is filled with photographs of a rough ball (3 GB by default) and may be deleted afterwards. Recorded in
results/large_capture.json, a section for each model and size.
"""

from __future__ import annotations

import argparse
import math
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import torch

from scripts.benchmarks.record import record
from scripts.benchmarks.timing import alone
from torch_orennayar import MODELS, linear_to_srgb
from torch_orennayar.core.progress import track
from torch_orennayar.geometry.primitives import Ball, spiral_lights
from torch_orennayar.io.images import write_image

ALBEDO, ROUGHNESS = 0.6, 25
"""Of the ball; degrees."""
NOISE = 0.006
"""Standard deviation of the noise: 1 % of the albedo."""
ROWS = 256
"""Rows of a photograph that are shaded at once."""


def make(folder: Path, lights: int, height: int, width: int) -> None:
    """Write photographs of a rough ball that covers most of the picture."""
    normal, mask = Ball(width / 2, height / 2, 0.48 * width).normals((height, width))
    directions = spiral_lights(lights, math.radians(50))
    vcavity = MODELS["vcavity"].function
    generator = torch.Generator().manual_seed(0)
    for index, light in enumerate(track(directions, "photographs", lights)):
        ci = torch.einsum("chw,c->hw", normal, light).clamp_min(0)
        image = torch.empty(height, width)
        for row in range(0, height, ROWS):
            part = slice(row, row + ROWS)
            co, cosine = normal[2, part].clamp_min(1e-3), ci[part].clamp_min(1e-4)
            rho, sigma = torch.tensor(ALBEDO), torch.tensor(math.radians(ROUGHNESS))
            image[part] = vcavity(cosine, co, light[2].expand_as(co), rho, sigma) * ci[part]
        image += NOISE * torch.randn(image.shape, generator=generator)
        write_image(folder / f"{index:02d}.png", (image.clamp(0, 1) * mask).expand(3, -1, -1), bits=16)
    np.savetxt(folder / "light_directions.txt", directions.numpy(), fmt="%.8f")
    write_image(folder / "mask.png", linear_to_srgb(mask.float()))


def main() -> None:
    """Make the capture if it does not exist, solve it in a process of its own, print and record what that took."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--lights", type=int, default=20)
    parser.add_argument("--height", type=int, default=4000)
    parser.add_argument("--width", type=int, default=6000)
    parser.add_argument("--model", default="auto")
    options = parser.parse_args()
    if not (options.folder / "light_directions.txt").is_file():
        # In a process of its own: a child inherits the peak of its parent.
        failed = alone(make, options.folder, options.lights, options.height, options.width)
        if failed:
            raise SystemExit(str(failed))
    begun = time.perf_counter()
    command = ["stereo", str(options.folder), "-o", str(options.folder / "out"), "--model", options.model]
    subprocess.run([sys.executable, "-m", "torch_orennayar", *command], check=True)
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024**2
    seconds = time.perf_counter() - begun
    print(f"{options.model}: {seconds:.0f} s, peak memory {peak:.2f} GB")
    megapixels = options.height * options.width / 1e6
    row = {"lights": options.lights, "megapixels": megapixels, "model": options.model, "seconds": seconds, "GB": peak}
    record("large_capture", {f"capture, {options.model}, {options.lights} x {megapixels:.3g} megapixels": row})


if __name__ == "__main__":
    main()
