"""What people open: textures, GLB and the page with its viewer."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from tests.support.example_code import CHROMIUM
from torch_orennayar import Finding, OrenNayar, Reconstruction, decode_normals
from torch_orennayar.geometry.primitives import Ball, spiral_lights
from torch_orennayar.io.capture import Capture
from torch_orennayar.io.images import read_image
from torch_orennayar.io.result_maps import ResultMaps
from torch_orennayar.io.results import write_reconstruction
from torch_orennayar.io.srgb import linear_to_srgb
from torch_orennayar.io.textures import perceptual_roughness
from torch_orennayar.io.verdict import verdict

SIZE = (40, 56)
NORMAL, MASK = Ball(26.0, 19.0, 17.0).normals(SIZE)
LIGHT = (0.3, -0.4, math.sqrt(0.75))


def result(model: str = "vcavity", exponents: tuple[int, ...] = (), falloff: float = 1.0) -> Reconstruction:
    draw = torch.Generator().manual_seed(0)
    albedo = (0.2 + 0.7 * torch.rand(3, *SIZE, generator=draw)) * MASK
    lobes = 0.1 * torch.rand(len(exponents), 3, *SIZE, generator=draw) * MASK
    return Reconstruction(
        normal=NORMAL, albedo=albedo, roughness=0.6 * torch.rand(1, *SIZE, generator=draw) * MASK,
        residual=0.01 * MASK, confidence=0.9 * MASK, model=model, scores={}, report=(), exponents=exponents,
        specular=lobes if exponents else None, falloff=falloff,
    )  # fmt: skip


def capture() -> Capture:
    lights = spiral_lights(5)
    images = OrenNayar("lambert")(NORMAL[None], lights[None], albedo=0.5)[0].expand(-1, 3, -1, -1)
    return Capture(images, lights, torch.ones(5, 3), MASK, None, tuple(f"<{k}>.png" for k in range(5)))


def test_textures_hold_the_maps(tmp_path: Path) -> None:
    found = result("lambert", (30,))
    written = write_reconstruction(tmp_path, found, capture(), title="ball", report=False, animation=False)
    inside = MASK[0]
    for name, green in (("normal_gl.png", "up"), ("normal_dx.png", "down")):
        stored = torch.from_numpy(read_image(tmp_path / name).astype(np.float32) / 65535).permute(2, 0, 1)
        assert (decode_normals(stored, green=green) - NORMAL)[:, inside].abs().max() <= 1e-4
    assert np.abs(read_image(tmp_path / "normal.exr").transpose(2, 0, 1) - NORMAL.numpy()).max() == 0
    depth = np.load(tmp_path / "depth.npy")[0]
    assert np.abs(np.squeeze(read_image(tmp_path / "height.exr")) - depth).max() == 0
    sigma = read_image(tmp_path / "roughness_sigma.png").astype(np.float64) / 65535 * math.pi / 2
    assert np.abs(np.squeeze(sigma) - found.roughness[0].numpy()).max() <= 2e-5
    seen = linear_to_srgb((found.albedo * written.numbers["albedo_exposure"]).clamp(0, 1)) * MASK
    stored = torch.from_numpy(read_image(tmp_path / "albedo.png").astype(np.float32) / 255).permute(2, 0, 1)
    assert (stored - seen).abs().max() <= 0.51 / 255
    assert not (tmp_path / "report.html").exists()


def test_perceptual_roughness_is_that_of_the_highlight() -> None:
    found = result("lambert", (30,))
    maps = ResultMaps.of(found, capture())
    inside = perceptual_roughness(maps, found.exponents)[MASK]
    alpha = math.sqrt(2 / 32)
    assert ((inside - math.sqrt(alpha)).abs() < 1e-6).float().mean() > 0.8  # the rest has next to no highlight
    assert bool((perceptual_roughness(ResultMaps.of(result(), capture()), ()) == 1).all())


@pytest.mark.parametrize("pixel_mm", [None, 0.5])
def test_the_relief_has_texture_coordinates_and_a_unit(tmp_path: Path, pixel_mm: float | None) -> None:
    write_reconstruction(tmp_path, result(), capture(), title="ball", pixel_mm=pixel_mm, report=False, animation=False)
    scene = trimesh.load(tmp_path / "mesh.glb")
    (mesh,) = scene.geometry.values()
    extent = mesh.extents[0]
    pixels = float(MASK[0].any(0).sum() - 1)
    assert extent == pytest.approx(pixels / SIZE[1] if pixel_mm is None else pixels * pixel_mm / 1000, rel=1e-5)
    assert mesh.visual.uv.min() > 0
    assert mesh.visual.uv.max() < 1
    column = mesh.visual.uv[:, 0] * SIZE[1] - 0.5  # a texture coordinate is where its pixel lies
    assert np.allclose(column, np.round(column), atol=1e-3)
    assert mesh.visual.material.normalTexture.size == (SIZE[1], SIZE[0])
    ply = trimesh.load(tmp_path / "mesh.ply")
    assert ply.extents[0] == pytest.approx(pixels * (pixel_mm or 1.0), rel=1e-5)
    assert json.loads((tmp_path / "result.json").read_text())["pixel_mm"] == pixel_mm


def test_the_page_begins_with_a_verdict_and_escapes_names(tmp_path: Path) -> None:
    doubtful = replace(result(), report=(Finding("near.", "lights-near", 2.0),))
    write_reconstruction(tmp_path, doubtful, capture(), title="a <b>", animation=False)
    page = (tmp_path / "report.html").read_text()
    assert page.index("Do not trust this result") < page.index("Photographs and lights") < page.index("Surface")
    assert "&lt;0&gt;.png" in page
    assert "a &lt;b&gt;" in page
    assert "http" not in page.replace("http://www.w3.org", "")  # nothing is fetched
    assert not (tmp_path / "relight.gif").exists()


def test_verdicts() -> None:
    maps = ResultMaps.of(result(), capture())
    assert verdict((), maps).word == "good"
    assert verdict((Finding("few.", "three-lights"),), maps).word == "look"
    assert verdict((Finding("bad.", "lights-uncertain", 15.0),), maps).word == "doubtful"
    assert verdict((Finding("little.", "clipped-samples", 0.1),), maps).word == "good"
    assert verdict((Finding("much.", "clipped-samples", 5.0),), maps).word == "look"
    assert verdict((), replace(maps, residual=0.2 * MASK)).word == "doubtful"
    assert verdict((), replace(maps, confidence=0.1 * MASK)).word == "look"
    few = MASK & (MASK.cumsum(1).cumsum(2) < 50)
    assert any("pixels were solved" in reason for reason in verdict((), replace(maps, mask=few)).reasons)


def _note(said: list[str], what: object) -> None:
    said.append(str(what))


@pytest.mark.slow
@pytest.mark.skipif(not CHROMIUM, reason="no Chromium")
def test_the_viewer_shows_what_torch_computes(tmp_path: Path) -> None:
    from playwright.sync_api import sync_playwright

    kinds: list[tuple[str, tuple[int, ...], float]] = [
        ("lambert", (12, 90), 1.3), ("qualitative", (), 1.0), ("qualitative-0.57", (), 1.0), ("fujii", (), 1.0),
        ("full", (), 1.0), ("vcavity", (40,), 1.0), ("eon", (), 1.0),
    ]  # fmt: skip
    arguments = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=arguments)
        for number, (model, exponents, falloff) in enumerate(kinds):
            found, folder = result(model, exponents, falloff), tmp_path / str(number)
            top = write_reconstruction(folder, found, capture(), title="ball", animation=False).numbers
            page = browser.new_page(viewport={"width": 390, "height": 800})
            said: list[str] = []
            page.on("console", partial(_note, said))
            page.on("pageerror", partial(_note, said))
            page.goto((folder / "report.html").as_uri())
            pixels = page.evaluate(
                """(light) => {
                  viewer.state.light = light; viewer.draw();
                  const gl = document.getElementById("viewer").getContext("webgl2");
                  const [w, h] = [gl.drawingBufferWidth, gl.drawingBufferHeight], seen = new Uint8Array(4 * w * h);
                  gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, seen);
                  return [...seen];
                }""",
                list(LIGHT),
            )
            assert said == []
            assert page.evaluate("document.documentElement.scrollWidth") <= 390
            seen = torch.tensor(pixels).reshape(*SIZE, 4).flip(0)[..., :3].permute(2, 0, 1) / 255
            wanted = linear_to_srgb((found.shade(torch.tensor([LIGHT]))[0] * top["albedo_exposure"]).clamp(0, 1))
            assert (seen - wanted).abs()[:, MASK[0]].max() <= 1.01 / 255, model
            page.close()
        browser.close()
