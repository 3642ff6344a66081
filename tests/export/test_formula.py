from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor

from tests.support.objects import run_graph
from torch_orennayar import MODELS, export_onnx, oren_nayar, register_model
from torch_orennayar.export.formula import INPUTS, Shading, Value, serves_every_size, trace_formula
from torch_orennayar.reflectance.models import unregister_model


@pytest.mark.parametrize("model", ["lambert", "qualitative", "full", "vcavity"])
@pytest.mark.slow
def test_formulas_of_the_package_do_not_depend_on_sizes(model: str) -> None:
    graph = trace_formula(Value(MODELS[model].function)).graph
    assert serves_every_size(graph)
    assert [value.name for value in graph.input] == list(INPUTS)


def by_size(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """A model that reads the size of a picture: it dims with the number of columns."""
    return rho * torch.ones_like(ci).sum(-1, keepdim=True).reciprocal() + 0 * ci


@pytest.mark.slow
def test_a_formula_that_reads_sizes_is_traced_with_sizes_that_vary(tmp_path: Path) -> None:
    assert not serves_every_size(trace_formula(Shading(by_size)).graph)
    register_model("by size", by_size)
    try:
        path = export_onnx("shading", tmp_path / "graph.onnx", model="by size")
        normal = torch.tensor([0.0, 0, 1]).reshape(1, 3, 1, 1).repeat(1, 1, 6, 4)
        inputs = {"normal": normal, "light": normal[..., :1, :1], "view": normal[..., :1, :1]}
        inputs |= {"albedo": torch.ones(1, 1, 6, 4), "roughness": torch.zeros(1, 1, 1, 1)}
        (answer,) = run_graph(path, 0, **inputs).values()
        assert torch.allclose(answer, oren_nayar(*inputs.values(), model="by size"))
    finally:
        unregister_model("by size")
