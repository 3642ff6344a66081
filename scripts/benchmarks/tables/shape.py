"""Tables of depth from normals and of shape from one photograph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from scripts.benchmarks.markdown import fixed, least_in_bold, mean_of, short, table
from scripts.benchmarks.record import load_section

SHAPE = "evaluate_shape_from_shading"
TITLES = {"inflated": "inflated silhouette"}
"""Methods whose name in tables is not that in the results."""


def integration() -> str:
    """Depth error of real objects."""
    section = load_section("evaluate_integration", "objects")
    rows = []
    for name, row in section.results.items():
        errors = [row["least squares"], row.get("reported"), row["error"]]
        rows.append([name, *least_in_bold(errors, [fixed(e, 3) for e in errors]), short(row["seconds"])])
    header = ["depth error in mm", "least squares", "bilateral, as reported", "`integrate_normals`", "seconds"]
    return f"{section.source}\n\n{table(header, rows)}"


def integration_large() -> str:
    """Time and memory of a large normal map."""
    section = load_section("evaluate_integration", "large")
    row = section.results
    header = ["megapixels", "seconds", "peak memory, GB", "largest error, pixels"]
    cells = [f"{row['megapixels']:g}", short(row["seconds"]), short(row["GB"], 3), fixed(row["error"], 3)]
    return f"{section.source}\n\n{table(header, [cells])}"


def integration_sharpness() -> str:
    """Error by the constant that was chosen."""
    section = load_section("evaluate_integration", "sharpness")
    header = ["last sharpness", *(f"{float(k):g}" for k in section.results)]
    row = ["error in pixels, geometric mean over ten views", *(fixed(v, 2) for v in section.results.values())]
    return f"{section.source}\n\n{table(header, [row])}"


def _errors(results: Mapping[str, Any], methods: Sequence[str], mean_title: str) -> str:
    """Median / mean error by case and method, and their means."""
    rows = []
    for name, row in results.items():
        medians = [row[m]["median"] for m in methods]
        cells = [f"{row[m]['median']:.2f} / {row[m]['mean']:.2f}" for m in methods]
        rows.append([name, *least_in_bold(medians, cells)])
    means = [mean_of(results, m, "median") for m in methods]
    cells = [f"{mean_of(results, m, 'median'):.2f} / {mean_of(results, m, 'mean'):.2f}" for m in methods]
    rows.append([mean_title, *least_in_bold(means, cells)])
    rows.append(["seconds, mean", *(short(mean_of(results, m, "seconds")) for m in methods)])
    return table(["median / mean error in degrees", *(TITLES.get(m, m) for m in methods)], rows)


def surfaces() -> str:
    """Error on analytic surfaces and meshes."""
    section = load_section(SHAPE, "surfaces")
    methods = ("inflated", "network", "lambert alone", "vcavity alone", "vcavity, silhouette", "vcavity")
    size = section.results["size"]
    body = _errors(section.results["found"], methods, "mean")
    return f"{section.source}\n\nPictures of {size} x {size} pixels.\n\n{body}"


def pictures() -> str:
    """Error on real photographs."""
    section = load_section(SHAPE, "pictures")
    methods = ("inflated", "network", "lambert alone", "vcavity alone", "vcavity, silhouette", "vcavity")
    return f"{section.source}\n\n{_errors(section.results['found'], methods, 'mean')}"


def ambient() -> str:
    """Error under ambient light."""
    section = load_section(SHAPE, "ambient")
    rows = [[name, fixed(row["median"], 2), fixed(row["mean"], 2)] for name, row in section.results["found"].items()]
    header = ["ambient light of a tenth of the light is", "median error, degrees", "mean"]
    return f"{section.source}\n\n{table(header, rows)}"


def steps() -> str:
    """Error and time by optimiser steps."""
    section = load_section(SHAPE, "steps")
    found = section.results["found"]
    rows = [
        ["median error, degrees", *(fixed(row["median"], 2) for row in found.values())],
        ["seconds", *(short(row["seconds"]) for row in found.values())],
    ]
    chart = "![Error against seconds of shape from shading](../../.github/images/shape_speed.png)"
    return f"{section.source}\n\n{table(['steps per level', *found], rows)}\n\n{chart}"


def sizes() -> str:
    """Error and time by size of the picture."""
    section = load_section(SHAPE, "sizes")
    rows = [
        [f"{side} x {side}", short(row["seconds"]), fixed(row["median"], 2)]
        for side, row in section.results["found"].items()
    ]
    return f"{section.source}\n\n{table(['bumpy ellipsoid', 'seconds', 'median error, degrees'], rows)}"


def counts() -> str:
    """Error by number of pictures, beside photometric stereo."""
    section = load_section(SHAPE, "counts")
    found = section.results["found"]
    numbers = list(next(iter(found.values())))
    methods = ("shape from shading", "photometric stereo")
    rows = [
        [f"{name}, {method}", *(fixed(row[n][method], 2) if method in row[n] else "" for n in numbers)]
        for name, row in found.items()
        for method in methods
    ]
    return f"{section.source}\n\n{table(['mean error in degrees; pictures', *numbers], rows)}"


def light() -> str:
    """Photographs whose light is found, beside the same with it given."""
    section = load_section(SHAPE, "light")
    found = section.results["found"]
    keys = ("off", "said", "found", "given")
    rows = [[name, *(fixed(row[key], 1) if key in row else "refused" for key in keys)] for name, row in found.items()]
    solved = [row for row in found.values() if "found" in row]
    rows.append([f"mean of {len(solved)}", *(fixed(sum(row[key] for row in solved) / len(solved), 1) for key in keys)])
    head = ["degrees", "light off by", "said to be within", "median error, light found", "light given"]
    return f"{section.source}\n\n{table(head, rows)}"


def failures() -> str:
    """Error by light and roughness, with and without the contour."""
    section = load_section(SHAPE, "failures")
    found = section.results["found"]
    places = list(found["contour"])
    rows = [[place, *(fixed(found[kind][place], 1) for kind in found)] for place in places]
    chart = "![Median error by light and roughness](../../.github/images/shape_failures.png)"
    return f"{section.source}\n\n{table(['median error in degrees (angles in degrees)', *found], rows)}\n\n{chart}"
