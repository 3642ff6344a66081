"""How far normals are from each other."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.errors import ShapeError


class AngularError(torch.Tensor):
    """A map of angles in degrees, NaN outside the foreground, that can sum itself up.

    It is a tensor like any other; `summary` looks at the foreground only.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> n = torch.tensor([0.0, 0.0, 1.0]).reshape(3, 1, 1)
        >>> ton.angular_error(n, n).summary()["mean"]
        0.0
    """

    def summary(self) -> dict[str, float]:
        """Mean, median and 90th percentile in degrees, shares within 5, 10 and 20 degrees, number of pixels."""
        values = self.as_subclass(torch.Tensor).double()
        values = values[values.isfinite()]
        if values.numel() == 0:
            keys = ("mean", "median", "p90", "within_5", "within_10", "within_20")
            return dict.fromkeys(keys, float("nan")) | {"pixels": 0}
        ordered = values.sort().values
        result = {
            "mean": values.mean().item(),
            "median": ordered[len(ordered) // 2].item(),
            "p90": ordered[int(0.9 * (len(ordered) - 1))].item(),
            "pixels": values.numel(),
        }
        return result | {f"within_{d}": (values <= d).double().mean().item() for d in (5, 10, 20)}


@torch.no_grad()
def angular_error(a: Tensor, b: Tensor, mask: Tensor | None = None, *, dim: int = -3) -> AngularError:
    """Angle between two sets of directions, in degrees.

    Accurate for small angles (``atan2`` of cross and dot product). A measure, not a loss: no gradients.

    Args:
        a: directions of any length, 3 along ``dim``: (3, H, W) or (B, 3, H, W); the estimate.
        b: the same shape, or one that broadcasts; the truth. Where it is zero or not finite, nothing is known
            and the pixel is left out.
        mask: foreground, bool, 1 along ``dim``; default: where both are known. A pixel of the mask where
            ``a`` is zero or not finite counts as 180 degrees, for nothing was found there.
        dim: the axis of x, y, z.

    Returns:
        An `AngularError`: a tensor of degrees with 1 along ``dim``, NaN outside the foreground.

    Raises:
        ShapeError: 3 is not found along ``dim``, or shapes do not broadcast.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> up, right = torch.tensor([0.0, 0.0, 1.0]), torch.tensor([1.0, 0.0, 0.0])
        >>> ton.angular_error(up, right, dim=-1).item()
        90.0
    """
    for name, value in (("a", a), ("b", b)):
        if not -value.ndim <= dim < value.ndim or value.shape[dim] != 3:
            raise ShapeError(name, expected=f"3 along axis {dim}", got=str(tuple(value.shape)), mend="pass dim=")
    try:
        dtype = torch.promote_types(torch.promote_types(a.dtype, b.dtype), torch.float32)
        first, second = torch.broadcast_tensors(a.to(dtype), b.to(dtype))
        cross = torch.linalg.cross(first, second, dim=dim).norm(dim=dim, keepdim=True)
        angle = torch.rad2deg(torch.atan2(cross, (first * second).sum(dim, keepdim=True)))
        found, known = (
            (v.abs().sum(dim, keepdim=True) > 0) & v.isfinite().all(dim, keepdim=True) for v in (first, second)
        )
        foreground = known & found if mask is None else known & mask.bool()
        angle = torch.where(found, angle, 180.0)
        return torch.where(foreground, angle, torch.nan).as_subclass(AngularError)
    except RuntimeError as error:
        raise ShapeError(
            "a, b, mask",
            expected="shapes that broadcast",
            got=", ".join(str(tuple(t.shape)) for t in (a, b, mask) if t is not None),
            mend="give them one size",
        ) from error
