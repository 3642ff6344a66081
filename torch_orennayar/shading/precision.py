"""Precision of the shading: what each dtype is computed in, and casts whose gradients stay finite."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def working_dtype(dtype: torch.dtype) -> torch.dtype:
    """The dtype in which values of ``dtype`` are computed: float32 for float16 and bfloat16."""
    return torch.float32 if dtype in (torch.float16, torch.bfloat16) else dtype


def cast(tensor: Tensor, dtype: torch.dtype) -> Tensor:
    """Convert ``tensor`` to ``dtype``; autograd's gradient of a float16 tensor saturates at its range."""
    if tensor.dtype == dtype:
        return tensor
    wider = tensor.to(dtype)
    if tensor.dtype == torch.float16 and wider.requires_grad and not torch.compiler.is_compiling():
        largest = torch.finfo(torch.float16).max
        wider.register_hook(lambda gradient: gradient.clamp(-largest, largest))
    return wider


def narrow(gradient: Tensor, dtype: torch.dtype) -> Tensor:
    """Convert ``gradient`` to the dtype of its tensor, saturated at the range of float16."""
    if dtype == torch.float16 and gradient.dtype != dtype:
        largest = torch.finfo(dtype).max
        gradient = gradient.clamp(-largest, largest)
    return gradient.to(dtype)


def smallest_cosine(dtype: torch.dtype) -> float:
    """Lower bound of the cosines: keeps ``1 / max(ci, co)**2`` in range, far below any cosine that is visible."""
    smallest: float = torch.finfo(dtype).tiny ** 0.25
    return smallest


def finite_or_zero(tensor: Tensor) -> Tensor:
    """``tensor`` with 0 for NaN and infinity: one selection in a compiled graph, one pass over memory in eager mode."""
    if torch.compiler.is_compiling():
        return torch.where(tensor.abs() < math.inf, tensor, 0.0)
    return tensor.nan_to_num(0.0, 0.0, 0.0)
