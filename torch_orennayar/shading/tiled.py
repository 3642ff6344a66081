"""Shade in tiles that fit in a processor's cache, with a backward pass that stores the inputs only.

Eager operations on whole images write every intermediate result to memory and keep most of them for the backward pass.
`shade` works tile by tile instead, saves its inputs only, and computes gradients from the analytic derivatives in
``reflectance/gradients.py`` (by autograd within a tile for models that have none). Where tiles do not apply, `evaluate`
computes the same in plain operations. ``torch.compile`` fuses operations by itself: there one tile is the whole.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import torch
from torch import Tensor

from ..core.checks import broadcast_shape
from ..core.threads import in_order
from ..reflectance.models import Model, value_and_vjp
from .evaluate import facing_both, shade_whole, transformed
from .inputs import ShadingInputs, map_inputs
from .precision import cast, finite_or_zero, narrow, smallest_cosine, working_dtype
from .vectors import dot

TILE = 1 << 18
"""Elements of a tile on a processor, which bounds the memory for temporaries. Set by hand: threads that work on smaller
tiles wait for each other's Python."""
TILE_LEAST = 1 << 14
"""Elements of a picture's half from which it is shaded in two tiles or more, so that two threads can; set by hand."""
TILE_ACCELERATOR = 1 << 24
"""Elements of a tile on an accelerator: bounds the memory for temporaries."""

_Index = tuple[slice, ...]
_Gradients = list[Tensor | None]
"""Gradients in the order of `ShadingInputs`; None where none is needed."""


def shade(model: Model, inputs: ShadingInputs, axis: int, dtype: torch.dtype) -> Tensor:
    """``pi f_r max(0, n.l)`` times the irradiance, in ``dtype``; differentiable in all inputs."""
    tensors = [t for t in inputs if t is not None]
    differentiate = torch.is_grad_enabled() and any(t.requires_grad for t in tensors)
    if torch.compiler.is_compiling():
        analytic = model.derivatives is not None and not torch.compiler.is_exporting()
        in_tiles = differentiate and analytic and not transformed(tensors)
    else:
        traced = torch.jit.is_tracing()  # type: ignore[attr-defined, no-untyped-call]
        in_tiles = not (traced or tensors[0].is_meta or transformed(tensors))
    if in_tiles and differentiate:
        result: Tensor = _Shade.apply(model, axis, dtype, *inputs)  # type: ignore[no-untyped-call]
        return result
    return (_forward if in_tiles else shade_whole)(model, inputs, axis, dtype)


class _Shade(torch.autograd.Function):
    """`shade` as one node of the autograd graph, which saves the inputs only."""

    @staticmethod
    def forward(ctx: Any, model: Model, axis: int, dtype: torch.dtype, *tensors: Any) -> Tensor:
        ctx.save_for_backward(*tensors)
        ctx.model, ctx.axis, ctx.dtype = model, axis, dtype
        return _forward(model, ShadingInputs(*tensors), axis, dtype)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Any, ...]:
        inputs, needed = ShadingInputs(*ctx.saved_tensors), ctx.needs_input_grad[3:]
        if torch.compiler.is_compiling():
            parts = _backward_tile(ctx.model, inputs, ctx.axis, gradient, needed, exact=True)
            found = [None if p is None or t is None else narrow(p, t.dtype) for p, t in zip(parts, inputs, strict=True)]
        elif torch.is_grad_enabled() or transformed((*inputs, gradient)):  # second derivatives, Jacobians
            found = _backward_whole(ctx.model, inputs, ctx.axis, ctx.dtype, gradient, needed)
        else:
            found = _backward(ctx.model, inputs, ctx.axis, gradient, needed)
        return None, None, None, *found


@torch.no_grad()
def _forward(model: Model, inputs: ShadingInputs, axis: int, dtype: torch.dtype) -> Tensor:
    """Values, tile by tile."""
    if torch.compiler.is_compiling():
        return shade_whole(model, inputs, axis, dtype)
    shape = _shape(inputs, axis)
    result = inputs.normal.new_empty(shape, dtype=dtype)
    on_processor = result.device.type == "cpu"

    def work(index: _Index) -> None:
        tile = _cut_inputs(inputs, index)
        values = _forward_tile(model, tile, axis, working_dtype(dtype)) if on_processor else None
        if values is None or not _all_finite((values,)):
            values = shade_whole(model, tile, axis, dtype)
        result[index].copy_(values)

    for _ in in_order(work, list(tile_indices(shape, axis, result.device)), result.device):
        pass
    return result


