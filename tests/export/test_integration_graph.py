from __future__ import annotations

from pathlib import Path

import pytest
import torch

from tests.support.objects import run_graph
from torch_orennayar import Camera, export_onnx, render_normals
from torch_orennayar.geometry.primitives import bumpy_ball
from torch_orennayar.geometry.smooth_integration import integrate_smooth


@pytest.mark.slow
def test_graph_equals_torch_and_repeats_to_the_bit(tmp_path: Path) -> None:
    path = export_onnx("integration", tmp_path / "integration.onnx")
    vertices, faces = bumpy_ball()
    seen = render_normals(vertices, faces, Camera.orthographic(1.05), (60, 60))
    broken = torch.where(seen.mask[0], seen.normal[0], torch.nan)  # outside the mask
    broken[:, 30, 30] = torch.nan  # and inside
    found = run_graph(path, normal=broken, mask=seen.mask[0])["depth"]
    wanted = integrate_smooth(seen.normal[0].double(), seen.mask[0])
    beside = seen.mask[0].clone()
    beside[:, 30, 30] = False
    assert found.isfinite().all()
    offset = (found - wanted)[beside].mean()
    assert (found - wanted - offset)[beside].abs().max() < 0.3  # pixels
    for size in ((90, 121), (257, 64), (3, 200)):
        seen = render_normals(vertices, faces, Camera.orthographic(1.05), size)
        normal, mask = seen.normal[0], seen.mask[0]
        wanted = integrate_smooth(normal.double(), mask)
        answers = [run_graph(path, threads, normal=normal, mask=mask)["depth"] for threads in (1, 4, 4, 4)]
        assert answers[0].shape == (1, *size)
        assert (answers[0] - wanted).abs().max() <= 1e-5 * (1 + float(wanted.abs().max()))
        assert all(torch.equal(a, answers[0]) for a in answers)
