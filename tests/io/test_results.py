from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from torch_orennayar import Finding, Reconstruction, ShapeError, load_capture, photometric_stereo
from torch_orennayar.io.capture import Capture
from torch_orennayar.io.images import read_image
from torch_orennayar.io.result_animations import write_turntable
from torch_orennayar.io.result_maps import ResultMaps
from torch_orennayar.io.results import write_reconstruction
from torch_orennayar.reconstruction import stack


@pytest.mark.slow
def test_findings_are_stored_with_code_and_value(capture_folder: Path, tmp_path: Path) -> None:
    capture = load_capture(capture_folder)
    assert [note.code for note in capture.notes] == ["read-as-linear"]
    found = photometric_stereo(capture.images, capture.lights, capture.mask, model="lambert", robust=False)
    dark = Finding("3 pixels are dark.", "dark-pixels", 3)
    found = replace(found, report=(*found.report, dark))
    written = write_reconstruction(tmp_path / "out", found, capture, title="ball")
    numbers = json.loads((tmp_path / "out" / "result.json").read_text())
    assert numbers == written.numbers
    assert numbers["report"] == [*capture.notes, *found.report]
    assert {"code": "dark-pixels", "value": 3, "text": dark} in numbers["findings"]
    assert numbers["findings"][0]["code"] == "read-as-linear"
    with pytest.raises(ShapeError, match="one by one"):
        write_reconstruction(tmp_path / "batch", stack([found, found]), capture, title="ball")
    assert not (tmp_path / "batch").exists()


def test_black_pixels_beside_bright_ones_can_be_animated(tmp_path: Path) -> None:
    """On the edges of triangles some barycentric weights are rounded below 0, and so would be albedo there."""
    generator, size = torch.Generator().manual_seed(0), (48, 64)
    albedo = (torch.rand(3, *size, generator=generator) > 0.5).float()
    whole, up = torch.ones(1, *size), torch.tensor([0.0, 0, 1]).reshape(3, 1, 1).expand(3, *size)
    found = Reconstruction(
        normal=up, albedo=albedo, roughness=0 * whole, residual=0 * whole, confidence=whole, model="lambert",
        scores={}, report=(), depth=4 * torch.rand(1, *size, generator=generator),
    )  # fmt: skip
    capture = Capture(torch.zeros(3, 3, *size), torch.eye(3), torch.ones(3, 3), whole.bool(), None, ("a", "b", "c"))
    write_turntable(tmp_path / "turntable.gif", ResultMaps.of(found, capture))
    assert (tmp_path / "turntable.gif").stat().st_size > 1000


@pytest.mark.slow
def test_a_map_of_materials_is_stored_and_drawn(capture_folder: Path, tmp_path: Path) -> None:
    """Each material in its own colour, in the report too; a later result of one material leaves no map behind."""
    capture = load_capture(capture_folder)
    plain = photometric_stereo(capture.images, capture.lights, capture.mask, model="lambert", robust=False)
    material = torch.arange(capture.mask.shape[2]).div(12, rounding_mode="floor").clamp(max=2)
    material = torch.where(capture.mask, material.expand_as(capture.mask), -1)
    write_reconstruction(tmp_path, replace(plain, material=material, falloffs=(1.0,) * 3), capture, title="ball")
    assert torch.equal(torch.from_numpy(np.load(tmp_path / "material.npy")), material)
    drawn = read_image(tmp_path / "material_map.png").reshape(-1, 3)
    colours, count = np.unique(drawn, axis=0, return_counts=True)
    grey = colours.max(1) == colours.min(1)
    assert (count[~grey] > 0.01 * len(drawn)).sum() >= 3
    assert "material_map" in (tmp_path / "report.html").read_text(encoding="utf-8")
    write_reconstruction(tmp_path, plain, capture, title="ball")
    assert not (tmp_path / "material_map.png").exists()
    assert not (tmp_path / "material.npy").exists()