def _forward_tile(model: Model, tile: ShadingInputs, axis: int, dtype: torch.dtype) -> Tensor:
    """`shade_whole` without ``torch.where``, which is slow on a processor; NaN where an input is NaN."""
    n, l, v, rho, sigma, irradiance = map_inputs(lambda t: cast(t, dtype), tile)  # noqa: E741
    lit, ci, co, _ = _lit(dot(n, l, axis), dot(n, v, axis))
    value = model.function(ci, co, dot(l, v, axis), rho, sigma) * lit
    return value if irradiance is None else value * irradiance


def _backward_whole(
    model: Model, inputs: ShadingInputs, axis: int, dtype: torch.dtype, gradient: Tensor, needed: Sequence[bool]
) -> _Gradients:
    """Gradients by autograd of plain operations, which can be differentiated again."""
    again = torch.is_grad_enabled()
    with torch.enable_grad():
        result = shade_whole(model, inputs, axis, dtype)
    wanted = [t for t, wants in zip(inputs, needed, strict=True) if wants and t is not None]
    found = [torch.zeros_like(t) for t in wanted]
    if result.requires_grad:  # a model may be a constant
        found = list(
            torch.autograd.grad(result, wanted, gradient, create_graph=again, allow_unused=True, materialize_grads=True)
        )
    return [found.pop(0) if wants else None for wants in needed]


def _backward(model: Model, inputs: ShadingInputs, axis: int, gradient: Tensor, needed: Sequence[bool]) -> _Gradients:
    """Gradients, tile by tile."""
    shape = tuple(gradient.shape)
    others = [d for d in range(-len(shape), 0) if d != axis]
    # An element of an input either belongs to one tile, or its gradient is a sum over tiles, in the working precision.
    own = [t is not None and all(t.shape[d] == shape[d] for d in others) for t in inputs]
    totals = [
        None
        if t is None or not wanted
        else torch.empty_like(t)
        if alone
        else torch.zeros_like(t, dtype=working_dtype(t.dtype))
        for t, wanted, alone in zip(inputs, needed, own, strict=True)
    ]
    exact = gradient.device.type != "cpu" or torch.is_anomaly_enabled()

    def work(index: _Index) -> _Gradients:
        arguments = model, _cut_inputs(inputs, index), axis, gradient[index], needed
        parts = _backward_tile(*arguments, exact=exact)
        return parts if exact or _all_finite(parts) else _backward_tile(*arguments, exact=True)

    for index, parts in in_order(work, list(tile_indices(shape, axis, gradient.device)), gradient.device):
        for total, part, alone in zip(totals, parts, own, strict=True):
            if total is not None and part is not None:
                place = _cut(total, index)
                place.copy_(narrow(part, place.dtype)) if alone else place.add_(part)
    return [None if g is None or t is None else narrow(g, t.dtype) for g, t in zip(totals, inputs, strict=True)]


def _backward_tile(
    model: Model, tile: ShadingInputs, axis: int, gradient: Tensor, needed: Sequence[bool], *, exact: bool
) -> _Gradients:
    """Gradients of a tile in the working precision.

    With ``exact``, NaN in the background, or in the gradient there, reaches no result; it costs selections.
    """
    dtype = working_dtype(gradient.dtype)
    n, l, v, rho, sigma, irradiance = map_inputs(lambda t: cast(t, dtype), tile)  # noqa: E741
    gradient = cast(gradient, dtype)
    ci, co = dot(n, l, axis), dot(n, v, axis)
    if exact:
        facing = facing_both(ci, co)
        lit = torch.where(facing, ci, 0.0)
        ci, co = (torch.where(facing, c, 1.0).clamp_min(smallest_cosine(dtype)) for c in (ci, co))
        gradient = torch.where(facing, gradient, 0.0)
        n, l, v, rho, sigma = (_facing_or_finite(t, facing) for t in (n, l, v, rho, sigma))  # noqa: E741
        irradiance = None if irradiance is None else torch.where(facing, irradiance, 0.0)
    else:
        lit, ci, co, mask = _lit(ci, co)
        gradient = gradient * mask
    lv = dot(l, v, axis)
    by_product = gradient * lit  # the gradient with respect to pi f_r times the irradiance
    weight, by_lit = (by_product, gradient) if irradiance is None else (by_product * irradiance, gradient * irradiance)
    arguments = ci, co, lv, rho, sigma
    shape = broadcast_shape(*(t.shape for t in arguments))
    value, found = value_and_vjp(model, arguments, weight.sum_to_size(shape))
    by_ci, by_co, by_lv, by_rho, by_sigma = (
        None if by is None else by.sum_to_size(t.shape) for by, t in zip(found, arguments, strict=True)
    )
    by_lit = (by_lit.sum_to_size(shape) * value).sum_to_size(ci.shape)
    by_ci = by_lit if by_ci is None else by_ci + by_lit
    parts = (
        _through_dots(((by_ci, l), (by_co, v)), n, axis) if needed[0] else None,
        _through_dots(((by_ci, n), (by_lv, v)), l, axis) if needed[1] else None,
        _through_dots(((by_co, n), (by_lv, l)), v, axis) if needed[2] else None,
        by_rho,
        by_sigma,
        (value * by_product).sum_to_size(tile.irradiance.shape) if needed[5] and tile.irradiance is not None else None,
    )
    return [
        torch.zeros_like(t, dtype=dtype) if p is None and wanted and t is not None else p if wanted else None
        for p, t, wanted in zip(parts, tile, needed, strict=True)
    ]


