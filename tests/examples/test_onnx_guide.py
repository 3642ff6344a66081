"""The JavaScript of the guide to ONNX graphs, in node; needs node, and npm once for the runtime."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import torch

from tests.support.example_code import EXAMPLES, WEB
from torch_orennayar import export_onnx, oren_nayar

MODULES = WEB / "node_modules"
NODE = shutil.which("node")


@pytest.mark.skipif(NODE is None or not (MODULES / "onnxruntime-web").is_dir(), reason="no node, or no npm install yet")
@pytest.mark.slow
def test_node_computes_what_torch_computes(tmp_path: Path) -> None:
    guide = (EXAMPLES / "guides" / "onnx.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```js\n(.*?)```", guide, re.DOTALL)
    assert len(code.splitlines()) <= 25
    (tmp_path / "shade.mjs").write_text(code, encoding="utf-8")
    (tmp_path / "node_modules").symlink_to(MODULES)
    export_onnx("shading", tmp_path / "shading.onnx", model="vcavity")
    assert NODE is not None
    shown = subprocess.run(
        [NODE, "shade.mjs"], cwd=tmp_path, capture_output=True, text=True, check=True, timeout=120
    ).stdout
    light, up = (torch.tensor(v).reshape(1, 3, 1, 1) for v in ((0.0, 0.6, 0.8), (0.0, 0.0, 1.0)))
    wanted = oren_nayar(up, light, up, 0.8, 0.5, model="vcavity").item()
    dims, value = re.fullmatch(r"\[ ([\d, ]+) \] ([\d.]+)\n", shown).groups()  # type: ignore[union-attr]
    assert dims == "1, 3, 4, 4"
    assert float(value) == pytest.approx(wanted, abs=1e-5)


def test_the_table_of_runtimes_names_the_versions_that_are_tested() -> None:
    guide = (EXAMPLES / "guides" / "onnx.md").read_text(encoding="utf-8")
    constraints = (EXAMPLES.parent / "scripts" / "constraints.txt").read_text(encoding="utf-8")
    package = json.loads((WEB / "package.json").read_text(encoding="utf-8"))
    (newest,) = re.findall(r'^onnxruntime==([\d.]+); python_version >= "3.11"$', constraints, re.MULTILINE)
    assert f"| ONNX Runtime, CPU, Python | {newest} |" in guide
    rows = [line for line in guide.splitlines() if line.startswith("| onnxruntime-web")]
    assert len(rows) == 3
    assert all(f"| {package['dependencies']['onnxruntime-web']} |" in row for row in rows)
