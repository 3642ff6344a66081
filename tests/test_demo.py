from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import torch

from torch_orennayar import load_capture, load_mesh
from torch_orennayar.demo import make_scene, run_demo
from torch_orennayar.export.describe import describe_onnx


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("demo") / "out"
    run_demo(place, size=96)
    return place


@pytest.mark.slow
def test_bars_of_the_demo(folder: Path) -> None:
    numbers = json.loads((folder / "result.json").read_text())
    mean = {name: n["normal_error_degrees"]["mean"] for name, n in numbers.items()}
    assert mean["vcavity"] <= 0.5 * mean["lambert"]
    assert abs(numbers["vcavity"]["roughness_degrees"] - 30) <= 3
    assert mean["vcavity"] < mean["qualitative"]
    assert numbers["auto"]["model"] == "vcavity"


@pytest.mark.slow
def test_everything_is_written_and_readable(folder: Path) -> None:
    assert load_capture(folder / "capture").images.shape == (24, 3, 96, 96)
    vertices, faces = load_mesh(folder / "mesh.ply")
    assert len(vertices) > 3000
    assert len(faces) > 6000
    assert describe_onnx(folder / "shading.onnx")["metadata"]["model"] == "vcavity"
    page = (folder / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 7
    # Without the pictures, whose base64 may spell anything.
    assert "http" not in re.sub(r"base64,[A-Za-z0-9+/=]+", "", page)


@pytest.mark.slow
def test_same_seed_same_pictures() -> None:
    assert torch.equal(make_scene(32, 1).images, make_scene(32, 1).images)
    assert not torch.equal(make_scene(32, 1).images, make_scene(32, 2).images)
