from __future__ import annotations

from pathlib import Path

import pytest
import torch
import torch.nn.functional as F

from tests.support.objects import run_graph
from torch_orennayar import ExportError, export_onnx, oren_nayar
from torch_orennayar.export.describe import describe_onnx

COREML = {
    "Add", "Cast", "Clip", "Concat", "Cos", "Div", "Erf", "Exp", "Identity", "MatMul", "Max", "Mul", "Pow", "ReduceMax",
    "ReduceMean", "ReduceSum", "Relu", "Reshape", "Round", "Sigmoid", "Sin", "Slice", "Split", "Sqrt", "Sub", "Tanh",
}  # fmt: skip
"""Of the ML programs of ONNX Runtime's CoreML provider, from its ``coreml_supported_mlprogram_ops.md``, what is
arithmetic; without ``Reciprocal``, to whose argument it adds 1e-4."""
WEB = Path(__file__).resolve().parents[2] / "examples" / "web" / "node_modules" / "onnxruntime-web" / "docs"


@pytest.mark.parametrize("model", ["lambert", "qualitative", "fujii", "vcavity", "eon"])
@pytest.mark.slow
def test_equals_torch_in_operators_of_coreml(tmp_path: Path, model: str) -> None:
    path = export_onnx("shading", tmp_path / "graph.onnx", model=model, portable=True)
    described = describe_onnx(path)
    assert described["opset"] == 17
    assert set(described["operators"]) <= COREML
    generator = torch.Generator().manual_seed(1)
    for batch, channels, area in ((2, 3, (40, 30)), (1, 1, (5, 64)), (3, 2, (1, 1))):
        inputs = {
            name: F.normalize(torch.randn(batch, 3, *size, generator=generator), dim=1)
            for name, size in (("normal", area), ("light", (1, 1)), ("view", (1, 1)))
        }
        inputs["albedo"] = torch.rand(batch, channels, *area, generator=generator)
        inputs["roughness"] = torch.rand(batch, 1, 1, 1, generator=generator) * 1.5
        wanted = oren_nayar(*inputs.values(), model=model)
        (answer,) = run_graph(path, 0, **inputs).values()
        assert answer.shape == wanted.shape
        assert (answer - wanted).abs().max() <= 1e-5


@pytest.mark.parametrize("backend", ["webgpu", "webnn"])
def test_browsers_have_the_operators(tmp_path: Path, backend: str) -> None:
    table = WEB / f"{backend}-operators.md"
    if not table.exists():
        pytest.skip("npm has not installed onnxruntime-web")
    names = {
        line.split("|")[1].strip() for line in table.read_text(encoding="utf-8").splitlines() if line.count("|") > 2
    }
    described = describe_onnx(export_onnx("shading", tmp_path / "graph.onnx", model="vcavity", portable=True))
    assert set(described["operators"]) <= names


def test_a_size_fixes_every_axis(tmp_path: Path) -> None:
    path = export_onnx("shading", tmp_path / "graph.onnx", model="lambert", portable=True, size=(12, 20))
    described = describe_onnx(path)
    assert described["inputs"] == {
        "normal": ["1", "3", "12", "20"],
        "light": ["1", "3", "1", "1"],
        "view": ["1", "3", "1", "1"],
        "albedo": ["1", "3", "12", "20"],
        "roughness": ["1", "1", "12", "20"],
    }
    assert described["outputs"] == {"shading": ["1", "3", "12", "20"]}


def test_models_with_other_operators_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="Atan"):
        export_onnx("shading", tmp_path / "graph.onnx", model="full", portable=True)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("what", "option"),
    [("stereo", "portable"), ("renderer", "checked"), ("shading", "view_inputs")],
)
def test_options_of_other_graphs_are_refused(tmp_path: Path, what: str, option: str) -> None:
    with pytest.raises(ExportError, match=option):
        export_onnx(what, tmp_path / "graph.onnx", **{option: True})  # type: ignore[arg-type]


def test_portable_does_not_check(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="checked"):
        export_onnx("shading", tmp_path / "graph.onnx", portable=True, checked=True)
