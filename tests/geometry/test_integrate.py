from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from scripts.benchmarks import evaluate_integration
from torch_orennayar import Camera, CaptureError, RangeError, ShapeError, integrate_normals
from torch_orennayar.geometry import integrate


def waves(size: int) -> tuple[Tensor, Tensor]:
    """A height field in pixels and its exact normals, camera frame (rows go down, y goes up)."""
    row, column = torch.meshgrid(torch.arange(size).double(), torch.arange(size).double(), indexing="ij")
    w = 2 * math.pi / size
    height = 6 * torch.sin(1.5 * w * column) * torch.cos(w * row)
    right = 6 * 1.5 * w * torch.cos(1.5 * w * column) * torch.cos(w * row)
    down = -6 * w * torch.sin(1.5 * w * column) * torch.sin(w * row)
    return height[None], F.normalize(torch.stack((-right, down, torch.ones_like(right))), dim=0)


def test_orthographic_heights_in_pixels() -> None:
    height, normal = waves(64)
    found = integrate_normals(normal)
    assert ((found - found.mean()) - (height - height.mean())).abs().max() < 0.02


def test_orthographic_camera_gives_world_units() -> None:
    _, normal = waves(64)
    found = integrate_normals(normal, camera=Camera.orthographic(2.0))
    assert torch.allclose(found, -integrate_normals(normal) * 4 / 64, atol=1e-6)  # distance grows away from the viewer


def test_perspective_depth_up_to_scale() -> None:
    """A tilted plane has depth d / (n.r)."""
    camera = Camera.perspective(math.radians(50))
    normal = F.normalize(torch.tensor([0.3, -0.2, 1.0]).double(), dim=0)
    rays = camera.rays((40, 56))[0].double()
    depth = -1 / (normal.reshape(3, 1, 1) * rays).sum(0)
    found = integrate_normals(normal.reshape(3, 1, 1).expand(3, 40, 56), camera=camera)[0]
    ratio = found / depth
    assert (found > 0).all()
    assert (ratio / ratio.mean() - 1).abs().max() < 1e-3


def test_regions_holes_and_single_pixels() -> None:
    height, normal = waves(64)
    mask = torch.ones(1, 64, 64, dtype=torch.bool)
    mask[:, :, 30:32] = False
    mask[:, 10:20, 5:15] = False
    mask[:, 0:3, 0:3] = False
    mask[:, 1, 1] = True
    found = integrate_normals(normal, mask)
    assert (found[~mask] == 0).all()
    assert found[0, 1, 1].item() == 0
    left, right = mask.clone(), mask.clone()
    left[:, :, 30:] = False
    left[:, 1, 1] = False
    right[:, :, :32] = False
    for region in (left, right):
        difference = (found - height)[region]
        assert (difference - difference.mean()).abs().max() < 0.05
        assert abs(found[region].mean()) < 1e-6


def test_normals_at_the_horizon_stay_finite() -> None:
    normal = torch.tensor([1.0, 0, 0]).reshape(3, 1, 1).expand(3, 8, 8)
    assert integrate_normals(normal).isfinite().all()


@pytest.mark.parametrize(
    ("normal", "mask", "error"),
    [
        (torch.zeros(3, 4, 4), None, CaptureError),
        (torch.zeros(1, 3, 4, 4), None, ShapeError),
        (torch.ones(3, 4, 4), torch.ones(1, 4, 5, dtype=torch.bool), ShapeError),
        (torch.full((3, 4, 4), torch.nan), torch.ones(1, 4, 4, dtype=torch.bool), RangeError),
    ],
)
def test_bad_input(normal: Tensor, mask: Tensor | None, error: type[Exception]) -> None:
    with pytest.raises(error):
        integrate_normals(normal, mask)


def spheres(size: int, camera: Camera | None) -> tuple[Tensor, Tensor, Tensor]:
    """A small sphere in front of a large one: normals, mask, height (no camera, pixels) or depth; exact."""
    if camera is None:
        row, column = torch.meshgrid(torch.arange(size).double(), torch.arange(size).double(), indexing="ij")
        start = torch.stack((column + 0.5 - size / 2, size / 2 - row - 0.5, torch.zeros_like(row)))
        ray = torch.tensor((0.0, 0.0, -1.0)).double().reshape(3, 1, 1)
    else:
        start, ray = torch.zeros(3, size, size).double(), camera.rays((size, size))[0].double()
    unit = size / 2 if camera is None else 1.0
    away = 0.0 if camera is None else -12.0
    nearest = torch.full((size, size), torch.inf).double()
    normal = torch.zeros(3, size, size).double()
    for x, y, z, radius in ((0.0, 0.0, -1.5, 0.9), (0.2, -0.1, 0.5, 0.4)):
        centre = (torch.tensor((x, y, z)).double() * unit + torch.tensor((0.0, 0.0, away)).double()).reshape(3, 1, 1)
        a, b = (ray * ray).sum(0), (ray * (start - centre)).sum(0)
        root = b * b - a * ((start - centre).square().sum(0) - (radius * unit) ** 2)
        depth = (-b - root.clamp_min(0).sqrt()) / a
        hit = (root > 0) & (depth < nearest)
        nearest = torch.where(hit, depth, nearest)
        normal = torch.where(hit, F.normalize(start + ray * depth - centre, dim=0), normal)
    mask = nearest.isfinite()[None]
    return normal, mask, torch.where(mask, (-nearest if camera is None else nearest)[None], 0)


