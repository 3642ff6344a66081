"""The app without torch, in a process in which torch cannot be imported."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

import torch_orennayar as ton
from tests.support.objects import Scene
from torch_orennayar.geometry.mesh import normalise_mesh
from torch_orennayar.io.capture import save_capture
from torch_orennayar.io.images import read_image, write_image
from torch_orennayar.stereo.closed_form import solve_closed_form

APP = Path(__file__).resolve().parents[2] / "examples" / "onnx_app" / "app.py"
WITHOUT_TORCH = (
    "import runpy, sys; sys.modules['torch'] = sys.modules['torch_orennayar'] = None; "
    f"sys.argv = [{str(APP)!r}, *sys.argv[1:]]; runpy.run_path({str(APP)!r}, run_name='__main__')"
)
CAMERA, SIZE = ton.Camera.orthographic(1.05), (96, 128)
LIGHT = torch.nn.functional.normalize(torch.tensor([0.3, 0.4, 0.86]), dim=0)


def app(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", WITHOUT_TORCH, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def graphs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("graphs")
    ton.export_onnx("shading", folder / "shading.onnx", model="vcavity")
    ton.export_onnx("renderer", folder / "renderer.onnx", camera=CAMERA, size=SIZE)
    ton.export_onnx("stereo", folder / "stereo.onnx", model="vcavity")
    return folder


def wanted_picture(normal: torch.Tensor) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """What Python shows, 0 to 255."""
    up = torch.tensor([0.0, 0, 1]).reshape(1, 3, 1, 1)
    shading = ton.oren_nayar(normal[None], LIGHT.reshape(1, 3, 1, 1), up, 0.8, math.radians(35), model="vcavity")
    return (ton.linear_to_srgb(shading[0])[0] * 255).double().numpy()


@pytest.mark.slow
def test_relight(graphs: Path, tmp_path: Path, rough: Scene) -> None:
    write_image(tmp_path / "normal.png", ton.encode_normals(rough.normal))
    done = app("relight", graphs / "shading.onnx", tmp_path / "normal.png", tmp_path / "out.png")
    assert done.returncode == 0, done.stderr
    stored = torch.from_numpy(read_image(tmp_path / "normal.png").astype(np.float32) / 255).permute(2, 0, 1)
    picture = read_image(tmp_path / "out.png").astype(float)
    assert np.abs(picture - wanted_picture(ton.decode_normals(stored))).max() <= 0.6


@pytest.mark.slow
def test_render(graphs: Path, tmp_path: Path) -> None:
    import trimesh

    ball = trimesh.creation.icosphere(3)
    ball.export(tmp_path / "ball.obj")
    files = graphs / "renderer.onnx", graphs / "shading.onnx", tmp_path / "ball.obj"
    done = app("render", *files, tmp_path / "out.png")
    assert done.returncode == 0, done.stderr
    vertices, faces = ton.load_mesh(tmp_path / "ball.obj")
    seen = ton.render_normals(normalise_mesh(vertices), faces, CAMERA, SIZE)
    picture = read_image(tmp_path / "out.png").astype(float)
    assert np.abs(picture - wanted_picture(seen.normal[0])).max() <= 0.6


@pytest.mark.slow
def test_solve(graphs: Path, tmp_path: Path, rough: Scene) -> None:
    save_capture(tmp_path / "capture", rough.images, rough.lights, rough.mask)
    done = app("solve", graphs / "stereo.onnx", tmp_path / "capture", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    normal = torch.from_numpy(np.load(tmp_path / "out" / "normal.npy"))
    assert ton.angular_error(normal, rough.normal, rough.mask).summary()["mean"] < 2
    assert float(done.stdout.split()[-1]) == pytest.approx(30, abs=3)
    assert read_image(tmp_path / "out" / "normal.png").dtype == np.uint16


@pytest.mark.slow
def test_ambient_light_lp_and_exif_are_read_as_the_package_reads_them(
    graphs: Path, tmp_path: Path, rough: Scene
) -> None:
    """Lying 8-bit photographs with an .lp file and light that is always on: the package's images, the same normals."""
    from PIL import Image

    folder = tmp_path / "capture"
    folder.mkdir()
    lines = [str(len(rough.lights))]
    for k, (picture, light) in enumerate(zip([*rough.images, 0 * rough.images[0]], [*rough.lights, None], strict=True)):
        seen = (255 * ton.linear_to_srgb((picture + 0.02).clamp(0, 1))).round().byte().permute(1, 2, 0).numpy()
        name = "ambient.png" if light is None else f"{k:02}.png"
        exif = Image.Exif()
        exif[0x112] = 6  # stored on its left side
        Image.fromarray(np.ascontiguousarray(np.rot90(seen))).save(folder / name, exif=exif)
        if light is not None:
            lines.append(f"C:\\rti\\{name} {' '.join(str(v) for v in light.tolist())}")
    (folder / "scene.lp").write_text("\n".join(lines))
    write_image(folder / "mask.png", rough.mask.float())
    done = app("solve", graphs / "stereo.onnx", folder, tmp_path / "out")
    assert done.returncode == 0, done.stderr
    capture = ton.load_capture(folder)
    wanted, *_ = solve_closed_form(capture.images.float(), capture.lights.float(), capture.mask, "vcavity")
    found = torch.from_numpy(np.load(tmp_path / "out" / "normal.npy"))
    assert found.shape == wanted.shape
    error = ton.angular_error(found, wanted, rough.mask).as_subclass(torch.Tensor)
    assert float(error[rough.mask].max()) < 0.1


@pytest.mark.slow
def test_half_graphs_and_ply(graphs: Path, tmp_path: Path) -> None:
    import trimesh

    ball = trimesh.creation.icosphere(2)
    for suffix, options in (("obj", {}), ("ply", {"encoding": "ascii"})):
        ball.export(tmp_path / f"ball.{suffix}", **options)
    half = ton.export_onnx("shading", tmp_path / "half.onnx", model="vcavity", dtype=torch.float16)
    for name, shading in (("ball.obj", graphs / "shading.onnx"), ("ball.ply", half)):
        done = app("render", graphs / "renderer.onnx", shading, tmp_path / name, tmp_path / f"{name}.png")
        assert done.returncode == 0, done.stderr
    pictures = [read_image(tmp_path / f"{name}.png").astype(float) for name in ("ball.obj", "ball.ply")]
    assert np.abs(pictures[0] - pictures[1]).max() <= 2  # 12.92 x 255 x 2^-11 where sRGB is steepest, and rounding


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("relight", "none.onnx", "normal.png", "out.png"), "no such file"),
        (("relight", "app.py", "normal.png", "out.png"), "not a graph"),
        (("solve", "shading", "empty", "out"), "light_directions.txt"),
        (("render", "shading", "shading", "broken.obj", "out.png"), "broken.obj"),
        (("solve", "shading", "capture", "out"), "takes albedo, light"),
    ],
)
@pytest.mark.slow
def test_mistakes_get_one_line(
    graphs: Path, tmp_path: Path, rough: Scene, arguments: tuple[str, ...], message: str
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "broken.obj").write_text("v 0 0 0\nf 1 2 9\n")
    write_image(tmp_path / "normal.png", ton.encode_normals(rough.normal))
    save_capture(tmp_path / "capture", rough.images[:3], rough.lights[:3], rough.mask)
    places = {"app.py": APP, "shading": graphs / "shading.onnx"}
    command, *files = arguments
    done = app(command, *(places.get(name, tmp_path / name) for name in files))
    assert done.returncode == 1
    assert message in done.stderr
    assert "Traceback" not in done.stderr
