"""The page in a real browser; needs Chromium, npm (once, for the runtime) and Playwright."""

from __future__ import annotations

import base64
import json
import math
import subprocess
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
import torch
import trimesh

import torch_orennayar as ton
from tests.support.example_code import CAN_BROWSE, CHROMIUM, WEB, served_page
from tests.support.objects import Scene
from torch_orennayar.geometry.mesh import normalise_mesh
from torch_orennayar.geometry.smooth_integration import integrate_smooth
from torch_orennayar.io.capture import save_capture
from torch_orennayar.io.images import read_image, write_image
from torch_orennayar.stereo.closed_form import solve_closed_form
from torch_orennayar.stereo.network_solver import solve_network

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page, Playwright

pytestmark = pytest.mark.skipif(not CAN_BROWSE, reason="no Chromium or npm")
QUIET = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with served_page() as address:
        yield address


@pytest.fixture(scope="module")
def driver() -> Iterator[Playwright]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        yield driver


@pytest.fixture(scope="module")
def browser(driver: Playwright) -> Iterator[Browser]:
    browser = driver.chromium.launch(executable_path=CHROMIUM, args=list(QUIET))
    yield browser
    browser.close()


@pytest.fixture
def page(browser: Browser, address: str) -> Iterator[Page]:
    """A page that shows something; at the end nothing was asked of another machine and no error was logged."""
    page = browser.new_page(viewport={"width": 1100, "height": 900})
    errors: list[str] = []
    asked: list[str] = []
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(address)
    page.wait_for_function("document.getElementById('left-time').textContent !== ''")
    settle(page)
    yield page
    page.close()
    assert errors == []
    assert [url for url in asked if not url.startswith((address, "blob:", "data:"))] == []


def settle(page: Page) -> None:
    """Until the picture has been the same for a while."""
    page.evaluate(
        """async () => {
          const canvas = document.getElementById('left');
          let [before, calm] = ['', 0];
          while (calm < 3) {
            await new Promise((done) => setTimeout(done, 120));
            const now = canvas.toDataURL();
            calm = now === before ? calm + 1 : 0;
            before = now;
          }
        }"""
    )


def seen(page: Page, canvas: str) -> npt.NDArray[np.float64]:
    """A canvas as (H, W, 3) of 0 to 255."""
    data = page.evaluate(f"document.getElementById('{canvas}').toDataURL('image/png')")
    pixels = cv2.imdecode(np.frombuffer(base64.b64decode(data.partition(",")[2]), np.uint8), cv2.IMREAD_UNCHANGED)
    assert pixels is not None
    colours: npt.NDArray[np.float64] = pixels[..., 2::-1].astype(np.float64)
    return colours


def shown(normal: torch.Tensor, model: str, light: tuple[float, float] = (0.3, 0.4)) -> npt.NDArray[np.float64]:
    """What Python shows of it, (H, W, 1)."""
    direction = torch.tensor([*light, math.sqrt(1 - light[0] ** 2 - light[1] ** 2)])
    up = torch.tensor([0.0, 0, 1]).reshape(1, 3, 1, 1)
    shading = ton.oren_nayar(normal[None], direction.reshape(1, 3, 1, 1), up, 0.8, math.radians(35), model=model)
    return (255 * ton.linear_to_srgb(shading[0]).permute(1, 2, 0)).double().numpy()


def stored_normals(file: Path) -> torch.Tensor:
    return ton.decode_normals(torch.from_numpy(read_image(file).astype(np.float32) / 255).permute(2, 0, 1))


def status(page: Page, text: str, timeout: float = 120_000) -> str:
    page.wait_for_function(
        f"document.getElementById('status').textContent.includes({json.dumps(text)})", timeout=timeout
    )
    return str(page.text_content("#status"))


@pytest.mark.slow
def test_pixels_equal_pythons(page: Page) -> None:
    normal = stored_normals(WEB / "graphs" / "normal.png")
    assert np.abs(seen(page, "left") - shown(normal, "vcavity")).max() <= 1
    assert np.abs(seen(page, "right") - shown(normal, "qualitative")).max() <= 1
    page.select_option("#model", "lambert")
    settle(page)
    assert np.abs(seen(page, "left") - shown(normal, "lambert")).max() <= 1
    assert page.evaluate("crossOriginIsolated") is True


