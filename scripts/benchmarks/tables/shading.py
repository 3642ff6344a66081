"""Tables of reflectance models, the shading layer, ONNX graphs and numerical stability."""

from __future__ import annotations

import torch

from scripts.benchmarks.markdown import NOTHING, fixed, short, table
from scripts.benchmarks.record import NotMeasuredError, load_section, load_sections, sources
from torch_orennayar.core.findings import CODES
from torch_orennayar.reflectance.formulas import eon, eon_from_r

GRADIENTS = {"lambert": "smooth", "vcavity": "smooth", "theory": "of the quadrature"}
"""How differentiable a model is; those not listed have kinks where both angles are equal and at right angles."""

KINDS = {
    "eager forward": "eager",
    "eager both": "eager, gradients",
    "compiled forward": "compiled",
    "compiled both": "compiled, gradients",
    "onnx": "ONNX Runtime",
}
"""What was timed of every model, and how tables call it."""


def models() -> str:
    """Error, white furnace, cost and smoothness of every model."""
    errors, properties = (load_section("evaluate_reflectance", title) for title in ("errors", "properties"))
    used = [errors]
    try:
        speed = load_section("benchmark_shading", "ratios")
        used.append(speed)
        cost = {n: r["median"] for n, r in speed.results["found"]["eager, forward over lambert"].items()}
    except NotMeasuredError:
        cost = {}
    rows = []
    for name, row in errors.results.items():
        white = properties.results[name]
        furnace = f"{white['furnace, least']:.3f} – {white['furnace, most']:.3f}"
        cells = [fixed(row["RMS"], 4), fixed(row["maximum"], 3), fixed(row["RMS, two bounces"], 4), furnace]
        rows.append([f"`{name}`", *cells, short(cost.get(name)), GRADIENTS.get(name, "kinks")])
    header = ["model", "RMS error", "largest", "RMS, two bounces", "white furnace", "cost over `lambert`", "gradients"]
    return f"{sources(*used)}\n\n{table(header, rows)}"


def model_errors() -> str:
    """Error of every model, for the guide."""
    found = load_section("evaluate_reflectance", "errors").results
    rows = [[f"`{name}`", fixed(row["RMS"], 4), GRADIENTS.get(name, "kinks")] for name, row in found.items()]
    return table(["model", "RMS error of shading over albedo", "gradients"], rows)


def properties() -> str:
    """Largest deviations from what must hold."""
    section = load_section("evaluate_reflectance", "properties")
    rows = [[f"`{n}`", *(f"{row[k]:.0e}" if row[k] else "0" for k in ("sigma = 0", "exchange", "rotation"))]
            for n, row in section.results.items()]  # fmt: skip
    header = ["largest difference in float32", "from `lambert` at σ = 0", "light and view exchanged", "scene rotated"]
    return f"{section.source}\n\n{table(header, rows)}"


def accuracy_and_speed() -> str:
    """Error and times of models and copied formulas."""
    section = load_section("chart_reflectance", "models")
    rows = [
        [name, fixed(d["rms"], 4), fixed(d["max"], 3), *(short(d["time"].get(kind), 3) for kind in KINDS)]
        for name, d in section.results["entries"].items()
    ]
    floor = section.results["floor_ms"]
    rows.append(["memory floor", NOTHING, NOTHING, *(short(floor.get(kind), 3) for kind in KINDS)])
    header = ["", "RMS error", "largest", *(f"{title}, ms per megapixel" for title in KINDS.values())]
    return f"{section.source}\n\n{table(header, rows)}"


def materials() -> str:
    """How models fit measured materials."""
    section = load_section("chart_reflectance", "materials")
    keys = ("median", "median with lobe")
    rows = []
    for name, row in section.results.items():
        gain = f"{100 * row['largest gain over lambert']:.1f} points" if row["simplest for"] else NOTHING
        rows.append([f"`{name}`", *(fixed(row[k], 3) for k in keys), str(row["simplest for"]), gain])
    header = ["model", "median relative RMS", "with a highlight", "simplest sufficient for", "gains up to"]
    return f"{section.source}\n\n{table(header, rows)}"


def shading_speed() -> str:
    """Ratios of times by model, beside their targets."""
    section = load_section("benchmark_shading", "ratios")
    found, targets = section.results["found"], section.results["targets"]
    names = list(found["eager, forward over lambert"])[:-1]  # theory is too slow to be timed elsewhere
    rows = []
    for kind, row in found.items():
        limits = targets.get(kind.rpartition(",")[0], {})
        aim = ", ".join(f"`{name}` {limit:g}" for name, limit in limits.items())
        rows.append([kind, *(short(row[name]["median"]) if name in row else NOTHING for name in names), aim])
    size = section.results["size"]
    head = f"medians, {size} x {size} unless another size is named"
    return f"{section.source}\n\n{table([head, *(f'`{n}`' for n in names), 'target'], rows)}"


