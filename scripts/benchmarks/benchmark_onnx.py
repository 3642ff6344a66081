"""Milliseconds per frame of shading and its largest error, in torch, ONNX Runtime and a browser.

    python -m scripts.benchmarks.benchmark_onnx [--models lambert qualitative vcavity] [--capture FOLDER]

`shading`: one picture of 512 and 1024 pixels squared, one light, grey albedo: torch eager and compiled, ONNX Runtime
with 1 and 2 threads and, where Chromium, npm and Playwright are installed, the page's WASM with 1 and with all threads;
`portable` is the graph without a loop over bands of rows. `renderer`: the graph that takes the view, with a sphere of
20,480 triangles. `integration`: a ball. Medians; errors are against float64. `stereo`, with a capture: how long both
`stereo` graphs take for it, and the angle of their normals to torch's. Recorded in results/benchmark_onnx.json.
"""

from __future__ import annotations

import argparse
import functools
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import onnxruntime
import torch
import trimesh
from torch import Tensor

import torch_orennayar as ton
from scripts.benchmarks.record import record
from scripts.benchmarks.timing import interleave
from tests.support.example_code import CAN_BROWSE, CHROMIUM, served_page
from tests.support.objects import opened_graph
from torch_orennayar.geometry.primitives import Ball
from torch_orennayar.geometry.smooth_integration import integrate_smooth
from torch_orennayar.stereo.closed_form import solve_closed_form
from torch_orennayar.stereo.network_solver import solve_network

if TYPE_CHECKING:
    from playwright.sync_api import Page

RUNS, WARM = 30, 5
"""Timed runs, and runs before them that are not counted."""
SIDES = (512, 1024)
"""Heights and widths of the picture."""
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
"""Runs a graph in the page: its times, number of threads and values."""
SCENE = """export function normals(side) {
  const values = new Float32Array(3 * side * side);
  for (let i = 0; i < side; i++) for (let j = 0; j < side; j++) {
    const x = ((j + 0.5) / side) * 1.4 - 0.7, y = ((i + 0.5) / side) * 1.4 - 0.7;
    const k = i * side + j;
    values[k] = x; values[side * side + k] = y; values[2 * side * side + k] = Math.sqrt(Math.max(1 - x * x - y * y, 0));
  }
  return values;
}"""


"""The scene of `scene` as the page makes it."""


class Scene(NamedTuple):
    """Inputs of the layer, float32 unless converted."""

    normal: Tensor
    light: Tensor
    view: Tensor
    albedo: Tensor
    roughness: Tensor

    def shade(self, model: str) -> Tensor:
        """Shading by one model."""
        return ton.oren_nayar(*self, model=model)

    def exact(self, model: str) -> Tensor:
        """The same in float64."""
        return Scene(*(part.double() for part in self)).shade(model)


Row = tuple[float, float]
"""Milliseconds and largest error."""


def scene(side: int) -> Scene:
    """A piece of a ball under one light, in float32."""
    steps = (torch.arange(side).double() + 0.5) / side * 1.4 - 0.7
    y, x = torch.meshgrid(steps, steps, indexing="ij")
    normal = torch.stack((x, y, (1 - x * x - y * y).clamp_min(0).sqrt())).float()
    rest = (torch.tensor(v).reshape(1, -1, 1, 1) for v in ((0.48, 0.36, 0.8), (0.0, 0.0, 1.0), (0.8,), (0.6,)))
    return Scene(normal[None], *rest)


def median(work: Callable[[], object]) -> float:
    """Milliseconds."""
    return statistics.median(interleave({"": work}, RUNS, warm=WARM)[""])


def in_python(model: str, side: int, graphs: dict[str, Path]) -> dict[str, Row]:
    """Milliseconds and error by runner; ``graphs`` by what is added to the runner's name."""
    given = scene(side)
    exact = given.exact(model)

    def row(work: Callable[[], Tensor]) -> Row:
        return median(work), (work().double() - exact).abs().max().item()

    compiled = torch.compile(lambda given: given.shade(model))
    with torch.no_grad():
        rows = {
            "torch eager": row(lambda: given.shade(model)),
            "torch compiled": row(lambda: compiled(given)),
        }
    feeds = {name: part.numpy() for name, part in given._asdict().items()}

    def run(session: onnxruntime.InferenceSession) -> Tensor:
        return torch.from_numpy(session.run(None, feeds)[0])

    for kind, graph in graphs.items():
        for threads in (1, 2):
            session = opened_graph(graph, threads)
            rows[f"ONNX Runtime{kind}, {threads} thread{'s' * (threads > 1)}"] = row(functools.partial(run, session))
    return rows