@pytest.mark.slow
def test_dragging_and_keys_move_the_light(page: Page) -> None:
    normal, first = stored_normals(WEB / "graphs" / "normal.png"), seen(page, "left")
    box = page.locator("#left").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    page.mouse.down()
    page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 0.5 * box["height"], steps=5)
    page.mouse.up()
    settle(page)
    moved = seen(page, "left")
    assert np.abs(moved - first).mean() > 5
    assert np.abs(moved - shown(normal, "vcavity", (-0.5, 0.0))).max() <= 2  # the mouse stands on whole pixels
    page.focus("#left")
    page.keyboard.press("ArrowUp")
    settle(page)
    assert np.abs(seen(page, "left") - moved).mean() > 0.3


@pytest.mark.slow
def test_a_mesh_is_drawn_as_python_draws_it(page: Page, tmp_path: Path) -> None:
    torus = trimesh.creation.torus(0.8, 0.35)
    torus.export(tmp_path / "torus.obj")
    page.set_input_files("#files", tmp_path / "torus.obj")
    status(page, "triangles drawn")
    settle(page)
    vertices, faces = ton.load_mesh(tmp_path / "torus.obj")
    view = ton.render_normals(normalise_mesh(vertices), faces, ton.Camera.orthographic(1.05), (512, 512))
    difference = np.abs(seen(page, "left") - shown(view.normal[0], "vcavity"))
    assert (difference > 1).mean() < 1e-4  # vertices are rounded once more on the way


@pytest.mark.slow
def test_photographs_become_normals(page: Page, tmp_path: Path, rough: Scene) -> None:
    save_capture(tmp_path / "capture", rough.images, rough.lights, rough.mask)
    page.set_input_files("#files", [f for f in (tmp_path / "capture").iterdir() if f.is_file()])
    found = status(page, "solved in")
    assert float(found.split("roughness ")[1].split("°")[0]) == pytest.approx(30, abs=3)
    capture = ton.load_capture(tmp_path / "capture")
    error = solve_closed_form(capture.images.float(), capture.lights.float(), capture.mask > 0, "vcavity")[3]
    wanted = math.degrees(error[error > 0].median())
    assert float(found.split("within ")[1].split("°")[0]) == pytest.approx(wanted, abs=0.06)
    settle(page)
    assert seen(page, "left").max() > 50
    page.select_option("#solver", "stereo_network")
    page.set_input_files("#files", [])
    page.set_input_files("#files", [f for f in (tmp_path / "capture").iterdir() if f.is_file()])
    status(page, "the network tells no roughness")


