"""Milliseconds per frame of shading and its largest error, in torch, ONNX Runtime and a browser.

    python -m scripts.benchmarks.benchmark_onnx [--models lambert qualitative vcavity] [--capture FOLDER]
        [--output out/benchmark]

One picture of 512 and 1024 pixels squared, one light, grey albedo: torch eager and compiled, ONNX Runtime with 1 and 2
threads, and, where Chromium, npm and Playwright are there, the page's WASM with 1 and with all threads. Medians;
errors are against float64. Prints a table, writes onnx.json. With a capture, prints how long both `stereo` graphs take
for it, and their angle to torch's normals.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import onnxruntime
import torch
from torch import Tensor

import torch_orennayar as ton
from tests.support.example_code import CAN_BROWSE, CHROMIUM, served_page
from torch_orennayar.stereo.closed_form import solve_closed_form
from torch_orennayar.stereo.network_solver import solve_network

RUNS, WARM = 30, 5
IN_PAGE = """async ([name, side, runs]) => {
  const { run, threads } = await import('/graphs.js');
  const { normals } = await import('/benchmark_scene.js');
  const one = (data) => ({ data: Float32Array.from(data), dims: [1, data.length, 1, 1] });
  const feeds = { normal: { data: normals(side), dims: [1, 3, side, side] }, light: one([0.48, 0.36, 0.8]),
    view: one([0, 0, 1]), albedo: one([0.8]), roughness: one([0.6]) };
  const times = [];
  let found;
  for (let k = 0; k < runs; k++) {
    const begun = performance.now();
    found = await run(name, feeds);
    times.push(performance.now() - begun);
  }
  return { times, threads, values: Array.from(found.shading.data) };
}"""
SCENE = """export function normals(side) {
  const values = new Float32Array(3 * side * side);
  for (let i = 0; i < side; i++) for (let j = 0; j < side; j++) {
    const x = ((j + 0.5) / side) * 1.4 - 0.7, y = ((i + 0.5) / side) * 1.4 - 0.7;
    const k = i * side + j;
    values[k] = x; values[side * side + k] = y; values[2 * side * side + k] = Math.sqrt(Math.max(1 - x * x - y * y, 0));
  }
  return values;
}"""


def scene(side: int) -> dict[str, Tensor]:
    """What SCENE makes, in float32: a piece of a ball."""
    steps = (torch.arange(side).double() + 0.5) / side * 1.4 - 0.7
    y, x = torch.meshgrid(steps, steps, indexing="ij")
    normal = torch.stack((x, y, (1 - x * x - y * y).clamp_min(0).sqrt())).float()
    one = {"light": (0.48, 0.36, 0.8), "view": (0.0, 0.0, 1.0), "albedo": (0.8,), "roughness": (0.6,)}
    return {"normal": normal[None]} | {n: torch.tensor(v).reshape(1, -1, 1, 1) for n, v in one.items()}


def median(work: Callable[[], Any]) -> float:
    """Milliseconds."""
    times = []
    for _ in range(RUNS + WARM):
        begun = time.perf_counter()
        work()
        times.append(1000 * (time.perf_counter() - begun))
    return statistics.median(times[WARM:])


def opened_graph(path: Path, threads: int) -> onnxruntime.InferenceSession:
    """A graph that runs on so many threads of the CPU."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


def in_python(model: str, side: int, graph: Path) -> dict[str, tuple[float, float]]:
    """Milliseconds and error by runner."""
    given = scene(side)
    exact = ton.oren_nayar(**{k: v.double() for k, v in given.items()}, model=model)

    def row(work: Callable[[], Tensor]) -> tuple[float, float]:
        return median(work), (work().double() - exact).abs().max().item()

    compiled = torch.compile(lambda given: ton.oren_nayar(**given, model=model))
    with torch.no_grad():
        rows = {
            "torch eager": row(lambda: ton.oren_nayar(**given, model=model)),
            "torch compiled": row(lambda: compiled(given)),
        }
    for threads in (1, 2):
        session = opened_graph(graph, threads)
        feeds = {k: v.numpy() for k, v in given.items()}
        rows[f"ONNX Runtime, {threads} thread{'s' * (threads > 1)}"] = row(
            lambda session=session, feeds=feeds: torch.from_numpy(session.run(None, feeds)[0])
        )
    return rows


