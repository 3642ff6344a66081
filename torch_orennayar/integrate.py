"""Depth from normals: weighted least squares over neighbouring pixels."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from .camera import Camera
from .errors import CaptureError, RangeError, ShapeError

MIN_FACING = 0.05
"""Cosine to the view below which a slope is cut; such pixels also weigh little."""


@torch.no_grad()
def integrate_normals(normal: Tensor, mask: Tensor | None = None, *, camera: Camera | None = None) -> Tensor:
    """Integrate normals to depth: the surface whose slopes between neighbours fit best, in least squares.

    Neighbours weigh with the square of their cosines to the view. Smooth surfaces only: a depth
    discontinuity is bridged by a slope. Not differentiable.

    Args:
        normal: (3, H, W) unit normals in the camera frame.
        mask: (1, H, W) bool; default: where the normal is not zero.
        camera: None for orthographic views in pixels; a `Camera` otherwise.

    Returns:
        (1, H, W), 0 outside the mask. Without a camera: height toward the viewer in pixels, mean 0 over
        every connected region. With a perspective camera: positive distance along the optical axis,
        geometric mean 1 over every connected region. With an orthographic one: distance along the axis in
        its units, mean 0 over every connected region.

    Raises:
        ShapeError: shapes other than these.
        RangeError: NaN inside the mask.
        CaptureError: an empty mask.

    Source:
        Least-squares integration as reviewed by Queau, Durou & Aujol 2018, "Normal integration: a survey".

    Example:
        >>> import torch, torch_orennayar as ton
        >>> tilted = torch.tensor([-0.6, 0.0, 0.8]).reshape(3, 1, 1).expand(3, 1, 3)
        >>> [round(v, 2) + 0 for v in ton.integrate_normals(tilted).flatten().tolist()]
        [-0.75, 0.0, 0.75]
    """
    inside = _check(normal, mask)
    height, width = inside.shape
    n = normal.detach().cpu().double()
    if camera is None or not camera.is_perspective:
        facing = n[2]
        step_x, step_y = (1.0, 1.0) if camera is None else (float(2 / (height * f)) for f in camera.focal[0])
    else:
        facing = -(n * camera.rays((height, width))[0].double().cpu()).sum(0)
        step_x, step_y = (float(2 / (height * f)) for f in camera.focal[0])
    facing = facing.clamp_min(MIN_FACING)
    # Slopes of height toward the viewer (orthographic) or of -log(depth) (perspective) per pixel.
    slope_right, slope_down = -n[0] / facing * step_x, n[1] / facing * step_y
    height_map = _solve(slope_right.numpy(), slope_down.numpy(), facing.numpy(), inside.cpu().numpy())
    depth = torch.from_numpy(height_map).to(normal)[None]
    if camera is not None:
        depth = (-depth).exp() if camera.is_perspective else -depth
    return torch.where(inside[None], depth, 0)


def _check(normal: Tensor, mask: Tensor | None) -> Tensor:
    if normal.ndim != 3 or normal.shape[0] != 3:
        raise ShapeError("normal", expected="(3, H, W)", got=str(tuple(normal.shape)), mend="integrate one at a time")
    if mask is None:
        mask = (normal != 0).any(0, keepdim=True)
    if tuple(mask.shape) != (1, *normal.shape[1:]):
        raise ShapeError(
            "mask", expected=str((1, *normal.shape[1:])), got=str(tuple(mask.shape)), mend="one mask per normal map"
        )
    if not bool(mask.any()):
        raise CaptureError("mask", expected="some pixels", got="none", mend="mark the object")
    if not bool(normal[:, mask[0]].isfinite().all()):
        raise RangeError("normal", expected="finite values inside the mask", got="NaN or infinity", mend="shrink mask")
    return mask[0]


def _solve(
    right: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    down: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    facing: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    inside: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Least squares over horizontal and vertical neighbours by conjugate gradients with algebraic multigrid."""
    import pyamg
    import scipy.ndimage
    import scipy.sparse

    count = int(inside.sum())
    index = np.full(inside.shape, -1)
    index[inside] = np.arange(count)
    rows, columns, slopes, weights = [], [], [], []
    for slope, here, there in (
        (right, np.s_[:, :-1], np.s_[:, 1:]),
        (down, np.s_[:-1], np.s_[1:]),
    ):
        both = inside[here] & inside[there]
        rows.append(index[here][both])
        columns.append(index[there][both])
        slopes.append((slope[here][both] + slope[there][both]) / 2)
        weights.append(np.minimum(facing[here][both], facing[there][both]) ** 2)
    first, second = np.concatenate(rows), np.concatenate(columns)
    slope, weight = np.concatenate(slopes), np.concatenate(weights)
    pairs = np.arange(len(first))
    ones = np.ones(len(first))
    difference = scipy.sparse.csr_matrix(
        (np.concatenate((ones, -ones)), (np.concatenate((pairs, pairs)), np.concatenate((second, first)))),
        shape=(len(first), count),
    )
    weighted = difference.T @ scipy.sparse.diags(weight)
    # The ridge makes the free constant of every region harmless to the solver; the means are set below.
    system = (weighted @ difference + 1e-10 * scipy.sparse.identity(count)).tocsr()
    solver = pyamg.ruge_stuben_solver(system) if count > 500 else None
    target = weighted @ slope
    if solver is None:
        solution = scipy.sparse.linalg.spsolve(system.tocsc(), target).reshape(count)
    else:
        solution = solver.solve(target, tol=1e-8, accel="cg", maxiter=200)
    result = np.zeros(inside.shape)
    result[inside] = solution
    labels, regions = scipy.ndimage.label(inside)
    means = scipy.ndimage.mean(result, labels, np.arange(1, regions + 1))
    result[inside] -= np.asarray(means)[labels[inside] - 1]
    return result