@pytest.mark.parametrize(
    "camera", [None, Camera.perspective(2 * math.atan(1 / 12))], ids=["orthographic", "perspective"]
)
@pytest.mark.parametrize("large", [integrate.LARGE, 2000], ids=["at once", "from half the size"])
def test_a_depth_edge_is_left_open(camera: Camera | None, large: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Least squares bridges the gap and bends both spheres; here each keeps its shape."""
    monkeypatch.setattr(integrate, "LARGE", large)
    normal, mask, truth = spheres(96, camera)
    found = integrate_normals(normal, mask, camera=camera)
    if camera is not None:
        found, truth = found.clamp_min(1e-9).log(), torch.where(mask, truth, 1).log()
    size = 96 / 2 if camera is None else 1 / 12  # what one radius of the picture is in these units
    centre = torch.zeros_like(mask)
    centre[:, 44:60, 50:66] = True  # well inside the small sphere
    rest = torch.zeros_like(mask)
    rest[:, 14:80, 12:34] = True  # a part of the large one
    for region in (centre, rest & mask):
        error = (found - truth)[region]
        assert (error - error.mean()).abs().max() < 0.01 * size


@pytest.mark.parametrize(("name", "bar"), [("cat", 0.074), ("pot1", 0.635), ("reading", 0.257)])
@pytest.mark.slow
def test_real_normals_against_published_errors(data: Path, name: str, bar: float) -> None:
    """Mean absolute depth error in mm, up to scale: no worse than bilateral normal integration is reported."""
    case = evaluate_integration.from_folder(data / "integration" / name)
    found = integrate_normals(case.normal, case.mask, camera=case.camera)
    assert case.error(found)[case.mask].mean() < bar


def test_a_field_that_no_surface_has() -> None:
    """A field with curl: finite, and no worse than by half the rise around a pixel."""
    row, column = torch.meshgrid(torch.arange(32.0).double() - 15.5, torch.arange(32.0).double() - 15.5, indexing="ij")
    swirl = F.normalize(torch.stack((-row, column, torch.full_like(row, 20.0))), dim=0)
    assert integrate_normals(swirl).isfinite().all()


def test_large_maps_start_from_half_the_size(monkeypatch: pytest.MonkeyPatch) -> None:
    height, normal = waves(96)
    at_once = integrate_normals(normal)
    monkeypatch.setattr(integrate, "LARGE", 1000)
    found = integrate_normals(normal)
    assert (found - at_once).abs().max() < 0.05
    assert ((found - found.mean()) - (height - height.mean())).abs().max() < 0.1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda n: n * torch.tensor([1.0, -1, -1]).double().reshape(3, 1, 1), "swap_opencv_frame"),
        (lambda n: n * torch.tensor([1.0, 1, -1]).double().reshape(3, 1, 1), "100 % of them facing away"),
        (lambda n: torch.stack((n[0], -n[2], n[1])), "world-space normals"),
        (lambda n: (n + 1) / 2, "decode_normals"),
        (lambda n: (255 * n).byte(), "floating-point"),
        (lambda n: n.numpy(), "floating-point"),
    ],
)
def test_normals_that_are_none_of_this_view(change: Callable[[Tensor], Tensor], words: str) -> None:
    with pytest.raises((RangeError, ShapeError), match=words):
        integrate_normals(change(waves(32)[1]))


def test_lengths_do_not_matter_and_a_few_normals_may_face_away() -> None:
    _, normal = waves(32)
    wanted = integrate_normals(normal)
    assert torch.allclose(integrate_normals(2 * normal), wanted, atol=1e-6)
    assert torch.allclose(integrate_normals(0.9 * normal), wanted, atol=1e-6)
    broken = normal.clone()
    broken[2, :2] *= -1
    integrate_normals(broken)


@pytest.mark.parametrize("mask", [torch.ones(1, 32, 32, dtype=torch.uint8), torch.ones(1, 32, 32), torch.ones(32, 32)])
def test_masks_of_other_types_are_refused_with_what_to_write(mask: Tensor) -> None:
    with pytest.raises(ShapeError, match=r"torch.as_tensor\(mask\)(\[None\])? > 0.5"):
        integrate_normals(waves(32)[1], mask)
