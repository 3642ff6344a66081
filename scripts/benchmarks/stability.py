"""The map of where shading formulas fail: this package's models beside implementations that people copy.

    python -m scripts.benchmarks.stability [-o FOLDER]

Rows are situations (``situations.py``), columns implementations in four number formats, cells values and gradients:
right, finite but wrong (the error against float64 on the same numbers, of gradients over 1 + their size), not finite,
or refused with an error where the call is a mistake. A surface that faces away from light or view counts as dark, and
at the very edge any finite gradient as right. Then the rounding of half precision: the largest error of each model
against float64 on the same numbers, in units in the last place, over 100,000 random pixels. Writes stability.png,
stability.html and stability.json.
"""

from __future__ import annotations

import argparse
import html
import json
import math
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from scripts.benchmarks import baselines
from scripts.benchmarks.shading_edge_cases import FORMATS, Shade, Verdict, judge, member, situations
from torch_orennayar import MODELS
from torch_orennayar.core.progress import track

COLOURS = {"right": "#d7ead0", "wrong": "#f4a742", "not finite": "#9e1b1b", "refused": "#a9c6e8"}
MARKS = {"right": "", "wrong": "w", "not finite": "N", "refused": "r"}
SHORT = {torch.float64: "64", torch.float32: "32", torch.bfloat16: "b16", torch.float16: "16"}
COPIED = {
    "acos": ("angles", "qualitative"),
    "HLSL rewrite": ("normalised", "qualitative"),
    "textbook": ("textbook", "full"),
}
PIXELS = 100_000
Map = dict[str, dict[str, dict[str, tuple[Verdict, Verdict]]]]


def implementations() -> dict[str, tuple[Shade, Shade]]:
    """By name: the implementation, and the model of this package that is its formula without the faults."""
    copied = {name: (getattr(baselines, function), member(truth)) for name, (function, truth) in COPIED.items()}
    return copied | {name: (member(name), member(name)) for name in MODELS}


def survey() -> Map:
    """Verdicts by situation, implementation and format."""
    found: Map = {}
    for at in track(situations(), "situations"):
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
        some = slice(2000 if name == "theory" else count)
        for dtype in (torch.float32, torch.bfloat16, torch.float16):
            scene = [t[some].to(dtype) for t in (normal, light, view, albedo, roughness)]
            scene[4] = scene[4].clamp(max=1.5)
            exact = member(name)(*(t.double() for t in scene))
            error = (member(name)(*scene).double() - exact).abs()
            found.setdefault(name, {})[SHORT[dtype]] = float((error / _unit_in_last_place(exact, dtype)).max())
    return found


def _unit_in_last_place(value: Tensor, dtype: torch.dtype) -> Tensor:
    """The gap between neighbouring numbers at ``value``; float32's errors stay over 1, the size of a white pixel."""
    info = torch.finfo(dtype)
    if dtype == torch.float32:
        return torch.full_like(value, info.eps)
    return torch.exp2(value.abs().clamp_min(info.tiny).log2().floor()) * info.eps


def draw(found: Map, path: Path) -> None:
    """The heat map."""
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    names, formats = list(next(iter(found.values()))), list(SHORT.values())
    kinds = list(COLOURS)
    figure = Figure(figsize=(22, 9), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for side, (axis, title) in enumerate(zip(axes, ("values", "gradients"), strict=True)):
        cells = [[row[n][f][side] for n in names for f in formats] for row in found.values()]
        codes = [[kinds.index(c.kind) for c in row] for row in cells]
        axis.imshow(codes, cmap=ListedColormap(list(COLOURS.values())), vmin=-0.5, vmax=3.5, aspect="auto")
        for y, row in enumerate(cells):
            for x, cell in enumerate(row):
                colour = "white" if cell.kind == "not finite" else "black"
                axis.text(x, y, MARKS[cell.kind], ha="center", va="center", fontsize=7, color=colour)
        axis.set_yticks(range(len(found)), list(found), fontsize=9)
        axis.set_xticks(range(len(names) * len(formats)), formats * len(names), fontsize=6, rotation=90)
        for k, name in enumerate(names):
            start = k * len(formats)
            axis.text(start + 1.5, -0.7, name, ha="left", va="bottom", rotation=35, fontsize=9)
            axis.axvline(start - 0.5, color="white", lw=3)
        axis.axvline(len(COPIED) * len(formats) - 0.5, color="black", lw=1.5)
        axis.set_title(title, pad=70, loc="left", fontsize=13)
        axis.tick_params(length=0)
    meaning = {
        "right": "right",
        "wrong": "w  finite, wrong",
        "not finite": "N  NaN or infinite",
        "refused": "r  refused",
    }
    handles = [Patch(color=COLOURS[k], label=meaning[k]) for k in kinds]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=10)
    figure.savefig(path, dpi=110)