def _facing_or_finite(tensor: Tensor, facing: Tensor) -> Tensor:
    """0 for a map where the surface faces away, and for other tensors where they are not finite.

    Selecting by pixel costs less in a compiled graph than testing each number of a map.
    """
    if broadcast_shape(facing.shape, tensor.shape) == tensor.shape:
        return torch.where(facing, tensor, 0.0)
    return finite_or_zero(tensor)


def _through_dots(pairs: Sequence[tuple[Tensor | None, Tensor]], like: Tensor, axis: int) -> Tensor | None:
    """The gradient of the vectors ``like``: for each of their dot products its gradient and the other vector."""
    known = [(by, other) for by, other in pairs if by is not None]
    if not known:
        return None
    components = []
    for k in range(3):
        target = like.select(axis, k).shape
        terms = [(by.squeeze(axis) * other.select(axis, k)).sum_to_size(target) for by, other in known]
        components.append(terms[0] if len(terms) == 1 else terms[0] + terms[1])
    return torch.stack(components, axis)


def _lit(ci: Tensor, co: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Mask the cosines by arithmetic instead of selections.

    Returns:
        ``ci``, or 0 where the surface faces away; ``ci`` and ``co``, or 1 there; 1, or 0 there. Where a cosine is
        infinite, which `facing_both` counts as facing away, the first is NaN.
    """
    mask = torch.minimum(ci, co).sign().relu()
    lit, away = torch.add(ci, co, alpha=0.0) * mask, (1 - mask).clamp_min(smallest_cosine(ci.dtype))
    return lit, torch.maximum(lit, away), torch.maximum(co * mask, away), mask


def _all_finite(tensors: Iterable[Tensor | None]) -> bool:
    """Whether all sums are finite: False for NaN and infinity, and for sums that overflow, which only costs time."""
    return all(math.isfinite(t.sum(dtype=working_dtype(t.dtype)).item()) for t in tensors if t is not None)


def _shape(inputs: ShadingInputs, axis: int) -> tuple[int, ...]:
    """Shape of the shading: channels along ``axis``, the other axes broadcast."""
    shapes = [list(t.shape) for t in inputs if t is not None]
    for shape in shapes[:3]:
        shape[axis] = 1
    return tuple(broadcast_shape(*shapes))


def tile_indices(shape: tuple[int, ...], axis: int, device: torch.device) -> Iterator[_Index]:
    """Indices that cut ``shape`` into tiles of at most about `TILE` elements, never along ``axis``."""
    limit = min(TILE, max(TILE_LEAST, math.prod(shape) // 2)) if device.type == "cpu" else TILE_ACCELERATOR
    steps = list(shape)
    for d in range(len(shape)):
        if d - len(shape) != axis:
            inner = math.prod(steps[:d] + steps[d + 1 :])
            steps[d] = max(1, min(shape[d], limit // max(inner, 1)))
    ranges = (range(0, n, step or 1) for n, step in zip(shape, steps, strict=True))
    for starts in itertools.product(*ranges):
        index = [slice(i, i + step) for i, step in zip(starts, steps, strict=True)]
        index[axis] = slice(None)
        yield tuple(index)


def _cut_inputs(inputs: ShadingInputs, index: _Index) -> ShadingInputs:
    return map_inputs(lambda t: _cut(t, index), inputs)


def _cut(tensor: Tensor, index: _Index) -> Tensor:
    """The tile of a tensor; axes of one element, and the axis of x, y, z, are whole in every tile."""
    return tensor[tuple(i if n > 1 else slice(None) for i, n in zip(index, tensor.shape, strict=True))]
