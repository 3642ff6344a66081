"""Height fields on the pixel grid: heights at the corners of pixels, normals at their centres.

A height is measured in pixels toward the viewer; under a perspective camera it is ``-log(depth)`` over the angle of a
pixel. Every pixel gets its normal from its own four corners, so the surface is integrable by construction.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.checks import check_mask
from ..core.optional import require
from .camera import Camera

DIRECT_SOLVE_PIXELS = 5000
"""Largest number of unknowns of `inflate` that a sparse direct solver gets; more go to algebraic multigrid. Set by
hand."""
MULTIGRID_TOLERANCE = 1e-4
"""Relative residual at which multigrid stops in `inflate`; set by hand: the result is only a start and a prior."""


def normals(height: Tensor, corner_rays: Tensor | None, pixel_angle: float) -> Tensor:
    """Unit normals of the pixels (3, H, W) from corner heights (1, H + 1, W + 1); differentiable in ``height``.

    Args:
        height: (1, H + 1, W + 1), of the corners.
        corner_rays: (3, H + 1, W + 1) viewing rays through the corners at depth 1; None for parallel rays.
        pixel_angle: radians; used with ``corner_rays`` only.
    """
    if corner_rays is None:
        z = height[0]
        right = (z[:-1, 1:] + z[1:, 1:] - z[:-1, :-1] - z[1:, :-1]) / 2
        up = (z[:-1, :-1] + z[:-1, 1:] - z[1:, :-1] - z[1:, 1:]) / 2
        facing = (1 + right * right + up * up).rsqrt()
        return torch.stack((-right * facing, -up * facing, facing))
    points = corner_rays * torch.exp(-height * pixel_angle) / pixel_angle
    falling = points[:, 1:, 1:] - points[:, :-1, :-1]
    rising = points[:, :-1, 1:] - points[:, 1:, :-1]
    return F.normalize(torch.linalg.cross(falling, rising, dim=0), dim=0)


def silhouette_normals(mask: Tensor) -> Tensor:
    """Normals of the inflated silhouette, a smooth surface whose rim is the mask's edge.

    The square of its height solves a Poisson equation that is 0 at the edge: on an ellipse it is half an ellipsoid.
    `shape_from_shading` starts from it.

    Args:
        mask: (1, H, W) bool, the object.

    Returns:
        (3, H, W) float32 unit normals in the camera frame, 0 outside the mask. Not differentiable.

    Raises:
        ShapeError: the mask has another shape or dtype.
        CaptureError: the mask is empty.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> y, x = torch.meshgrid(torch.linspace(1, -1, 48), torch.linspace(-1, 1, 48), indexing="ij")
        >>> ball = (x * x + y * y < 0.9)[None]
        >>> normal = ton.silhouette_normals(ball)
        >>> bool(normal[2, 24, 24] > 0.99), bool(normal[0, 24, 44] > 0.8)  # the middle faces the viewer, the rim right
        (True, True)
    """
    inside = check_mask(mask, mask)
    return torch.where(inside, normals(inflate(inside.float()), None, 1.0), 0.0)


def inflate(mask: Tensor) -> Tensor:
    """Corner heights (1, H + 1, W + 1) of the inflated silhouette of ``mask`` (1, H, W) float, in its dtype."""
    require("pyamg", "scipy")
    import pyamg
    import scipy.sparse.linalg

    padded = F.pad(mask, (1, 1, 1, 1))[0] > 0.5
    inside = padded.cpu().numpy()
    kept = inside.flatten().nonzero()[0]
    laplacian = pyamg.gallery.poisson(inside.shape, format="csr")[kept][:, kept]
    right_side = torch.full((len(kept),), 4.0, dtype=torch.float64).numpy()  # height**2 = r**2 - x**2 - y**2 on a disc
    if len(kept) > DIRECT_SOLVE_PIXELS:
        solver = pyamg.ruge_stuben_solver(laplacian.tocsr(), max_coarse=50)
        solution = solver.solve(right_side, tol=MULTIGRID_TOLERANCE, accel="cg")
    else:
        solution = scipy.sparse.linalg.spsolve(laplacian.tocsc(), right_side)
    squared_height = torch.zeros(inside.shape, dtype=torch.float64)
    squared_height[padded.cpu()] = torch.as_tensor(solution).reshape(-1)
    height = squared_height.clamp_min(0).sqrt().to(mask)
    return to_corners(height[None, 1:-1, 1:-1])


def to_corners(values: Tensor) -> Tensor:
    """Pixel values (1, H, W) averaged at the corners, (1, H + 1, W + 1); beyond the picture they count as 0."""
    return F.avg_pool2d(F.pad(values, (1, 1, 1, 1)), 2, 1)


def to_centers(height: Tensor) -> Tensor:
    """Corner heights (1, H + 1, W + 1) averaged at the pixels, (1, H, W)."""
    return (height[:, :-1, :-1] + height[:, 1:, :-1] + height[:, :-1, 1:] + height[:, 1:, 1:]) / 4


def resize(values: Tensor, size: tuple[int, int]) -> Tensor:
    """Corner values (C, H, W), bilinearly interpolated to ``size``; the outermost corners stay."""
    return F.interpolate(values[None], size=size, mode="bilinear", align_corners=True)[0]


def corner_rays(camera: Camera, size: tuple[int, int]) -> Tensor:
    """Viewing rays through the corners of pixels, (3, H + 1, W + 1); they are linear in row and column."""
    rays = camera.rays(size)[0] if min(size) > 1 else camera.rays((size[0] + 1, size[1] + 1))[0]
    right, down = rays[:, :1, 1:2] - rays[:, :1, :1], rays[:, 1:2, :1] - rays[:, :1, :1]
    rows, columns = (torch.arange(n + 1).to(rays) - 0.5 for n in size)
    return rays[:, :1, :1] + right * columns.reshape(1, 1, -1) + down * rows.reshape(1, -1, 1)


def pixel_size(camera: Camera, size: tuple[int, int]) -> float:
    """Side of a pixel of a picture of ``size``: at depth 1 if perspective, otherwise in the camera's unit."""
    return 2 / (size[0] * float(camera.focal[0, 1]))


def depth_to_height(depth: Tensor, camera: Camera | None, size: tuple[int, int]) -> Tensor:
    """Heights of a depth map, or of a part of it, in a picture of ``size``."""
    if camera is None:
        return depth
    return -(depth.log() if camera.is_perspective else depth) / pixel_size(camera, size)


def height_to_depth(height: Tensor, camera: Camera | None, size: tuple[int, int]) -> Tensor:
    """Inverse of `depth_to_height`."""
    if camera is None:
        return height
    distance = -height * pixel_size(camera, size)
    return distance.exp() if camera.is_perspective else distance
