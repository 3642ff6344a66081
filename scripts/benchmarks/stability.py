"""Map of where shading formulas fail: this package's models beside implementations that people copy.

    python -m scripts.benchmarks.stability [-o FOLDER]

`map`: rows are edge cases (``shading_edge_cases.py``), columns implementations in four number formats, cells the
verdicts on values and gradients: right, finite but wrong (error against float64 on the same numbers, of gradients over
1 + their size), not finite, or refused with an error where the call is a mistake. A surface that faces away from light
or view counts as dark, and at the horizon itself any finite gradient as right. `rounding`: the largest error of each
model against float64 on the same numbers, in units in the last place, over 100,000 random pixels. Recorded in
results/stability.json, from which `scripts.benchmarks.charts` draws stability.png. Writes stability.html, the same with
the errors on hover.
"""

from __future__ import annotations

import argparse
import html
import math
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from scripts.benchmarks import baselines
from scripts.benchmarks.charts import COLOURS, MARKS
from scripts.benchmarks.markdown import aligned
from scripts.benchmarks.record import record
from scripts.benchmarks.shading_edge_cases import FORMATS, Shade, Verdict, edge_cases, judge, member
from torch_orennayar import MODELS
from torch_orennayar.core.progress import track

SHORT = {torch.float64: "64", torch.float32: "32", torch.bfloat16: "b16", torch.float16: "16"}
"""Names of the number formats on the map."""
COPIED = {
    "acos": ("angles", "qualitative"),
    "HLSL rewrite": ("normalised", "qualitative"),
    "textbook": ("textbook", "full"),
}
"""Copied implementations: the function in `baselines`, and the model of this package that is the same formula."""
PIXELS = 100_000
"""Random pixels on which rounding is measured."""
SLOW_PIXELS = 2000
"""The same for the slow `theory`."""
Map = dict[str, dict[str, dict[str, tuple[Verdict, Verdict]]]]


def implementations() -> dict[str, tuple[Shade, Shade]]:
    """By name: the implementation, and the model of this package by which it is judged."""
    copied = {name: (getattr(baselines, function), member(truth)) for name, (function, truth) in COPIED.items()}
    return copied | {name: (member(name), member(name)) for name in MODELS}


def survey() -> Map:
    """Verdicts by edge case, implementation and format."""
    found: Map = {}
    for at in track(edge_cases(), "edge cases"):
        found[at.name] = {
            name: {SHORT[dtype]: judge(shade, truth, at, dtype) for dtype in FORMATS}
            for name, (shade, truth) in implementations().items()
        }
    return found


def rounding() -> dict[str, dict[str, float]]:
    """Largest error in units in the last place of float16 and bfloat16, and of float32 in units of its epsilon."""
    draw = torch.Generator().manual_seed(0)
    count = PIXELS
    normal = torch.tensor([[0.0, 0.0, 1.0]]).repeat(count, 1)
    light, view = (F.normalize(torch.randn(count, 3, generator=draw), dim=-1) for _ in range(2))
    light[:, 2].abs_()
    view[:, 2].abs_()
    albedo, roughness = torch.rand(count, 1, generator=draw), 1.5 * torch.rand(count, 1, generator=draw)
    found: dict[str, dict[str, float]] = {}
    for name in track(MODELS, "rounding", len(MODELS)):
        some = slice(SLOW_PIXELS if name == "theory" else count)
        for dtype in (torch.float32, torch.bfloat16, torch.float16):
            scene = [t[some].to(dtype) for t in (normal, light, view, albedo, roughness)]
            scene[4] = scene[4].clamp(max=1.5)
            exact = member(name)(*(t.double() for t in scene))
            error = (member(name)(*scene).double() - exact).abs()
            found.setdefault(name, {})[SHORT[dtype]] = float((error / _unit_in_last_place(exact, dtype)).max())
    return found


def _unit_in_last_place(value: Tensor, dtype: torch.dtype) -> Tensor:
    """The gap between neighbouring numbers at ``value``; for float32 its gap at 1, the size of a white pixel."""
    info = torch.finfo(dtype)
    if dtype == torch.float32:
        return torch.full_like(value, info.eps)
    return torch.exp2(value.abs().clamp_min(info.tiny).log2().floor()) * info.eps


