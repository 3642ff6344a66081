from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from torch_orennayar import Finding, ShapeError, load_capture, photometric_stereo
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
