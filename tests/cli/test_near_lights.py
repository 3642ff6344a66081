"""``orennayar stereo`` with the positions of near lights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F
import trimesh
from torch import Tensor

from tests.support import rendered_captures
from tests.support.command_line import Run
from tests.support.near_relief import SIZE, relief
from torch_orennayar import angular_error
from torch_orennayar.io.capture import save_capture
from torch_orennayar.stereo import light_positions


@pytest.mark.slow
def test_positions_from_a_file(orennayar: Run, meshes: dict[str, tuple[Tensor, Tensor]], tmp_path: Path) -> None:
    """The scene's unit is 10 cm here; positions count from the object's mean depth."""
    scene = rendered_captures.near_capture(meshes["bumps"], lights=12, size=64)
    from_object = 100 * (scene.positions + torch.tensor([0.0, 0, scene.distance]))
    white = (from_object / 100).square().sum(1).mean()  # irradiance 1 where the object is
    folder = tmp_path / "photos"
    save_capture(folder, (white * scene.images).expand(-1, 3, -1, -1), F.normalize(from_object, dim=1), scene.mask)
    np.savetxt(tmp_path / "lamps.csv", from_object.numpy(), delimiter=",", header="x_mm,y_mm,z_mm", comments="")
    result = orennayar("stereo", folder, "-o", tmp_path / "out", "--model", "vcavity", "--positions",
                       tmp_path / "lamps.csv", "--camera-distance", 100 * scene.distance, "--fov", 35)  # fmt: skip
    assert result.status == 0
    extent = trimesh.load(tmp_path / "out" / "mesh.ply").extents
    np.savetxt(tmp_path / "lamps.csv", from_object.numpy() / 10, delimiter=",")
    options = ("--unit", "cm", "--camera-distance", 10 * scene.distance, "--fov", 35, "--no-report")
    result = orennayar("stereo", folder, "-o", tmp_path / "cm", "--model", "vcavity", "--positions",
                       tmp_path / "lamps.csv", *options)  # fmt: skip
    assert result.status == 0
    assert np.allclose(trimesh.load(tmp_path / "cm" / "mesh.ply").extents, extent, rtol=1e-3)
    normal = torch.from_numpy(np.load(tmp_path / "out" / "normal.npy"))
    assert angular_error(normal, scene.normal, scene.mask).summary()["mean"] < 4
    albedo = torch.from_numpy(np.load(tmp_path / "out" / "albedo.npy"))[:, scene.mask[0]]
    assert albedo.median().item() == pytest.approx(0.6, abs=0.15)
    height = torch.from_numpy(np.load(tmp_path / "out" / "depth.npy")).squeeze()
    assert float(height[scene.mask[0]].max() - height[scene.mask[0]].min()) < 64


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--camera-distance", "400"), "leave --camera-distance out"),
        (("--positions", "lamps.csv"), "got no --camera-distance and no --fov"),
        (("--positions", "lamps.csv", "--camera-distance", "400"), "got no --fov"),
        (("--unit", "cm"), "leave --unit out"),
        (("--fov", "30"), "expected a mirror ball"),
        (("--near", "--refine-lights"), "--near: expected neither --positions, --refine-lights nor --least-squares"),
        (("--distant", "--least-squares"), "--distant: expected neither"),
        (("--positions", "lamps.csv", "--crop", "0,0,9,9"), "choose a part with --mask"),
        (("--pixel-size", "-1"), "millimetres divided by its pixels"),
        (("--positions", "lamps.csv", "--pixel-size", "0.2"), "follows from --camera-distance"),
        (("--positions", "lamps.csv", "--camera-distance", "400", "--fov", "35", "--refine-lights"), "neither"),
    ],
)
def test_options_that_do_not_go_together(
    orennayar: Run, capture_folder: Path, tmp_path: Path, options: tuple[str, ...], message: str
) -> None:
    result = orennayar("stereo", capture_folder, "-o", tmp_path / "out", *options)
    assert result.status == 1
    assert message in result.err


@pytest.fixture(scope="module")
def ring(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Tensor]:
    """A folder of photographs of a wavy table under a ring of lamps at twice its size, and the true normals."""
    folder = tmp_path_factory.mktemp("ring")
    images, light, normal = relief(2.0, noise=0.0)
    save_capture(folder, images.expand(-1, 3, -1, -1), light, torch.ones(1, SIZE, SIZE, dtype=torch.bool))
    return folder, normal


@pytest.mark.parametrize("option", [(), ("--near",)], ids=["seen", "said"])
def test_near_lamps_whose_directions_are_known(
    orennayar: Run, ring: tuple[Path, Tensor], tmp_path: Path, option: tuple[str, ...]
) -> None:
    folder, normal = ring
    result = orennayar("stereo", folder, "-o", tmp_path, "--model", "lambert", "--no-report", *option)
    assert result.status == 0
    assert "lights found near, at 2.0 +- 0.0 times the object's size" in result.out
    found = torch.from_numpy(np.load(tmp_path / "normal.npy"))
    assert angular_error(found, normal).summary()["mean"] < 0.5
    albedo = torch.from_numpy(np.load(tmp_path / "albedo.npy"))
    assert albedo.median().item() == pytest.approx(0.5, abs=0.02)
    depth = torch.from_numpy(np.load(tmp_path / "depth.npy")).squeeze()
    assert float(depth.max() - depth.min()) < 5  # pixels; 1.3 in truth


@pytest.mark.filterwarnings("ignore:lights at about 2 times")
def test_lamps_taken_as_distant_where_told(orennayar: Run, ring: tuple[Path, Tensor], tmp_path: Path) -> None:
    folder, normal = ring
    result = orennayar("stereo", folder, "-o", tmp_path, "--model", "lambert", "--no-report", "--distant")
    assert result.status == 0
    assert "the surface found is bent" in result.out
    found = torch.from_numpy(np.load(tmp_path / "normal.npy"))
    assert angular_error(found, normal).summary()["mean"] > 5


@pytest.mark.filterwarnings("ignore:lights at about 2 times")
def test_a_distance_that_is_not_found_is_no_end(
    orennayar: Run, ring: tuple[Path, Tensor], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where near lights are seen but not how far they are, they are taken as distant, with a warning."""
    monkeypatch.setattr(light_positions, "TELLS", 0.0)
    result = orennayar("stereo", ring[0], "-o", tmp_path, "--model", "lambert", "--no-report")
    assert result.status == 0
    assert "the surface found is bent" in result.out
    asked = orennayar("stereo", ring[0], "-o", tmp_path, "--model", "lambert", "--no-report", "--near")
    assert asked.status == 1
    assert "solve as under distant lights" in asked.err
