"""Properties, error and cost of every model in MODELS, as the README and `orennayar info` quote them.

    python scripts/evaluate_reflectance.py [FOLDER]

Properties, over 100,000 random scenes in float32 (1,000 for the slow `theory`; sigma up to 60 degrees): difference from
lambert at sigma = 0, f_r with light and view exchanged, shading of the rotated scene, and a white surface's least and
most directional albedo. Error: RMS and maximum of the shading Y = pi f_r cos / albedo against the V-cavity theory,
over the rows of FOLDER/theory/vcavity_reference.npz (default: $TORCH_ORENNAYAR_DATA) with sigma from 5 to 60 degrees,
grazing slice left out; the ray tracer's own noise is taken out of the all-bounce RMS. Cost: eager forward time of one
megapixel on this machine over that of lambert, medians of interleaved runs. Compiled cost: forward time over the memory
floor, a compiled kernel that reads and writes the same bytes and computes next to nothing, for a picture that may fit
in a processor's cache and for one that does not.
"""

from __future__ import annotations

import functools
import math
import os
import sys
import time
from pathlib import Path
from statistics import median

import numpy as np
import torch
import torch.nn.functional as F
from baselines import memory_floor
from torch import Tensor

from torch_orennayar import MODELS, brdf, directional_albedo, oren_nayar
from torch_orennayar.progress import track

RUNS = 9
SIZE = 1024


def errors(table: dict[str, Tensor]) -> dict[str, tuple[float, float, float]]:
    """RMS against two bounces, RMS and maximum against all bounces, per model."""
    keep = (table["sigma"] > 0.08) & (table["grazing_slice"] == 0)
    t = {name: column[keep] for name, column in table.items()}
    ci, co = t["theta_i"].cos(), t["theta_o"].cos()
    lv = ci * co + t["theta_i"].sin() * t["theta_o"].sin() * t["phi"].cos()
    noise = t["mc_stderr_allbounce"].square().mean()
    result = {}
    for name, model in track(MODELS.items(), "errors", len(MODELS)):
        value = model.function(ci, co, lv, t["rho"], t["sigma"]) / t["rho"] * ci
        two, every = value - t["radiance_2bounce"], value - t["mc_allbounce"]
        rms_every = (every.square().mean() - noise).clamp_min(0).sqrt()
        result[name] = (two.square().mean().sqrt().item(), rms_every.item(), every.abs().max().item())
    return result


def costs() -> dict[str, tuple[float, float, float]]:
    """Eager forward time over lambert's: median, least and most of the interleaved runs."""
    scene, small = random_scene(SIZE), random_scene(32)
    seconds: dict[str, list[float]] = {name: [] for name in MODELS}
    for _ in range(RUNS + 1):
        for name, taken in seconds.items():
            share = (32 / SIZE) ** 2 if name == "theory" else 1
            begun = time.perf_counter()
            oren_nayar(*(small if name == "theory" else scene), model=name)
            taken.append((time.perf_counter() - begun) / share)
    return ratios(seconds, "lambert")


def random_scene(size: int) -> tuple[Tensor, ...]:
    """Normals, light, view, albedo, roughness."""
    generator = torch.Generator().manual_seed(0)
    normal = F.normalize(torch.randn(1, 3, size, size, generator=generator), dim=1)
    light, view = (F.normalize(torch.randn(1, 3, 1, 1, generator=generator), dim=1) for _ in range(2))
    albedo, roughness = (torch.rand(1, 1, size, size, generator=generator) for _ in range(2))
    return normal, light, view, albedo, roughness


def ratios(seconds: dict[str, list[float]], to: str) -> dict[str, tuple[float, float, float]]:
    """Median, least and most of each entry's time over that of ``to`` in the same run, the first two runs left out."""
    result = {}
    for name, taken in seconds.items():
        r = [a / b for a, b in zip(taken, seconds[to], strict=True)][2:]
        result[name] = (median(r), min(r), max(r))
    return result


