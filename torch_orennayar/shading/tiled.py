"""Evaluate a scene: whole, in plain differentiable operations, or in tiles that fit in a processor's cache.

Eager operations on whole pictures write every intermediate result to memory and keep most of them for the backward
pass. `shade` works tile by tile instead, keeps its inputs alone, and goes back by the formulas of `gradients` (by
autograd within a tile for models that have none). What cannot run in tiles takes the plain operations: function
transforms, forward mode, second derivatives and export. ``torch.compile`` fuses by itself: there one tile is the whole.

A scene is (normal, light, view, albedo, roughness, irradiance or None): tensors of one number of axes that broadcast,
with x, y, z or channels along ``axis``, which counts from the end.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.autograd import forward_ad

from ..core import torch_private
from ..reflectance.models import Model, ModelFunction

Scene = Sequence[Any]
Index = tuple[slice, ...]

TILE = 1 << 16
"""Elements of a tile on a processor: the temporaries of one operation after the other stay in its cache."""
TILE_ACCELERATOR = 1 << 24


def working_dtype(dtype: torch.dtype) -> torch.dtype:
    """The precision that a dtype is computed in: float32 for both halves."""
    return torch.float32 if dtype in (torch.float16, torch.bfloat16) else dtype


def shade(model: Model, scene: Scene, axis: int, dtype: torch.dtype) -> Tensor:
    """``pi f_r max(0, n.l)`` times the irradiance, in ``dtype``."""
    tensors = [t for t in scene if t is not None]
    differentiate = torch.is_grad_enabled() and any(t.requires_grad for t in tensors)
    if torch.compiler.is_compiling():
        by_hand = model.derivatives is not None and not torch.compiler.is_exporting()
        in_tiles = differentiate and by_hand and not _transformed(tensors)
    else:
        traced = torch.jit.is_tracing()  # type: ignore[attr-defined, no-untyped-call]
        in_tiles = not (traced or tensors[0].is_meta or _transformed(tensors))
    if in_tiles and differentiate:
        result: Tensor = _Shade.apply(model, axis, dtype, *scene)  # type: ignore[no-untyped-call]
        return result
    return (_forward if in_tiles else shade_whole)(model, scene, axis, dtype)


def shade_whole(model: Model, scene: Scene, axis: int, dtype: torch.dtype) -> Tensor:
    """`shade` in plain operations on whole tensors."""
    value, ci, facing = evaluate(model.function, scene[:5], axis, working_dtype(dtype))
    shading = value * ci
    if scene[5] is not None:
        irradiance = cast(scene[5], working_dtype(dtype))
        if irradiance.requires_grad or shading.requires_grad or _transformed((irradiance, shading)):
            irradiance = torch.where(facing, irradiance, 0.0)
        shading = shading * irradiance
    return torch.where(facing, shading, 0.0).to(dtype)


def evaluate(function: ModelFunction, scene: Scene, axis: int, dtype: torch.dtype) -> tuple[Tensor, Tensor, Tensor]:
    """``pi f_r`` in ``dtype``, ``n.l``, and whether the surface faces light and view: if not, they mean nothing."""
    parts = [cast(t, dtype) for t in scene]
    differentiate = (torch.is_grad_enabled() and any(t.requires_grad for t in parts)) or _transformed(parts)
    if differentiate:
        parts = [_finite(t) for t in parts]  # a background of NaN must not reach a gradient
    n, l, v, rho, sigma = parts  # noqa: E741
    ci, co, lv = _dot(n, l, axis), _dot(n, v, axis), _dot(l, v, axis)
    facing = facing_both(ci, co)
    if differentiate:  # nor must the derivative of a formula below the horizon
        ci, co = torch.where(facing, ci, 1.0), torch.where(facing, co, 1.0)
    return above_horizon(function, ci, co, lv, rho, sigma), ci, facing


def above_horizon(function: ModelFunction, ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """``function`` with its cosines kept positive, in the shape of all its arguments, whichever it uses."""
    least = floor_of(ci.dtype)
    arguments = ci.clamp_min(least), co.clamp_min(least), lv, rho, sigma
    return _expanded(function(*arguments), arguments)


def _expanded(value: Tensor, arguments: Sequence[Tensor]) -> Tensor:
    shape = torch.broadcast_shapes(*(t.shape for t in arguments))
    return value if value.shape == shape else value.expand(shape)


class _Shade(torch.autograd.Function):
    """`shade` that keeps its inputs alone."""

    @staticmethod
    def forward(ctx: Any, model: Model, axis: int, dtype: torch.dtype, *scene: Any) -> Tensor:
        ctx.save_for_backward(*scene)
        ctx.model, ctx.axis, ctx.dtype = model, axis, dtype
        return _forward(model, scene, axis, dtype)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Any, ...]:
        scene, needed = ctx.saved_tensors, ctx.needs_input_grad[3:]
        if torch.compiler.is_compiling():
            parts = _backward_tile(ctx.model, scene, ctx.axis, gradient, needed, exact=True)
            found = [None if p is None else _narrow(p, t.dtype) for p, t in zip(parts, scene, strict=True)]
        elif torch.is_grad_enabled() or _transformed((*scene, gradient)):  # second derivatives, Jacobians
            found = _backward_whole(ctx.model, scene, ctx.axis, ctx.dtype, gradient, needed)
        else:
            found = _backward(ctx.model, scene, ctx.axis, gradient, needed)
        return None, None, None, *found


@torch.no_grad()
def _forward(model: Model, scene: Scene, axis: int, dtype: torch.dtype) -> Tensor:
    """Values, tile by tile."""
    if torch.compiler.is_compiling():
        return shade_whole(model, scene, axis, dtype)
    shape = _shape(scene, axis)
    result: Tensor = scene[0].new_empty(shape, dtype=dtype)
    for index in _tiles(shape, axis, result.device):
        part = [_cut(t, index) for t in scene]
        values = None
        if result.device.type == "cpu":
            values = _forward_tile(model, part, axis, working_dtype(dtype))
        if values is None or not _all_finite((values,)):
            values = shade_whole(model, part, axis, dtype)
        result[index].copy_(values)
    return result


def _forward_tile(model: Model, scene: Scene, axis: int, dtype: torch.dtype) -> Tensor:
    """`shade_whole` without selections, which are slow on a processor; NaN where a direction is."""
    n, l, v, rho, sigma, irradiance = (cast(t, dtype) for t in scene)  # noqa: E741
    lit, ci, co, _ = _lit(_dot(n, l, axis), _dot(n, v, axis))
    value = model.function(ci, co, _dot(l, v, axis), rho, sigma) * lit
    return value if irradiance is None else value * irradiance


def _backward_whole(
    model: Model, scene: Scene, axis: int, dtype: torch.dtype, gradient: Tensor, needed: Sequence[bool]
) -> list[Tensor | None]:
    """Gradients of the scene by autograd of plain operations, through which others may differentiate again."""
    again = torch.is_grad_enabled()
    with torch.enable_grad():
        result = shade_whole(model, scene, axis, dtype)
    wanted = [t for t, wants in zip(scene, needed, strict=True) if wants]
    slopes = [torch.zeros_like(t) for t in wanted]
    if result.requires_grad:  # a model may be of constants
        slopes = list(
            torch.autograd.grad(result, wanted, gradient, create_graph=again, allow_unused=True, materialize_grads=True)
        )
    return [slopes.pop(0) if wants else None for wants in needed]


def _backward(model: Model, scene: Scene, axis: int, gradient: Tensor, needed: Sequence[bool]) -> list[Tensor | None]:
    """Gradients of the scene, tile by tile; None where not ``needed``."""
    shape = tuple(gradient.shape)
    others = [d for d in range(-len(shape), 0) if d != axis]
    # An element either belongs to one tile, or gathers sums over tiles, in the working precision.
    own = [t is not None and all(t.shape[d] == shape[d] for d in others) for t in scene]
    totals = [
        None if not wanted else torch.empty_like(t) if alone else torch.zeros_like(t, dtype=working_dtype(t.dtype))
        for t, wanted, alone in zip(scene, needed, own, strict=True)
    ]
    for index in _tiles(shape, axis, gradient.device):
        arguments = model, [_cut(t, index) for t in scene], axis, gradient[index], needed
        exact = gradient.device.type != "cpu" or torch.is_anomaly_enabled()
        parts = _backward_tile(*arguments, exact=exact)
        if not exact and not _all_finite(parts):
            parts = _backward_tile(*arguments, exact=True)
        for total, part, alone in zip(totals, parts, own, strict=True):
            if total is not None and part is not None:
                place = _cut(total, index)
                place.copy_(_narrow(part, place.dtype)) if alone else place.add_(part)
    return [t if t is None else _narrow(t, s.dtype) for t, s in zip(totals, scene, strict=True)]


def _backward_tile(
    model: Model, scene: Scene, axis: int, gradient: Tensor, needed: Sequence[bool], *, exact: bool
) -> list[Tensor | None]:
    """Gradients of the scene; with ``exact`` a NaN of the background, or of the gradient there, reaches none."""
    dtype = working_dtype(gradient.dtype)
    n, l, v, rho, sigma, irradiance = (cast(t, dtype) for t in scene)  # noqa: E741
    arriving = cast(gradient, dtype)
    ci, co = _dot(n, l, axis), _dot(n, v, axis)
    if exact:
        facing = facing_both(ci, co)
        lit = torch.where(facing, ci, 0.0)
        ci, co = (torch.where(facing, c, 1.0).clamp_min(floor_of(dtype)) for c in (ci, co))
        arriving = torch.where(facing, arriving, 0.0)
        # A map is selected from by pixel, which costs less where it is compiled than a look at each of its numbers.
        n, l, v, rho, sigma = (  # noqa: E741
            torch.where(facing, t, 0.0) if torch.broadcast_shapes(facing.shape, t.shape) == t.shape else _finite(t)
            for t in (n, l, v, rho, sigma)
        )
        irradiance = None if irradiance is None else torch.where(facing, irradiance, 0.0)
    else:
        lit, ci, co, mask = _lit(ci, co)
        arriving = arriving * mask
    lv = _dot(l, v, axis)
    alone = arriving * lit  # what arrives at pi f_r times the irradiance
    weight, at_ci = (alone, arriving) if irradiance is None else (alone * irradiance, arriving * irradiance)
    arguments = ci, co, lv, rho, sigma
    shape = torch.broadcast_shapes(*(t.shape for t in arguments))
    value, found = pull(model, arguments, weight.sum_to_size(shape))
    by_ci, by_co, by_lv, by_rho, by_sigma = (
        None if by is None else by.sum_to_size(t.shape) for by, t in zip(found, arguments, strict=True)
    )
    at_ci = (at_ci.sum_to_size(shape) * value).sum_to_size(ci.shape)
    by_ci = at_ci if by_ci is None else by_ci + at_ci
    parts = [
        _gather(((by_ci, l), (by_co, v)), n, axis) if needed[0] else None,
        _gather(((by_ci, n), (by_lv, v)), l, axis) if needed[1] else None,
        _gather(((by_co, n), (by_lv, l)), v, axis) if needed[2] else None,
        by_rho,
        by_sigma,
        (value * alone).sum_to_size(scene[5].shape) if needed[5] else None,
    ]
    return [
        (torch.zeros_like(t, dtype=dtype) if p is None else p) if wanted else None
        for p, t, wanted in zip(parts, scene, needed, strict=True)
    ]


def pull(
    model: Model, arguments: tuple[Tensor, Tensor, Tensor, Tensor, Tensor], weight: Tensor
) -> tuple[Tensor, tuple[Tensor | None, ...]]:
    """A model's value and ``weight`` times its derivatives, by hand where it has them so."""
    if model.derivatives is not None:
        return model.derivatives(*arguments, weight)
    with torch.enable_grad():
        leaves = [t.detach().requires_grad_() for t in arguments]
        value = _expanded(model.function(*leaves), leaves)
        if not value.requires_grad:  # a constant
            return value, (None,) * 5
        return value.detach(), torch.autograd.grad(value, leaves, weight, allow_unused=True)


