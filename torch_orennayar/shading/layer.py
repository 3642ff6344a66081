"""Shading with a diffuse reflectance model: functions, the layer, and near lights.

Shading is ``pi f_r max(0, n.l)`` times the irradiance: radiance under a source whose irradiance on a
plane facing it is pi, so a white Lambertian surface that faces the light is 1. All of it is linear light.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

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
from ..reflectance.model_choice import ModelChoice, simplest_model
from ..reflectance.models import get_model
from ..reflectance.theory import floored_sine, gauss_legendre
from .tiled import Scene, cast, evaluate, shade, working_dtype

MAX_ROUGHNESS = math.pi / 2 + 1e-6


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
    0. Kinks are listed per model in ``MODELS``. Half precision is computed in float32.

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
            radians?), or directions that are no unit vectors; of a map, vectors spread over it are looked at, and
            zero or non-finite ones are gaps. Not checked inside ``torch.compile``, export and ``vmap``.
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
    return shade(known, *_lay_scene(normal, light, view, albedo, roughness, irradiance, dim))


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
    """The reflectance f_r in 1/sr, without the cosine of the light.

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
    scene, axis, dtype = _lay_scene(normal, light, view, albedo, roughness, None, dim)
    value, _, facing = evaluate(known.function, scene[:5], axis, working_dtype(dtype))
    return torch.where(facing, value / math.pi, 0.0).to(dtype)


