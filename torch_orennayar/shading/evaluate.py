"""Evaluate reflectance models on whole tensors in plain differentiable operations.

Function transforms, forward-mode differentiation, second derivatives and export need these; `tiled` computes the same
values and first derivatives with less memory.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import torch
from torch import Tensor
from torch.autograd import forward_ad

from ..core import torch_private
from ..reflectance.models import Model, ModelFunction, expand_value
from .inputs import ShadingInputs
from .precision import cast, finite_or_zero, smallest_cosine, working_dtype
from .vectors import dot


def shade_whole(model: Model, inputs: ShadingInputs, axis: int, dtype: torch.dtype) -> Tensor:
    """``pi f_r max(0, n.l)`` times the irradiance, in ``dtype``."""
    value, ci, facing = evaluate(model.function, inputs, axis, working_dtype(dtype))
    shading = value * ci
    if inputs.irradiance is not None:
        irradiance = cast(inputs.irradiance, working_dtype(dtype))
        if irradiance.requires_grad or shading.requires_grad or transformed((irradiance, shading)):
            irradiance = torch.where(facing, irradiance, 0.0)
        shading = shading * irradiance
    return torch.where(facing, shading, 0.0).to(dtype)


def evaluate(
    function: ModelFunction, inputs: ShadingInputs, axis: int, dtype: torch.dtype
) -> tuple[Tensor, Tensor, Tensor]:
    """Evaluate a model, without the irradiance.

    Returns:
        ``(value, ci, facing)``: ``pi f_r`` and ``n.l`` in ``dtype``, and whether the surface faces light and view;
        where it does not, the first two are meaningless.
    """
    normal, light, view, albedo, roughness, _ = inputs
    parts = [cast(t, dtype) for t in (normal, light, view, albedo, roughness)]
    differentiate = (torch.is_grad_enabled() and any(t.requires_grad for t in parts)) or transformed(parts)
    if differentiate:
        parts = [finite_or_zero(t) for t in parts]  # NaN in the background must not reach a gradient
    n, l, v, rho, sigma = parts  # noqa: E741
    ci, co, lv = dot(n, l, axis), dot(n, v, axis), dot(l, v, axis)
    facing = facing_both(ci, co)
    if differentiate:  # nor must the derivative of a formula below the horizon
        ci, co = torch.where(facing, ci, 1.0), torch.where(facing, co, 1.0)
    return above_horizon(function, ci, co, lv, rho, sigma), ci, facing


def above_horizon(function: ModelFunction, ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """Evaluate ``function`` with ``ci`` and ``co`` clamped to positive values, in the shape of all its arguments."""
    smallest = smallest_cosine(ci.dtype)
    arguments = ci.clamp_min(smallest), co.clamp_min(smallest), lv, rho, sigma
    return expand_value(function(*arguments), arguments)


def facing_both(ci: Tensor, co: Tensor) -> Tensor:
    """Whether the surface faces light and view; False where a cosine is NaN or infinite."""
    return (torch.minimum(ci, co) > 0) & (ci + co < math.inf)


def transformed(tensors: Iterable[Tensor | None]) -> bool:
    """Whether a function transform (``vmap``, ``jacrev``), a vectorised Jacobian or forward mode is active."""
    functorch = torch_private.functorch_active()
    if functorch or torch.compiler.is_compiling():
        return functorch
    known = [t for t in tensors if t is not None]
    return any(torch_private.is_legacy_batched(t) or forward_ad.unpack_dual(t).tangent is not None for t in known)
