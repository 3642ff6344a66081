"""Draw the charts of the documentation from the recorded results.

    python -m scripts.benchmarks.charts [--output .github/images]

A chart whose measurement has not been recorded is left as it is.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from scripts.benchmarks.markdown import mean_of
from scripts.benchmarks.record import ROOT, NotMeasuredError, load_section, load_sections

DPI = 130
"""Dots per inch of the charts."""
OURS, OTHERS = "#1b3a6b", "#999"
"""Colours of this package's entries and of the others."""
ACCENT = "#c2571a"
"""Colour of a line that is to be looked at first."""
COLOURS = {"right": "#d7ead0", "wrong": "#f4a742", "not finite": "#9e1b1b", "refused": "#a9c6e8"}
"""Colours of the verdicts on an implementation."""
MARKS = {"right": "", "wrong": "w", "not finite": "N", "refused": "r"}
"""Letters of the verdicts, so that the map can be read without colours."""


CROWDED = 60, 12
"""Pixels across and down within which two names would lie on each other."""


def _name_ends(axis: Axes) -> None:
    """Write each line's name at its end, above it, or below it where that of another line is there."""
    named: list[Any] = []
    ends = [(float(np.asarray(x)[-1]), float(np.asarray(y)[-1])) for x, y in (line.get_data() for line in axis.lines)]
    for line, end in sorted(zip(axis.lines, ends, strict=True), key=lambda pair: -pair[1][1]):
        at = axis.transData.transform(end)
        crowded = any(abs(at[0] - x) < CROWDED[0] and abs(at[1] - y) < CROWDED[1] for x, y in named)
        place = (5, -11) if crowded else (5, 3)
        name = str(line.get_label())
        axis.annotate(name, end, place, textcoords="offset points", fontsize=9, color=line.get_color())
        named.append(at)


def draw_lines(
    curves: Mapping[str, Mapping[str, float]], axes: tuple[str, str], *, log: str = "", title: str = ""
) -> Figure:
    """Lines with their names at the end; with both axes logarithmic, the diagonal too."""
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axis = figure.subplots()
    for name, curve in curves.items():
        x, y = [float(k) for k in curve], list(curve.values())
        axis.plot(x, y, marker="o", markersize=4, label=name)
    if "x" in log:
        axis.set_xscale("log")
    if "y" in log:
        axis.set_yscale("log")
    _name_ends(axis)
    if log == "xy":  # predicted equals measured
        low, high = axis.get_xlim()
        axis.plot((low, high), (low, high), color="#999", linewidth=0.8, zorder=0)
    axis.set_xlabel(axes[0])
    axis.set_ylabel(axes[1])
    axis.set_title(title, fontsize=10)
    axis.margins(x=0.15)
    axis.spines[["top", "right"]].set_visible(False)
    return figure


def _error_by_time(results: Mapping[str, Any], title: str) -> Figure:
    methods = next(iter(results.values()))
    points = {m: {str(mean_of(results, m, "seconds")): mean_of(results, m, "mean")} for m in methods}
    return draw_lines(points, ("seconds, mean over objects", "mean angular error, degrees"), log="x", title=title)


def photographs() -> Figure:
    """Error against seconds on photographed objects."""
    found = load_sections("evaluate_stereo", "photographs")
    return _error_by_time({name: s.results["methods"] for name, s in found.items()}, "photographs")


def rendered() -> Figure:
    """Error against seconds on rendered captures."""
    return _error_by_time(load_section("evaluate_stereo", "rendered").results, "rendered captures")


def few_lights() -> Figure:
    """Error against the number of lights."""
    found = load_section("evaluate_stereo", "few lights").results
    return draw_lines(found["curves"], ("lights", "mean error, degrees"), log="x", title=found["object"])


def unknown_lights() -> Figure:
    """Error of normals against seconds, with lights known, found, and found with their brightness."""
    found = load_section("evaluate_unknown_lights", "photographs").results
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axis = figure.subplots()
    kinds = {"known": "lights known", "equal": "lights found", "unknown": "lights and brightness found"}
    for (kind, title), marker in zip(kinds.items(), "os^", strict=True):
        axis.plot(
            [row[kind]["seconds"] for row in found.values()],
            [row[kind]["normals"] for row in found.values()],
            marker, label=title,
        )  # fmt: skip
    for name, row in found.items():
        axis.annotate(name, (row["known"]["seconds"], row["known"]["normals"]), (6, 6), textcoords="offset points")
    axis.set(xlabel="seconds", ylabel="mean angular error, degrees", xlim=(0, None), ylim=(0, None))
    axis.legend(frameon=False)
    axis.spines[["top", "right"]].set_visible(False)
    return figure