def run_in_page(page: Page, name: str, feeds: dict[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[np.float32]]:
    """A graph on given numbers in the browser."""
    kinds = {"float32": "Float32Array", "int64": "BigInt64Array", "bool": "Uint8Array"}
    packed = {
        k: {
            "bytes": base64.b64encode(np.ascontiguousarray(v).tobytes()).decode(),
            "dims": list(v.shape),
            "type": str(v.dtype),
            "array": kinds[str(v.dtype)],
        }
        for k, v in feeds.items()
    }
    answers = page.evaluate(
        """async ([name, packed]) => {
          const { run } = await import('/graphs.js');
          const feeds = {};
          for (const [k, v] of Object.entries(packed)) {
            const bytes = Uint8Array.from(atob(v.bytes), (c) => c.charCodeAt(0));
            feeds[k] = { data: new globalThis[v.array](bytes.buffer), dims: v.dims, type: v.type };
          }
          const found = await run(name, feeds);
          return Object.fromEntries(Object.entries(found).map(([k, v]) => [k, {
            dims: v.dims.map(Number), values: Array.from(v.data, Number).map((x) => Number.isFinite(x) ? x : null) }]));
        }""",
        [name, packed],
    )
    return {k: np.array(v["values"], dtype=np.float32).reshape(v["dims"]) for k, v in answers.items()}


@pytest.mark.slow
def test_all_graphs_give_torchs_answer(page: Page, rough: Scene) -> None:
    generator = torch.Generator().manual_seed(0)
    scene = {
        "normal": torch.nn.functional.normalize(torch.randn(2, 3, 30, 20, generator=generator), dim=1),
        "light": torch.tensor([0.6, 0.0, 0.8]).reshape(1, 3, 1, 1),
        "view": torch.tensor([0.0, 0.0, 1.0]).reshape(1, 3, 1, 1),
        "albedo": torch.rand(2, 3, 30, 20, generator=generator),
        "roughness": torch.rand(2, 1, 30, 20, generator=generator),
    }
    for model in ("lambert", "qualitative", "vcavity"):
        found = run_in_page(page, f"shading_{model}", {k: v.numpy() for k, v in scene.items()})
        assert np.abs(found["shading"] - ton.oren_nayar(*scene.values(), model=model).numpy()).max() <= 1e-5

    feeds = {"images": rough.images, "lights": rough.lights, "mask": rough.mask}
    answers = run_in_page(page, "stereo", {k: v.numpy() for k, v in feeds.items()})
    solved = solve_closed_form(rough.images, rough.lights, rough.mask, "vcavity")
    for name, value in zip(("normal", "albedo", "roughness", "error"), solved, strict=True):
        assert np.abs(answers[name] - value.numpy()).max() <= 1e-5

    answers = run_in_page(page, "stereo_network", {k: v.numpy() for k, v in feeds.items()})
    wanted = solve_network(rough.images, rough.lights, rough.mask[0])
    for name in ("normal", "albedo", "roughness", "error"):
        assert np.abs(answers[name] - wanted[name].numpy()).max() <= 1e-5

    ball = trimesh.creation.icosphere(2)
    vertices, faces = torch.tensor(ball.vertices).float(), torch.tensor(ball.faces)
    drawn = run_in_page(page, "renderer", {"vertices": vertices.numpy(), "faces": faces.numpy()})
    view = ton.render_normals(vertices, faces, ton.Camera.orthographic(1.05), (512, 512))
    assert (drawn["face"] == view.face.numpy()).all()
    assert np.abs(drawn["normal"] - view.normal.numpy()).max() <= 1e-5


@pytest.mark.slow
def test_mistakes_are_told(page: Page, tmp_path: Path, rough: Scene) -> None:
    for k, size in enumerate((20, 20, 24)):
        write_image(tmp_path / f"{k}.png", torch.rand(3, size, size))
    (tmp_path / "lights.txt").write_text("0 0 1\n.6 0 .8\n0 .6 .8\n")
    (tmp_path / "two.txt").write_text("0 0 1\n.6 0 .8\n")
    (tmp_path / "rubbish.png").write_bytes(b"rubbish")
    (tmp_path / "rubbish.obj").write_text("nothing\n")
    pictures = [tmp_path / f"{k}.png" for k in range(3)]
    for files, message in (
        ([*pictures, tmp_path / "lights.txt"], "one size"),
        (pictures, "no light file"),
        ([*pictures[:2], tmp_path / "lights.txt"], "3 lights but 2"),
        ([tmp_path / "rubbish.png"], "not a picture"),
        ([tmp_path / "rubbish.obj"], "no faces"),
        ([pictures[0]], "no normal map"),
    ):
        page.set_input_files("#files", files)
        status(page, message)
        assert "wrong" in str(page.get_attribute("#status", "class"))


@pytest.mark.slow
def test_webgpu_shows_the_same(driver: Playwright, address: str) -> None:
    """Where the browser has it, if only in software."""
    flags = ("--no-sandbox", "--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader", "--ignore-gpu-blocklist")
    browser = driver.chromium.launch(executable_path=CHROMIUM, args=list(flags))
    page = browser.new_page()
    page.goto(address)
    page.wait_for_function("document.getElementById('left-time').textContent !== ''")
    if not page.evaluate("async () => Boolean(await navigator.gpu?.requestAdapter())"):
        browser.close()
        pytest.skip("no WebGPU here")
    page.evaluate("document.getElementById('left-time').textContent = ''")
    page.select_option("#device", "webgpu")
    page.wait_for_function("document.getElementById('left-time').textContent !== ''", timeout=120_000)
    settle(page)
    normal = stored_normals(WEB / "graphs" / "normal.png")
    assert np.abs(seen(page, "left") - shown(normal, "vcavity")).max() <= 1
    browser.close()


@pytest.mark.slow
def test_a_broken_graph_is_told(browser: Browser, address: str) -> None:
    page = browser.new_page()
    page.route("**/shading_vcavity.onnx", lambda route: route.fulfill(body=b"rubbish"))
    page.goto(address)
    status(page, "shading_vcavity.onnx does not load")
    assert "wrong" in str(page.get_attribute("#status", "class"))
    page.close()


def saved(page: Page, kind: str, folder: Path) -> Path:
    """The file that the page saves."""
    page.select_option("#saved", kind)
    with page.expect_download() as download:
        page.click("#save")
    target = folder / download.value.suggested_filename
    download.value.save_as(target)
    return target


@pytest.mark.slow
def test_results_are_saved_as_python_has_them(page: Page, tmp_path: Path, rough: Scene) -> None:
    save_capture(tmp_path / "capture", rough.images, rough.lights, rough.mask)
    page.set_input_files("#files", [f for f in (tmp_path / "capture").iterdir() if f.is_file()])
    status(page, "solved in")
    rows, columns = (torch.nonzero(rough.mask[0].any(k)).flatten() for k in (1, 0))
    window = slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
    capture = ton.load_capture(tmp_path / "capture")
    cut = [t.float()[..., window[0], window[1]] for t in (capture.images, capture.mask)]
    normal, albedo, *_ = solve_closed_form(cut[0], capture.lights.float(), cut[1] > 0, "vcavity")
    mask = (normal != 0).any(0)

    pixels = torch.from_numpy(read_image(saved(page, "normals", tmp_path)).astype(np.float32) / 65535)
    found = ton.decode_normals(pixels.permute(2, 0, 1))
    assert (found - normal).abs()[:, mask].max() <= 1e-3
    assert (pixels.permute(2, 0, 1)[:, ~mask] == 0).all()

    colours = torch.from_numpy(read_image(saved(page, "albedo", tmp_path)).astype(np.float32) / 65535).permute(2, 0, 1)
    assert (colours - ton.linear_to_srgb(albedo.clamp(0, 1))).abs()[:, mask].max() <= 2e-3

    height = torch.from_numpy(read_image(saved(page, "heights", tmp_path)).astype(np.float32) / 65535)
    wanted = integrate_smooth(normal, mask[None])[0]
    low, high = wanted[mask].min(), wanted[mask].max()
    assert (height.reshape(mask.shape) - (wanted - low) / (high - low)).abs()[mask].max() <= 2e-3

    (surface,) = trimesh.load_scene(saved(page, "glb", tmp_path)).geometry.values()
    assert len(surface.vertices) == int(mask.sum())
    assert np.ptp(surface.vertices[:, 2]) == pytest.approx(float(high - low), rel=2e-3)
    assert (surface.face_normals[:, 2] > 0).mean() > 0.99


@pytest.mark.slow
def test_a_static_host_without_headers_is_enough(browser: Browser, address: str) -> None:
    """``npm run build``, served by a server that sets no header: one thread, the same pixels."""
    assert address  # the graphs are there
    subprocess.run(["node", "build.js"], cwd=WEB, check=True, capture_output=True)
    handler = partial(SimpleHTTPRequestHandler, directory=str(WEB / "dist"))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        page = browser.new_page()
        page.goto(f"http://localhost:{server.server_address[1]}")
        page.wait_for_function("document.getElementById('left-time').textContent !== ''")
        settle(page)
        assert page.evaluate("crossOriginIsolated") is False
        assert "1 thread" in str(page.text_content("#device"))
        normal = stored_normals(WEB / "graphs" / "normal.png")
        assert np.abs(seen(page, "left") - shown(normal, "vcavity")).max() <= 1
        page.close()
        server.shutdown()


@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.slow
def test_screen_readers_find_no_serious_fault(browser: Browser, address: str, width: int) -> None:
    page = browser.new_page(viewport={"width": width, "height": 800})
    page.goto(address)
    page.wait_for_function("document.getElementById('left-time').textContent !== ''")
    page.add_script_tag(path=WEB / "node_modules" / "axe-core" / "axe.min.js")
    found = page.evaluate("async () => (await axe.run()).violations")
    assert [(v["id"], v["help"]) for v in found if v["impact"] in ("serious", "critical")] == []
    page.close()


@pytest.mark.slow
def test_a_phone_needs_no_sideways_scrolling(browser: Browser, address: str) -> None:
    """And the picture stays in sight beside the controls."""
    page = browser.new_page(viewport={"width": 360, "height": 740}, has_touch=True)
    page.goto(address)
    page.wait_for_function("document.getElementById('left-time').textContent !== ''")
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    page.locator("#turn").scroll_into_view_if_needed()
    page.evaluate("window.scrollTo(0, document.body.scrollHeight)")
    box = page.locator("#left").bounding_box()
    assert box is not None
    assert box["y"] >= 0
    assert box["y"] + box["height"] <= 740
    page.close()
