"""Checks of the arguments of public functions; checks of values are skipped while torch compiles or exports."""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Real

import numpy as np
import torch
from torch import Tensor

from .errors import CaptureError, RangeError, ShapeError

SAMPLED_DIRECTIONS = 2048
"""Number of directions of a map whose length is checked. Set by hand: few enough to cost nothing beside the shading."""
UNIT_TOLERANCE = 0.02
"""Largest deviation of a unit vector's length from 1. Set by hand above the rounding of bfloat16 (0.4 %) and of 8-bit
colours (0.7 %)."""


def checking() -> bool:
    """Whether values may be read now: not while torch compiles or exports."""
    return not torch.compiler.is_compiling()


def check_count(argument: str, value: object) -> None:
    """Check that a number of things is a whole number, 1 or more.

    Raises:
        RangeError: it is not.
    """
    if not isinstance(value, int) or value < 1:
        raise RangeError(argument, expected="a whole number, 1 or more", got=repr(value), mend="ask for one or more")


def check_mask(mask: object, image: Tensor) -> Tensor:
    """The mask (1, H, W) bool of the object in ``image`` (..., H, W), all pixels if it is None.

    Raises:
        ShapeError: another shape or dtype.
        CaptureError: the mask is empty.
    """
    size = (1, *image.shape[-2:])
    if mask is None:
        return torch.ones(size, dtype=torch.bool, device=image.device)
    if not isinstance(mask, Tensor) or tuple(mask.shape) != size or mask.dtype != torch.bool:
        got = f"{tuple(mask.shape)} {mask.dtype}" if isinstance(mask, Tensor) else type(mask).__name__
        mend = "torch.as_tensor(mask)[None] > 0.5" if getattr(mask, "ndim", 3) == 2 else "torch.as_tensor(mask) > 0.5"
        raise ShapeError("mask", expected=f"a tensor {size} bool", got=got, mend=mend)
    if not bool(mask.any()):
        raise CaptureError("mask", expected="at least one pixel", got="none", mend="mark the object")
    return mask


def check_axis(argument: str, tensor: Tensor, axis_from_end: int, sizes: tuple[int, ...]) -> None:
    """Check that ``tensor`` has one of ``sizes`` along ``axis_from_end``, a negative axis."""
    if tensor.ndim < -axis_from_end or tensor.shape[axis_from_end] not in sizes:
        wanted = " or ".join(str(s) for s in sizes)
        raise ShapeError(
            argument,
            expected=f"size {wanted} along axis {axis_from_end}, that of x, y, z or channels",
            got=f"shape {tuple(tensor.shape)}",
            mend="reshape it so that it broadcasts, e.g. light.reshape(B, 3, 1, 1), or pass dim=",
        )


def broadcast_shape(*shapes: Sequence[int]) -> torch.Size:
    """The shape to which ``shapes`` broadcast, without the symbolic mathematics that torch imports for it (0.8 s).

    Raises:
        ValueError: they do not; RuntimeError while torch compiles.
    """
    return torch.Size(np.broadcast_shapes(*map(tuple, shapes))) if checking() else torch.broadcast_shapes(*shapes)


def check_broadcast(axis_from_end: int, **values: Tensor | float) -> None:
    """Check that the tensors among ``values`` broadcast along all axes but that of x, y, z or channels."""
    shapes = {name: tuple(v.shape) for name, v in values.items() if isinstance(v, Tensor)}
    rest = [list(shape) for shape in shapes.values()]
    for shape in rest:
        if len(shape) >= -axis_from_end:
            shape[axis_from_end] = 1
    try:
        broadcast_shape(*rest)
    except (RuntimeError, ValueError) as mismatch:
        raise ShapeError(
            ", ".join(shapes),
            expected="shapes that broadcast",
            got=", ".join(str(shape) for shape in shapes.values()),
            mend="give the arguments equal sizes, or 1, along each axis",
        ) from mismatch


def check_channels(axis_from_end: int, **values: Tensor | float) -> None:
    """Check that tensors among ``values`` have an axis of channels, with one channel or one common number of them."""
    counts = {}
    for name, value in values.items():
        if isinstance(value, Tensor) and value.ndim > 0:
            if value.ndim < -axis_from_end:
                raise ShapeError(
                    name,
                    expected=f"an axis of channels at {axis_from_end}",
                    got=f"shape {tuple(value.shape)}",
                    mend="reshape it so that it broadcasts, e.g. albedo.reshape(1, 3, 1, 1)",
                )
            counts[name] = value.shape[axis_from_end]
            if checking() and counts[name] == 0:
                raise ShapeError(
                    name, expected="channels", got=f"shape {tuple(value.shape)}", mend="give it at least 1"
                )
    # Not during export: comparing dynamic sizes would make them constants of the graph.
    if checking() and len(set(counts.values()) - {1}) > 1:
        raise ShapeError(
            ", ".join(counts),
            expected="1 or equally many channels",
            got=", ".join(str(c) for c in counts.values()),
            mend="give them one channel count",
        )


def check_range(argument: str, value: Tensor | float, low: float, high: float, mend: str) -> None:
    """Check that every number of ``value`` lies in [low, high]; NaN does not."""
    if not checking():
        return
    if isinstance(value, Tensor):
        if value.numel() == 0:
            return
        try:
            least, most = (float(v) for v in value.detach().aminmax())
        except RuntimeError:  # values cannot be read inside vmap
            return
    else:
        least = most = float(value)
    if not (low <= least and most <= high and math.isfinite(most)):
        raise RangeError(
            argument,
            expected=f"values in [{low:g}, {high:g}]" if math.isfinite(high) else f"finite values >= {low:g}",
            got="NaN" if math.isnan(least) or math.isnan(most) else f"{least:g} to {most:g}",
            mend=mend,
        )


