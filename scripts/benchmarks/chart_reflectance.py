"""Accuracy against speed: every model in MODELS and the formulas people copy, on one chart.

    python -m scripts.benchmarks.chart_reflectance [-o FOLDER] [--size 1024] [--plugin FILE.py]

Error: shading over albedo against the V-cavity theory, by this package's quadrature (scripts/fit/theory_reference.py):
RMS and maximum over 2000 cosine-weighted pairs of light and view, RMS over 1000 retro-grazing ones; roughness 5 to 60
degrees, albedo 0.2, 0.5, 0.9; against all bounces and against two. Time: one megapixel, eager, compiled and in ONNX
Runtime, forward and with all gradients, medians of interleaved runs on this machine. Where TORCH_ORENNAYAR_DATA points
at measured materials: each model's best fit to them, and for how many it is the simplest sufficient one.

Writes reflectance.png, .svg, .json and a page with hover, reflectance.html; cylinder.png, the brightness across a matte
cylinder; materials.png. A plug-in is a file that registers models of its own (examples/custom_reflectance.py).
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from scripts.benchmarks.baselines import BASELINES, memory_floor
from scripts.benchmarks.materials import fit_materials
from scripts.benchmarks.timing import Call, both, forward, interleave
from scripts.fit.theory_reference import Directions, cosine_weighted, grazing, theory
from torch_orennayar import MODELS, export_onnx, linear_to_srgb, oren_nayar
from torch_orennayar.core.progress import track
from torch_orennayar.export.nodes import quiet

ROUGHNESS = (5, 10, 20, 30, 40, 50, 60)
ALBEDO = (0.2, 0.5, 0.9)
RUNS = 15
Shade = Callable[[Tensor, Tensor, Tensor, Tensor, Tensor], Tensor]


def shaders() -> dict[str, Shade]:
    """``(normal, light, view, albedo, roughness) -> shading``, 3 along the last axis."""

    def member(name: str) -> Shade:
        return lambda *scene: oren_nayar(*scene, model=name, dim=-1)

    return {name: member(name) for name in MODELS} | {b.name: b.shade for b in BASELINES}


def vectors(pairs: Directions) -> tuple[Tensor, Tensor, Tensor]:
    """Normal, light and view with the pairs' cosines."""
    sin_i, sin_o = ((1 - c * c).clamp_min(0).sqrt() for c in (pairs.ci, pairs.co))
    cos_phi = ((pairs.lv - pairs.ci * pairs.co) / (sin_i * sin_o).clamp_min(1e-12)).clamp(-1, 1)
    sin_phi = (1 - cos_phi * cos_phi).sqrt()
    light = torch.stack((sin_i, torch.zeros_like(sin_i), pairs.ci), -1)
    view = torch.stack((sin_o * cos_phi, sin_o * sin_phi, pairs.co), -1)
    return torch.tensor([0.0, 0.0, 1.0], dtype=light.dtype).expand_as(light), light, view


def measure_errors() -> dict[str, dict[str, object]]:
    """Per entry: RMS, maximum and grazing RMS against all bounces, RMS against two, and RMS by roughness and albedo."""
    rho = torch.tensor(ALBEDO, dtype=torch.float64)
    sigma = torch.tensor(ROUGHNESS, dtype=torch.float64).deg2rad()
    found: dict[str, dict[str, object]] = {name: {} for name in shaders()}
    for kind, pairs in (("hemisphere", cosine_weighted(2000, 11)), ("grazing", grazing(1000, 12))):
        bounces = theory(pairs, sigma, rho, f"theory, {kind}") * pairs.ci[:, None, None]  # (S, N, K, 3)
        every, two = bounces.sum(-1), bounces[..., :2].sum(-1)
        n, l, v = (d[:, None] for d in vectors(pairs))  # noqa: E741
        for name, shade in shaders().items():
            if name == "theory":
                value = every
            else:
                shading = [shade(n, l, v, rho[:, None].expand(len(pairs), -1, 1), s.expand(1, 1, 1)) for s in sigma]
                value = torch.stack(shading)[..., 0] / rho
            error = value - every
            if kind == "grazing":
                found[name]["grazing"] = _rms(error)
                continue
            cells = error.square().mean(1).sqrt()
            found[name] |= {
                "rms": _rms(error),
                "max": error.abs().max().item(),
                "rms_two_bounces": _rms(value - two),
                "cells": [[float(f"{c:.5f}") for c in row] for row in cells.tolist()],
            }
    return found


