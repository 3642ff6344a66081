"""Accuracy of photometric stereo on rendered captures that hold two to eight materials.

    python -m scripts.benchmarks.evaluate_materials [--half tuning|judging] [--count N]

The captures are those of `mixed_captures.py`. Numbers in the solvers were set on the half for tuning; the half for
judging has other shapes, other measured materials and other seeds. The true patches are compared with the map of
materials by the adjusted Rand index. Needs the folder of real data that TORCH_ORENNAYAR_DATA names. What is measured is
recorded in results/evaluate_materials.json.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from unittest.mock import patch

import torch
from torch import Tensor

from scripts.benchmarks.markdown import aligned
from scripts.benchmarks.mixed_captures import MixedCapture, captures
from scripts.benchmarks.record import record
from torch_orennayar import angular_error, photometric_stereo
from torch_orennayar.core.progress import track
from torch_orennayar.stereo import solver

COUNT = 12
"""Captures of a half."""
ONE = "one material"
"""`auto` as it solves captures of one material, without the network."""
METHODS = ("network", ONE, "auto")
"""Solvers that are compared, by their names."""


def agreement(found: Tensor, true: Tensor) -> float:
    """Adjusted Rand index of two labellings (P,): 1 if they are the same up to names, about 0 by chance."""
    table = torch.zeros(int(found.max()) + 1, int(true.max()) + 1, dtype=torch.float64)
    table.index_put_((found, true), torch.ones(len(found), dtype=torch.float64), accumulate=True)

    def pairs(count: Tensor) -> float:
        return float((count * (count - 1) / 2).sum())

    rows, columns, whole = pairs(table.sum(1)), pairs(table.sum(0)), pairs(table.sum().reshape(1))
    chance = rows * columns / whole
    span = (rows + columns) / 2 - chance
    return (pairs(table) - chance) / span if span else 1.0


def measure(case: MixedCapture, method: str) -> dict[str, float]:
    """Mean error in degrees, seconds, and for ``auto`` the number of materials and how well their map agrees."""
    begun = time.perf_counter()
    if method == ONE:
        with patch.object(solver, "choose_mixture", return_value=None):
            found = photometric_stereo(case.images, case.lights, case.mask)
    else:
        found = photometric_stereo(case.images, case.lights, case.mask, model=method)
    seconds = time.perf_counter() - begun
    row = {"mean": angular_error(found.normal, case.normal, case.mask).summary()["mean"], "seconds": seconds}
    if method == "auto":
        label = torch.zeros_like(case.material) if found.material is None else found.material
        row["materials"] = float(label[case.mask].unique().numel())
        row["agreement"] = agreement(label[case.mask], case.material[case.mask])
    return row


def main() -> None:
    """Measure, print and record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--half", choices=("tuning", "judging"), default="judging")
    parser.add_argument("--count", type=int, default=COUNT)
    options = parser.parse_args()
    data = os.environ.get("TORCH_ORENNAYAR_DATA")
    if not data:
        raise SystemExit("TORCH_ORENNAYAR_DATA does not name the folder of real data")
    cases = captures(options.half, Path(data), options.count)
    rows = {case.name: {m: measure(case, m) for m in METHODS} for case in track(cases, options.half, len(cases))}
    body = []
    for name, row in rows.items():
        auto = row["auto"]
        errors = [f"{row[m]['mean']:.2f}" for m in METHODS]
        body.append([name, *errors, f"{auto['materials']:.0f}", f"{auto['agreement']:.2f}", f"{auto['seconds']:.1f}"])
    means = [sum(row[m]["mean"] for row in rows.values()) / len(rows) for m in METHODS]
    body.append(["mean", *(f"{mean:.2f}" for mean in means), "", "", ""])
    print(aligned(["mean error, degrees", *METHODS, "materials", "agreement", "seconds"], body))
    if options.count == COUNT:
        record("evaluate_materials", {options.half: rows})


if __name__ == "__main__":
    main()
