"""Properties and errors of every model in MODELS.

    python -m scripts.benchmarks.evaluate_reflectance [FOLDER]

`properties`, over 100,000 random scenes in float32 (1,000 for the slow `theory`; sigma up to 60 degrees): difference
from `lambert` at sigma = 0, change of f_r when light and view are exchanged, change of shading when the scene is
rotated, and the least and largest directional albedo of a white surface (white furnace). `errors`: RMS and maximum of
the shading Y = pi f_r cos / albedo against the V-cavity theory, over the rows of FOLDER/theory/vcavity_reference.npz
(default: $TORCH_ORENNAYAR_DATA) with sigma from 5 to 60 degrees, without the grazing slice; the noise of the ray tracer
that made them is removed from the RMS with all bounces. Recorded in results/evaluate_reflectance.json. The cost of a
model is measured by benchmark_shading.py.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from scripts.benchmarks.markdown import aligned
from scripts.benchmarks.record import record
from torch_orennayar import MODELS, brdf, directional_albedo, oren_nayar
from torch_orennayar.core.progress import track


def errors(table: dict[str, Tensor]) -> dict[str, dict[str, float]]:
    """RMS against two bounces, RMS and maximum against all bounces, by model."""
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
        result[name] = {
            "RMS, two bounces": two.square().mean().sqrt().item(),
            "RMS": rms_every.item(),
            "maximum": every.abs().max().item(),
        }
    return result


def properties(name: str) -> dict[str, float]:
    """Largest differences at sigma = 0, under exchange and under rotation; range of the white furnace."""
    generator = torch.Generator().manual_seed(0)
    count, cosines, step = (100_000, 20, 5) if name != "theory" else (1_000, 3, 30)
    normal, light, view = (F.normalize(torch.randn(count, 3, generator=generator), dim=1) for _ in range(3))
    albedo = torch.rand(count, 1, generator=generator)
    sigma = torch.rand(count, 1, generator=generator) * math.radians(60)
    turn = torch.linalg.qr(torch.randn(3, 3, generator=generator)).Q
    smooth = oren_nayar(normal, light, view, albedo, 0.0, model=name)
    smooth = smooth - oren_nayar(normal, light, view, albedo, 0.0, model="lambert")
    # Away from the horizon, where f_r may grow without bound.
    high = ((normal * light).sum(1) > 0.02) & ((normal * view).sum(1) > 0.02)
    there = brdf(normal, light, view, albedo, sigma, model=name)
    exchanged = (there - brdf(normal, view, light, albedo, sigma, model=name))[high]
    shading = oren_nayar(normal, light, view, albedo, sigma, model=name)
    rotated = shading - oren_nayar(normal @ turn, light @ turn, view @ turn, albedo, sigma, model=name)
    cosine = torch.linspace(0.05, 1, cosines, dtype=torch.float64)[:, None]
    furnace = directional_albedo(cosine, 1.0, torch.arange(0, 61, step).double().deg2rad(), model=name)
    differences = {"sigma = 0": smooth, "exchange": exchanged, "rotation": rotated}
    return {
        **{title: d.abs().max().item() for title, d in differences.items()},
        "furnace, least": furnace.min().item(),
        "furnace, most": furnace.max().item(),
    }


def main() -> None:
    """Measure, print and record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", default=os.environ.get("TORCH_ORENNAYAR_DATA", ""))
    file = Path(parser.parse_args().folder) / "theory" / "vcavity_reference.npz"
    found = {name: properties(name) for name in track(MODELS, "properties", len(MODELS))}
    print(aligned(["model", *found["lambert"]], [[n, *(f"{v:.3g}" for v in row.values())] for n, row in found.items()]))
    record("evaluate_reflectance", {"properties": found})
    if not file.is_file():
        sys.exit(f"{file} does not exist: pass the folder of reference data, or set TORCH_ORENNAYAR_DATA")
    table = {name: torch.from_numpy(column).double() for name, column in np.load(file).items()}
    off = errors(table)
    print(aligned(["model", *off["lambert"]], [[n, *(f"{v:.4f}" for v in row.values())] for n, row in off.items()]))
    record("evaluate_reflectance", {"errors": off})


if __name__ == "__main__":
    main()
