"""Every use of a name that torch keeps private, in one tested place: `tests/core/test_torch_private.py`."""

from __future__ import annotations

from contextlib import AbstractContextManager

import torch
from torch import Tensor


def functorch_active() -> bool:
    """Whether a ``torch.func`` transform (vmap, grad, jvp ...) is running."""
    active: bool = torch._C._are_functorch_transforms_active()
    return active


def is_legacy_batched(value: Tensor) -> bool:
    """Whether ``value`` is batched by the vmap of ``torch.autograd.functional``, not by ``torch.func.vmap``."""
    batched: bool = torch._C._functorch.is_legacy_batchedtensor(value)
    return batched


def assume(condition: bool) -> None:
    """Tell the tracer of ``torch.export`` that ``condition``, about a size that depends on data, holds."""
    torch._check(condition)


def without_runtime_assertions() -> AbstractContextManager[None]:
    """Export without assertions on sizes that depend on data, which ONNX cannot express."""
    context: AbstractContextManager[None] = torch._dynamo.config.patch(do_not_emit_runtime_asserts=True)
    return context
