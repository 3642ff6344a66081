"""The sRGB curve and its inverse, by kornia."""

from __future__ import annotations

from torch import Tensor

from ..core.checks import check_encoded, check_floating
from ..core.errors import RangeError
from ..core.optional import require


def srgb_to_linear(image: Tensor) -> Tensor:
    """Undo the sRGB curve (IEC 61966-2-1): encoded values to linear light.

    Args:
        image: (..., 1|3, H, W) encoded values in [0, 1]; differentiable.

    Returns:
        Linear light of the same shape.

    Raises:
        ShapeError: integers, or an axis of channels elsewhere.
        RangeError: values outside [0, 1].
        MissingPackageError: kornia is not installed.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> round(ton.srgb_to_linear(torch.full((1, 1, 1), 0.5)).item(), 3)
        0.214
    """
    check_encoded("image", image, (1, 3))
    require("kornia")
    from kornia.color import rgb_to_linear_rgb

    linear: Tensor = rgb_to_linear_rgb(image.expand(*image.shape[:-3], 3, -1, -1))
    return linear[..., : image.shape[-3], :, :]


def linear_to_srgb(image: Tensor, *, tone_map: str = "clamp") -> Tensor:
    """Encode linear light as sRGB (IEC 61966-2-1) for display; computations stay in linear light.

    Args:
        image: (..., 1|3, H, W) linear light; differentiable.
        tone_map: ``"clamp"`` cuts at 1; ``"reinhard"`` maps x to x / (1 + x) (Reinhard et al. 2002).

    Returns:
        Encoded values in [0, 1], of the same shape.

    Raises:
        ShapeError: no floating-point tensor.
        RangeError: an unknown tone map.
        MissingPackageError: kornia is not installed.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> round(ton.linear_to_srgb(torch.full((1, 1, 1), 0.214)).item(), 2)
        0.5
    """
    require("kornia")
    from kornia.color import linear_rgb_to_rgb

    if tone_map not in ("clamp", "reinhard"):
        raise RangeError("tone_map", expected="'clamp' or 'reinhard'", got=repr(tone_map), mend="choose one")
    check_floating(image=image)
    light = image.clamp_min(0)
    light = (light / (1 + light)) if tone_map == "reinhard" else light.clamp(max=1)
    encoded: Tensor = linear_rgb_to_rgb(light.expand(*light.shape[:-3], 3, -1, -1))
    return encoded[..., : image.shape[-3], :, :]


def as_rgb(image: Tensor) -> Tensor:
    """(C, H, W) as (3, H, W): of another number of channels than 3 the mean."""
    return image if len(image) == 3 else image.mean(0, True).expand(3, -1, -1)
