"""Shading, reflectance and directional albedo as functions.

Shading is ``pi f_r max(0, n.l)`` times the irradiance: the radiance under a source whose irradiance on a plane facing
it is pi, so that a white Lambertian surface facing the light is 1. All values are linear light.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ..core.checks import check_floating, check_range
from ..reflectance.models import get_model
from ..reflectance.theory import floored_sine, gauss_legendre
from .evaluate import evaluate
from .inputs import check_parameters, prepare_inputs
from .precision import cast, working_dtype
from .tiled import shade

NODES = 48
"""Gauss-Legendre nodes per axis of `directional_albedo`: errors stay below 1e-3 (``tests/shading/test_layer.py``)."""


def oren_nayar(
    normal: Tensor,
    light: Tensor,
    view: Tensor,
    albedo: Tensor | float,
    roughness: Tensor | float,
    *,
    model: str = "qualitative",
    irradiance: Tensor | float | None = None,
    dim: int = 1,
) -> Tensor:
    """Shade rough surfaces: ``pi f_r max(0, n.l)`` times the irradiance, in linear light.

    Everything broadcasts. Differentiable in all tensors; where a pixel faces away from light or view
    (``n.l <= 0`` or ``n.v <= 0``), or its normal is zero or not finite, value and gradients are exactly
    0. ``MODELS`` lists the kinks of each model. float16 and bfloat16 are computed in float32.

    Args:
        normal: unit normals, 3 along ``dim``, e.g. (B, 3, H, W).
        light: unit directions from the surface to the light, 3 along ``dim``, e.g. (B, 3, 1, 1).
        view: unit directions from the surface to the camera, 3 along ``dim``.
        albedo: facet albedo, >= 0 (in [0, 1] for a surface that creates no light), 1 or C along ``dim``.
        roughness: standard deviation of the facet slope angle in radians, in [0, pi/2], 1 along ``dim``.
        model: a name in ``MODELS``.
        irradiance: scale of the light, 1 or C along ``dim``; 1 is the source of the default unit.
        dim: the axis of x, y, z in the broadcast shape.

    Returns:
        Shading, C along ``dim``, in the promoted dtype of the inputs.

    Raises:
        ShapeError: an argument lacks its 3 (or 1) along ``dim``, or shapes do not broadcast.
        RangeError: negative or NaN albedo or roughness, roughness above pi/2 (degrees given for
            radians?), or directions that are not unit vectors; of a map a sample is checked, in which zero and
            non-finite vectors count as background. Not checked inside ``torch.compile``, export and ``vmap``.
        ModelError: unknown ``model``.

    Source:
        Oren & Nayar, "Generalization of Lambert's reflectance model", SIGGRAPH 1994; each model's own
        source is in ``MODELS``.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> up = torch.tensor([0.0, 0.0, 1.0]).reshape(1, 3, 1, 1)
        >>> ton.oren_nayar(up, up, up, 1.0, 0.0).item()
        1.0
        >>> round(ton.oren_nayar(up, up, up, 1.0, 0.5).item(), 4)
        0.7845
    """
    known = get_model(model)
    return shade(known, *prepare_inputs(normal, light, view, albedo, roughness, irradiance, dim))


def brdf(
    normal: Tensor,
    light: Tensor,
    view: Tensor,
    albedo: Tensor | float,
    roughness: Tensor | float,
    *,
    model: str = "qualitative",
    dim: int = 1,
) -> Tensor:
    """The bidirectional reflectance f_r in 1/sr, without the cosine of the light.

    Arguments, broadcasting, gradients and errors are those of `oren_nayar`; f_r is 0 where the surface
    faces away from light or view.

    Returns:
        f_r, C along ``dim``.

    Example:
        >>> import math, torch, torch_orennayar as ton
        >>> up = torch.tensor([[0.0, 0.0, 1.0]])
        >>> math.isclose(ton.brdf(up, up, up, 0.5, 0.0, model="lambert").item(), 0.5 / math.pi, rel_tol=1e-6)
        True
    """
    known = get_model(model)
    inputs, axis, dtype = prepare_inputs(normal, light, view, albedo, roughness, None, dim)
    value, _, facing = evaluate(known.function, inputs, axis, working_dtype(dtype))
    return torch.where(facing, value / math.pi, 0.0).to(dtype)


def directional_albedo(
    cos_view: Tensor, albedo: Tensor | float, roughness: Tensor | float, *, model: str = "qualitative"
) -> Tensor:
    """Directional albedo: the share of light from one direction that the surface reflects, the integral of ``f_r n.l``.

    Computed by a product rule of 48 x 48 Gauss-Legendre nodes, accurate to 1e-3 for every model (the slow ``theory``
    takes about a second per value); by reciprocity it is the same for light and view. Differentiable in all arguments.

    Args:
        cos_view: cosines in (0, 1], any shape.
        albedo: >= 0, broadcasts with ``cos_view``.
        roughness: radians in [0, pi/2], broadcasts with ``cos_view``.
        model: a name in ``MODELS``.

    Returns:
        The hemispherical integral, of the broadcast shape.

    Raises:
        RangeError: a cosine outside (0, 1], or albedo or roughness out of range.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> round(ton.directional_albedo(torch.tensor(0.5), 0.8, 0.0, model="lambert").item(), 5)
        0.8
    """
    check_floating(cos_view=cos_view)
    check_range("cos_view", cos_view, 1e-6, 1 + 1e-6, "it is the cosine between normal and view")
    function = get_model(model).function
    dtype = cos_view.dtype
    cos_view = cast(cos_view, working_dtype(dtype))
    rho, sigma = check_parameters(albedo, roughness, cos_view)
    node, weight = (t.to(cos_view) for t in gauss_legendre(NODES))
    ci = node[:, None]  # (NODES, 1)
    cos_phi = (torch.pi * node)[None, :].cos()  # (1, NODES), half of the circle
    co = cos_view[..., None, None]
    # The lower bound keeps the derivative of the root finite at the frontal view, where the sum over cos_phi is zero.
    lv = ci * co + (1 - ci * ci).sqrt() * floored_sine(co) * cos_phi
    value = function(ci, co, lv, rho[..., None, None], sigma[..., None, None])
    return (value * ci * 2 * weight[:, None] * weight[None, :]).sum((-2, -1)).to(dtype)