def page(found: Map, halves: dict[str, dict[str, float]]) -> str:
    """The same as a table with the errors on hover."""
    names, formats = list(next(iter(found.values()))), list(SHORT.values())
    parts = [
        "<!doctype html><html lang='en'><meta charset='utf-8'><title>Where shading fails</title><style>",
        "body{font:14px system-ui,sans-serif;margin:1.5rem}table{border-collapse:collapse}.wide{overflow-x:auto}",
        "td,th{padding:.15rem .35rem;text-align:center;border:1px solid #fff;font-weight:400}",
        "th:first-child{text-align:left;white-space:nowrap}",
        *(f".{kind.replace(' ', '-')}{{background:{colour}}}" for kind, colour in COLOURS.items()),
        ".not-finite{color:#fff}</style><h1>Where shading fails</h1>",
        "<p>Point at a cell for its error against float64. Columns are number formats; w finite but wrong, N not ",
        "finite, r refused with an error; empty cells are right.</p>",
    ]
    for side, title in enumerate(("Values", "Gradients")):
        parts.append(f"<h2>{title}</h2><div class='wide'><table><tr><th></th>")
        parts += [f"<th colspan='{len(formats)}'>{html.escape(name)}</th>" for name in names]
        parts.append("</tr><tr><th></th>" + "".join(f"<th>{f}</th>" for _ in names for f in formats) + "</tr>")
        for situation, row in found.items():
            parts.append(f"<tr><th>{html.escape(situation)}</th>")
            for name in names:
                for f in formats:
                    cell = row[name][f][side]
                    label = f"{name}, {f}: {cell.kind}" + ("" if math.isnan(cell.error) else f", {cell.error:.1e}")
                    kind = cell.kind.replace(" ", "-")
                    parts.append(f"<td class='{kind}' title='{html.escape(label)}'>{MARKS[cell.kind]}</td>")
            parts.append("</tr>")
        parts.append("</table></div>")
    parts.append(
        "<h2>Largest rounding error</h2><p>Half precision in units in the last place, float32 in its epsilon.</p>"
    )
    parts.append("<table><tr><th>model</th><th>float32</th><th>bfloat16</th><th>float16</th></tr>")
    for name, row in halves.items():
        parts.append(f"<tr><th>{name}</th>" + "".join(f"<td>{v:.2f}</td>" for v in row.values()) + "</tr>")
    parts.append("</table></html>")
    return "".join(parts)


def main() -> None:
    """Survey, draw, write, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("out/stability"))
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    found, halves = survey(), rounding()
    target = arguments.output / "stability"
    draw(found, target.with_suffix(".png"))
    target.with_suffix(".html").write_text(page(found, halves), encoding="utf-8")
    cells = {
        s: {n: {f: [{"kind": c.kind, "error": None if math.isnan(c.error) else c.error} for c in pair]
                for f, pair in formats.items()} for n, formats in row.items()}
        for s, row in found.items()
    }  # fmt: skip
    document = {"torch": torch.__version__, "map": cells, "largest_rounding_error": halves}
    target.with_suffix(".json").write_text(json.dumps(document, indent=1), encoding="utf-8")
    print(f"{'':18}" + "".join(f"{kind:>14}" for kind in COLOURS) + "   of cells, values and gradients in four formats")
    for name in next(iter(found.values())):
        kinds = [c.kind for row in found.values() for pair in row[name].values() for c in pair]
        print(f"{name:18}" + "".join(f"{kinds.count(kind):14d}" for kind in COLOURS))
    print(f"\n{'largest error':18}{'float32, eps':>14}{'bfloat16, ulp':>16}{'float16, ulp':>14}")
    for name, row in halves.items():
        print(f"{name:18}{row['32']:14.2f}{row['b16']:16.2f}{row['16']:14.2f}")
    print(f"wrote {target}.png, .html, .json")


if __name__ == "__main__":
    main()
