"""The demo: render a rough object under known lights, recover it from the pictures, report the errors."""

from __future__ import annotations

import json
import math
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

import torch
from torch import Tensor

from .core.files import atomic_directory
from .core.optional import PACKAGES, require
from .core.progress import say
from .export.api import export_onnx
from .geometry.camera import Camera
from .geometry.integrate import integrate_normals
from .geometry.mesh import depth_to_mesh
from .geometry.mesh_files import save_mesh
from .geometry.metrics import angular_error
from .geometry.primitives import bumpy_ball, spiral_lights
from .io.capture import Capture, load_capture, save_capture
from .io.figures import save_maps, save_sheet, show_light, show_normals
from .io.report import Section, write_report
from .io.result_numbers import FindingEntry, finding_entries
from .io.srgb import linear_to_srgb
from .reconstruction import Reconstruction
from .render.normal_map import NormalMap, render_normals
from .shading.layer import OrenNayar
from .stereo.solver import photometric_stereo

ROUGHNESS = math.radians(30)
"""Of the demo's object, radians; set by hand: where Lambert's law is clearly wrong."""
NOISE = 0.01
"""Standard deviation of the noise in the demo's photographs, of a white surface facing the light; set by hand."""
LIGHTS = 24
"""Photographs of the demo; set by hand, a quarter of DiLiGenT's 96 (Shi et al. 2016)."""
SWEEP_DEGREES = (0, 20, 35, 45, 70, 85)
"""Roughnesses that the demo draws side by side, degrees; set by hand."""
METHODS = ("lambert", "qualitative", "vcavity")
"""Models that the demo compares, beside the automatic choice."""


@dataclass(frozen=True)
class Scene:
    """The demo's object and the photographs of it, with the truth.

    Attributes:
        surface: the rendered view of the object.
        albedo: (3, H, W) linear.
        lights: (K, 3) unit directions to the lights.
        images: (K, 3, H, W) linear light, with noise.
    """

    surface: NormalMap
    albedo: Tensor
    lights: Tensor
    images: Tensor


class DemoNumbers(TypedDict):
    """What the demo's ``result.json`` holds of one method."""

    model: str
    normal_error_degrees: dict[str, float]
    roughness_degrees: float
    albedo_error_share: float
    scores: dict[str, float]
    report: list[str]
    findings: list[FindingEntry]
    seconds: float


def make_scene(size: int, seed: int) -> Scene:
    """Render the object with ``vcavity`` at 30 degrees under 24 lights, with 1 % noise."""
    vertices, faces = bumpy_ball()
    camera = Camera.orthographic(1.05)
    surface = render_normals(vertices, faces, camera, (size, size))
    points = camera.points(torch.where(surface.mask, surface.depth, 0.0))
    stripes = torch.sigmoid(12 * torch.sin(4 * points[:, 1:2] + 2 * points[:, :1]))
    warm, cool = (torch.tensor(c).reshape(1, 3, 1, 1) for c in ((0.85, 0.62, 0.45), (0.45, 0.55, 0.7)))
    albedo = (warm * stripes + cool * (1 - stripes)) * surface.mask
    lights = spiral_lights(LIGHTS)
    images = OrenNayar("vcavity")(surface.normal, lights[None], albedo=albedo, roughness=ROUGHNESS)[0]
    noise = torch.randn(images.shape, generator=torch.Generator().manual_seed(seed)) * NOISE
    return Scene(surface, albedo[0], lights, (images + noise * surface.mask[0]).clamp_min(0))


def run_demo(folder: str | os.PathLike[str], *, size: int = 256, seed: int = 0) -> dict[str, DemoNumbers]:
    """Run the demo and write its folder: pictures, capture, results, mesh, ONNX file, report.

    Args:
        folder: the output folder; its files appear together or not at all.
        size: height and width of the pictures in pixels.
        seed: of the noise.

    Returns:
        The numbers in ``result.json``, by method.

    Raises:
        FileError: the place cannot be written.
        MissingPackageError: a package that draws, writes or exports is not installed.
    """
    require(*PACKAGES)  # a missing one is named before minutes of work
    with atomic_directory(folder) as temporary:
        say("rendering a rough object")
        scene = make_scene(size, seed)
        save_capture(temporary / "capture", scene.images, scene.lights, scene.surface.mask[0], scene.surface.normal[0])
        capture = load_capture(temporary / "capture")
        found: dict[str, Reconstruction] = {}
        numbers: dict[str, DemoNumbers] = {}
        for model in (*METHODS, "auto"):
            say(f"recovering it with {model}")
            begun = time.perf_counter()
            found[model] = photometric_stereo(capture.images, capture.lights, capture.mask, model=model, seed=seed)
            numbers[model] = _numbers(found[model], scene, time.perf_counter() - begun)
        say("drawing, and exporting an ONNX graph")
        sections = [
            _sweep(temporary, scene),
            _photographs(temporary, capture),
            _comparison(temporary, found, numbers, scene),
            _surface(temporary, found["auto"], scene),
            _graph(temporary),
        ]
        (temporary / "result.json").write_text(json.dumps(numbers, indent=2) + "\n")
        write_report(temporary / "report.html", "A rough object, rendered and recovered", sections)
    return numbers


