"""Accuracy against speed of every model in MODELS and of the formulas that people copy.

    python -m scripts.benchmarks.chart_reflectance [-o FOLDER] [--size 1024] [--plugin FILE.py]

Error: shading over albedo against the V-cavity theory, by this package's quadrature (scripts/fit/theory_reference.py):
RMS and maximum over 2000 cosine-weighted pairs of light and view, RMS over 1000 retro-grazing ones; roughness 5 to 60
degrees, albedo 0.2, 0.5, 0.9; against all bounces and against two. Time: one megapixel, eager, compiled and in ONNX
Runtime, forward and with all gradients, medians of interleaved runs. Where TORCH_ORENNAYAR_DATA points at measured
materials: the best fit of each model to them, and for how many it is the simplest sufficient one.

Records results/chart_reflectance.json, from which `scripts.benchmarks.charts` draws reflectance.png. Writes a page with
hover, reflectance.html; cylinder.png, the brightness across a matte cylinder; materials.png. A plug-in is a file that
registers models of its own (examples/custom_reflectance.py); runs with plug-ins are not recorded.
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import os
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import TypedDict

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from scripts.benchmarks.baselines import BASELINES, memory_floor
from scripts.benchmarks.charts import frontier
from scripts.benchmarks.markdown import aligned, fixed
from scripts.benchmarks.materials import MaterialFit, fit_materials
from scripts.benchmarks.record import record
from scripts.benchmarks.shading_edge_cases import Shade, member
from scripts.benchmarks.timing import Call, allow_recompilations, both, forward, interleave
from scripts.fit.theory_reference import Directions, cosine_weighted, grazing, theory
from torch_orennayar import MODELS, export_onnx, linear_to_srgb, oren_nayar
from torch_orennayar.core.progress import track
from torch_orennayar.export.nodes import quiet

ROUGHNESS = (5, 10, 20, 30, 40, 50, 60)
"""Degrees at which errors are measured."""
ALBEDO = (0.2, 0.5, 0.9)
"""Albedos at which errors are measured: dark, middle and bright."""
RUNS = 15
"""Interleaved runs of which a time is the median."""
SMALL = 32
"""Height and width of the picture that the slow `theory` is timed on."""


def shaders() -> dict[str, Shade]:
    """``(normal, light, view, albedo, roughness) -> shading``, 3 along the last axis."""
    return {name: member(name) for name in MODELS} | {b.name: b.shade for b in BASELINES}


def vectors(pairs: Directions) -> tuple[Tensor, Tensor, Tensor]:
    """Normal, light and view with the pairs' cosines."""
    sin_i, sin_o = ((1 - c * c).clamp_min(0).sqrt() for c in (pairs.ci, pairs.co))
    cos_phi = ((pairs.lv - pairs.ci * pairs.co) / (sin_i * sin_o).clamp_min(1e-12)).clamp(-1, 1)
    sin_phi = (1 - cos_phi * cos_phi).sqrt()
    light = torch.stack((sin_i, torch.zeros_like(sin_i), pairs.ci), -1)
    view = torch.stack((sin_o * cos_phi, sin_o * sin_phi, pairs.co), -1)
    return torch.tensor([0.0, 0.0, 1.0], dtype=light.dtype).expand_as(light), light, view


class ModelError(TypedDict, total=False):
    """Error of one entry against the theory."""

    rms: float
    max: float
    grazing: float
    rms_two_bounces: float
    cells: list[list[float]]


def measure_errors() -> dict[str, ModelError]:
    """Per entry: RMS, maximum and grazing RMS against all bounces, RMS against two, and RMS by roughness and albedo."""
    rho = torch.tensor(ALBEDO, dtype=torch.float64)
    sigma = torch.tensor(ROUGHNESS, dtype=torch.float64).deg2rad()
    found: dict[str, ModelError] = {name: {} for name in shaders()}
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
            found[name]["rms"] = _rms(error)
            found[name]["max"] = error.abs().max().item()
            found[name]["rms_two_bounces"] = _rms(value - two)
            found[name]["cells"] = [[float(f"{c:.5f}") for c in row] for row in cells.tolist()]
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
    from tests.support.objects import opened_graph

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "shading.onnx"
        if name in MODELS:
            export_onnx("shading", file, model=name)
            scene = [t.movedim(-1, 0)[None] for t in scene]
        else:
            with quiet():
                torch.onnx.export(_Module(shade).eval(), tuple(scene), str(file), dynamo=True, verbose=False)
        session = opened_graph(file, torch.get_num_threads())
    feeds = {i.name: t.contiguous().numpy() for i, t in zip(session.get_inputs(), scene, strict=True)}
    return lambda: session.run(None, feeds)


KINDS = ("eager forward", "eager both", "compiled forward", "compiled both", "onnx")
"""What is timed; \"both\" is forward and the gradients of all inputs."""