def shading_memory() -> str:
    """Peak memory of calls."""
    section = load_section("benchmark_shading", "memory")
    rows = [[name, short(value, 3)] for name, value in section.results["MB"].items()]
    return f"{section.source}\n\n{table(['peak memory', 'MB'], rows)}"


def onnx_shading() -> str:
    """Milliseconds and errors of shading by runner."""
    found = load_sections("benchmark_onnx", "shading")
    first = next(iter(found.values())).results
    columns = [(model, side) for model in found for side in first]
    rows = []
    for runner in next(iter(first.values())):
        cells = [found[m].results[side].get(runner, (None, None)) for m, side in columns]
        rows.append([runner, *(short(milliseconds) for milliseconds, _ in cells)])
    errors = [max(e for _, e in found[m].results[side].values()) for m, side in columns]
    rows.append(["largest error of any", *(f"{e:.0e}" for e in errors)])
    header = ["milliseconds per frame", *(f"`{model}`, {side}²" for model, side in columns)]
    return f"{sources(*found.values())}\n\n{table(header, rows)}"


def onnx_renderer() -> str:
    """Milliseconds and errors of the renderer's graph by size and threads."""
    return _by_threads("renderer", "`renderer` graph, sphere of 20,480 triangles", "largest error of a normal")


def onnx_integration() -> str:
    """Milliseconds and errors of integration by size and threads."""
    return _by_threads("integration", "`integration` graph, ball", "largest error of a height, pixels")


def _by_threads(name: str, what: str, error_of: str) -> str:
    section = load_section("benchmark_onnx", name)
    rows = [
        [f"{side}²", threads, short(milliseconds), f"{error:.0e}"]
        for side, found in section.results.items()
        for threads, (milliseconds, error) in found.items()
    ]
    return f"{section.source}\n\n{table([what, 'threads', 'milliseconds', error_of], rows)}"


def onnx_stereo() -> str:
    """Seconds and errors of the stereo graphs."""
    section = load_section("benchmark_onnx", "stereo")
    rows = [
        [f"`{m}`", short(r["seconds"]), f"{r['mean']:.0e}", f"{r['most']:.0e}"]
        for m, r in section.results["graphs"].items()
    ]
    capture = section.results["capture"].removesuffix("PNG")
    header = [f"`stereo` graph on {capture}, 2 threads", "seconds", "degrees from torch, mean", "largest"]
    return f"{section.source}\n\n{table(header, rows)}"


def stability() -> str:
    """Number of verdicts by implementation."""
    section = load_section("stability", "map")
    counts = section.results["counts"]
    kinds = list(next(iter(counts.values())))
    copied = section.results["copied"]
    rows = [
        [f"{name} (copied)" if k < copied else f"`{name}`", *(str(row[kind]) for kind in kinds)]
        for k, (name, row) in enumerate(counts.items())
    ]
    return f"{section.source}\n\n{table(['values and gradients in four formats', *kinds], rows)}"


def rounding() -> str:
    """Largest rounding errors."""
    section = load_section("stability", "rounding")
    rows = [[f"`{name}`", *(fixed(row[f], 2) for f in ("b16", "16"))] for name, row in section.results.items()]
    header = ["largest error, units in the last place", "bfloat16", "float16"]
    return f"{section.source}\n\n{table(header, rows)}"


def fuzzing() -> str:
    """Counts of what happened to mutated files, by reader."""
    section = load_section("fuzz", "counts")
    kinds = list(next(iter(section.results.values())))
    rows = [[name, *(f"{row[kind]:,}" for kind in kinds)] for name, row in section.results.items()]
    return f"{section.source}\n\n{table(['reader', *kinds], rows)}"


def finding_codes() -> str:
    """Codes of findings and what they mean."""
    return table(["code", "what it says"], [[f"`{code}`", meaning] for code, meaning in CODES.items()])


def eon_roughness() -> str:
    """EON's r beside the roughness whose light `eon` reflects in the same way."""
    sigma = torch.linspace(0, torch.pi / 2, 100_001, dtype=torch.float64)
    ci, co, lv, rho = (torch.full_like(sigma, value) for value in (0.8, 0.7, 0.9, 0.5))
    shading, rows = eon(ci, co, lv, rho, sigma), []
    for r in (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8):
        same = (shading - eon_from_r(ci[:1], co[:1], lv[:1], rho[:1], torch.full_like(ci[:1], r))).abs().argmin()
        rows.append([f"{r:g}", fixed(sigma[same].item(), 3), fixed(sigma[same].rad2deg().item(), 1)])
    return table(["r of EON", "σ, radians", "σ, degrees"], rows)