def _numbers(found: Reconstruction, scene: Scene, seconds: float) -> DemoNumbers:
    mask = scene.surface.mask[0]
    albedo_error = (found.albedo - scene.albedo).abs()[:, mask[0]].mean() / scene.albedo[:, mask[0]].mean()
    return {
        "model": found.model,
        "normal_error_degrees": angular_error(found.normal, scene.surface.normal[0], mask).summary(),
        "roughness_degrees": math.degrees(found.roughness.max().item()),
        "albedo_error_share": albedo_error.item(),
        "scores": found.scores,
        "report": [str(entry) for entry in found.report],
        "findings": finding_entries(found.report),
        "seconds": seconds,
    }


def _sweep(folder: Path, scene: Scene) -> Section:
    """Roughness from 0 to 85 degrees beside Lambert, light at the camera."""
    mask, normal = scene.surface.mask[0], scene.surface.normal
    light = torch.tensor([[0.0, 0.0, 1.0]])
    rows = []
    for model in ("qualitative", "vcavity"):
        row = {"Lambert": OrenNayar("lambert")(normal, light, albedo=0.8)}
        for degrees in SWEEP_DEGREES:
            layer = OrenNayar(model)
            row[f"σ = {degrees}°"] = layer(normal, light, albedo=0.8, roughness=math.radians(degrees))
        rows.append({caption: show_light(image[0], mask) for caption, image in row.items()})
    picture = save_sheet(folder / "sweep.png", rows, labels=("qualitative", "vcavity"))
    text = (
        "Albedo 0.8, the light at the camera. The rougher the surface, the flatter it looks: slopes that are dark by "
        "Lambert's law return more light. The qualitative model also loses light overall; the fit to the V-cavity "
        "theory with all bounces keeps it.",
    )
    return Section("Roughness against Lambert", text, pictures=(picture,))


def _photographs(folder: Path, capture: Capture) -> Section:
    shown = range(0, len(capture.images), max(1, len(capture.images) // 6))
    row = {f"light {i + 1}": show_light(capture.images[i], capture.mask) for i in shown}
    picture = save_sheet(folder / "photographs.png", [row])
    text = (
        f"{len(capture.images)} pictures rendered with vcavity, roughness {math.degrees(ROUGHNESS):.0f}°, "
        f"{NOISE:.0%} noise, written as 16-bit files (folder capture) and read back.",
    )
    return Section("The photographs", text, pictures=(picture,))


def _comparison(
    folder: Path, found: dict[str, Reconstruction], numbers: dict[str, DemoNumbers], scene: Scene
) -> Section:
    mask, truth = scene.surface.mask[0], scene.surface.normal[0]
    normals = {"truth": truth} | {m: found[m].normal for m in METHODS}
    albedos = {"truth": scene.albedo} | {m: found[m].albedo for m in METHODS}
    recovered = save_sheet(
        folder / "recovered.png",
        [
            {name: show_normals(n, mask) for name, n in normals.items()},
            {name: show_light(a, mask) for name, a in albedos.items()},
        ],
        labels=("normal", "albedo"),
    )
    errors = {f"normal error, {m}": angular_error(found[m].normal, truth, mask) for m in METHODS}
    error_map = save_maps(folder / "normal_error.png", errors, mask, unit="degrees", top=12)
    differences = {f"albedo error, {m}": (found[m].albedo - scene.albedo).abs().mean(0, keepdim=True) for m in METHODS}
    albedo_map = save_maps(folder / "albedo_error.png", differences, mask, unit="albedo", top=0.2)
    rough = {f"roughness error, {m}": (found[m].roughness - ROUGHNESS * mask).abs().rad2deg() for m in METHODS}
    roughness_map = save_maps(folder / "roughness_error.png", rough, mask, unit="degrees", top=30)
    rows = [
        (
            name if name != "auto" else f"auto: {n['model']}",
            f"{n['normal_error_degrees']['mean']:.2f}°",
            f"{n['normal_error_degrees']['median']:.2f}°",
            f"{n['roughness_degrees']:.1f}°",
            f"{n['albedo_error_share']:.1%}",
            f"{n['seconds']:.1f} s",
        )
        for name, n in numbers.items()
    ]
    text = (
        "The error of lambert is what leaving roughness out costs; that of qualitative, what the older formula costs.",
        *numbers["auto"]["report"],
    )
    columns = (
        "solved with",
        "normal error, mean",
        "median",
        f"σ (truth {math.degrees(ROUGHNESS):.0f}°)",
        "albedo error",
        "time",
    )
    return Section(
        "Recovered from the photographs", text, columns, rows, (recovered, error_map, albedo_map, roughness_map)
    )


def _surface(folder: Path, found: Reconstruction, scene: Scene) -> Section:
    mask = scene.surface.mask[0]
    depth = integrate_normals(found.normal, mask)
    vertices, faces, pixels = depth_to_mesh(depth, mask)
    save_mesh(folder / "mesh.ply", vertices, faces, linear_to_srgb(found.albedo).flatten(1)[:, pixels].T)
    low = depth[mask].min()
    picture = save_maps(folder / "depth.png", {"height": (depth - low) * mask}, mask, unit="pixels", palette="viridis")
    text = (f"mesh.ply: {len(vertices)} vertices and {len(faces)} faces, integrated from the recovered normals.",)
    return Section("The surface", text, pictures=(picture,))


def _graph(folder: Path) -> Section:
    path = export_onnx("shading", folder / "shading.onnx", model="vcavity")
    size = f"{path.stat().st_size / 1000:.0f} kB"
    text = (f"shading.onnx ({size}) gives torch's values in ONNX Runtime at every size tried.",)
    return Section("The ONNX graph", text)