def confidence() -> Figure:
    """Error against the error that the confidence predicts."""
    found = load_section("evaluate_stereo", "confidence").results
    return draw_lines(found, ("predicted error, degrees", "RMS error, degrees"), log="xy", title="confidence")


def shape_speed() -> Figure:
    """Error against seconds of shape from shading, by optimiser steps and by method."""
    steps = load_section("evaluate_shape_from_shading", "steps").results["found"]
    methods = load_section("evaluate_shape_from_shading", "surfaces").results["found"]["bumpy ellipsoid, 30 degrees"]
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axis = figure.subplots()
    points = {f"{count} steps": (row, "o", "#1f77b4") for count, row in steps.items()}
    points |= {
        m: (row, "s", "#888") for m, row in methods.items() if m not in ("plane", "vcavity", "vcavity, silhouette")
    }
    for name, (row, marker, colour) in points.items():
        axis.plot(row["seconds"], row["median"], marker, color=colour)
        axis.annotate(name, (row["seconds"], row["median"]), (5, 4), textcoords="offset points", fontsize=8)
    axis.set(xscale="log", yscale="log", xlabel="seconds", ylabel="median error, degrees")
    axis.set_title("bumpy ellipsoid: vcavity by L-BFGS steps per level, and the others", fontsize=10)
    axis.spines[["top", "right"]].set_visible(False)
    return figure


def shape_failures() -> Figure:
    """Median error of shape from shading by light and roughness."""
    found = load_section("evaluate_shape_from_shading", "failures").results["found"]
    figure = Figure(figsize=(9, 3.4), layout="constrained")
    for axis, (kind, cells) in zip(figure.subplots(1, 2), found.items(), strict=True):
        slants = sorted({int(k.split()[1].rstrip(",")) for k in cells})
        angles = sorted({int(k.split()[3]) for k in cells})
        values = np.array([[cells[f"light {s}, roughness {a}"] for a in angles] for s in slants])
        axis.imshow(values, cmap="viridis", vmin=0, vmax=20, aspect="auto")
        for i, j in np.ndindex(values.shape):
            axis.text(j, i, f"{values[i, j]:.1f}", ha="center", va="center", color="w" if values[i, j] < 12 else "k")
        axis.set_xticks(range(len(angles)), [f"{a}°" for a in angles])
        axis.set_yticks(range(len(slants)), [f"{s}°" for s in slants])
        axis.set(xlabel="roughness", ylabel="light off the view", title=f"median error, {kind}")
    return figure


def frontier(points: Mapping[str, tuple[float, float]]) -> list[str]:
    """Names that no other beats in both coordinates, by the first."""
    best, names = float("inf"), []
    for name, (_, error) in sorted(points.items(), key=lambda item: item[1]):
        if error < best:
            best = error
            names.append(name)
    return names


def reflectance() -> Figure:
    """Error of the models against time with the frontier, and error by roughness."""
    found = load_section("chart_reflectance", "models").results
    entries = found["entries"]
    figure = Figure(figsize=(13, 5.2), layout="constrained")
    axes = figure.subplots(1, 3, width_ratios=(1.15, 1.15, 1))
    titles = {"compiled forward": "torch.compile, forward", "eager both": "eager, with gradients"}
    for axis, (kind, title) in zip(axes, titles.items(), strict=False):
        _error_by_model_time(axis, entries, kind)
        axis.set_title(title)
    for name, d in entries.items():
        if d["kind"] == "model" and name != "theory":
            axes[2].plot(found["roughness_degrees"], np.sqrt(np.square(d["cells"]).mean(1)), ".-", label=name)
    axes[2].set(yscale="log", xlabel="roughness in degrees", ylabel="RMS error over albedo 0.2, 0.5, 0.9")
    axes[2].set_title("error by roughness")
    axes[2].legend(fontsize=8)
    axes[2].grid(alpha=0.2, which="both")
    return figure


def _error_by_model_time(axis: Axes, entries: Mapping[str, Any], kind: str) -> None:
    points = {n: (d["time"][kind], d["rms"]) for n, d in entries.items() if kind in d["time"]}
    edge = [points[n] for n in frontier(points)]
    axis.step([x for x, _ in edge], [y for _, y in edge], where="post", color=ACCENT, lw=1.2, alpha=0.6)
    for name, (x, y) in points.items():
        model = entries[name]["kind"] == "model"
        axis.plot(x, y, "o" if model else "x", color=OURS if model else OTHERS, ms=6)
        place, side = ((6, 4), "left") if model else ((-6, -4), "right")
        axis.annotate(
            name, (x, y), place, textcoords="offset points", ha=side, fontsize=8, color="k" if model else "#777"
        )
    axis.set(xscale="log", yscale="log", xlabel="ms per megapixel", ylabel="RMS error, all bounces")
    for ruler in (axis.xaxis, axis.yaxis):
        ruler.set_major_locator(LogLocator(subs=(1, 2, 5)))
        ruler.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ruler.set_minor_formatter(NullFormatter())
    axis.grid(alpha=0.2, which="both")
    axis.margins(x=0.15)


