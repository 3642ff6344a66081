"""What `orennayar batch` costs per capture, and from that what many captures cost on many machines.

    python -m scripts.benchmarks.batch_cost CAPTURE [CAPTURE ...] [--tasks 2000]

`capture, NAME`: seconds of one process on one thread, peak memory, bytes read and written, with `lambert` and without a
report. `scheduler`: tasks a second of a Dask scheduler whose workers do nothing. `scale`: calculated from both, not
measured. Recorded in results/batch_cost.json.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from distributed import Client, LocalCluster

from scripts.benchmarks.record import record

CAPTURES, MACHINES, WORKERS = 100_000, 100, 16
"""The case that is calculated: captures, machines, and workers of each, of one thread."""


def size_of(folder: Path) -> int:
    """Bytes of all files below a folder."""
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())


def solve(capture: Path) -> dict[str, float]:
    """Cost of one capture in a process of its own."""
    with tempfile.TemporaryDirectory() as place:
        command = [sys.executable, "-m", "torch_orennayar", "batch", str(capture), "-o", place]
        options = ["--model", "lambert", "--no-report"]
        before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run([*command, *options], check=True, env=os.environ | {"OMP_NUM_THREADS": "1"})
        after, seconds = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - begun
        return {
            "seconds": seconds,
            "processor seconds": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
            "GB": after.ru_maxrss / 1024**2,
            "MB read": size_of(capture) / 1e6,
            "MB written": size_of(Path(place)) / 1e6,
        }


def tasks_per_second(count: int) -> float:
    """Tasks that a scheduler hands out and collects in a second, with two workers that do nothing."""
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        client.gather(client.map(abs, range(10), pure=False))
        begun = time.perf_counter()
        client.gather(client.map(abs, range(count), pure=False))
        return count / (time.perf_counter() - begun)


def scale(costs: dict[str, dict[str, float]], tasks: float) -> dict[str, dict[str, float]]:
    """Hours of `CAPTURES` captures, and the shares of the scheduler and of a file system that they need."""
    rows = {}
    for name, cost in costs.items():
        per_second = MACHINES * WORKERS / cost["processor seconds"]
        rows[name] = {
            "hours": CAPTURES / per_second / 3600,
            "captures per second": per_second,
            "share of the scheduler": per_second / tasks,
            "GB read per second": per_second * cost["MB read"] / 1e3,
            "GB written per second": per_second * cost["MB written"] / 1e3,
            "TB written": CAPTURES * cost["MB written"] / 1e6,
        }
    return rows


def main() -> None:
    """Measure, print and record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", type=Path, nargs="+")
    parser.add_argument("--tasks", type=int, default=2000)
    options = parser.parse_args()
    costs = {capture.name: solve(capture) for capture in options.captures}
    tasks = tasks_per_second(options.tasks)
    sections: dict[str, dict[str, object]] = {
        "captures": {**costs},
        "scheduler": {"tasks per second": tasks},
        "scale": {"captures": CAPTURES, "machines": MACHINES, "workers": WORKERS, "rows": scale(costs, tasks)},
    }
    for title, found in sections.items():
        print(title, *found.items(), sep="\n  ")
    record("batch_cost", sections)


if __name__ == "__main__":
    main()