def _gather(pairs: Sequence[tuple[Tensor | None, Tensor]], like: Tensor, axis: int) -> Tensor | None:
    """The gradient of ``like`` from those of its dot products and the other vector in each."""
    known = [(by, other) for by, other in pairs if by is not None]
    if not known:
        return None
    components = []
    for k in range(3):
        target = like.select(axis, k).shape
        terms = [(by.squeeze(axis) * other.select(axis, k)).sum_to_size(target) for by, other in known]
        components.append(terms[0] if len(terms) == 1 else terms[0] + terms[1])
    return torch.stack(components, axis)


def _transformed(tensors: Sequence[Tensor]) -> bool:
    """Whether a function transform (``vmap``, ``jacrev``), a vectorised Jacobian or forward mode is at work."""
    functorch = torch_private.functorch_active()
    if functorch or torch.compiler.is_compiling():
        return functorch
    known = [t for t in tensors if t is not None]
    return any(torch_private.is_legacy_batched(t) or forward_ad.unpack_dual(t).tangent is not None for t in known)


def _shape(scene: Scene, axis: int) -> tuple[int, ...]:
    """The shading's shape: channels along ``axis``, all else broadcast."""
    shapes = [list(t.shape) for t in scene if t is not None]
    for shape in shapes[:3]:
        shape[axis] = 1
    return tuple(torch.broadcast_shapes(*shapes))


