"""The inputs of the shading: arguments checked and brought to one number of axes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from ..core.checks import (
    check_axis,
    check_broadcast,
    check_channels,
    check_floating,
    check_numbers,
    check_range,
    check_unit,
)
from ..core.errors import ShapeError
from ..reflectance.roughness import MAX_ROUGHNESS


class ShadingInputs(NamedTuple):
    """Tensors with equally many axes that broadcast, with x, y, z or channels along one and the same axis.

    The functions that take them name that axis ``axis`` and count it from the end (it is negative).

    Attributes:
        normal: unit normals, 3 along the axis.
        light: unit directions to the light, 3 along the axis.
        view: unit directions to the camera, 3 along the axis.
        albedo: 1 or C along the axis.
        roughness: radians, 1 along the axis.
        irradiance: 1 or C along the axis; None for 1.
    """

    normal: Tensor
    light: Tensor
    view: Tensor
    albedo: Tensor
    roughness: Tensor
    irradiance: Tensor | None = None


def map_inputs(function: Callable[[Tensor], Tensor], inputs: ShadingInputs) -> ShadingInputs:
    """Apply ``function`` to every tensor of ``inputs``."""
    normal, light, view, albedo, roughness, irradiance = inputs
    return ShadingInputs(
        function(normal),
        function(light),
        function(view),
        function(albedo),
        function(roughness),
        None if irradiance is None else function(irradiance),
    )


def prepare_inputs(
    normal: Tensor,
    light: Tensor,
    view: Tensor,
    albedo: Tensor | float,
    roughness: Tensor | float,
    irradiance: Tensor | float | None,
    dim: int,
) -> tuple[ShadingInputs, int, torch.dtype]:
    """Check the arguments of `oren_nayar` and bring them to one number of axes.

    Returns:
        ``(inputs, axis, dtype)``: the axis of x, y, z counted from the end, and the dtype of the result.
    """
    check_floating(normal=normal, light=light, view=view)
    scale: dict[str, Tensor | float] = {} if irradiance is None else {"irradiance": irradiance}
    check_numbers(albedo=albedo, roughness=roughness, **scale)
    tensors = [t for t in (normal, light, view, albedo, roughness, irradiance) if isinstance(t, Tensor)]
    axis = axis_from_end(dim, *tensors)
    for name, vectors in (("normal", normal), ("light", light), ("view", view)):
        check_axis(name, vectors, axis, (3,))
        check_unit(name, vectors, axis, gaps=name == "normal" or vectors.numel() > 3)
    if isinstance(roughness, Tensor) and roughness.ndim > 0:
        check_axis("roughness", roughness, axis, (1,))
    check_channels(axis, albedo=albedo, **scale)
    check_broadcast(axis, normal=normal, light=light, view=view, albedo=albedo, roughness=roughness, **scale)
    rho, sigma = check_parameters(albedo, roughness, normal)
    power: Tensor | None = None
    if irradiance is not None:
        check_range("irradiance", irradiance, 0.0, math.inf, "irradiance is never negative or infinite")
        power = irradiance if isinstance(irradiance, Tensor) else normal.new_tensor(irradiance)
    ndim = max(t.ndim for t in tensors)

    def expand(tensor: Tensor) -> Tensor:
        # A tensor with one number may be on the CPU beside maps on an accelerator, as elsewhere in torch.
        tensor = tensor.to(normal.device) if tensor.ndim == 0 else tensor
        return tensor.reshape((1,) * (ndim - tensor.ndim) + tuple(tensor.shape))

    inputs = map_inputs(expand, ShadingInputs(normal, light, view, rho, sigma, power))
    return inputs, axis, result_dtype(*tensors)


def check_parameters(albedo: Tensor | float, roughness: Tensor | float, like: Tensor) -> tuple[Tensor, Tensor]:
    """Check the ranges of albedo and roughness, and return them as tensors; numbers take dtype and device of ``like``.

    Raises:
        RangeError: one of them is negative, NaN or too large.
    """
    check_range("albedo", albedo, 0.0, math.inf, "clamp it, or learn it through softplus or sigmoid")
    check_range(
        "roughness",
        roughness,
        0.0,
        MAX_ROUGHNESS,
        "it is in radians (use math.radians for degrees); learn it as math.pi / 2 * x.sigmoid()",
    )
    rho = albedo if isinstance(albedo, Tensor) else like.new_tensor(albedo)
    sigma = roughness if isinstance(roughness, Tensor) else like.new_tensor(roughness)
    return rho, sigma


def axis_from_end(dim: object, *tensors: Tensor) -> int:
    """Count ``dim``, an axis of the broadcast shape, from its end: there it means the same axis in every tensor.

    Raises:
        ShapeError: the broadcast shape has no such axis.
    """
    ndim = max(t.ndim for t in tensors)
    if not isinstance(dim, int) or not -ndim <= dim < ndim:
        raise ShapeError("dim", expected=f"an axis of {ndim}-axis tensors", got=str(dim), mend="see the shapes")
    return dim if dim < 0 else dim - ndim


def result_dtype(*tensors: Tensor) -> torch.dtype:
    """The dtype to which all ``tensors`` promote."""
    dtype = tensors[0].dtype
    for tensor in tensors[1:]:
        dtype = torch.promote_types(dtype, tensor.dtype)
    return dtype
