"""How fast the layer is and how much memory it takes, as ratios measured in one run, beside the bars.

    python -m scripts.benchmarks.benchmark_shading [-o FOLDER] [--size 1024] [--quick]

Compiled: over the memory floor, a compiled kernel that reads and writes the same bytes and computes next to nothing,
for a picture that may fit in a processor's cache and for one of 16 times as many pixels.
Eager: over the classic form in angles as course notes have it (`acos`), which is measured on pictures in planes, as
image tensors are, and on x, y, z last. Memory: the peak of a fresh process over what it held before the call. ONNX
Runtime: over eager torch on the same threads, in turns of their own, since its idle threads spin. Half precision:
over float32. A GPU, if there is one: bytes per second over a copy's. Medians of interleaved runs, least and most in
brackets. Writes shading.json; needs Linux for the memory.
"""

from __future__ import annotations

import argparse
import functools
import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from statistics import median

import torch
import torch.nn.functional as F
from torch import Tensor

from scripts.benchmarks.baselines import angles, memory_floor
from scripts.benchmarks.timing import Call, Ratio, both, forward, interleave, peak_bytes, ratio
from torch_orennayar import MODELS, OrenNayar, export_onnx, oren_nayar

CLOSED = [name for name in MODELS if name != "theory"]
BARS = {
    "compiled, forward": {"qualitative": 1.3, "vcavity": 1.8},
    "compiled, forward and backward": {"qualitative": 1.1, "vcavity": 1.6},
}
Table = dict[str, object]


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


def compiled(size: int, runs: int) -> dict[str, dict[str, Ratio]]:
    """Time over the memory floor's, model by model: one that frees much makes whatever comes next pay for pages."""
    torch._dynamo.config.recompile_limit = 100  # all entries share one code object
    parts, found = scene(size), {}
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


def eager(size: int, runs: int) -> dict[str, dict[str, Ratio]]:
    """Time over lambert's forward, and how many times faster than the `acos` code forward and backward."""
    parts = scene(size)
    times = interleave({name: forward(model(name), parts) for name in CLOSED}, runs, "eager, forward")
    few = 32  # pixels in a row of the picture that the slow theory gets
    times["theory"] = [t * (size / few) ** 2 for t in interleave({"": forward(model("theory"), scene(few))}, 3)[""]]
    times["theory"] *= -(-runs // 3)
    times["theory"] = times["theory"][:runs]
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
    """``acos`` or a model on one picture."""
    parts = scene(size, dtype)
    return make(angles, xyz_last(parts, planes=True)) if name == "acos" else make(model(name), parts)


def many_lights(size: int, name: str, count: int) -> Call:
    """Several lights in one call of the layer."""
    parts, layer = scene(size), OrenNayar(name)
    lights = torch.randn(1, count, 3, generator=torch.Generator().manual_seed(1)) + torch.tensor([0, 0, 2])
    lights = F.normalize(lights, dim=-1)
    return forward(lambda n, light, rho, sigma: layer(n, light, None, rho, sigma), [parts[0], lights, *parts[3:]])


def memory(size: int) -> dict[str, float | None]:
    """Peaks in MB."""
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


def onnx(size: int, runs: int) -> dict[str, dict[str, Ratio]]:
    """Time of ONNX Runtime over eager torch's, on as many threads; roughness a map, and one number."""
    import onnxruntime

    found: dict[str, dict[str, Ratio]] = {}
    before = torch.get_num_threads()
    for threads in sorted({1, before}):
        torch.set_num_threads(threads)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        for kind in ("map", "number"):
            parts = scene(size)
            if kind == "number":
                parts[4] = torch.full((1, 1, 1, 1), 0.5)
            row = found[f"ONNX Runtime over eager, {threads} threads, roughness a {kind}"] = {}
            for name in CLOSED:
                with tempfile.TemporaryDirectory() as folder:
                    file = export_onnx("shading", Path(folder) / "shading.onnx", model=name)
                    session = onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
                feeds = {i.name: t.numpy() for i, t in zip(session.get_inputs(), parts, strict=True)}
                times = interleave({"eager": forward(model(name), parts)}, runs)
                times |= interleave({"onnx": lambda s=session, f=feeds: s.run(None, f)}, runs)
                del session
                row[name] = ratio(times, "onnx", "eager")
    torch.set_num_threads(before)
    return found


def half(size: int, runs: int) -> dict[str, dict[str, Ratio]]:
    """Eager forward time of half precision over that of float32."""
    found = {}
    for name in CLOSED:
        calls = {str(d): forward(model(name), scene(size, d)) for d in (torch.float32, torch.float16, torch.bfloat16)}
        times = interleave(calls, runs)
        for dtype in (torch.float16, torch.bfloat16):
            found.setdefault(f"eager, forward, {dtype} over float32", {})[name] = ratio(
                times, str(dtype), "torch.float32"
            )
    return found


def gpu(size: int, runs: int) -> dict[str, dict[str, Ratio]]:
    """Bytes per second of the compiled layer over those of a copy on the device."""
    parts = scene(size, device="cuda")
    calls: dict[str, Call] = {n: forward(torch.compile(model(n), fullgraph=True), parts) for n in CLOSED}
    block = torch.empty(3, size, size, device="cuda")  # read and written: as many bytes as five maps in and one out
    calls["copy"] = block.clone
    times = interleave(calls, 10 * runs, "GPU", warm=10)
    return {"GPU, compiled: bytes per second over a copy's": {n: ratio(times, "copy", n) for n in CLOSED}}


def show(results: dict[str, dict[str, Ratio]]) -> None:
    """Tables, with the bars."""
    for kind, row in results.items():
        print(f"\n{kind}")
        for name, value in row.items():
            bar = BARS.get(kind.rpartition(",")[0], {}).get(name)
            print(f"  {name:26}{value}" + (f"   bar {bar}" if bar else ""))


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("out/benchmark"))
    parser.add_argument("--size", type=int, default=1024, help="height and width of the picture")
    parser.add_argument("--quick", action="store_true", help="few runs")
    arguments = parser.parse_args()
    size, runs = arguments.size, 5 if arguments.quick else 21
    results: dict[str, dict[str, Ratio]] = {}
    for measure in (compiled, eager, half, onnx):
        results |= measure(size, runs)
    results |= compiled(4 * size, max(runs // 4, 3))  # out of any cache
    if torch.cuda.is_available():
        results |= gpu(4 * size, runs)
    print(f"{size} x {size}, {torch.get_num_threads()} threads, torch {torch.__version__}: median (least to most)")
    show(results)
    peaks = memory(size)
    print("\nmemory, MB")
    for name, value in peaks.items():
        print(f"  {name:46}" + ("not measured here" if value is None else f"{value:8.1f}"))
    document = {
        "size": size,
        "threads": torch.get_num_threads(),
        "torch": torch.__version__,
        "ratios": {kind: {n: r._asdict() for n, r in row.items()} for kind, row in results.items()},
        "bars": BARS,
        "memory_mb": peaks,
    }
    arguments.output.mkdir(parents=True, exist_ok=True)
    (arguments.output / "shading.json").write_text(json.dumps(document, indent=1), encoding="utf-8")
    print(f"\nwrote {arguments.output / 'shading.json'}")


if __name__ == "__main__":
    main()
