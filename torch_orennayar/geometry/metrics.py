"""Angular error of normals."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.checks import check_tensors
from ..core.errors import ShapeError


class AngularError(torch.Tensor):
    """A map of angles in degrees, NaN outside the foreground, with a method for its statistics.

    It is a tensor otherwise; `summary` considers the foreground only.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> n = torch.tensor([0.0, 0.0, 1.0]).reshape(3, 1, 1)
        >>> ton.angular_error(n, n).summary()["mean"]
        0.0
    """

    def summary(self) -> dict[str, float]:
        """Statistics of the foreground.

        Returns:
            ``mean``, ``median`` and ``p90`` (the 90th percentile) in degrees; ``within_5``, ``within_10`` and
            ``within_20``, the shares of pixels with at most that many degrees; ``pixels``, their number. All but the
            last are NaN where there are no pixels.
        """
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

    Accurate for small angles (``atan2`` of cross and dot product). Not differentiable.

    Args:
        a: the estimate: directions of any length, 3 along ``dim``, e.g. (3, H, W) or (B, 3, H, W).
        b: the ground truth: the same shape, or one that broadcasts. Pixels where it is zero or not finite are
            excluded.
        mask: foreground, bool, 1 along ``dim``; default: where both are known. Pixels of the mask where the estimate
            ``a`` is missing (zero or not finite) count as 180 degrees.
        dim: the axis of x, y, z.

    Returns:
        An `AngularError`: degrees, 1 along ``dim``, NaN outside the foreground.

    Raises:
        ShapeError: 3 is not found along ``dim``, or shapes do not broadcast.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> up, right = torch.tensor([0.0, 0.0, 1.0]), torch.tensor([1.0, 0.0, 0.0])
        >>> ton.angular_error(up, right, dim=-1).item()
        90.0
    """
    check_tensors(a=a, b=b, mask=mask)
    for name, value in (("a", a), ("b", b)):
        if not -value.ndim <= dim < value.ndim or value.shape[dim] != 3:
            raise ShapeError(name, expected=f"3 along axis {dim}", got=str(tuple(value.shape)), mend="pass dim=")
    if mask is not None and dim < 0 and mask.ndim >= -dim and mask.shape[dim] != 1:
        got = f"{tuple(mask.shape)} for {tuple(a.shape)}"
        raise ShapeError("mask", expected=f"1 along axis {dim}", got=got, mend=f"use mask.unsqueeze({dim})")
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