def measure_times(size: int) -> dict[str, dict[str, float]]:
    """Milliseconds per million pixels: per kind and entry, with the floor among the compiled ones."""
    allow_recompilations()
    scene, million = _scene(size), size * size / 1e6
    small = _scene(SMALL)
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
            times[name][kind] = median(milliseconds) / (SMALL * SMALL / 1e6 if name == "theory" else million)
    return times


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


def draw_materials(found: dict[str, MaterialFit], path: Path) -> None:
    """What roughness gains on measured materials, and for how many each model is the simplest sufficient one."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    flat = np.array([row[1] for row in found["lambert"].materials.values()])
    for name, d in found.items():
        if name != "lambert":
            gain = flat - np.array([row[1] for row in d.materials.values()])
            left.plot(np.sort(gain)[::-1][:60] * 100, label=name)
    left.set(xlabel="materials, most helped first (60 of 151)", ylabel="relative RMS below Lambert's, in points")
    left.set_title("what roughness gains, highlight fitted too")
    left.legend(fontsize=8)
    left.grid(alpha=0.2)
    names = list(found)[::-1]
    bars = right.barh(names, [len(found[n].simplest_for) for n in names], color="#1b3a6b")
    right.bar_label(bars, padding=3, fontsize=9)
    right.set_title("materials for which it is the simplest sufficient model")
    right.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)


def write_page(document: dict[str, object], path: Path) -> None:
    """A self-contained page: choose the measures, hover for the numbers."""
    template = (Path(__file__).parent / "chart_template.html").read_text(encoding="utf-8")
    path.write_text(template.replace("/*DATA*/", json.dumps(document).replace("</", "<\\/")), encoding="utf-8")


def print_table(errors: dict[str, ModelError], times: dict[str, dict[str, float]]) -> None:
    """Errors and times of every entry, and the frontiers."""
    body = [
        [name, f"{e['rms']:.4f}", f"{e['max']:.3f}", f"{e['grazing']:.4f}", f"{e['rms_two_bounces']:.4f}"]
        + [fixed(times[name].get(kind), 2) for kind in KINDS]
        for name, e in errors.items()
    ]
    print(aligned(["", "RMS", "maximum", "grazing", "two bounces", *KINDS], body))
    print("memory floor, compiled: " + ", ".join(f"{k} {v:.2f} ms" for k, v in times["floor"].items()))
    for kind in KINDS:
        points = {n: (times[n][kind], e["rms"]) for n, e in errors.items() if kind in times[n]}
        print(f"frontier, {kind}: {', '.join(frontier(points))}")


def summarise_materials(found: dict[str, MaterialFit]) -> dict[str, dict[str, object]]:
    """What tables print of the fits: medians, and for which materials a model is the simplest sufficient one."""
    flat = found["lambert"].materials
    return {
        name: {
            "median": fit.median,
            "median with lobe": fit.median_with_lobe,
            "simplest for": len(fit.simplest_for),
            "largest gain over lambert": max((flat[m][1] - fit.materials[m][1] for m in fit.simplest_for), default=0.0),
        }
        for name, fit in found.items()
    }


def main() -> None:
    """Measure, draw, record and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/reflectance"))
    parser.add_argument("--size", type=int, default=1024, help="height and width of the timed picture")
    parser.add_argument("--plugin", type=Path, action="append", default=[], help="a file that registers models")
    options = parser.parse_args()
    for plugin in options.plugin:
        sys.path.insert(0, str(plugin.resolve().parent))
        importlib.import_module(plugin.stem)  # a real module: the compiler looks its functions up by name
    options.output.mkdir(parents=True, exist_ok=True)
    errors, times, about = measure_errors(), measure_times(options.size), describe()
    head = {"roughness_degrees": ROUGHNESS, "albedo": ALBEDO, "pixels": options.size**2, "floor_ms": times["floor"]}
    page: dict[str, object] = head | {
        "threads": torch.get_num_threads(),
        "entries": {name: {"about": about[name], "error": errors[name], "time": times[name]} for name in errors},
    }
    sections: dict[str, object] = {
        "models": head
        | {"entries": {n: {"kind": about[n]["kind"], **errors[n], "time": times[n]} for n in errors}}
    }  # fmt: skip
    measured = Path(os.environ.get("TORCH_ORENNAYAR_DATA", "")) / "measured_brdf" / "measured_brdf.npz"
    if measured.is_file():
        materials = fit_materials(measured)
        draw_materials(materials, options.output / "materials.png")
        sections["materials"] = summary = summarise_materials(materials)
        page["materials"] = {
            n: {"median": fit.median, "median with lobe": fit.median_with_lobe, "materials": fit.materials,
                "simplest for": len(fit.simplest_for)}
            for n, fit in materials.items()
        }  # fmt: skip
        print(aligned(["materials", *next(iter(summary.values()))],
                      [[n, *(f"{v:.4g}" for v in row.values())] for n, row in summary.items()]))  # fmt: skip
    draw_cylinder(options.output / "cylinder.png")
    write_page(page, options.output / "reflectance.html")
    print_table(errors, times)
    if not options.plugin:
        record("chart_reflectance", sections)


if __name__ == "__main__":
    main()