def renderer() -> Figure:
    """Error of the normals against time, for every renderer."""
    rows = load_section("benchmark_renderer", "accuracy").results
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for axis, shape in zip(axes, ("sphere", "torus"), strict=True):
        for name in dict.fromkeys(r["renderer"] for r in rows):
            own = [r for r in rows if r["renderer"] == name and r["shape"] == shape]
            x, y = [r["ms"] for r in own], [r["degrees"] for r in own]
            (line,) = axis.plot(x, y, "o-", ms=4, lw=1.2, label=name)
            if "package" in name:
                line.set(color=ACCENT, linestyle=":" if "front" in name else "-")
        axis.set(xscale="log", yscale="log", xlabel="milliseconds, 512 x 512", title=shape)
        axis.grid(alpha=0.3, which="both")
    axes[0].set_ylabel("mean error of normals, degrees")
    axes[0].legend(fontsize=7)
    return figure


def renderer_cost() -> Figure:
    """Time of the renderer against triangles and against pixels."""
    found = load_section("benchmark_renderer", "costs").results
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    units = {"triangles": "triangles at 512 x 512", "pixels": "pixels, 20,480 triangles"}
    for axis, (kind, unit) in zip(figure.subplots(1, 2), units.items(), strict=True):
        rows = found[kind]
        for key, label, style in (("all", "both sides", "o-"), ("front", "front faces", "o:")):
            axis.plot([r[kind] for r in rows], [r[key] for r in rows], style, color=ACCENT, ms=4, label=label)
        last = rows[-1]
        axis.plot([last[kind] / 30, last[kind]], [last["all"] / 30, last["all"]], color="grey", lw=1, label="linear")
        axis.set(xscale="log", yscale="log", xlabel=unit, ylabel="milliseconds")
        axis.grid(alpha=0.3, which="both")
        axis.legend(fontsize=8)
    return figure


def stability() -> Figure:
    """Verdicts by edge case, implementation and number format."""
    found = load_section("stability", "map").results
    names, formats, copied = found["implementations"], found["formats"], found["copied"]
    kinds = {mark or ".": k for k, mark in enumerate(MARKS.values())}
    figure = Figure(figsize=(22, 9), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for axis, side in zip(axes, ("values", "gradients"), strict=True):
        rows = ["".join(found[side][case][name] for name in names) for case in found[side]]
        codes = [[kinds[mark] for mark in row] for row in rows]
        axis.imshow(codes, cmap=ListedColormap(list(COLOURS.values())), vmin=-0.5, vmax=3.5, aspect="auto")
        for y, row in enumerate(rows):
            for x, mark in enumerate(row.replace(".", " ")):
                axis.text(x, y, mark, ha="center", va="center", fontsize=7, color="white" if mark == "N" else "black")
        axis.set_yticks(range(len(rows)), list(found[side]), fontsize=9)
        axis.set_xticks(range(len(names) * len(formats)), formats * len(names), fontsize=6, rotation=90)
        for k, name in enumerate(names):
            axis.text(k * len(formats) + 1.5, -0.7, name, ha="left", va="bottom", rotation=35, fontsize=9)
            axis.axvline(k * len(formats) - 0.5, color="white", lw=3)
        axis.axvline(copied * len(formats) - 0.5, color="black", lw=1.5)
        axis.set_title(side, pad=70, loc="left", fontsize=13)
        axis.tick_params(length=0)
    meaning = ("right", "w  finite, wrong", "N  NaN or infinite", "r  refused")
    handles = [Patch(color=colour, label=label) for colour, label in zip(COLOURS.values(), meaning, strict=True)]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=10)
    return figure


CHARTS: dict[str, Callable[[], Figure]] = {
    "photographs": photographs,
    "rendered": rendered,
    "few_lights": few_lights,
    "unknown_lights": unknown_lights,
    "confidence": confidence,
    "shape_speed": shape_speed,
    "shape_failures": shape_failures,
    "reflectance": reflectance,
    "renderer": renderer,
    "renderer_cost": renderer_cost,
    "stability": stability,
}
"""Charts by the name of their picture."""


def main() -> None:
    """Draw every chart whose measurement is recorded."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=ROOT / ".github" / "images")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    for name, draw in CHARTS.items():
        with suppress(NotMeasuredError):
            draw().savefig(options.output / f"{name}.png", dpi=DPI)
            print(f"drew {name}.png")


if __name__ == "__main__":
    main()