def render(folder: Path) -> dict[str, dict[str, Row]]:
    """The graph of the renderer that takes the view, on a sphere of 20,480 triangles: by side and number of threads."""
    ball = trimesh.creation.icosphere(5)
    vertices, faces = torch.tensor(ball.vertices).float(), torch.tensor(ball.faces)
    camera = ton.Camera.orthographic(1.05)
    graph = ton.export_onnx("renderer", folder / "renderer.onnx", camera=camera, size=(8, 8), view_inputs=True)
    feeds = {"vertices": vertices.numpy(), "faces": faces.numpy()}
    feeds |= {name: getattr(camera, name)[0].numpy() for name in ("rotation", "eye", "focal", "centre")}
    found: dict[str, dict[str, Row]] = {}
    for side in SIDES:
        exact = ton.render_normals(vertices.double(), faces, camera, (side, side)).normal
        size = {"size": torch.tensor([side, side]).numpy()}
        for threads in (1, 2):
            run = functools.partial(opened_graph(graph, threads).run, ["normal"], feeds | size)
            error = (torch.from_numpy(run()[0]).double() - exact).abs().max().item()
            found.setdefault(str(side), {})[f"{threads} thread{'s' * (threads > 1)}"] = median(run), error
    return found


def integrate(folder: Path) -> dict[str, dict[str, Row]]:
    """The graph of integration on a ball that fills the picture, by side and number of threads; errors in pixels."""
    graph = ton.export_onnx("integration", folder / "integration.onnx")
    found: dict[str, dict[str, Row]] = {}
    for side in SIDES:
        normal, mask = Ball(side / 2, side / 2, 0.48 * side).normals((side, side))
        exact = integrate_smooth(normal.double(), mask)
        feeds = {"normal": normal.numpy(), "mask": mask.numpy()}
        for threads in (1, 2):
            run = functools.partial(opened_graph(graph, threads).run, ["depth"], feeds)
            error = (torch.from_numpy(run()[0]).double() - exact).abs().max().item()
            found.setdefault(str(side), {})[f"{threads} thread{'s' * (threads > 1)}"] = median(run), error
    return found


def in_browser(page: Page, model: str, side: int) -> tuple[str, Row]:
    """Name of the runner, and its milliseconds and error."""
    exact = scene(side).exact(model)
    found = page.evaluate(IN_PAGE, [f"shading_{model}", side, RUNS + WARM])
    error = (torch.tensor(found["values"], dtype=torch.float64) - exact.flatten()).abs().max().item()
    threads = found["threads"]
    return f"WASM, {threads} thread{'s' * (threads > 1)}", (statistics.median(found["times"][WARM:]), error)


@contextmanager
def pages() -> Iterator[list[Page]]:
    """The page with one thread and with all threads; empty where a browser or npm is missing."""
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


def solve_capture(folder: Path) -> dict[str, dict[str, float]]:
    """Seconds of both `stereo` graphs on a capture, 2 threads, and the angle in degrees to torch's normals."""
    capture = ton.load_capture(folder)
    images, lights, mask = capture.images.float(), capture.lights.float(), capture.mask
    feeds = {"images": images.numpy(), "lights": lights.numpy(), "mask": mask.numpy()}
    wanted: dict[str, Callable[[], Tensor]] = {
        "vcavity": lambda: solve_closed_form(images, lights, mask, "vcavity")[0],
        "network": lambda: solve_network(images, lights, mask[0])["normal"],
    }
    rows = {}
    for model, solve in wanted.items():
        with tempfile.TemporaryDirectory() as kept:
            session = opened_graph(ton.export_onnx("stereo", Path(kept) / "stereo.onnx", model=model), 2)
        begun = time.perf_counter()
        found = torch.from_numpy(session.run(["normal"], feeds)[0])
        seconds = time.perf_counter() - begun
        apart = ton.angular_error(found, solve(), mask).as_subclass(Tensor)[mask]
        apart = apart[apart.isfinite()]
        rows[model] = {"seconds": seconds, "mean": apart.mean().item(), "most": apart.max().item()}
        print(f"stereo graph, {model}: {rows[model]}")
    return rows


def main() -> None:
    """Measure, print and record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", nargs="*", default=["lambert", "qualitative", "vcavity"])
    parser.add_argument("--capture", type=Path)
    options = parser.parse_args()
    sections: dict[str, object] = {}
    with tempfile.TemporaryDirectory() as folder, pages() as opened:
        for model in options.models:
            graphs = {
                kind: ton.export_onnx("shading", Path(folder) / f"{model}{kind}.onnx", model=model, portable=bool(kind))
                for kind in ("", ", portable")
            }
            sides: dict[str, dict[str, Row]] = {}
            for side in SIDES:
                rows = in_python(model, side, graphs) | dict(in_browser(page, model, side) for page in opened)
                sides[str(side)] = rows
                for name, (milliseconds, error) in rows.items():
                    print(f"{model:24}{side:6}  {name:24}{milliseconds:9.1f} ms {error:11.1e}")
            sections[f"shading, {model}"] = sides
        sections["renderer"] = render(Path(folder))
        sections["integration"] = integrate(Path(folder))
        print(f"integration: {sections['integration']}")
    if options.capture:
        sections["stereo"] = {"capture": options.capture.name, "graphs": solve_capture(options.capture)}
    record("benchmark_onnx", sections)


if __name__ == "__main__":
    main()
