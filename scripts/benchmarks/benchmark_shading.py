"""Speed and memory of the shading layer, as ratios measured in one run, beside their targets.

    python -m scripts.benchmarks.benchmark_shading [--size 1024] [--quick]

Compiled: over the memory floor, a compiled kernel that reads and writes the same bytes and computes next to nothing,
for a picture that may fit in a processor's cache and for one of 16 times as many pixels. Eager: over the classic model
in angles as course notes have it (`acos`), which is measured on pictures in planes, as image tensors are, and on arrays
with x, y, z last. Memory: the peak of a fresh process over what it held before the call (Linux). ONNX Runtime: over
eager torch on the same threads, one after the other, since its idle threads spin. Half precision: over float32. Medians
of interleaved runs, with the smallest and largest. Recorded in results/benchmark_shading.json. A GPU: gpu.py.
"""

from __future__ import annotations

import argparse
import functools
import tempfile
from collections.abc import Callable
from pathlib import Path
from statistics import median

import torch
import torch.nn.functional as F
from torch import Tensor

from scripts.benchmarks.baselines import angles, memory_floor
from scripts.benchmarks.record import record
from scripts.benchmarks.timing import (
    Call,
    Ratio,
    allow_recompilations,
    both,
    forward,
    interleave,
    peak_bytes,
    ratio,
)  # fmt: skip
from torch_orennayar import MODELS, OrenNayar, export_onnx, oren_nayar

CLOSED = [name for name in MODELS if name != "theory"]
"""Models in closed form, which are timed on whole pictures."""
TARGETS = {
    "compiled, forward": {"qualitative": 1.3, "vcavity": 1.8},
    "compiled, forward and backward": {"qualitative": 1.1, "vcavity": 1.6},
}
"""Largest ratio aimed at, by measurement and model."""
SMALL = 32
"""Height and width of the picture that the slow `theory` is timed on."""
Table = dict[str, dict[str, Ratio]]


def scene(size: int, dtype: torch.dtype = torch.float32, device: str = "cpu") -> list[Tensor]:
    """Normals, one light and view, maps of albedo and roughness."""
    draw = torch.Generator().manual_seed(0)
    normal = F.normalize(torch.randn(1, 3, size, size, generator=draw), dim=1)
    normal[:, 2].abs_()
    albedo, roughness = (torch.rand(1, 1, size, size, generator=draw) for _ in range(2))
    light, view = (torch.tensor(d).reshape(1, 3, 1, 1) for d in ((0.0, 0.6, 0.8), (0.0, 0.0, 1.0)))
    return [t.to(device, dtype) for t in (normal, light, view, albedo, roughness)]


def xyz_last(parts: list[Tensor], *, planes: bool) -> list[Tensor]:
    """The scene as copied code takes it; in ``planes`` it is a view of an image tensor."""
    moved = [t.movedim(1, -1) for t in parts]
    return moved if planes else [t.contiguous() for t in moved]


def model(name: str) -> Callable[..., Tensor]:
    """A model as a function of the scene."""
    return functools.partial(oren_nayar, model=name)


def compiled(size: int, runs: int) -> Table:
    """Time over that of the memory floor, model by model: a call that frees much memory slows the one after it."""
    allow_recompilations()
    parts, found = scene(size), Table()
    floor = functools.partial(memory_floor, dim=1)
    for kind, make in (("compiled, forward", forward), ("compiled, forward and backward", both)):
        row, floors = found.setdefault(f"{kind}, {size}", {}), []
        calls = {name: make(torch.compile(model(name), fullgraph=True), parts) for name in CLOSED}
        if make is forward:
            calls["clone of as many bytes"] = lambda: [t.clone() for t in (parts[0], parts[3])]
        base = make(torch.compile(floor, fullgraph=True), parts)
        for name, call in calls.items():
            times = interleave({"floor": base, name: call}, 2 * runs, warm=5)
            row[name] = ratio(times, name, "floor")
            floors += times["floor"]
        row["floor in ms"] = Ratio(median(floors), min(floors), max(floors))
    return found


