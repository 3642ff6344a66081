"""The shading layer: `oren_nayar` as a module, with short forms for lights, albedo and roughness."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from torch import Tensor, nn

from ..core.checks import check_floating, check_unit
from ..core.errors import ShapeError
from ..reflectance.model_choice import ModelChoice, simplest_model
from ..reflectance.models import get_model
from .functional import oren_nayar
from .vectors import normalise


class OrenNayar(nn.Module):
    """`oren_nayar` as a layer, with an axis for several lights.

    Args:
        model: a name in ``MODELS``, or ``"auto"``: the choice of `simplest_model` for roughness up to 60 degrees,
            any albedo and any angle. For a narrower scene pass ``simplest_model(roughness=..., ...)`` itself.
        dim: the axis of x, y, z in the normals.
        tolerance: largest RMS error of the model that ``"auto"`` chooses; ``choice.reason`` explains the choice.
        normalise: whether to scale normals, lights and views to unit length first (a network's output, a map that
            was resized); differentiable, with gradient 0 for zero vectors.

    Attributes:
        model: the name of the model in use.
        choice: the `ModelChoice` with its reason if ``model`` was ``"auto"`` or a choice, otherwise None.

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
        """See the class."""
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
        check_floating(normal=normal, light=light, **({} if view is None else {"view": view}))
        layout = self._layout(normal, light)
        if view is None:
            view = normal.new_tensor((0.0, 0.0, 1.0))
        return oren_nayar(
            self._directions("normal", normal, layout),
            self._directions("light", light, layout),
            self._directions("view", view, layout),
            _arrange_parameter("albedo", 1.0 if albedo is None else albedo, layout),
            _arrange_parameter("roughness", 0.0 if roughness is None else roughness, layout, (1,)),
            model=self.model,
            irradiance=None if irradiance is None else _arrange_parameter("irradiance", irradiance, layout),
            dim=layout.axis + int(layout.lights is not None),
        )

    if TYPE_CHECKING:  # nn.Module declares calls as Any
        __call__ = forward

    def _layout(self, normal: Tensor, light: Tensor) -> _Layout:
        """The layout of a call, from the shapes of normals and lights."""
        axis = self.dim if self.dim >= 0 else normal.ndim + self.dim
        if not 0 <= axis < normal.ndim or normal.shape[axis] != 3:
            raise ShapeError(
                "normal",
                expected=f"3 along axis {self.dim}",
                got=f"shape {tuple(normal.shape)}",
                mend="add a batch axis (normal[None]), or say OrenNayar(dim=...) if x, y, z lie along another axis",
            )
        several = light.ndim == normal.ndim + 1 or (light.ndim == 3 and normal.ndim >= 4)
        if several and axis == 0:
            raise ShapeError(
                "normal",
                expected="a batch axis before x, y, z where there are several lights",
                got=f"shape {tuple(normal.shape)} with dim=0",
                mend="use normal.unsqueeze(0)",
            )
        batch = normal.shape[0] if axis > 0 else 1
        return _Layout(normal.ndim, axis, batch, light.shape[1] if several else None)

    def _directions(self, name: str, value: Tensor, layout: _Layout) -> Tensor:
        """Directions in the layout of the normals, normalised if asked for.

        Directions that are not maps are checked: none may be zero or not finite, as the background of a map is.
        """
        axis = layout.axis - layout.ndim
        directions = _arrange(name, value, layout, (3,))
        directions = normalise(directions, axis) if self.normalise else directions
        if value.ndim < layout.ndim:
            check_unit(name, directions, axis, gaps=False)
        return directions


class _Layout(NamedTuple):
    """Layout of a call.

    Attributes:
        ndim: number of axes of the normals.
        axis: their axis of x, y, z, at least 0.
        batch: size of their first axis; 1 where that axis holds x, y, z.
        lights: number of lights, None where there is no axis for them.
    """

    ndim: int
    axis: int
    batch: int
    lights: int | None


def _arrange_parameter(
    name: str, value: Tensor | float, layout: _Layout, channels: tuple[int, ...] = (1, 3)
) -> Tensor | float:
    return _arrange(name, value, layout, channels) if isinstance(value, Tensor) else value


def _arrange(name: str, value: Tensor, layout: _Layout, channels: tuple[int, ...]) -> Tensor:
    """Bring (C,), (B, C), (B, K, C) or a map to the layout of the normals, with lights (if several) along axis 1.

    The sizes tell the short forms apart: a batch, a number of lights or a number of channels that does not fit is
    refused rather than broadcast.
    """
    ndim, axis, batch, lights = layout
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
    several = name == "light" and ndim > 3 and value.ndim == 2
    more = f", ({batch}, K, {size})" if several else ""
    more = more if lights is None else f", ({batch}, {lights}, {size}) or a map per light"
    raise ShapeError(
        name,
        expected=f"({size},), ({batch}, {size}), a map of {ndim} axes{more}",
        got=f"shape {shape}",
        mend="use light[None] for several lights of every image"
        if several
        else "give it the layout of the normals, or one value per image",
    )