def compiled_costs(size: int) -> dict[str, tuple[float, float, float]]:
    """Compiled forward time over the floor's: median, least and most of the interleaved runs."""
    torch._dynamo.config.recompile_limit = 100
    calls = {"floor": torch.compile(functools.partial(memory_floor, dim=1), fullgraph=True)}
    for name in set(MODELS) - {"theory"}:
        calls[name] = torch.compile(functools.partial(oren_nayar, model=name), fullgraph=True)
    scene = random_scene(size)
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    with torch.no_grad():
        for _ in range(3 * RUNS):
            for name, call in calls.items():
                begun = time.perf_counter()
                call(*scene)
                seconds[name].append(time.perf_counter() - begun)
    return ratios(seconds, "floor")


def properties(name: str) -> tuple[float, float, float, float, float]:
    """Largest differences at sigma = 0, under exchange and under rotation; white furnace least and most."""
    generator = torch.Generator().manual_seed(0)
    count, cosines, step = (100_000, 20, 5) if name != "theory" else (1_000, 3, 30)
    normal, light, view = (F.normalize(torch.randn(count, 3, generator=generator), dim=1) for _ in range(3))
    albedo = torch.rand(count, 1, generator=generator)
    sigma = torch.rand(count, 1, generator=generator) * math.radians(60)
    turn = torch.linalg.qr(torch.randn(3, 3, generator=generator)).Q
    smooth = oren_nayar(normal, light, view, albedo, 0.0, model=name)
    smooth = smooth - oren_nayar(normal, light, view, albedo, 0.0, model="lambert")
    # Away from the horizon, where f_r itself may grow without bound.
    high = ((normal * light).sum(1) > 0.02) & ((normal * view).sum(1) > 0.02)
    there = brdf(normal, light, view, albedo, sigma, model=name)
    exchanged = (there - brdf(normal, view, light, albedo, sigma, model=name))[high]
    shading = oren_nayar(normal, light, view, albedo, sigma, model=name)
    rotated = shading - oren_nayar(normal @ turn, light @ turn, view @ turn, albedo, sigma, model=name)
    cosine = torch.linspace(0.05, 1, cosines, dtype=torch.float64)[:, None]
    furnace = directional_albedo(cosine, 1.0, torch.arange(0, 61, step).double().deg2rad(), model=name)
    differences = (d.abs().max().item() for d in (smooth, exchanged, rotated))
    return *differences, furnace.min().item(), furnace.max().item()  # type: ignore[return-value]


def print_properties() -> None:
    """One line per model."""
    print(f"{'model':18}{'sigma = 0':>11}{'exchange':>11}{'rotation':>11}  white furnace")
    for name in MODELS:
        smooth, exchanged, rotated, least, most = properties(name)
        print(f"{name:18}{smooth:11.1e}{exchanged:11.1e}{rotated:11.1e}  {least:.3f} to {most:.3f}")


def main() -> None:
    """Print the properties, then error and cost."""
    print_properties()
    print()
    for size in (SIZE, 4 * SIZE):
        print(f"compiled forward over the memory floor at {size} x {size}: median (least to most)")
        for name, (middle, least, most) in sorted(compiled_costs(size).items(), key=lambda item: item[1]):
            print(f"{name:18}{middle:6.2f}  ({least:.2f} to {most:.2f})")
        print()
    place = sys.argv[1] if len(sys.argv) > 1 else os.environ.get("TORCH_ORENNAYAR_DATA", "")
    file = Path(place) / "theory" / "vcavity_reference.npz"
    if not file.is_file():
        sys.exit(f"{file} is not there: pass the folder of reference data, or set TORCH_ORENNAYAR_DATA")
    table = {name: torch.from_numpy(column).double() for name, column in np.load(file).items()}
    measured, cost = errors(table), costs()
    print(f"{'model':18}{'RMS, 2 bounces':>16}{'RMS, all':>10}{'max, all':>10}{'cost':>9}  (least to most)")
    for name, (two, every, most) in measured.items():
        middle, least, highest = cost[name]
        print(f"{name:18}{two:16.4f}{every:10.4f}{most:10.3f}{middle:9.2f}  ({least:.2f} to {highest:.2f})")


if __name__ == "__main__":
    main()
