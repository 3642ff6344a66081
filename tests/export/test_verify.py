"""Graphs that differ from their function in torch are refused, and say how."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import onnx
import pytest
import torch
from onnx import TensorProto, helper
from torch import Tensor

from torch_orennayar import ExportError
from torch_orennayar.export.nodes import Nodes, as_model
from torch_orennayar.export.task import ExportTask
from torch_orennayar.export.verify import verify

X = torch.tensor([[0.5, -2.0, 3.0]])


def absolute_and_sign(x: Tensor) -> tuple[Tensor, ...]:
    return x.abs(), x > 0


def task(function: Callable[..., tuple[Tensor, ...]], operator: str = "Abs") -> ExportTask:
    """``operator`` and the comparison with 0, which should be ``function``."""
    add = Nodes("")
    value = add(operator, "x")
    positive = add("Greater", "x", add("Sub", "x", "x"))
    graph = helper.make_graph(
        add.nodes,
        "tiny",
        [helper.make_tensor_value_info("x", TensorProto.FLOAT, ["rows", 3])],
        [
            helper.make_tensor_value_info(value, TensorProto.FLOAT, ["rows", 3]),
            helper.make_tensor_value_info(positive, TensorProto.BOOL, ["rows", 3]),
        ],
    )
    return ExportTask(as_model(graph), {}, ("x",), [(X,), (X.repeat(2, 1),)], function)


def check(tmp_path: Path, what: ExportTask) -> None:
    onnx.save(what.graph, tmp_path / "graph.onnx")
    verify(tmp_path / "graph.onnx", what, torch.float32)


def test_an_equal_graph_passes(tmp_path: Path) -> None:
    check(tmp_path, task(absolute_and_sign))


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda x: (x.abs() + 1e-3, x > 0), "difference 0.001"),
        (lambda x: (x.abs()[:, :2], x > 0), r"shape \(1, 3\)"),
        (lambda x: (x.abs(), x > -3), "1 different values"),
    ],
)
def test_a_difference_is_named(tmp_path: Path, function: Callable[..., tuple[Tensor, ...]], message: str) -> None:
    with pytest.raises(ExportError, match=message):
        check(tmp_path, task(function))


def test_rounding_that_torch_has_too_is_allowed(tmp_path: Path) -> None:
    """torch's float32 result may be off by more than the tolerance, if float64 shows that rounding is the reason."""

    def rounded(x: Tensor) -> tuple[Tensor, ...]:
        error = 1e-3 if x.dtype == torch.float32 else 0.0
        return x.abs() + error, x > 0

    check(tmp_path, task(rounded))


def test_a_graph_that_changes_from_run_to_run(tmp_path: Path) -> None:
    noisy = task(lambda x: (torch.full_like(x, 0.5), x > 0), "RandomUniformLike")
    attribute = [helper.make_attribute(name, value) for name, value in (("low", 0.5), ("high", 0.500001))]
    noisy.graph.graph.node[0].attribute.extend(attribute)
    with pytest.raises(ExportError, match="another result in a second run"):
        check(tmp_path, noisy)


def test_a_graph_that_does_not_run(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="a graph that ONNX Runtime runs"):
        check(tmp_path, task(absolute_and_sign, "NoSuchOperator"))
