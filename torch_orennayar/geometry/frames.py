"""Conversion between camera frames."""

from __future__ import annotations

from torch import Tensor

from ..core.checks import check_floating


def swap_opencv_frame(vectors: Tensor, *, dim: int = 1) -> Tensor:
    """Convert from this package's camera frame (y up, z toward the viewer) to OpenCV's (y down, z forward), or back.

    Args:
        vectors: points or directions, 3 along ``dim``; differentiable.
        dim: the axis of x, y, z.

    Returns:
        The same shape, y and z negated: the conversion is its own inverse.

    Raises:
        ShapeError: no floating-point tensor.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> ton.swap_opencv_frame(torch.tensor([1.0, 2.0, 3.0]), dim=0).tolist()
        [1.0, -2.0, -3.0]
    """
    check_floating(vectors=vectors)
    shape = [1] * vectors.ndim
    shape[dim] = 3
    return vectors * vectors.new_tensor((1.0, -1.0, -1.0)).reshape(shape)
