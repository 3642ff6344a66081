"""How much slower this package is on a machine whose processors are taken by other processes.

    python -m scripts.benchmarks.busy [--runs N]

Milliseconds of public functions (median) with no other process, with as many busy ones as there are cores, and with
twice as many. The fair slow-down is that of threads that get their share of the cores and never wait for each other:
(busy processes + threads) / cores. Recorded in results/busy.json.
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from statistics import median

import torch
import torch.nn.functional as F

from scripts.benchmarks.record import record
from scripts.benchmarks.timing import Call, interleave
from torch_orennayar import (
    Camera,
    OrenNayar,
    SyntheticCaptures,
    integrate_normals,
    photometric_stereo,
    render_normals,
    shape_from_shading,
)
from torch_orennayar.geometry.primitives import bumpy_ball, spiral_lights

SIZE = 256
"""Pixels on a side of most pictures."""
SETTLE = 1.0
"""Seconds that busy processes get to start."""


def calls() -> dict[str, Call]:
    """What is measured, by name."""
    vertices, faces = bumpy_ball()
    camera = Camera.orthographic(1.2)
    seen = render_normals(vertices, faces, camera, (SIZE, SIZE))
    normal, mask = seen.normal[0], seen.mask[0]
    layer, lights = OrenNayar("vcavity"), spiral_lights(12, math.radians(50))
    images = layer(normal[None], lights[None], albedo=0.6, roughness=0.4)[0] * mask
    small, inside = F.avg_pool2d(images, 4), F.avg_pool2d(mask.float(), 4) == 1
    captures = SyntheticCaptures("images", size=(64, 64), lights=(4, 4))
    numbers = iter(range(10**9))

    def with_gradients() -> None:
        moved = vertices.clone().requires_grad_()
        render_normals(moved, faces, camera, (SIZE, SIZE)).normal.sum().backward()

    def shading_with_gradients() -> None:
        leaf = normal[None].clone().requires_grad_()
        layer(leaf, lights[None], albedo=0.6, roughness=0.4).sum().backward()

    return {
        "layer": lambda: layer(normal[None], lights[None], albedo=0.6, roughness=0.4),
        "layer, gradients": shading_with_gradients,
        "render_normals": lambda: render_normals(vertices, faces, camera, (SIZE, SIZE)),
        "render_normals, gradients": with_gradients,
        "photometric_stereo, lambert": lambda: photometric_stereo(small, lights, inside, model="lambert"),
        "photometric_stereo, auto": lambda: photometric_stereo(small, lights, inside),
        "integrate_normals": lambda: integrate_normals(normal, mask),
        "shape_from_shading": lambda: shape_from_shading(small[0], lights[0], inside, albedo=0.6, roughness=0.4),
        "SyntheticCaptures": lambda: captures.sample(next(numbers)),
    }


@contextmanager
def busy(count: int) -> Iterator[None]:
    """So many processes that do nothing but compute."""
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    time.sleep(SETTLE if count else 0)
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


def main() -> None:
    """Measure, print and record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=5, help="of every function")
    runs = parser.parse_args().runs
    warnings.simplefilter("ignore", UserWarning)
    cores, threads = os.cpu_count() or 1, torch.get_num_threads()
    measured, times = calls(), {}
    for others in (0, cores, 2 * cores):
        with busy(others):
            taken = interleave(measured, runs, f"{others} others", warm=1)
        times[str(others)] = {name: median(values) for name, values in taken.items()}
    fair = {others: max(1.0, (int(others) + threads) / cores) for others in times}
    for name in measured:
        alone = times["0"][name]
        shares = ", ".join(f"{o} others {times[o][name] / alone:.2f} (fair {fair[o]:.1f})" for o in list(times)[1:])
        print(f"{name}: {alone:.1f} ms, {shares}")
    record("busy", {"slow-down": {"threads": threads, "cores": cores, "fair": fair, "milliseconds": times}})


if __name__ == "__main__":
    main()