def _rms(error: Tensor) -> float:
    return error.square().mean().sqrt().item()


class _Module(nn.Module):
    def __init__(self, shade: Shade) -> None:
        super().__init__()
        self.shade = shade

    def forward(self, n: Tensor, l: Tensor, v: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:  # noqa: E741
        return self.shade(n, l, v, rho, sigma)


def _scene(size: int) -> list[Tensor]:
    """Normals in planes (a view with x, y, z last, as an image tensor permuted), one light and view, maps."""
    draw = torch.Generator().manual_seed(0)
    normal = F.normalize(torch.randn(3, size, size, generator=draw), dim=0)
    normal[2].abs_()
    maps = (torch.rand(size, size, 1, generator=draw) for _ in range(2))
    light, view = torch.tensor([[[0.0, 0.6, 0.8]]]), torch.tensor([[[0.0, 0.0, 1.0]]])
    return [normal.permute(1, 2, 0), light, view, *maps]


def _runner(kind: str, shade: Shade, scene: list[Tensor]) -> Call:
    """What is timed in torch: a call without arguments."""
    call = torch.compile(shade, fullgraph=True) if kind.startswith("compiled") else shade
    return (forward if kind.endswith("forward") else both)(call, scene)


def _onnx_runner(name: str, shade: Shade, scene: list[Tensor]) -> Call:
    """A member's own graph, or a copied formula as it is traced."""
    import onnxruntime

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "shading.onnx"
        if name in MODELS:
            export_onnx("shading", file, model=name)
            scene = [t.movedim(-1, 0)[None] for t in scene]
        else:
            with quiet():
                torch.onnx.export(_Module(shade).eval(), tuple(scene), str(file), dynamo=True, verbose=False)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = torch.get_num_threads()
        session = onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
    feeds = {i.name: t.contiguous().numpy() for i, t in zip(session.get_inputs(), scene, strict=True)}
    return lambda: session.run(None, feeds)


KINDS = ("eager forward", "eager both", "compiled forward", "compiled both", "onnx")


def measure_times(size: int) -> dict[str, dict[str, float]]:
    """Milliseconds per million pixels: per kind and entry, with the floor among the compiled ones."""
    torch._dynamo.config.recompile_limit = 100  # all entries share one code object
    scene, million = _scene(size), size * size / 1e6
    small = _scene(32)
    entries = shaders()
    times: dict[str, dict[str, float]] = {name: {} for name in (*entries, "floor")}
    for kind in track(KINDS, "timing"):
        floor = {"floor": memory_floor} if kind.startswith("compiled") else {}
        timed = {n: f for n, f in (entries | floor).items() if n != "theory" or kind == "eager forward"}
        if kind == "onnx":  # one session at a time: idle ones keep processors busy
            taken = {n: interleave({n: _onnx_runner(n, f, scene)}, RUNS)[n] for n, f in timed.items()}
        else:
            calls = {n: _runner(kind, f, small if n == "theory" else scene) for n, f in timed.items()}
            taken = interleave(calls, RUNS)
        for name, milliseconds in taken.items():
            times[name][kind] = median(milliseconds) / (32 * 32 / 1e6 if name == "theory" else million)
    return times


def frontier(points: dict[str, tuple[float, float]]) -> list[str]:
    """Names that no other beats in both coordinates, by the first."""
    best, names = math.inf, []
    for name, (_, error) in sorted(points.items(), key=lambda item: item[1]):
        if error < best:
            best = error
            names.append(name)
    return names


def describe() -> dict[str, dict[str, str]]:
    """Source, formula and link of every entry."""
    code = "https://en.wikipedia.org/wiki/Oren%E2%80%93Nayar_reflectance_model"
    links = {
        "lambert": "https://en.wikipedia.org/wiki/Lambertian_reflectance",
        "fujii": "https://mimosa-pudica.net/improved-oren-nayar.html",
        "eon": "https://arxiv.org/abs/2410.18026",
    }
    about = {
        name: {
            "kind": "model",
            "source": model.source,
            "formula": (model.function.__doc__ or "registered by the user").strip().splitlines()[0],
            "link": links.get(
                name,
                code if name != "vcavity" else "https://www.cs.columbia.edu/CAVE/publications/pdfs/Oren_SIGGRAPH94.pdf",
            ),
        }
        for name, model in MODELS.items()
    }
    return about | {
        b.name: {
            "kind": "copied",
            "source": b.source,
            "formula": (b.shade.__doc__ or "").strip().splitlines()[0],
            "link": b.link,
        }
        for b in BASELINES
    }


def draw_chart(data: dict[str, dict], path: Path) -> None:  # type: ignore[type-arg]
    """Error against time with the frontier, and error by roughness."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    figure = Figure(figsize=(13, 5.2), layout="constrained")
    axes = figure.subplots(1, 3, width_ratios=(1.15, 1.15, 1))
    for axis, kind in zip(axes, ("compiled forward", "eager both"), strict=False):
        points = {n: (d["time"][kind], d["error"]["rms"]) for n, d in data.items() if kind in d["time"]}
        edge = [points[n] for n in frontier(points)]
        axis.step(*zip(*edge, strict=True), where="post", color="#c2571a", lw=1.2, alpha=0.6, label="frontier")
        for name, (x, y) in points.items():
            model = data[name]["about"]["kind"] == "model"
            axis.plot(x, y, "o" if model else "x", color="#1b3a6b" if model else "#999", ms=6)
            place = {"xytext": (6, 4)} if model else {"xytext": (-6, -4), "ha": "right"}
            axis.annotate(name, (x, y), **place, textcoords="offset points", fontsize=8, color="k" if model else "#777")
        axis.set(xscale="log", yscale="log", xlabel="ms per megapixel", ylabel="RMS error, all bounces")
        for ruler in (axis.xaxis, axis.yaxis):
            ruler.set_major_locator(LogLocator(subs=(1, 2, 5)))
            ruler.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            ruler.set_minor_formatter(NullFormatter())
        axis.set_title({"compiled forward": "torch.compile, forward", "eager both": "eager, with gradients"}[kind])
        axis.grid(alpha=0.2, which="both")
        axis.margins(x=0.15)
    for name, d in data.items():
        if d["about"]["kind"] == "model" and name != "theory":
            axes[2].plot(ROUGHNESS, np.sqrt(np.square(d["error"]["cells"]).mean(1)), ".-", label=name)
    axes[2].set(yscale="log", xlabel="roughness in degrees", ylabel="RMS error over albedo 0.2, 0.5, 0.9")
    axes[2].set_title("error by roughness")
    axes[2].legend(fontsize=8)
    axes[2].grid(alpha=0.2, which="both")
    for suffix in (".png", ".svg"):
        figure.savefig(path.with_suffix(suffix), dpi=130)


def draw_cylinder(path: Path, sigma: float = math.radians(40), rho: float = 0.8) -> None:
    """Brightness across a matte cylinder lit from the camera, in linear light and as a screen shows it."""
    from matplotlib.figure import Figure

    place = torch.linspace(-0.995, 0.995, 200, dtype=torch.float64)
    normal = torch.stack((place, torch.zeros_like(place), (1 - place * place).sqrt()), -1)
    front = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
    figure = Figure(figsize=(9.5, 4), layout="constrained")

    def same(light: Tensor) -> Tensor:
        return light

    def screen(light: Tensor) -> Tensor:
        return linear_to_srgb(light.reshape(1, 1, -1))[0, 0]

    for axis, encode, title in zip(
        figure.subplots(1, 2), (same, screen), ("linear light", "sRGB-encoded"), strict=True
    ):
        for name, style in (("lambert", ":"), ("qualitative", "--"), ("vcavity", "-"), ("theory", "k.")):
            shade = oren_nayar(normal, front, front, rho, sigma, model=name, dim=-1)[:, 0]
            step = 8 if name == "theory" else 1
            axis.plot(place[::step], encode(shade)[::step], style, label=name, ms=5)
        axis.set(xlabel="position across the cylinder", ylabel=title, ylim=(0, 1.02))
        axis.set_title(f"{title}: roughness {math.degrees(sigma):.0f}°, albedo {rho:g}")
        axis.grid(alpha=0.2)
        axis.legend(fontsize=8)
    figure.savefig(path, dpi=130)


def draw_materials(found: dict[str, dict], path: Path) -> None:  # type: ignore[type-arg]
    """What roughness gains on measured materials, and for how many each model is the simplest that suffices."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    flat = np.array([row[1] for row in found["lambert"]["materials"].values()])
    for name, d in found.items():
        if name != "lambert":
            gain = flat - np.array([row[1] for row in d["materials"].values()])
            left.plot(np.sort(gain)[::-1][:60] * 100, label=name)
    left.set(xlabel="materials, most helped first (60 of 151)", ylabel="relative RMS below Lambert's, in points")
    left.set_title("what roughness gains, highlight fitted too")
    left.legend(fontsize=8)
    left.grid(alpha=0.2)
    names = list(found)[::-1]
    bars = right.barh(names, [found[n]["simplest for"] for n in names], color="#1b3a6b")
    right.bar_label(bars, padding=3, fontsize=9)
    right.set_title("materials for which it is the simplest sufficient model")
    right.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)


