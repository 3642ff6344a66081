"""What torch keeps private does on the installed torch what this package relies on."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import torch
from torch import Tensor

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


@pytest.mark.parametrize("file", sorted(PACKAGE.rglob("*.py")), ids=lambda file: str(file.relative_to(PACKAGE)))
def test_private_names_of_torch_are_used_in_one_place(file: Path) -> None:
    if file == Path(str(torch_private.__file__)):
        assert PRIVATE_NAME.search(file.read_text(encoding="utf-8"))
        return
    found = PRIVATE_NAME.findall(file.read_text(encoding="utf-8"))
    assert found == []
