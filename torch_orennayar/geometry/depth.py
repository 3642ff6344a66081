"""Normals from depth maps."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.checks import check_floating
from ..core.defaults import independent_of_defaults
from ..core.errors import ShapeError
from .camera import Camera
from .mesh import unit_or_zero


@independent_of_defaults
def depth_to_normals(depth: Tensor, *, mask: Tensor | None = None, camera: Camera | None = None) -> Tensor:
    """Normals of a depth map, the inverse of `integrate_normals`.

    Slopes are central differences, one-sided at the edge of the mask, so that pixels outside the mask have no
    influence. A depth discontinuity inside it appears as a steep surface.

    Args:
        depth: (1, H, W) or (B, 1, H, W). Without a camera the height toward the viewer in pixels; with one the
            distance along its optical axis, as in `NormalMap`. Differentiable.
        mask: bool, of the shape of ``depth``; default: where it is finite.
        camera: the camera of the depth map, or B of them; differentiable.

    Returns:
        (3, H, W) or (B, 3, H, W) unit normals in the camera frame; 0 outside the mask and where a pixel has no
        neighbour in its row or none in its column.

    Raises:
        ShapeError: shapes other than these.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> slope = 0.75 * torch.arange(4.0).expand(1, 3, 4)
        >>> [round(v, 4) for v in ton.depth_to_normals(slope)[:, 1, 1].tolist()]
        [-0.6, 0.0, 0.8]
    """
    check_floating(depth=depth)
    batched = depth if depth.ndim == 4 else depth[None]
    if batched.ndim != 4 or batched.shape[1] != 1:
        raise ShapeError("depth", expected="(1, H, W) or (B, 1, H, W)", got=str(tuple(depth.shape)), mend="reshape it")
    if mask is not None and (mask.shape != depth.shape or mask.dtype != torch.bool):
        got = f"{tuple(mask.shape)} {mask.dtype}"
        raise ShapeError("mask", expected=f"{tuple(depth.shape)} bool", got=got, mend="one mask per depth map; .bool()")
    if camera is not None and len(camera.eye) not in (1, len(batched)):
        got = f"{len(camera.eye)} cameras for {len(batched)} maps"
        raise ShapeError("camera", expected="one camera, or one for each map", got=got, mend="repeat the depth map")
    inside = batched.isfinite() if mask is None else (mask if mask.ndim == 4 else mask[None]) & batched.isfinite()
    known = torch.where(inside, batched, 0.0).double()
    if camera is None:
        height, width = known.shape[2:]
        row, column = torch.meshgrid(torch.arange(height).to(known), torch.arange(width).to(known), indexing="ij")
        points = torch.cat((column.expand_as(known), -row.expand_as(known), known), 1)
    else:
        points = camera.points(known)
    right, has_right = _difference(points, inside, 3)
    down, has_down = _difference(points, inside, 2)
    normal = torch.linalg.cross(down, right, dim=1)
    there = inside & has_right & has_down
    normal = unit_or_zero(normal * there, 1).to(depth.dtype)
    return normal if depth.ndim == 4 else normal[0]


def _difference(points: Tensor, inside: Tensor, axis: int) -> tuple[Tensor, Tensor]:
    """Sum of the steps (B, 3, H, W) from the previous and to the next pixel, and whether at least one exists."""
    length = points.shape[axis] - 1
    step = points.narrow(axis, 1, length) - points.narrow(axis, 0, length)
    both = inside.narrow(axis, 1, length) & inside.narrow(axis, 0, length)
    step, pad = torch.where(both, step, 0.0), [0, 0] * (3 - axis)
    behind, before = (torch.nn.functional.pad(step, [*pad, *ends]) for ends in ((0, 1), (1, 0)))
    has = torch.nn.functional.pad(both, [*pad, 0, 1]) | torch.nn.functional.pad(both, [*pad, 1, 0])
    return behind + before, has