def write_page(data: dict[str, dict], path: Path) -> None:  # type: ignore[type-arg]
    """A self-contained page: choose the measures, hover for the figures."""
    template = (Path(__file__).parent / "chart_template.html").read_text(encoding="utf-8")
    path.write_text(template.replace("/*DATA*/", json.dumps(data).replace("</", "<\\/")), encoding="utf-8")


def print_table(data: dict[str, dict], floor_ms: dict[str, float]) -> None:  # type: ignore[type-arg]
    """The figures that the README quotes."""
    print(f"{'':18}{'RMS':>8}{'max':>8}{'grazing':>9}{'2-bounce':>10}" + "".join(f"{k:>18}" for k in KINDS))
    for name, d in data.items():
        e, t = d["error"], d["time"]
        line = f"{name:18}{e['rms']:8.4f}{e['max']:8.3f}{e['grazing']:9.4f}{e['rms_two_bounces']:10.4f}"
        print(line + "".join(f"{t[k]:18.2f}" if k in t else f"{'-':>18}" for k in KINDS))
    print("memory floor, compiled: " + ", ".join(f"{k} {v:.2f} ms" for k, v in floor_ms.items()))
    for kind in KINDS:
        points = {n: (d["time"][kind], d["error"]["rms"]) for n, d in data.items() if kind in d["time"]}
        print(f"frontier, {kind}: {', '.join(frontier(points))}")


