"""Depth from normals by weighted least squares, with weights that leave depth discontinuities open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.checks import UNIT_TOLERANCE, check_floating, check_mask
from ..core.errors import RangeError, ShapeError
from ..core.optional import require
from ..core.progress import track
from .camera import Camera

Floats: TypeAlias = npt.NDArray[np.float64]
Bools: TypeAlias = npt.NDArray[np.bool_]
Indices: TypeAlias = npt.NDArray[np.int32]

MIN_FACING = 0.02
"""Smallest cosine between normal and view, below which the slope is clamped: 88.9 degrees, set by hand."""
MAX_FACING_AWAY = 0.2
"""Share of the normals inside the mask that may face away from the camera, by noise or at the rim; set by hand."""
SHARPNESS = (0.02, 8.0)
"""First and last slope of the logistic function by which a pixel prefers the flatter of its two sides, per squared
slope of the surface.

The last value has the smallest error on renders of five meshes (``scripts/benchmarks/evaluate_integration.py``,
``by_sharpness``); the first is set by hand. The growth must be slow, since a depth discontinuity appears only once the
surfaces on both sides have separated.
"""
STEPS, LAST_STEPS = 15, 3
"""Number of least-squares solutions, and how many of them use the last sharpness; set by hand."""
TOLERANCE = 1e-4
"""Residual relative to the right-hand side at which conjugate gradients stop; set by hand."""
LARGE = 500_000
"""Number of pixels above which a solution at half the size is the initial value; set by hand."""
MAX_STEPS = 100
"""Steps of conjugate gradients after which a system counts as solved; set by hand."""
MOST_STEPS = 5
"""Steps of conjugate gradients after which the next system gets a multigrid hierarchy of its own. Set by hand: with a
larger number early systems gain nothing and late ones, whose weights change more, need up to 100 steps."""
SMALL = 500
"""Number of pixels up to which a direct solver is used instead of conjugate gradients; set by hand."""
LEAST_TRUST = 1e-9
"""Weight of the edges at a discontinuity: it decides the offset between two surfaces where no other edge does."""


@torch.no_grad()
def integrate_normals(normal: Tensor, mask: Tensor | None = None, *, camera: Camera | None = None) -> Tensor:
    """Integrate normals to depth; depth discontinuities are detected and left open.

    Between neighbouring pixels the surface follows the chord of a circle: it is perpendicular to the sum of both
    normals, in perspective views too. In rows and in columns each pixel gives more weight to the flatter of its two
    sides; an edge has a small weight unless both of its pixels trust it. Weights and depth are computed in turn, with
    weights that become more selective. Not differentiable.

    Args:
        normal: (3, H, W) unit normals in the camera frame.
        mask: (1, H, W) bool; default: where the normal is not zero.
        camera: None for orthographic views in pixels; a `Camera` otherwise.

    Returns:
        (1, H, W), 0 outside the mask. Without a camera: height toward the viewer in pixels, mean 0 over
        every connected region. With a perspective camera: positive distance along the optical axis,
        geometric mean 1 over every connected region. With an orthographic one: distance along the axis in
        its units, mean 0 over every connected region. The offset between a surface and another one that hides
        where the two meet is not determined by the normals.

    Raises:
        ShapeError: shapes other than these.
        RangeError: NaN inside the mask, normals that mostly face away, or colours that were not decoded.
        CaptureError: an empty mask.

    Source:
        Weights of the flatter side: Cao, Santo, Shi, Okura & Matsushita 2022, "Bilateral normal integration". The
        chords, the weight of the less trusting pixel, and the slow growth of sharpness are specific to this package.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> tilted = torch.tensor([-0.6, 0.0, 0.8]).reshape(3, 1, 1).expand(3, 1, 3)
        >>> [round(v, 2) + 0 for v in ton.integrate_normals(tilted).flatten().tolist()]
        [-0.75, 0.0, 0.75]
    """
    inside = _check(normal, mask, camera)
    size = (inside.shape[0], inside.shape[1])
    n = F.normalize(normal.detach().cpu().double(), dim=0)
    perspective = camera is not None and camera.is_perspective
    right, down = (1.0, 1.0) if camera is None else (2 / (size[0] * camera.focal[0].double())).tolist()
    rays = camera.rays(size)[0].double().cpu().numpy() if camera is not None and perspective else None
    field = _Field(n.numpy(), rays, inside.cpu().numpy(), (right, down))
    depth = torch.from_numpy(_centre(_integrate(field), field.inside)).to(normal)[None]
    if camera is not None:
        depth = (-depth).exp() if perspective else -depth
    return torch.where(inside[None], depth, 0)


@dataclass(frozen=True)
class _Field:
    """Normals on a grid of pixels.

    Attributes:
        normal: (3, H, W) in the camera frame.
        rays: (3, H, W) points on the lines of sight at depth 1, z = -1; None for an orthographic view.
        inside: (H, W) bool.
        step: distance between pixels, to the right and down: in pixels or world units, at depth 1 in perspective.
    """

    normal: Floats
    rays: Floats | None
    inside: Bools
    step: tuple[float, float]

    def halved(self) -> _Field:
        """The field at half the size: the mean of every 2 x 2 pixels."""
        inside = _pool(self.inside[None].astype(float))[0]
        share = np.maximum(inside, 1e-12)
        normal = _pool(self.normal * self.inside) / share
        normal /= np.maximum(np.linalg.norm(normal, axis=0), 1e-12)
        rays = None if self.rays is None else _pool(self.rays) / _pool(np.ones_like(self.rays))
        return _Field(normal, rays, inside > 0, (2 * self.step[0], 2 * self.step[1]))


def _pool(values: Floats) -> Floats:
    """Sums of 2 x 2 pixels, (C, H, W); odd sizes are padded with 0."""
    height, width = values.shape[1:]
    padded = np.pad(values, ((0, 0), (0, height % 2), (0, width % 2)))
    return padded[:, ::2, ::2] + padded[:, 1::2, ::2] + padded[:, ::2, 1::2] + padded[:, 1::2, 1::2]


@dataclass(frozen=True)
class _Pairs:
    """Neighbouring pixels in rows or in columns.

    Attributes:
        first: (E,) index of the left or upper pixel among those inside.
        second: (E,) index of the other pixel.
        rise: (E,) increase of the height from first to second if the surface is continuous; of -log(depth) in
            perspective.
        scale: (2, E) factors that convert a rise to a slope per pixel, as seen from either pixel: small where the
            surface is steep.
    """

    first: Indices
    second: Indices
    rise: Floats
    scale: Floats

    @staticmethod
    def of(field: _Field, axis: int) -> _Pairs:
        """Pairs of a pixel and its right (axis 0) or lower neighbour (axis 1)."""
        here, there = (np.s_[:, :-1], np.s_[:, 1:]) if axis == 0 else (np.s_[:-1, :], np.s_[1:, :])
        inside, step = field.inside, field.step[axis]
        both = inside[here] & inside[there]
        index = np.full(inside.shape, -1, np.int32)
        index[inside] = np.arange(int(inside.sum()), dtype=np.int32)
        first, second = index[here][both], index[there][both]
        normal = field.normal[:, inside]
        one, other = normal[:, first], normal[:, second]
        total = one + other  # perpendicular to the chord
        if field.rays is None:
            across = total[0] if axis == 0 else -total[1]
            rise = -across / np.maximum(total[2], 2 * MIN_FACING) * step
            facing = np.stack((one[2], other[2]))
        else:
            rays = field.rays[:, inside]
            near, far = rays[:, first], rays[:, second]
            facing = -np.stack(((one * near).sum(0), (other * far).sum(0)))
            before, behind = (np.maximum(-(total * r).sum(0), 2 * MIN_FACING) for r in (near, far))
            rise = np.log(behind / before)
        scale = np.maximum(facing, MIN_FACING) / step
        return _Pairs(first, second, rise, scale)

    def trust(self, height: Floats, sharpness: float) -> Floats:
        """Weights of the pairs, (E,) in (0, 1/2]: the trust of the less trusting pixel in a continuous surface."""
        rise = height[self.second] - height[self.first]
        forward, backward = np.zeros_like(height), np.zeros_like(height)
        forward[self.first] = (self.scale[0] * rise) ** 2
        backward[self.second] = (self.scale[1] * rise) ** 2
        steeper = np.clip(sharpness * (forward - backward), -50, 50)  # exp stays in range
        ahead = 1 / (1 + np.exp(steeper))
        return np.maximum(np.minimum(ahead[self.first], 1 - ahead[self.second]), LEAST_TRUST)


def _integrate(field: _Field) -> Floats:
    """Heights of the pixels inside, (P,), from alternating weights and solutions."""
    count = int(field.inside.sum())
    pairs = [_Pairs.of(field, axis) for axis in (0, 1)]
    growth = np.geomspace(*SHARPNESS, STEPS - LAST_STEPS + 1).tolist()
    # The first solution has equal weights: plain least squares.
    sharpness = [0.0, *growth, *[SHARPNESS[1]] * (LAST_STEPS - 2)][:STEPS]
    height = np.zeros(count)
    if count > LARGE:
        coarse = field.halved()
        height = _doubled(_integrate(coarse), coarse.inside, field.inside.shape)[field.inside]
        sharpness = [SHARPNESS[1]] * LAST_STEPS
    solver = _Solver(pairs, count)
    for value in track(sharpness, "integrating", len(sharpness)):
        before, height = height, solver.solve(np.concatenate([p.trust(height, value) for p in pairs]), height)
        if value == SHARPNESS[1] and np.array_equal(before, height):
            break  # the next weights are the same again
    return height


def _doubled(height: Floats, inside: Bools, size: tuple[int, ...]) -> Floats:
    """Heights (P,) of the pixels ``inside``, linearly interpolated to twice their rows and columns, cut to ``size``."""
    canvas = torch.zeros(2, *inside.shape, dtype=torch.float64)
    canvas[0][torch.from_numpy(inside)] = torch.from_numpy(height)
    canvas[1] = torch.from_numpy(inside)
    known, share = F.interpolate(canvas[None], scale_factor=2, mode="bilinear")[0, :, : size[0], : size[1]]
    return np.asarray((known / share.clamp_min(1e-12)).numpy())


class _Solver:
    """Weighted least squares over pairs of pixels by conjugate gradients with algebraic multigrid.

    From one set of weights to the next the multigrid hierarchy is kept while it does its work.
    """

    def __init__(self, pairs: Sequence[_Pairs], count: int) -> None:
        require("pyamg", "scipy")  # both are named at once where both are missing
        import scipy.sparse

        self.count = count
        self.first, self.second = (np.concatenate([getattr(p, name) for p in pairs]) for name in ("first", "second"))
        self.squares = np.concatenate([(p.scale**2).sum(0) for p in pairs])
        self.rise = np.concatenate([p.rise for p in pairs])
        own = np.arange(count, dtype=np.int32)
        rows, columns = (
            np.concatenate((*ends, own)) for ends in ((self.first, self.second), (self.second, self.first))
        )
        entries = np.arange(len(rows), dtype=np.int32)
        self.pattern = scipy.sparse.csr_matrix((entries, (rows, columns)), shape=(count, count))
        self.preconditioner: Any = None
        self.steps = 0

    def solve(self, trust: Floats, start: Floats) -> Floats:
        """Heights (P,) for the trust (E,) in the pairs."""
        require("pyamg", "scipy")
        import pyamg
        import scipy.sparse.linalg

        first, second, count = self.first, self.second, self.count
        weight = trust * self.squares
        diagonal = np.bincount(first, weight, count) + np.bincount(second, weight, count)
        # The ridge makes the system regular although every region has a free constant; the means are set later.
        ridge = 1e-9 * max(float(diagonal.mean()), 1e-12)
        values = np.concatenate((-weight, -weight, diagonal + ridge))[self.pattern.data]
        system = scipy.sparse.csr_matrix((values, self.pattern.indices, self.pattern.indptr), (count, count))
        weight *= self.rise
        target = np.asarray(np.bincount(second, weight, count) - np.bincount(first, weight, count), np.float64)
        if count <= SMALL:
            return np.asarray(scipy.sparse.linalg.spsolve(system.tocsc(), target)).reshape(count)
        if self.preconditioner is None or self.steps > MOST_STEPS:
            self.preconditioner = None  # frees the memory of the one before
            self.preconditioner = pyamg.ruge_stuben_solver(
                system, max_coarse=50, coarse_solver="splu"
            ).aspreconditioner()
        return self._conjugate_gradients(system, target, start)

    def _conjugate_gradients(self, system: Any, target: Floats, start: Floats) -> Floats:
        """Solve one system; SciPy's function waits for BLAS's threads at every product, seconds on a busy machine."""
        solution: Floats = start.copy()
        residual = target - system @ start
        goal, direction, last = TOLERANCE**2 * _product(target, target), np.zeros(self.count), 1.0
        for self.steps in range(MAX_STEPS):
            if _product(residual, residual) <= goal:
                break
            improved = self.preconditioner @ residual
            size = _product(residual, improved)
            direction = improved + (size / last) * direction
            moved = system @ direction
            length = size / _product(direction, moved)
            solution += length * direction
            residual -= length * moved
            last = size
        return solution


def _product(a: Floats, b: Floats) -> float:
    return float(np.einsum("i,i", a, b))


def _centre(height: Floats, inside: Bools) -> Floats:
    """Heights (P,) on the grid (H, W), the mean of every connected region 0."""
    require("scipy")
    import scipy.ndimage

    canvas = np.zeros(inside.shape)
    canvas[inside] = height
    labels, regions = scipy.ndimage.label(inside)
    means = np.asarray(scipy.ndimage.mean(canvas, labels, np.arange(1, regions + 1)))
    canvas[inside] -= means[labels[inside] - 1]
    return canvas


def _check(normal: Tensor, mask: Tensor | None, camera: Camera | None) -> Tensor:
    """The mask (H, W) bool of normals that can be integrated."""
    check_floating(normal=normal)
    if normal.ndim != 3 or normal.shape[0] != 3:
        raise ShapeError("normal", expected="(3, H, W)", got=str(tuple(normal.shape)), mend="integrate one at a time")
    inside = check_mask((normal != 0).any(0, keepdim=True) if mask is None else mask, normal)[0]
    seen = normal[:, inside]
    if not bool(seen.isfinite().all()):
        raise RangeError(
            "normal", expected="finite values inside the mask", got="NaN or infinity", mend="take them out of the mask"
        )
    if bool((seen >= 0).all()) and bool(((seen.norm(dim=0) - 1).abs() > UNIT_TOLERANCE).double().mean() > 0.5):
        raise RangeError("normal", expected="unit vectors", got="colours from 0 to 1", mend="use decode_normals")
    size = (normal.shape[1], normal.shape[2])
    view = camera.view_directions(size)[0].to(normal)[:, inside] if camera is not None else None
    toward = seen[2] if view is None or not camera or not camera.is_perspective else (seen * view).sum(0)
    away = float((toward < 0).double().mean())
    if away > MAX_FACING_AWAY:
        raise RangeError(
            "normal",
            expected="normals toward the camera (x right, y up, z toward the viewer)",
            got=f"{100 * away:.0f} % of them facing away",
            mend="use swap_opencv_frame for OpenCV's frame (y down, z forward), turn world-space normals into the "
            "camera's frame, and compute z where a map stores two channels",
        )
    return inside
