"""The relief `mesh.glb` of a result: three.js shows it in a real browser, and the Khronos validator finds no error."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
from pathlib import Path

import pytest
import torch
from torch import Tensor

from tests.support.example_code import CAN_BROWSE, CHROMIUM, WEB, load, served_page
from torch_orennayar import OrenNayar, Reconstruction
from torch_orennayar.geometry.primitives import Ball, spiral_lights
from torch_orennayar.io.capture import Capture
from torch_orennayar.io.results import write_reconstruction

SIZE = (48, 64)
PAGE = """<!doctype html><meta charset="utf-8">
<script type="importmap">{"imports": {"three": "/node_modules/three/build/three.module.js",
 "three/addons/": "/node_modules/three/examples/jsm/"}}</script>
<script type="module">
import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
const relief = (await new GLTFLoader().loadAsync("/relief.glb")).scene;
relief.updateMatrixWorld(true);
const meshes = [];
relief.traverse((part) => part.isMesh && meshes.push(part));
const box = new THREE.Box3().setFromObject(relief), { geometry, material } = meshes[0];
const size = box.getSize(new THREE.Vector3());
window.found = {
  meshes: meshes.length, width: size.x, height: size.y, depth: size.z, vertices: geometry.attributes.position.count,
  coordinates: geometry.attributes.uv.count,
  textures: ["map", "normalMap", "roughnessMap"].map((n) => material[n]?.image.width),
};
</script>"""


VALIDATE = """
const validator = require("gltf-validator"), fs = require("fs");
const file = new Uint8Array(fs.readFileSync(process.argv[1]));
validator.validateBytes(file).then((report) => console.log(JSON.stringify(report.issues)));
"""
PIXEL_MM = 0.5


@pytest.fixture(scope="module")
def relief(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Tensor, Tensor]:
    """The folder of a ball's results, its mask and its height."""
    radius, folder = 20.0, tmp_path_factory.mktemp("relief")
    normal, mask = Ball(30.0, 24.0, radius).normals(SIZE)
    lights, whole = spiral_lights(4), torch.ones(1, *SIZE)
    images = OrenNayar("lambert")(normal[None], lights[None], albedo=0.5)[0].expand(-1, 3, -1, -1)
    capture = Capture(images, lights, torch.ones(4, 3), mask, None, ("a", "b", "c", "d"))
    column = torch.arange(SIZE[1]) - 30.0
    row = torch.arange(SIZE[0])[:, None] - 24.0
    height = (radius**2 - column**2 - row**2).clamp_min(0).sqrt()[None]
    found = Reconstruction(
        normal=normal, albedo=0.5 * mask.expand(3, -1, -1).float(), roughness=0 * whole, residual=0 * whole,
        confidence=whole * mask, model="lambert", scores={}, report=(), depth=height,
    )  # fmt: skip
    write_reconstruction(folder, found, capture, title="ball", pixel_mm=PIXEL_MM, report=False, animation=False)
    return folder, mask, height


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("node") is None or shutil.which("npm") is None, reason="no Node.js")
def test_the_validator_finds_no_error(relief: tuple[Path, Tensor, Tensor]) -> None:
    load("web/serve").install()
    ran = subprocess.run(
        ["node", "-e", VALIDATE, relief[0] / "mesh.glb"], cwd=WEB, capture_output=True, text=True, check=True
    )
    issues = json.loads(ran.stdout)
    assert issues["numErrors"] == 0, issues["messages"]
    # Viewers make the tangents of a normal map themselves (MikkTSpace), which the validator warns of.
    assert {m["code"] for m in issues["messages"] if m["severity"] < 2} <= {"MESH_PRIMITIVE_GENERATED_TANGENT_SPACE"}


@pytest.mark.slow
@pytest.mark.skipif(not CAN_BROWSE, reason="no Chromium or npm")
def test_three_js_shows_the_relief(relief: tuple[Path, Tensor, Tensor]) -> None:
    from playwright.sync_api import sync_playwright

    folder, mask, height = relief
    inside = mask[0].nonzero()
    with served_page() as address, sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page()
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.route("**/relief.html", lambda route: route.fulfill(body=PAGE, content_type="text/html"))
        page.route("**/relief.glb", lambda route: route.fulfill(path=folder / "mesh.glb"))
        page.goto(f"{address}/relief.html")
        page.wait_for_function("window.found !== undefined", timeout=30_000)
        seen = page.evaluate("window.found")
        browser.close()
    assert errors == []
    assert seen["meshes"] == 1
    assert seen["vertices"] == seen["coordinates"] == len(inside)
    assert seen["textures"] == [SIZE[1]] * 3
    metres = PIXEL_MM / 1000  # the unit of glTF
    assert math.isclose(seen["width"], int(inside[:, 1].max() - inside[:, 1].min()) * metres, rel_tol=1e-4)
    assert math.isclose(seen["depth"], float(height[mask].max() - height[mask].min()) * metres, rel_tol=1e-4)