def in_browser(page: Any, model: str, side: int) -> tuple[str, float, float]:
    """Name of the runner, milliseconds and error."""
    given = scene(side)
    exact = ton.oren_nayar(**{k: v.double() for k, v in given.items()}, model=model)
    found = page.evaluate(IN_PAGE, [f"shading_{model}", side, RUNS + WARM])
    error = (torch.tensor(found["values"], dtype=torch.float64) - exact.flatten()).abs().max().item()
    threads = found["threads"]
    return f"WASM, {threads} thread{'s' * (threads > 1)}", statistics.median(found["times"][WARM:]), error


@contextmanager
def pages() -> Iterator[list[Any]]:
    """The page with one thread and with all; nothing where a browser or npm is missing."""
    if not CAN_BROWSE:
        print("no Chromium or npm: WASM is left out")
        yield []
        return
    from playwright.sync_api import sync_playwright

    with served_page() as address, sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        found = []
        for single in (True, False):
            page = browser.new_page()
            if single:
                page.add_init_script("Object.defineProperty(navigator, 'hardwareConcurrency', { value: 1 })")
            page.route("**/benchmark_scene.js", lambda route: route.fulfill(body=SCENE, content_type="text/javascript"))
            page.goto(address)
            found.append(page)
        yield found
        browser.close()


def solve_capture(folder: Path) -> None:
    """Print seconds and largest angle to torch's normals of both `stereo` graphs on a capture, 2 threads."""
    capture = ton.load_capture(folder)
    images, lights, mask = capture.images.float(), capture.lights.float(), capture.mask
    feeds = {"images": images.numpy(), "lights": lights.numpy(), "mask": mask.numpy()}
    wanted = {
        "vcavity": lambda: solve_closed_form(images, lights, mask, "vcavity")[0],
        "network": lambda: solve_network(images, lights, mask[0])["normal"],
    }
    for model, solve in wanted.items():
        with tempfile.TemporaryDirectory() as kept:
            session = opened_graph(ton.export_onnx("stereo", Path(kept) / "stereo.onnx", model=model), 2)
        begun = time.perf_counter()
        found = torch.from_numpy(session.run(["normal"], feeds)[0])
        seconds = time.perf_counter() - begun
        apart = ton.angular_error(found, solve(), mask).as_subclass(Tensor)[mask]
        apart = apart[apart.isfinite()]
        print(f"stereo graph, {model}: {seconds:.1f} s, degrees from torch {apart.mean():.1e}, most {apart.max():.1e}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", nargs="+", default=["lambert", "qualitative", "vcavity"])
    parser.add_argument("--capture", type=Path)
    parser.add_argument("--output", type=Path, default=Path("out/benchmark"))
    options = parser.parse_args()
    document: dict[str, dict[str, dict[str, tuple[float, float]]]] = {}
    with tempfile.TemporaryDirectory() as folder, pages() as opened:
        for model in options.models:
            graph = ton.export_onnx("shading", Path(folder) / f"{model}.onnx", model=model)
            for side in (512, 1024):
                rows = in_python(model, side, graph)
                for page in opened:
                    name, milliseconds, error = in_browser(page, model, side)
                    rows[name] = (milliseconds, error)
                document.setdefault(model, {})[str(side)] = rows
    for model, sides in document.items():
        print(f"{model:24}" + "".join(f"{s + ' squared':>24}" for s in sides))
        for name in sides["512"]:
            cells = (f"{rows[name][0]:9.1f} ms {rows[name][1]:11.1e}" for rows in sides.values())
            print(f"  {name:22}" + "".join(cells))
    if options.capture:
        solve_capture(options.capture)
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / "onnx.json").write_text(json.dumps(document, indent=2) + "\n")


if __name__ == "__main__":
    main()
