"""Make or reuse the project's `.venv`; shared by the scripts beside this file."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CONSTRAINTS = ROOT / "scripts" / "constraints.txt"
MINIMUM = (3, 10)


def prepare(extra: str = "all") -> Path:
    """Install the project with ``extra``, a name of pyproject.toml, unless that was done already; return its python."""
    if sys.version_info < MINIMUM:
        sys.exit(f"Python {MINIMUM[0]}.{MINIMUM[1]} or newer is needed, this is {sys.version.split()[0]}")
    home = ROOT / ".venv"
    python = home / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    wanted = hashlib.sha256((ROOT / "pyproject.toml").read_bytes() + CONSTRAINTS.read_bytes()).hexdigest()
    stamps = [home / f".installed-{name}" for name in (extra, *["test"] * (extra == "all"))]  # test includes all
    if python.exists() and any(s.exists() and s.read_text() == wanted for s in stamps):
        return python
    if not python.exists():
        print("making .venv", flush=True)
        subprocess.run([sys.executable, "-m", "venv", str(home)], check=True)
    pip = [str(python), "-m", "pip", "--disable-pip-version-check", "install", "--quiet", "-c", str(CONSTRAINTS)]
    print("installing (a few minutes the first time)", flush=True)
    subprocess.run([*pip, torch_requirement()], check=True)
    subprocess.run([*pip, "--editable", f"{ROOT}[{extra}]"], check=True)
    (home / f".installed-{extra}").write_text(wanted)
    return python


def torch_requirement() -> str:
    """What pip is asked for first: torch by its exact version, as a looser request may bring gigabytes for GPUs."""
    return next(line for line in CONSTRAINTS.read_text().splitlines() if line.startswith("torch=="))


def run(python: Path, *arguments: str) -> None:
    """Run ``python`` with ``arguments`` in the project's root; leave with its exit status if it fails."""
    status = subprocess.run([str(python), *arguments], cwd=ROOT, check=False).returncode
    if status:
        sys.exit(status)