def check_unit(argument: str, vectors: Tensor, dim: int, *, gaps: bool = True) -> None:
    """Check that directions have unit length within `UNIT_TOLERANCE`.

    ``gaps`` allows zero and non-finite vectors, which maps have in the background. Of a large map only
    `SAMPLED_DIRECTIONS` vectors are checked, spread evenly over it: the usual mistakes (colours not decoded, normals
    averaged by resizing) show in many places.
    """
    if not checking() or vectors.numel() == 0:
        return
    vectors = _sample(vectors.detach(), dim % vectors.ndim)
    length = vectors.double().norm(dim=dim)
    wrong = ~((length - 1).abs() <= UNIT_TOLERANCE)
    if gaps:
        wrong &= length.isfinite() & (length > 0)
    try:
        found = bool(wrong.any())
    except RuntimeError:  # values cannot be read inside vmap
        return
    if found:
        raise RangeError(
            argument,
            expected="unit vectors",
            got=f"length {length[wrong][0].item():.3g}",
            mend=_mend_length(vectors),
        )


def _mend_length(vectors: Tensor) -> str:
    """What brings vectors of another length right: colours, which are never negative, must be decoded first."""
    coloured = vectors.numel() > 3 and bool(((vectors >= 0) & (vectors <= 1)).all())
    colours = "decode_normals for normals stored as colours; " if coloured else ""
    return f"use {colours}torch.nn.functional.normalize; point_light for a light's position"


def _sample(vectors: Tensor, axis: int) -> Tensor:
    """About `SAMPLED_DIRECTIONS` of the vectors at most, spread evenly over the tensor."""
    axes = sorted((d for d in range(vectors.ndim) if d != axis), key=lambda d: vectors.shape[d])
    for k, d in enumerate(axes):  # the shortest first; the longer ones make up for what it cannot contribute
        excess = vectors.numel() / vectors.shape[axis] / SAMPLED_DIRECTIONS
        # An odd step, so that a pattern that repeats every second pixel is not missed.
        step = min(vectors.shape[d], math.ceil(max(excess, 1) ** (1 / (len(axes) - k))) | 1)
        vectors = vectors[(slice(None),) * d + (slice(step // 2, None, step),)]
    return vectors


def check_numbers(**values: object) -> None:
    """Check that all values are real numbers or tensors of them, and no pictures of 8 bits."""
    for argument, value in values.items():
        if isinstance(value, Real) or (isinstance(value, Tensor) and not value.is_complex() and not _stored(value)):
            continue
        raise ShapeError(
            argument,
            expected="a number or a tensor of real numbers",
            got=str(value.dtype) if isinstance(value, Tensor) else type(value).__name__,
            mend=_mend_type(value),
        )


def check_floating(**values: object) -> None:
    """Check that all values are floating-point tensors."""
    for argument, value in values.items():
        if not isinstance(value, Tensor) or not value.is_floating_point():
            raise ShapeError(
                argument,
                expected="a floating-point tensor",
                got=str(value.dtype) if isinstance(value, Tensor) else type(value).__name__,
                mend=_mend_type(value),
            )


def check_tensors(**values: object) -> None:
    """Check that all values are tensors, of any type; None is left alone."""
    for argument, value in values.items():
        if value is not None and not isinstance(value, Tensor):
            got = type(value).__name__
            raise ShapeError(argument, expected="a tensor", got=got, mend=f"use torch.as_tensor({argument})")


def check_encoded(argument: str, image: object, channels: tuple[int, ...]) -> None:
    """Check that a picture (..., C, H, W) holds floating-point values in [0, 1], as files do divided by their white.

    Raises:
        ShapeError: another type, or other channels.
        RangeError: values outside [0, 1].
    """
    check_floating(**{argument: image})
    picture: Tensor = image  # type: ignore[assignment]
    if picture.ndim < 3 or picture.shape[-3] not in channels:
        wanted = " or ".join(str(c) for c in channels)
        mend = "move the channels before rows and columns: image.movedim(-1, -3); leave an alpha channel out"
        raise ShapeError(argument, expected=f"(..., {wanted}, H, W)", got=str(tuple(picture.shape)), mend=mend)
    if checking() and picture.numel() and not bool(((picture > -OVERSHOOT) & (picture < 1 + OVERSHOOT)).all()):
        check_range(argument, picture, 0.0, 1.0, "divide 8-bit values by 255, 16-bit ones by 65535")


OVERSHOOT = 0.25
"""By how much values may leave [0, 1], as after resizing with a sharp kernel. Set by hand."""
STORED = (torch.uint8, torch.int16, torch.uint16)
"""Types in which files hold pictures."""


def _stored(value: object) -> bool:
    return isinstance(value, Tensor) and value.ndim > 0 and value.dtype in STORED


def _mend_type(value: object) -> str:
    """What makes a floating-point tensor of ``value``."""
    if _stored(value):
        return "divide by 255 (16 bits: 65535), then srgb_to_linear for photographs, decode_normals for normal maps"
    return "use torch.as_tensor(..., dtype=torch.float32)"