def eager(size: int, runs: int) -> Table:
    """Time over lambert's forward, and how many times faster than the `acos` code forward and backward."""
    parts = scene(size)
    times = interleave({name: forward(model(name), parts) for name in CLOSED}, runs, "eager, forward")
    slow = interleave({"": forward(model("theory"), scene(SMALL))}, 3)[""]
    slow = [t * (size / SMALL) ** 2 for t in slow] * -(-runs // 3)
    times["theory"] = slow[:runs]
    found = {"eager, forward over lambert": {name: ratio(times, name, "lambert") for name in MODELS}}
    found["eager, forward in ms"] = {n: Ratio(median(t), min(t), max(t)) for n, t in times.items()}
    copied = {
        f"acos, {'planes' if p else 'x, y, z last'}": both(angles, xyz_last(parts, planes=p)) for p in (True, False)
    }
    calls = copied | {name: both(model(name), parts) for name in CLOSED}
    times = interleave(calls, max(runs // 3, 3), "eager, both")
    for name in copied:
        found[f"eager, forward and backward: times faster than {name}"] = {n: ratio(times, name, n) for n in CLOSED}
    found["eager, forward and backward in ms"] = {n: Ratio(median(t), min(t), max(t)) for n, t in times.items()}
    return found


def one_light(size: int, name: str, dtype: torch.dtype, make: Callable[..., Call]) -> Call:
    """``acos`` or a model on one picture, as `peak_bytes` calls it."""
    parts = scene(size, dtype)
    return make(angles, xyz_last(parts, planes=True)) if name == "acos" else make(model(name), parts)


def many_lights(size: int, name: str, count: int) -> Call:
    """Several lights in one call of the layer, as `peak_bytes` calls it."""
    parts, layer = scene(size), OrenNayar(name)
    lights = torch.randn(1, count, 3, generator=torch.Generator().manual_seed(1)) + torch.tensor([0, 0, 2])
    lights = F.normalize(lights, dim=-1)
    return forward(lambda n, light, rho, sigma: layer(n, light, None, rho, sigma), [parts[0], lights, *parts[3:]])


def memory(size: int) -> dict[str, float | None]:
    """Peak memory in MB."""
    cases: dict[str, tuple[object, ...]] = {
        f"{name}, forward and backward, {size}": (one_light, size, name, torch.float32, both)
        for name in ("acos", "qualitative", "vcavity")
    }
    for dtype in (torch.float32, torch.float16, torch.bfloat16):
        cases[f"vcavity, forward, {size}, {dtype}"] = (one_light, size, "vcavity", dtype, forward)
    cases["vcavity, 96 lights x 512 x 512"] = (many_lights, 512, "vcavity", 96)
    peaks = {name: peak_bytes(*case) for name, case in cases.items()}  # type: ignore[arg-type]
    found = {name: None if peak is None else peak / 1e6 for name, peak in peaks.items()}
    return found | {"its output": 96 * 512 * 512 * 4 / 1e6}


def onnx(size: int, runs: int) -> Table:
    """Time of ONNX Runtime over eager torch's, on as many threads; roughness a map, and one number."""
    from tests.support.objects import opened_graph

    found: Table = {}
    before = torch.get_num_threads()
    for threads in sorted({1, before}):
        torch.set_num_threads(threads)
        for kind in ("map", "number"):
            parts = scene(size)
            if kind == "number":
                parts[4] = torch.full((1, 1, 1, 1), 0.5)
            row = found[f"ONNX Runtime over eager, {threads} threads, roughness a {kind}"] = {}
            for name in CLOSED:
                with tempfile.TemporaryDirectory() as folder:
                    file = export_onnx("shading", Path(folder) / "shading.onnx", model=name)
                    session = opened_graph(file, threads)
                feeds = {i.name: t.numpy() for i, t in zip(session.get_inputs(), parts, strict=True)}
                times = interleave({"eager": forward(model(name), parts)}, runs)
                times |= interleave({"onnx": functools.partial(session.run, None, feeds)}, runs)
                del session
                row[name] = ratio(times, "onnx", "eager")
    torch.set_num_threads(before)
    return found


def half(size: int, runs: int) -> Table:
    """Eager forward time of half precision over that of float32."""
    found: Table = {}
    for name in CLOSED:
        calls = {str(d): forward(model(name), scene(size, d)) for d in (torch.float32, torch.float16, torch.bfloat16)}
        times = interleave(calls, runs)
        for dtype in (torch.float16, torch.bfloat16):
            found.setdefault(f"eager, forward, {dtype} over float32", {})[name] = ratio(
                times, str(dtype), "torch.float32"
            )
    return found


def show(results: Table) -> None:
    """Print the ratios beside their targets."""
    for kind, row in results.items():
        print(f"\n{kind}")
        for name, value in row.items():
            target = TARGETS.get(kind.rpartition(",")[0], {}).get(name)
            print(f"  {name:26}{value}" + (f"   target {target}" if target else ""))


def main() -> None:
    """Measure, print and record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=1024, help="height and width of the picture")
    parser.add_argument("--quick", action="store_true", help="few runs")
    options = parser.parse_args()
    size, runs = options.size, 5 if options.quick else 21
    results: Table = {}
    for measure in (compiled, eager, half, onnx):
        results |= measure(size, runs)
    results |= compiled(4 * size, max(runs // 4, 3))  # larger than any cache
    print(f"{size} x {size}, {torch.get_num_threads()} threads, torch {torch.__version__}: median (least to most)")
    show(results)
    peaks = memory(size)
    print("\nmemory, MB")
    for name, value in peaks.items():
        print(f"  {name:46}" + ("not measured here" if value is None else f"{value:8.1f}"))
    sections = {
        "ratios": {
            "size": size,
            "targets": TARGETS,
            "found": {kind: {name: r._asdict() for name, r in row.items()} for kind, row in results.items()},
        },
        "memory": {"size": size, "MB": peaks},
    }
    record("benchmark_shading", sections, quick=list(sections) if options.quick else [])


if __name__ == "__main__":
    main()
