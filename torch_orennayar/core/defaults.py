"""Independence of torch's default dtype and device, which belong to the program that calls."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import ParamSpec, TypeVar

import torch

P = ParamSpec("P")
R = TypeVar("R")


def independent_of_defaults(function: Callable[P, R]) -> Callable[P, R]:
    """Let a function make its tensors as if no default dtype and device had been set.

    Does nothing while torch compiles. Default dtypes are global: other threads see float32 while the function runs.

    Example:
        >>> import torch
        >>> from torch_orennayar.core.defaults import independent_of_defaults
        >>> with torch.device("meta"):
        ...     independent_of_defaults(torch.zeros)(2).device
        device(type='cpu')
    """

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        if torch.compiler.is_compiling():
            return function(*args, **kwargs)
        with _plain_defaults():
            return function(*args, **kwargs)

    return call


@contextmanager
def _plain_defaults() -> Iterator[None]:
    dtype, device = torch.get_default_dtype(), torch.get_default_device()
    with nullcontext() if device.type == "cpu" else torch.device("cpu"):
        if dtype == torch.float32:
            yield
            return
        torch.set_default_dtype(torch.float32)
        try:
            yield
        finally:
            torch.set_default_dtype(dtype)
