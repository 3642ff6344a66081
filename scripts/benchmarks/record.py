"""Results of the benchmarks as small JSON files that tables and charts are made from.

`scripts/benchmarks/results/NAME.json` holds one entry per section: what was measured, and the run that measured it
(commit, date, command, processor, threads, versions). A run writes the sections that it measured and leaves the others
as they are. What a quick run measures on fewer or smaller cases is a section of its own, so it never replaces the full
measurement.
"""

from __future__ import annotations

import json
import math
import os
import platform
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torch_orennayar.core.files import atomic_path

ROOT = Path(__file__).resolve().parents[2]
RESULTS = Path(__file__).resolve().parent / "results"
DIGITS = 8
"""Significant digits of a recorded number: so many more than a table prints that rounding twice does not show."""
PACKAGES = ("torch", "numpy", "scipy", "onnx", "onnxruntime", "opencv-contrib-python-headless", "kornia", "pyamg")
"""Packages whose versions are recorded, where they are installed."""
GENERATED = (
    "scripts/benchmarks/results", "scripts/benchmarks/README.md", "README.md", "examples/guides", ".github",
    "examples/gallery", "scripts/website",
)  # fmt: skip
"""What benchmarks and tables write, or pure documentation: changes there do not make the measured code another one."""
QUICK = " (quick)"
"""Ending of the name of a section that was measured with ``--quick``."""


class NotMeasuredError(LookupError):
    """A section that no run has recorded yet."""


@dataclass(frozen=True)
class Section:
    """One recorded measurement.

    Attributes:
        run: commit, date, command and machine.
        results: what was measured.
    """

    run: dict[str, Any]
    results: Any

    @property
    def source(self) -> str:
        """The command and the machine in one line of Markdown."""
        run = self.run
        commit = f"commit {run['commit'][:10]}" if run["commit"] else "no commit"
        changed = " with changes" if run["changed"] else ""
        threads = f"{run['threads']} thread{'s' * (run['threads'] != 1)}"
        return (
            f"`{run['command']}`\n\n"
            f"<sub>{run['date'][:10]}, {commit}{changed}, {run['processor']}, {threads}, "
            f"torch {run['versions']['torch']}</sub>"
        )


def record(
    name: str, sections: Mapping[str, object], *, quick: Sequence[str] = (), folder: Path = RESULTS, device: str = "cpu"
) -> Path:
    """Write sections of a benchmark's results; sections that are not named here stay as they are.

    Args:
        name: the benchmark's module name.
        sections: what was measured, by section.
        quick: sections that hold less than the full measurement, recorded under their own names.
        folder: where ``NAME.json`` lies.
        device: where tensors lay, ``"cpu"`` or ``"cuda"``.

    Returns:
        The file that was written.
    """
    path = folder / f"{name}.json"
    document, run = _read(path), describe_run(device)
    for title, results in sections.items():
        key = title + QUICK if title in quick else title
        document[key] = {"run": run, "results": simplify(results)}
    text = json.dumps({key: document[key] for key in sorted(document)}, indent=1, ensure_ascii=False, allow_nan=False)
    with atomic_path(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")
    print(f"recorded {', '.join(sections)} in {path}")
    return path


def load_section(name: str, title: str, folder: Path = RESULTS) -> Section:
    """A recorded section: the full measurement, or the quick one where there is no other.

    Raises:
        NotMeasuredError: no run has recorded it.
    """
    path = folder / f"{name}.json"
    document = _read(path)
    for key in (title, title + QUICK):
        if key in document:
            return Section(document[key]["run"], document[key]["results"])
    raise NotMeasuredError(f"{title!r} is not in {path.name}")


def load_sections(name: str, prefix: str, folder: Path = RESULTS) -> dict[str, Section]:
    """All sections called ``"PREFIX, WHAT"``, by WHAT.

    Raises:
        NotMeasuredError: there are none.
    """
    path = folder / f"{name}.json"
    document = _read(path)
    start = f"{prefix}, "
    found = {k.removeprefix(start): Section(v["run"], v["results"]) for k, v in document.items() if k.startswith(start)}
    if not found:
        raise NotMeasuredError(f"no section {start!r} is in {path.name}")
    return found


def _read(path: Path) -> dict[str, Any]:
    """The sections of a file; empty where there is none."""
    document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    return document


def sources(*sections: Section) -> str:
    """`Section.source` of all sections, each different one once."""
    return "\n\n".join(dict.fromkeys(section.source for section in sections))


def describe_run(device: str = "cpu") -> dict[str, object]:
    """Commit, date, command, processor, threads and versions of this process."""
    return {
        "commit": git("rev-parse", "HEAD") or os.environ.get("GIT_COMMIT"),  # a copy without .git is told it
        "changed": bool(git("status", "--porcelain", "--", ".", *(f":(exclude){place}" for place in GENERATED))),
        "date": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "command": command_line(),
        "processor": _processor(device),
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
        "system": f"{platform.system()} {platform.machine()}",
        "versions": {"python": platform.python_version(), **_versions()},
    }


def command_line() -> str:
    """The command that runs this process, with the folder of real data by its variable."""
    specification = getattr(sys.modules["__main__"], "__spec__", None)
    module = specification.name.removesuffix(".__main__") if specification else ""
    begin = f"python -m {module}" if module else f"python {Path(sys.argv[0]).name}"
    data = os.environ.get("TORCH_ORENNAYAR_DATA")
    arguments = [a.replace(data, "$TORCH_ORENNAYAR_DATA") if data else a for a in sys.argv[1:]]
    return " ".join([begin, *arguments])


def simplify(value: object) -> object:
    """``value`` as JSON holds it: numbers to `DIGITS` digits, what is not finite as null, keys as strings."""
    if isinstance(value, Mapping):
        return {_key(key): simplify(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [simplify(each) for each in value]
    if isinstance(value, (float, np.floating)):
        number = float(value)
        return float(f"{number:.{DIGITS}g}") if math.isfinite(number) else None
    if isinstance(value, np.integer):
        return int(value)
    if value is None or isinstance(value, (str, bool, int)):
        return value
    raise TypeError(f"a result of type {type(value).__name__} cannot be recorded")


def _key(key: object) -> str:
    return f"{key:.{DIGITS}g}" if isinstance(key, float) else str(key)


def git(*arguments: str) -> str:
    """What git prints; nothing where it fails or is missing."""
    try:
        answer = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return ""
    return answer.stdout.strip()


def _processor(device: str) -> str:
    """The model's name; that of the GPU where tensors lie there."""
    if device.startswith("cuda"):
        return torch.cuda.get_device_name(device)
    listed = Path("/proc/cpuinfo")
    if listed.exists():
        for line in listed.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _versions() -> dict[str, str]:
    found = {}
    for package in PACKAGES:
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found