def main() -> None:
    """Measure, draw, write, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("out/reflectance"))
    parser.add_argument("--size", type=int, default=1024, help="height and width of the timed picture")
    parser.add_argument("--plugin", type=Path, action="append", default=[], help="a file that registers models")
    arguments = parser.parse_args()
    for plugin in arguments.plugin:
        sys.path.insert(0, str(plugin.resolve().parent))
        importlib.import_module(plugin.stem)  # a real module: the compiler looks its functions up by name
    arguments.output.mkdir(parents=True, exist_ok=True)
    errors, times, about = measure_errors(), measure_times(arguments.size), describe()
    data = {name: {"about": about[name], "error": errors[name], "time": times[name]} for name in errors}
    target = arguments.output / "reflectance"
    document: dict[str, object] = {
        "roughness_degrees": ROUGHNESS,
        "albedo": ALBEDO,
        "pixels": arguments.size**2,
        "threads": torch.get_num_threads(),
        "torch": torch.__version__,
        "floor_ms": times["floor"],
        "entries": data,
    }
    measured = Path(os.environ.get("TORCH_ORENNAYAR_DATA", "")) / "measured_brdf" / "measured_brdf.npz"
    if measured.is_file():
        document["materials"] = materials = fit_materials(measured)
        draw_materials(materials, arguments.output / "materials.png")
    target.with_suffix(".json").write_text(json.dumps(document, indent=1), encoding="utf-8")
    draw_chart(data, target)
    draw_cylinder(arguments.output / "cylinder.png")
    write_page(document, target.with_suffix(".html"))  # type: ignore[arg-type]
    print_table(data, times["floor"])
    for name, m in document.get("materials", {}).items():  # type: ignore[attr-defined]
        print(
            f"materials, {name:18} median relative RMS {m['median']:.3f}, simplest sufficient for {m['simplest for']}"
        )
    print(f"wrote {target}.png, .svg, .json, .html")


if __name__ == "__main__":
    main()