def directional_albedo(
    cos_view: Tensor, albedo: Tensor | float, roughness: Tensor | float, *, model: str = "qualitative"
) -> Tensor:
    """Share of light from one direction that leaves the surface again: the integral of ``f_r n.l``.

    A product rule of 48 x 48 Gauss-Legendre nodes, within 1e-3 for every model (a second for each value of the slow
    `theory`); by reciprocity the same
    for light and view. Differentiable in all arguments.

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
    albedo_tensor, sigma = _parameters(albedo, roughness, cos_view)
    node, weight = (t.to(cos_view) for t in gauss_legendre(48))
    ci = node[:, None]  # (48, 1)
    cos_phi = (torch.pi * node)[None, :].cos()  # (1, 48), half of the circle
    co = cos_view[..., None, None]
    # The floor keeps the root's derivative finite at the frontal view, where cos_phi sums it to zero.
    lv = ci * co + (1 - ci * ci).sqrt() * floored_sine(co) * cos_phi
    value = function(ci, co, lv, albedo_tensor[..., None, None], sigma[..., None, None])
    return (value * ci * 2 * weight[:, None] * weight[None, :]).sum((-2, -1)).to(dtype)


def point_light(points: Tensor, position: Tensor, intensity: Tensor | float, *, dim: int = 1) -> tuple[Tensor, Tensor]:
    """Direction and irradiance of a near source at every point: inverse-square law.

    Differentiable in all arguments; at the source itself (zero distance) and at points that are not
    finite (background) both results and their gradients are 0.

    Args:
        points: surface points in the camera frame, 3 along ``dim``, e.g. (B, 3, H, W).
        position: the source, 3 along ``dim``, e.g. (B, 3, 1, 1).
        intensity: irradiance at unit distance, >= 0, in the unit of ``irradiance=``; 1 or C along ``dim``.
        dim: the axis of x, y, z in the broadcast shape.

    Returns:
        ``(light, irradiance)`` for `oren_nayar`: unit directions to the source, 3 along ``dim``, and
        irradiance on a plane facing the source, 1 or C along ``dim``.

    Raises:
        ShapeError: 3 is not found along ``dim``.
        RangeError: negative intensity.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> points = torch.zeros(1, 3, 1, 1)
        >>> light, irradiance = ton.point_light(points, torch.tensor([0.0, 0.0, 2.0]).reshape(1, 3, 1, 1), 1.0)
        >>> light.flatten().tolist(), irradiance.item()
        ([0.0, 0.0, 1.0], 0.25)
    """
    check_floating(points=points, position=position)
    axis = _axis_from_end(dim, points, position)
    check_axis("points", points, axis, (3,))
    check_axis("position", position, axis, (3,))
    check_range("intensity", intensity, 0.0, math.inf, "intensity is never negative")
    dtype = _result_dtype(points, position, intensity)
    here, there = (cast(t, working_dtype(dtype)).nan_to_num(0.0, 0.0, 0.0) for t in (points, position))
    known = (points.isfinite() & position.isfinite()).all(axis, keepdim=True)
    offset = (there - here) * known
    inverse = _inverse_length(offset, axis)
    check_broadcast(axis, points=points, position=position, intensity=intensity)
    return (offset * inverse).to(dtype), (intensity * (inverse * inverse)).to(dtype)


def _inverse_length(vectors: Tensor, axis: int) -> Tensor:
    """1 over the length, and 0 for zero; its gradient is finite, and 0 there."""
    square = (vectors * vectors).sum(axis, keepdim=True)
    apart = square > 0
    return torch.where(apart, square, 1).rsqrt() * apart


def _normalised(vectors: Tensor, axis: int) -> Tensor:
    """Unit vectors along ``axis``, in the dtype given; zero and non-finite ones become 0, with gradient 0."""
    wide = cast(vectors, working_dtype(vectors.dtype))
    known = wide.isfinite().all(axis, keepdim=True)
    wide = torch.where(known, wide, 0.0)
    # Whatever the scale, so that no square over- or underflows; the result does not depend on it.
    largest = wide.detach().abs().amax(axis, keepdim=True)
    wide = wide / torch.where(largest > 0, largest, 1.0)
    return (wide * _inverse_length(wide, axis)).to(vectors.dtype)


class OrenNayar(nn.Module):
    """`oren_nayar` as a layer, with an axis for several lights.

    Args:
        model: a name in ``MODELS``, or ``"auto"``: what `simplest_model` picks for roughness up to 60 degrees,
            any albedo and any angle. For a narrower scene pass ``simplest_model(roughness=..., ...)`` itself.
        dim: the axis of x, y, z in the normals.
        tolerance: the RMS error that ``"auto"`` may have; ``choice.reason`` says what it bought.
        normalise: whether to bring normals, lights and views of any length to 1 first (a network's output, a map that
            was resized); gradients go through it, and are 0 for zero vectors.

    Attributes:
        model: the name of the model in use.
        choice: the `ModelChoice` where one was made, with its reason, otherwise None.

    Raises:
        ModelError: unknown ``model``, or none within ``tolerance``.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> normal = torch.tensor([0.0, 0.0, 1.0]).reshape(1, 3, 1, 1).expand(2, 3, 4, 5)
        >>> lights = torch.tensor([0.0, 0.6, 0.8]).expand(2, 7, 3)
        >>> ton.OrenNayar("vcavity")(normal, lights, albedo=0.5, roughness=0.3).shape
        torch.Size([2, 7, 1, 4, 5])
    """

    def __init__(
        self, model: str = "qualitative", dim: int = 1, *, tolerance: float = 0.01, normalise: bool = False
    ) -> None:
        super().__init__()
        if model == "auto":
            model = simplest_model(tolerance=tolerance)
        self.choice = model if isinstance(model, ModelChoice) else None
        self.model = get_model(model).name
        self.dim = dim
        self.normalise = normalise

    def extra_repr(self) -> str:
        """What ``print(layer)`` shows."""
        return f"model={self.model!r}, dim={self.dim}" + (", normalise=True" if self.normalise else "")

    def forward(
        self,
        normal: Tensor,
        light: Tensor,
        view: Tensor | None = None,
        albedo: Tensor | float | None = None,
        roughness: Tensor | float | None = None,
        irradiance: Tensor | float | None = None,
    ) -> Tensor:
        """Shade ``normal``.

        Args:
            normal: (B, 3, H, W), or any shape with 3 along ``dim``.
            light: (B, 3) or (3,) one per image, (B, K, 3) several per image (normals of 4 axes or more),
                (B, 3, H, W) per pixel, (B, K, 3, H, W) several per pixel; unit, from surface to light.
            view: as one light; default (0, 0, 1), orthographic.
            albedo: number, (C,) or (B, C) with 1 or 3 channels, or a map with any C along ``dim``; default 1.
            roughness: radians: number, (1,), (B, 1), or a map with 1 along ``dim``; default 0.
            irradiance: number, or 1 or 3 channels laid out as the lights are: (C,), (B, C), (B, K, C), or
                maps with any C: (B, C, H, W), (B, K, C, H, W); default 1.

        Returns:
            (B, C, H, W), or (B, K, C, H, W) for several lights (sum over dim 1 for all of them on).
            Gradients as in `oren_nayar`.

        Raises:
            ShapeError, RangeError: as `oren_nayar`.
        """
        axis = self.dim if self.dim >= 0 else normal.ndim + self.dim
        if not 0 <= axis < normal.ndim or normal.shape[axis] != 3:
            raise ShapeError(
                "normal",
                expected=f"3 along axis {self.dim}",
                got=f"shape {tuple(normal.shape)}",
                mend="construct OrenNayar(dim=...) with the axis that holds x, y, z",
            )
        several = light.ndim == normal.ndim + 1 or (light.ndim == 3 and normal.ndim >= 4)
        if several and axis == 0:
            raise ShapeError(
                "normal",
                expected="a batch axis before x, y, z where there are several lights",
                got=f"shape {tuple(normal.shape)} with dim=0",
                mend="use normal.unsqueeze(0)",
            )
        if view is None:
            view = normal.new_tensor((0.0, 0.0, 1.0))

        batch = normal.shape[0] if axis > 0 else 1
        count = light.shape[1] if several else 1

        def lay(name: str, value: Tensor, channels: tuple[int, ...] = (3,)) -> Tensor:
            return _lay_out(name, value, normal.ndim, axis, batch, count if several else None, channels)

        def lay_direction(name: str, value: Tensor) -> Tensor:
            laid = lay(name, value)
            laid = _normalised(laid, axis - normal.ndim) if self.normalise else laid
            if value.ndim < normal.ndim:  # not a map, which may have gaps
                check_unit(name, laid, axis - normal.ndim, gaps=False)
            return laid

        def lay_number(name: str, value: Tensor | float, channels: tuple[int, ...] = (1, 3)) -> Tensor | float:
            return lay(name, value, channels) if isinstance(value, Tensor) else value

        return oren_nayar(
            lay_direction("normal", normal),
            lay_direction("light", light),
            lay_direction("view", view),
            lay_number("albedo", 1.0 if albedo is None else albedo),
            lay_number("roughness", 0.0 if roughness is None else roughness, (1,)),
            model=self.model,
            irradiance=None if irradiance is None else lay_number("irradiance", irradiance),
            dim=axis + int(several),
        )


def _lay_out(
    name: str, value: Tensor, ndim: int, axis: int, batch: int, lights: int | None, channels: tuple[int, ...]
) -> Tensor:
    """Bring (C,), (B, C), (B, K, C) or a map to the layout of the normals, with a light axis at 1 if ``lights``.

    The short forms are told apart by their sizes: a batch, a light count or a channel count that does not
    fit is refused rather than broadcast.
    """
    shape = tuple(value.shape)
    between, after = (1,) * max(axis - 1, 0), (1,) * (ndim - axis - 1)
    if value.ndim == 0 or (value.ndim == ndim + 1 and lights is not None):
        return value
    if value.ndim == ndim:
        return value if lights is None else value.unsqueeze(1)
    if shape[-1] in channels:
        if value.ndim == 1:
            return value.reshape(*shape, *after)
        if value.ndim == 2 and axis > 0 and shape[0] in (1, batch):
            return value.reshape(shape[0], *(() if lights is None else (1,)), *between, shape[1], *after)
        if value.ndim == 3 and lights is not None and shape[0] in (1, batch) and shape[1] in (1, lights):
            return value.reshape(shape[0], shape[1], *between, shape[2], *after)
    size = " or ".join(str(c) for c in channels)
    raise ShapeError(
        name,
        expected=f"({size},), ({batch}, {size}), a map of {ndim} axes"
        + ("" if lights is None else f", ({batch}, {lights}, {size}) or a map per light"),
        got=f"shape {shape}",
        mend="give it the layout of the normals, or one value per image",
    )


def _axis_from_end(dim: int, *tensors: Tensor) -> int:
    """``dim`` of the broadcast shape, counted from its end, where it means the same for every tensor."""
    ndim = max(t.ndim for t in tensors)
    if not isinstance(dim, int) or not -ndim <= dim < ndim:
        raise ShapeError("dim", expected=f"an axis of {ndim}-axis tensors", got=str(dim), mend="see the shapes")
    return dim if dim < 0 else dim - ndim


def _result_dtype(*values: Tensor | float | None) -> torch.dtype:
    tensors = [v for v in values if isinstance(v, Tensor)]
    dtype = tensors[0].dtype
    for tensor in tensors[1:]:
        dtype = torch.promote_types(dtype, tensor.dtype)
    return dtype


def _parameters(albedo: Tensor | float, roughness: Tensor | float, like: Tensor) -> tuple[Tensor, Tensor]:
    """Albedo and roughness checked and as tensors beside ``like``."""
    check_range("albedo", albedo, 0.0, math.inf, "clamp it, or learn it through softplus or sigmoid")
    check_range(
        "roughness",
        roughness,
        0.0,
        MAX_ROUGHNESS,
        "it is in radians (use math.radians for degrees); a learned one may be clamped or go through sigmoid",
    )
    rho = albedo if isinstance(albedo, Tensor) else like.new_tensor(albedo)
    sigma = roughness if isinstance(roughness, Tensor) else like.new_tensor(roughness)
    return rho, sigma


def _lay_scene(
    normal: Tensor,
    light: Tensor,
    view: Tensor,
    albedo: Tensor | float,
    roughness: Tensor | float,
    irradiance: Tensor | float | None,
    dim: int,
) -> tuple[Scene, int, torch.dtype]:
    """The arguments checked, as tensors of one number of axes; the axis of x, y, z from the end; the result's dtype."""
    check_floating(normal=normal, light=light, view=view)
    check_numbers(albedo=albedo, roughness=roughness, **({} if irradiance is None else {"irradiance": irradiance}))
    tensors = [t for t in (normal, light, view, albedo, roughness, irradiance) if isinstance(t, Tensor)]
    axis = _axis_from_end(dim, *tensors)
    for name, vectors in (("normal", normal), ("light", light), ("view", view)):
        check_axis(name, vectors, axis, (3,))
        check_unit(name, vectors, axis, gaps=name == "normal" or vectors.numel() > 3)
    if isinstance(roughness, Tensor) and roughness.ndim > 0:
        check_axis("roughness", roughness, axis, (1,))
    scale: dict[str, Tensor | float] = {} if irradiance is None else {"irradiance": irradiance}
    check_channels(axis, albedo=albedo, **scale)
    check_broadcast(axis, normal=normal, light=light, view=view, albedo=albedo, roughness=roughness, **scale)
    parts: list[Tensor | None] = [normal, light, view, *_parameters(albedo, roughness, normal), None]
    if irradiance is not None:
        check_range("irradiance", irradiance, 0.0, math.inf, "irradiance is never negative or infinite")
        parts[-1] = irradiance if isinstance(irradiance, Tensor) else normal.new_tensor(irradiance)
    ndim = max(t.ndim for t in tensors)
    # A number in a tensor may lie on the processor beside maps on an accelerator, as everywhere in torch.
    parts = [t.to(normal.device) if t is not None and t.ndim == 0 else t for t in parts]
    scene = [None if t is None else t.reshape((1,) * (ndim - t.ndim) + tuple(t.shape)) for t in parts]
    return scene, axis, _result_dtype(*tensors)
