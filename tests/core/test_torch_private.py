"""What torch keeps private does on the installed torch what this package relies on."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor, nn

import torch_orennayar
from torch_orennayar.core import torch_private

PACKAGE = Path(torch_orennayar.__file__).parent
PRIVATE_NAME = re.compile(r"\btorch(?:\.\w+)*\._|\._C\b|_functorch|_dynamo")


# The first use of forward mode compiles torch's decompositions for it with the deprecated torch.jit.script.
jit = pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")


@jit
def test_functorch_is_active_inside_transforms_only() -> None:
    seen: list[bool] = []

    def square(value: Tensor) -> Tensor:
        seen.append(torch_private.functorch_active())
        return (value * value).sum()

    square(torch.ones(2))
    torch.autograd.functional.jacobian(square, torch.ones(2))
    torch.autograd.functional.jacobian(square, torch.ones(2), vectorize=True)
    torch.func.vmap(square)(torch.ones(2, 2))
    torch.func.grad(square)(torch.ones(2))
    torch.func.jvp(square, (torch.ones(2),), (torch.ones(2),))
    torch.func.jacrev(square)(torch.ones(2))
    assert seen == [False, False, False, True, True, True, True]
    assert not torch_private.functorch_active()


@jit
def test_legacy_batches_are_those_of_vectorised_jacobians() -> None:
    """Forward mode batches the tangents that the function computes with, reverse mode those of its backward pass."""
    seen: list[bool] = []

    class Square(torch.autograd.Function):
        @staticmethod
        def forward(value: Tensor) -> Tensor:
            return value * value

        @staticmethod
        def setup_context(ctx: torch.autograd.function.FunctionCtx, inputs: tuple[Tensor], output: Tensor) -> None:
            ctx.save_for_backward(*inputs)

        @staticmethod
        def backward(ctx: torch.autograd.function.BackwardCFunction, *grads: Tensor) -> Tensor:
            (value,) = ctx.saved_tensors
            seen.append(torch_private.is_legacy_batched(grads[0]))
            return 2 * value * grads[0]

    def square(value: Tensor) -> Tensor:
        result: Tensor = Square.apply(value)  # type: ignore[no-untyped-call]
        return result

    torch.autograd.functional.jacobian(square, torch.ones(2), vectorize=False)
    assert not any(seen)
    seen.clear()
    torch.autograd.functional.jacobian(square, torch.ones(2), vectorize=True)
    assert seen == [True]

    seen.clear()

    def look(value: Tensor) -> Tensor:
        seen.append(torch_private.is_legacy_batched(value))
        return value

    torch.func.vmap(look)(torch.ones(2))
    assert seen == [False]
    assert not torch_private.is_legacy_batched(torch.ones(2))


def test_assume_checks_outside_a_tracer() -> None:
    torch_private.assume(True)
    with pytest.raises(RuntimeError):
        torch_private.assume(False)


class Ones(nn.Module):
    """As many ones as the input sums to: a size that depends on data."""

    def forward(self, number: Tensor) -> Tensor:
        count: Any = number.sum(dtype=torch.int64).item()  # a number, or a symbol while torch traces
        torch_private.assume(count >= 0)
        return torch.ones(count)


def decomposed_again() -> torch.export.ExportedProgram:
    """The program with its assertions erased, then decomposed as ``torch.onnx.export`` does."""
    program = torch.export.export(Ones(), (torch.tensor([1, 0, 2]),), strict=False)
    assert assertions(program) > 0
    for node in list(program.graph.nodes):
        if "assert" in str(node.target):
            program.graph.erase_node(node)
    program.graph.eliminate_dead_code()
    decomposed: torch.export.ExportedProgram = program.run_decompositions()
    return decomposed


def assertions(program: torch.export.ExportedProgram) -> int:
    return sum("assert" in str(node.target) for node in program.graph.nodes)


@pytest.mark.filterwarnings("ignore:.*LeafSpec.*:FutureWarning")  # torch copies its own deprecated class
def test_erased_assertions_stay_away() -> None:
    assert assertions(decomposed_again()) > 0
    with torch_private.without_runtime_assertions():
        program = decomposed_again()
    assert assertions(program) == 0
    assert program.module()(torch.tensor([4, 0, 1])).tolist() == [1.0] * 5


@pytest.mark.parametrize("file", sorted(PACKAGE.rglob("*.py")), ids=lambda file: str(file.relative_to(PACKAGE)))
def test_private_names_of_torch_are_used_in_one_place(file: Path) -> None:
    if file == Path(str(torch_private.__file__)):
        assert PRIVATE_NAME.search(file.read_text(encoding="utf-8"))
        return
    found = PRIVATE_NAME.findall(file.read_text(encoding="utf-8"))
    assert found == []
