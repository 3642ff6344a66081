"""Properties and error of every model in MODELS, as the README and `orennayar info` quote them.

    python -m scripts.benchmarks.evaluate_reflectance [FOLDER]

Properties, over 100,000 random scenes in float32 (1,000 for the slow `theory`; sigma up to 60 degrees): difference from
lambert at sigma = 0, f_r with light and view exchanged, shading of the rotated scene, and a white surface's least and
most directional albedo. Error: RMS and maximum of the shading Y = pi f_r cos / albedo against the V-cavity theory,
over the rows of FOLDER/theory/vcavity_reference.npz (default: $TORCH_ORENNAYAR_DATA) with sigma from 5 to 60 degrees,
grazing slice left out; the ray tracer's own noise is taken out of the all-bounce RMS. What the models cost is
benchmark_shading.py's.
"""

from __future__ import annotations

import math
import os
import sys
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from torch_orennayar import MODELS, brdf, directional_albedo, oren_nayar
from torch_orennayar.core.progress import track


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
    """Print the properties, then the errors."""
    print_properties()
    print()
    place = sys.argv[1] if len(sys.argv) > 1 else os.environ.get("TORCH_ORENNAYAR_DATA", "")
    file = Path(place) / "theory" / "vcavity_reference.npz"
    if not file.is_file():
        sys.exit(f"{file} is not there: pass the folder of reference data, or set TORCH_ORENNAYAR_DATA")
    table = {name: torch.from_numpy(column).double() for name, column in np.load(file).items()}
    print(f"{'model':18}{'RMS, 2 bounces':>16}{'RMS, all':>10}{'max, all':>10}")
    for name, (two, every, most) in errors(table).items():
        print(f"{name:18}{two:16.4f}{every:10.4f}{most:10.3f}")


if __name__ == "__main__":
    main()