def _tiles(shape: tuple[int, ...], axis: int, device: torch.device) -> Iterator[Index]:
    """Indices that cut ``shape`` into pieces of about a tile, never along ``axis``."""
    limit = TILE if device.type == "cpu" else TILE_ACCELERATOR
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


def _cut(tensor: Tensor | None, index: Index) -> Any:
    """The tile of a tensor; axes of one element, and vectors, are whole in every tile."""
    if tensor is None:
        return None
    return tensor[tuple(i if n > 1 else slice(None) for i, n in zip(index, tensor.shape, strict=True))]


def cast(tensor: Tensor | None, dtype: torch.dtype) -> Any:
    """``tensor`` in ``dtype``; gradients that go back to float16 by autograd saturate at its range."""
    if tensor is None or tensor.dtype == dtype:
        return tensor
    wider = tensor.to(dtype)
    if tensor.dtype == torch.float16 and wider.requires_grad and not torch.compiler.is_compiling():
        most = torch.finfo(torch.float16).max
        wider.register_hook(lambda gradient: gradient.clamp(-most, most))
    return wider


def _narrow(gradient: Tensor, dtype: torch.dtype) -> Tensor:
    """``gradient`` in the dtype of its tensor, saturated at float16's range."""
    if dtype == torch.float16 and gradient.dtype != dtype:
        most = torch.finfo(dtype).max
        gradient = gradient.clamp(-most, most)
    return gradient.to(dtype)


