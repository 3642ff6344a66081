"""Every use of a name that torch keeps private; `tests/core/test_torch_private.py` checks the installed torch."""

from __future__ import annotations

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


def assume(condition: bool | torch.SymBool) -> None:
    """Tell the tracer of ``torch.export`` that ``condition`` holds, which is about a size that depends on data.

    Raises:
        RuntimeError: outside a tracer, if ``condition`` is false.
    """
    torch._check(condition)
