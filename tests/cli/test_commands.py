from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
import torch

from tests.support import height_fields
from tests.support.command_line import Run
from torch_orennayar import angular_error, decode_normals, load_capture, save_mesh
from torch_orennayar.geometry.primitives import Ball, bumpy_ball
from torch_orennayar.io.images import read_image, write_image
from torch_orennayar.io.picture import to_unit


@pytest.mark.slow
def test_stereo_writes_everything(orennayar: Run, capture_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = orennayar("stereo", capture_folder, "-o", out)
    assert result.status == 0
    assert "normal error: mean" in result.out
    numbers = json.loads((out / "result.json").read_text())
    assert numbers["model"] == "vcavity"
    assert numbers["normal_error_degrees"]["mean"] < 3
    normal = np.load(out / "normal.npy")
    assert normal.shape == (3, 32, 32)
    stored = read_image(out / "normal.png")
    assert stored.dtype == np.uint16
    decoded = decode_normals(torch.from_numpy(to_unit(stored)).permute(2, 0, 1))
    assert np.abs(decoded.numpy() - normal).max() < 1e-4
    for name in ("albedo", "roughness", "residual", "confidence", "error"):
        assert (out / f"{name}.png").stat().st_size > 0
        assert np.load(out / f"{name}.npy").shape[1:] == (32, 32)
    page = (out / "report.html").read_text()
    assert page.count("data:image/png;base64,") >= 5
    assert "http" not in page
    assert (out / "mesh.ply").exists()


@pytest.mark.slow
def test_results_of_an_earlier_run_do_not_mix(orennayar: Run, capture_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    orennayar("stereo", capture_folder, "-o", out)
    assert (out / "error.png").exists()
    (capture_folder / "normal_gt.npy").unlink()
    assert orennayar("stereo", capture_folder, "-o", out, "--least-squares").status == 0
    assert not any((out / name).exists() for name in ("error.png", "error.npy", "scores.png"))


def test_a_bad_output_is_refused_before_the_work(orennayar: Run, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for command in (("stereo", "absent"), ("render", "absent.obj"), ("demo",)):
        result = orennayar(*command, "-o", tmp_path / "file")
        assert result.status == 1
        assert "expected a folder" in result.err


def test_failed_stereo_leaves_nothing(orennayar: Run, capture_folder: Path, tmp_path: Path) -> None:
    lights = capture_folder / "light_directions.txt"
    lights.write_text("\n".join(lights.read_text().splitlines()[:-1]))
    result = orennayar("stereo", capture_folder, "-o", tmp_path / "out")
    assert result.status == 1
    assert result.err.startswith("error: ")
    assert "add the missing lines" in result.err
    assert result.err.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["capture"]


@pytest.mark.slow
def test_render_draws_a_mesh(orennayar: Run, tmp_path: Path) -> None:
    vertices, faces = bumpy_ball()
    save_mesh(tmp_path / "ball.ply", vertices * 7 + 3, faces)
    for extra in ((), ("--fov", 40)):
        result = orennayar("render", tmp_path / "ball.ply", "-o", tmp_path / "out", "--size", 64, *extra)
        assert result.status == 0
        shaded = read_image(tmp_path / "out" / "shaded.png")
        assert shaded.shape == (64, 64)
        assert shaded.max() > 150
        mask = read_image(tmp_path / "out" / "mask.png")
        assert 0.1 < (mask != 0).mean() < 0.9
        depth = np.load(tmp_path / "out" / "depth.npy")
        assert np.isinf(depth[0][mask == 0]).all()


@pytest.mark.slow
def test_export_and_info(orennayar: Run, tmp_path: Path) -> None:
    path = tmp_path / "graph.onnx"
    assert orennayar("export", path, "--model", "lambert").status == 0
    described = json.loads(orennayar("info", path, "--json").out)
    assert described["inputs"]["normal"] == ["normal_batch", "3", "normal_height", "normal_width"]
    shown = orennayar("info", path).out
    assert shown.index("roughness") < shown.index("pi f_r max(0, n.l)") < shown.index("opset: 18")
    assert "Loop" not in shown
    assert "Loop" in orennayar("info", path, "--operators").out
    assert orennayar("info", "--json").status == 1
    overview = orennayar("info").out
    assert "vcavity" in overview
    assert "torch" in overview


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("stereo", "absent"), "nothing there"),
        (("render", "absent.obj"), "nothing there"),
        (("render", "absent.obj", "--model", "phong"), "expected one of"),
        (("render", "absent.obj", "--turntable", "walk.avi"), "gif"),
        (("render", "absent.obj", "--light", 0, 0, 0), "direction"),
        (("export", "graph.onnx", "--model", "phong"), "expected one of"),
        (("stereo", "absent", "--least-squares", "--model", "vcavity"), "leave one"),
        (("info", "picture.png"), "onnx"),
        (("info", "absent.onnx"), "absent.onnx"),
    ],
)
def test_mistakes_are_one_line(
    orennayar: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[object, ...], words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    result = orennayar(*arguments)
    assert result.status == 1
    assert words in result.err
    assert result.err.count("\n") == 1
    assert "Traceback" not in result.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("degrees", [-1, 91, "rough"])
def test_roughness_in_degrees_has_a_range(orennayar: Run, degrees: object) -> None:
    result = orennayar("render", "absent.obj", "--roughness", degrees)
    assert result.status == 2
    assert "--roughness" in result.err


def test_interruption_is_one_line(orennayar: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("torch_orennayar.demo.photometric_stereo", stop)
    result = orennayar("demo", "-o", tmp_path / "out", "--size", 32)
    assert result.status == 130
    assert "interrupted" in result.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_render_walks_around_under_many_lights(orennayar: Run, tmp_path: Path) -> None:
    vertices, faces = bumpy_ball()
    save_mesh(tmp_path / "ball.ply", vertices, faces)
    out, walk = tmp_path / "out", tmp_path / "walk.gif"
    result = orennayar(
        "render", tmp_path / "ball.ply", "-o", out, "--size", 33, "--lights", 7, "--turntable", walk, "--frames", 5
    )
    assert result.status == 0, result.err
    with PIL.Image.open(walk) as gif:
        assert (gif.n_frames, gif.size) == (5, (34, 34))
    assert read_image(out / "lights.png").shape[0] > 0


def test_calibrate_writes_files_that_the_loader_reads(orennayar: Run, tmp_path: Path, capture_folder: Path) -> None:
    ball = Ball(40.0, 30.0, 25.0)
    normal, inside = ball.normals((60, 80))
    mirrored = 2 * normal[2:] * normal - torch.tensor((0.0, 0.0, 1.0)).reshape(3, 1, 1)
    lights = load_capture(capture_folder).lights
    for index, light in enumerate(lights):
        shine = ((torch.einsum("chw,c->hw", mirrored, light) - 1) / 0.003).exp()[None] * inside
        write_image(tmp_path / "chrome" / f"{index:02d}.png", shine, bits=16)
    circle = ("--circle", "40", "30", "25")
    result = orennayar("calibrate", "chrome", tmp_path / "chrome", "-o", tmp_path, *circle)
    assert result.status == 0, result.err
    table = torch.tensor(
        [[float(v) for v in row.split()] for row in (tmp_path / "light_directions.txt").read_text().splitlines()]
    )
    assert ((table * lights).sum(1).clamp(max=1).acos().rad2deg() < 1.5).all()
    result = orennayar("calibrate", "own", capture_folder, "-o", tmp_path)
    assert result.status == 0, result.err
    assert len((tmp_path / "light_intensities.txt").read_text().splitlines()) == len(lights)
    result = orennayar("calibrate", "silver", capture_folder)
    assert result.status == 1
    assert "chrome, grey or own" in result.err


@pytest.mark.slow
def test_shape_from_one_photograph(orennayar: Run, tmp_path: Path) -> None:
    field, light = height_fields.make("sphere cap", 64), height_fields.light_at(30)
    write_image(tmp_path / "photo.png", height_fields.photograph(field, light, 0.5).clamp(0, 1), bits=16)
    write_image(tmp_path / "mask.png", field.mask.float())
    out = tmp_path / "out"
    command = ("shape", tmp_path / "photo.png", "--mask", tmp_path / "mask.png", "-o", out, "--light", *light.tolist())
    result = orennayar(*command, "--albedo", 0.8, "--roughness", np.degrees(0.5))
    assert result.status == 0
    assert "in shadow" in result.out
    found = torch.from_numpy(np.load(out / "normal.npy"))
    assert angular_error(found, field.normal.float(), field.mask).summary()["median"] < 4
    depth = np.load(out / "depth.npy")
    assert depth.shape == (1, 64, 64)
    with PIL.Image.open(out / "turntable.gif") as turntable:
        assert turntable.n_frames == 24
    assert {"mesh.ply", "report.html", "relight.gif"} <= {f.name for f in out.iterdir()}
    guessed = orennayar(*command)
    assert "take it as a guess" in guessed.out
    assert "ambient light 0." in guessed.out
    for given in ((*command, "--ambient", 0.05), (*command, "--mask", "whole")):
        assert "ambient light" not in orennayar(*given).out
    assert "found before its dark background" in orennayar(*command[:2], *command[4:]).out
    found = torch.from_numpy(np.load(out / "normal.npy"))
    assert angular_error(found, field.normal.float(), field.mask & (found != 0).any(0)).summary()["median"] < 8
    with pytest.warns(UserWarning, match="no light was given"):
        assert "no light was given" in orennayar(*command[:6]).out
    assert "outline is seen" in orennayar(*command[:2], "--mask", "whole", "-o", out).err
    dark = orennayar(*command[:6], "--light", 0, 0, -1)
    assert dark.status == 1
    assert "swap_opencv_frame" in dark.err