PAGE_HEAD = """<!doctype html><html lang='en'><meta charset='utf-8'><title>Where shading fails</title><style>
body{font:14px system-ui,sans-serif;margin:1.5rem}table{border-collapse:collapse}.wide{overflow-x:auto}
td,th{padding:.15rem .35rem;text-align:center;border:1px solid #fff;font-weight:400}
th:first-child{text-align:left;white-space:nowrap}
COLOURS.not-finite{color:#fff}</style><h1>Where shading fails</h1>
<p>Point at a cell for its error against float64. Columns are number formats; w finite but wrong, N not
finite, r refused with an error; empty cells are right.</p>"""
"""Beginning of the page."""


def page(found: Map, halves: dict[str, dict[str, float]]) -> str:
    """The map as a page with the errors on hover, and the rounding errors."""
    colours = "".join(f".{kind.replace(' ', '-')}{{background:{colour}}}" for kind, colour in COLOURS.items())
    parts = [PAGE_HEAD.replace("COLOURS", colours)]
    parts += [page_table(found, side, title) for side, title in enumerate(("Values", "Gradients"))]
    parts.append(
        "<h2>Largest rounding error</h2><p>Half precision in units in the last place, float32 in its epsilon.</p>"
        "<table><tr><th>model</th><th>float32</th><th>bfloat16</th><th>float16</th></tr>"
    )
    for name, row in halves.items():
        parts.append(f"<tr><th>{name}</th>" + "".join(f"<td>{v:.2f}</td>" for v in row.values()) + "</tr>")
    return "".join([*parts, "</table></html>"])


def page_table(found: Map, side: int, title: str) -> str:
    """Verdicts on values (``side`` 0) or gradients (1) as HTML."""
    names, formats = list(next(iter(found.values()))), list(SHORT.values())
    parts = [f"<h2>{title}</h2><div class='wide'><table><tr><th></th>"]
    parts += [f"<th colspan='{len(formats)}'>{html.escape(name)}</th>" for name in names]
    parts.append("</tr><tr><th></th>" + "".join(f"<th>{f}</th>" for _ in names for f in formats) + "</tr>")
    for case, row in found.items():
        parts.append(f"<tr><th>{html.escape(case)}</th>")
        for name, f in ((name, f) for name in names for f in formats):
            cell = row[name][f][side]
            label = f"{name}, {f}: {cell.kind}" + ("" if math.isnan(cell.error) else f", {cell.error:.1e}")
            kind = cell.kind.replace(" ", "-")
            parts.append(f"<td class='{kind}' title='{html.escape(label)}'>{MARKS[cell.kind]}</td>")
        parts.append("</tr>")
    return "".join([*parts, "</table></div>"])


def count_kinds(found: Map) -> dict[str, dict[str, int]]:
    """Number of verdicts of each kind, by implementation."""
    kinds = {
        name: [v.kind for row in found.values() for pair in row[name].values() for v in pair]
        for name in next(iter(found.values()))
    }
    return {name: {kind: listed.count(kind) for kind in COLOURS} for name, listed in kinds.items()}


def main() -> None:
    """Judge, write, record and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/stability"))
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    found, halves = survey(), rounding()
    (options.output / "stability.html").write_text(page(found, halves), encoding="utf-8")
    counts = count_kinds(found)
    marks = {
        title: {
            case: {n: "".join(MARKS[pair[side].kind] or "." for pair in row[n].values()) for n in row}
            for case, row in found.items()
        }
        for side, title in enumerate(("values", "gradients"))
    }
    head = {"formats": list(SHORT.values()), "implementations": list(counts), "copied": len(COPIED), "counts": counts}
    print(aligned(["verdicts", *COLOURS], [[n, *(str(v) for v in row.values())] for n, row in counts.items()]))
    titles = ["largest error", "float32, eps", "bfloat16, ulp", "float16, ulp"]
    print(aligned(titles, [[n, *(f"{row[f]:.2f}" for f in ("32", "b16", "16"))] for n, row in halves.items()]))
    record("stability", {"map": head | marks, "rounding": halves})


if __name__ == "__main__":
    main()
