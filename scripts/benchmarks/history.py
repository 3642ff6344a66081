"""Recorded figures from release to release, and those that got worse by more than their spread.

    python -m scripts.benchmarks.history [--output out/history]

Reads results/*.json as the tags v* and the working tree have them; before the first release, as the commits have them
that recorded something. Writes history.png and history.md, and ends with status 1 where the last figure is worse than
the best before by more than its spread.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from scripts.benchmarks.markdown import short, table
from scripts.benchmarks.record import ROOT, git

RESULTS = "scripts/benchmarks/results"
WORSE = "worse"
"""Mark of a figure that got worse."""
HEAD = f"""# History

Recorded figures from release to release, or from record to record before the first one: the first, the least and the
last value. A figure is marked `{WORSE}` where the last value is above the least one by more than what differs from run
to run: a hundredth for errors, half for times, which this kind of machine repeats within a factor of 1.5.
"""


class Figure(NamedTuple):
    """A recorded number that should not grow.

    Attributes:
        name: what it is, with its unit.
        path: file without suffix, section and keys of the number.
        spread: share by which it may differ from run to run: 0.01 for errors, which are computed, 0.5 for times, which
            this kind of machine repeats within a factor of 1.5.
    """

    name: str
    path: tuple[str, ...]
    spread: float


ERROR, TIME = 0.01, 0.5
"""Spreads of errors and of times."""
PHOTOGRAPHS = {thing: ("evaluate_stereo", f"photographs, {thing}", "methods") for thing in ("ball", "cat", "reading")}
"""Where the results of an object are."""
ONE_PICTURE = ("evaluate_shape_from_shading", "pictures", "found")
"""Where the results of shape from one picture are, by the photograph's name."""
FIGURES = (
    *(
        Figure(f"`{model}` on {thing}, degrees", (*path, model, "mean"), ERROR)
        for model in ("auto", "network")
        for thing, path in PHOTOGRAPHS.items()
    ),
    Figure("`auto` on cat, seconds", (*PHOTOGRAPHS["cat"], "auto", "seconds"), TIME),
    *(
        Figure(f"one picture of {name}, degrees", (*ONE_PICTURE, name, "vcavity", "median"), ERROR)
        for name in ("DiLiGenT cat", "DiLiGenT reading", "UW grey ball")
    ),
    Figure("`vcavity` against theory, RMS", ("evaluate_reflectance", "errors", "vcavity", "RMS"), ERROR),
    Figure("`integrate_normals` on cat, mm", ("evaluate_integration", "objects", "cat", "error"), ERROR),
    Figure("`integrate_normals` on cat, seconds", ("evaluate_integration", "objects", "cat", "seconds"), TIME),
    Figure("one view of 512², ms", ("benchmark_renderer", "steps", "whole"), TIME),
    Figure("64 views of 128², ms", ("benchmark_renderer", "batches", "64 cameras"), TIME),
)


def revisions() -> list[str]:
    """Tags of releases, else commits that recorded something, oldest first."""
    tags = git("tag", "--list", "v*", "--sort=creatordate").split()
    return tags or git("log", "--reverse", "--first-parent", "--format=%h", "--", RESULTS).split()


def read(revision: str, name: str) -> Mapping[str, Any]:
    """A file of results as a revision has it, or the working tree for ""; empty where there is none."""
    file = f"{RESULTS}/{name}.json"
    text = git("show", f"{revision}:{file}") if revision else (ROOT / file).read_text(encoding="utf-8")
    found: Mapping[str, Any] = json.loads(text) if text else {}
    return found


def value(results: Mapping[str, Any], path: Sequence[str]) -> float | None:
    """The number at a path of section and keys, or None."""
    section, *keys = path
    found: Any = results.get(section, {}).get("results")
    for key in keys:
        found = found.get(key) if isinstance(found, Mapping) else None
    return float(found) if isinstance(found, (int, float)) else None


def collect() -> dict[Figure, dict[str, float]]:
    """Every figure by revision; "" is the working tree, and revisions that repeat the one before are left out."""
    found: dict[Figure, dict[str, float]] = {figure: {} for figure in FIGURES}
    for revision in [*revisions(), ""]:
        files = {name: read(revision, name) for name in {figure.path[0] for figure in FIGURES}}
        for figure, known in found.items():
            number = value(files[figure.path[0]], figure.path[1:])
            if number is not None and number not in list(known.values())[-1:]:
                known[revision] = number
    return found


def worse(figure: Figure, known: Mapping[str, float]) -> bool:
    """Whether the last value is above the least one before by more than the spread."""
    *before, last = known.values()
    return bool(before) and last > (1 + figure.spread) * min(before)


def draw(found: Mapping[Figure, Mapping[str, float]], target: Path) -> None:
    """A small chart per figure; red where it got worse."""
    import matplotlib.pyplot as plt

    chart, axes = plt.subplots(-(-len(found) // 3), 3, figsize=(11, 2 * -(-len(found) // 3)), layout="constrained")
    for axis in axes.flat[len(found) :]:
        axis.axis("off")
    for axis, (figure, known) in zip(axes.flat, found.items(), strict=False):
        axis.plot(
            range(len(known)), list(known.values()), "o-", color="tab:red" if worse(figure, known) else "tab:blue"
        )
        axis.set_title(figure.name.replace("`", ""), fontsize=9)
        axis.set_xticks(range(len(known)), [revision or "now" for revision in known], fontsize=7, rotation=30)
        axis.set_ylim(0, 1.15 * max(known.values(), default=1.0))
    chart.savefig(target)
    plt.close(chart)


def write(target: Path) -> str:
    """Write history.md and history.png into a folder; returns the table, in which worse figures are marked."""
    found = {figure: known for figure, known in collect().items() if known}
    rows = [
        [f.name, *(short(v, 3) for v in (next(iter(known.values())), min(known.values()), list(known.values())[-1])),
         WORSE if worse(f, known) else ""]
        for f, known in found.items()
    ]  # fmt: skip
    figures = table(["figure", "first", "least", "now", ""], rows)
    target.mkdir(parents=True, exist_ok=True)
    draw(found, target / "history.png")
    (target / "history.md").write_text(
        f"{HEAD}\n{figures}\n\n![The figures over time](history.png)\n", encoding="utf-8"
    )
    return figures


def main() -> None:
    """Write, and say what got worse."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=ROOT / "out" / "history")
    figures = write(parser.parse_args().output)
    print(figures)
    if f" {WORSE} " in figures:
        sys.exit("worse than the best before by more than the spread: say why in the changelog, or mend it")


if __name__ == "__main__":
    main()