def _finite(tensor: Tensor) -> Tensor:
    """0 where ``tensor`` is NaN or infinite; one selection where it is compiled, one pass where it is not."""
    if torch.compiler.is_compiling():
        return torch.where(tensor.abs() < math.inf, tensor, 0.0)
    return tensor.nan_to_num(0.0, 0.0, 0.0)


def _all_finite(tensors: Sequence[Tensor | None]) -> bool:
    """Whether no number is NaN or infinite, or no sum overflows: cheap, and a false alarm costs time alone."""
    return all(math.isfinite(t.sum(dtype=working_dtype(t.dtype)).item()) for t in tensors if t is not None)


def _dot(a: Tensor, b: Tensor, axis: int) -> Tensor:
    """The dot product along ``axis``, kept as 1; by component, since torch makes slow loops of sums over 3."""
    if torch.compiler.is_exporting():  # runtimes copy what is selected
        return (a * b).sum(axis, keepdim=True)
    (ax, ay, az), (bx, by, bz) = ([t.select(axis, k) for k in range(3)] for t in (a, b))
    return torch.addcmul(torch.addcmul(ax * bx, ay, by), az, bz).unsqueeze(axis)


def facing_both(ci: Tensor, co: Tensor) -> Tensor:
    """Whether the surface faces light and view; False where a cosine is NaN or infinite."""
    return (torch.minimum(ci, co) > 0) & (ci + co < math.inf)


def _lit(ci: Tensor, co: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """``ci`` or 0 where the surface faces away; ``ci`` and ``co``, or 1; 1 or 0. All by arithmetic.

    Where `facing_both` turns infinite cosines away, the first is NaN.
    """
    mask = torch.minimum(ci, co).sign().relu()
    lit, away = torch.add(ci, co, alpha=0.0) * mask, (1 - mask).clamp_min(floor_of(ci.dtype))
    return lit, torch.maximum(lit, away), torch.maximum(co * mask, away), mask


def floor_of(dtype: torch.dtype) -> float:
    """Keeps 1 / max(ci, co)**2 inside the format; far below any cosine that shows."""
    least: float = torch.finfo(dtype).tiny ** 0.25
    return least
