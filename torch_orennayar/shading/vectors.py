"""Dot products and lengths along one axis."""

from __future__ import annotations

import torch
from torch import Tensor

from .precision import cast, working_dtype


def dot(a: Tensor, b: Tensor, axis: int) -> Tensor:
    """The dot product along ``axis``, which is kept with size 1.

    It is written by component, since torch's sums over an axis of 3 are slow; except in a traced graph, where runtimes
    would copy each component.
    """
    if torch.compiler.is_exporting():
        return (a * b).sum(axis, keepdim=True)
    (ax, ay, az), (bx, by, bz) = ([t.select(axis, k) for k in range(3)] for t in (a, b))
    return torch.addcmul(torch.addcmul(ax * bx, ay, by), az, bz).unsqueeze(axis)


def inverse_length(vectors: Tensor, axis: int) -> Tensor:
    """1 over the length along ``axis``, which is kept with size 1; 0 with gradient 0 for vectors of length 0."""
    square = (vectors * vectors).sum(axis, keepdim=True)
    apart = square > 0
    return torch.where(apart, square, 1).rsqrt() * apart


def normalise(vectors: Tensor, axis: int) -> Tensor:
    """Unit vectors along ``axis``, in the dtype of ``vectors``; 0 with gradient 0 for zero or non-finite vectors."""
    wide = cast(vectors, working_dtype(vectors.dtype))
    known = wide.isfinite().all(axis, keepdim=True)
    wide = torch.where(known, wide, 0.0)
    # Scaled by the largest component, so that squares neither overflow nor underflow; the result does not depend on it.
    largest = wide.detach().abs().amax(axis, keepdim=True)
    wide = wide / torch.where(largest > 0, largest, 1.0)
    return (wide * inverse_length(wide, axis)).to(vectors.dtype)
