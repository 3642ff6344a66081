"""Gauss-Newton steps under Geman-McClure weights for normal, albedo and highlights of pixels, all pixels at once.

Observations are (P, K) over the pixel's mean: P pixels, K lights. `compiled_fit` is the same for processors.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from .linear_systems import camera_facing, solve_symmetric, tangent_vectors
from .material import LightDirections, Material, Response, cosines, respond
from .robust_stats import NOISE_FLOOR, geman_mcclure, median_rank, noise_level

DAMPING = 1e-3
"""Of Gauss-Newton steps, as a share of the diagonal (Levenberg-Marquardt); set by hand."""
MAX_TILT = 0.25
"""Radians by which a normal may tilt in a step; set by hand."""
LOBE_RIDGE = 0.02
"""Weight of the prior that lobes have no strength, in squared observations over their mean: without a highlight in
sight their strengths are not determined. Set by hand."""
NEIGHBOUR_WEIGHT = 440.0
"""Weight of the neighbours' normal per variance of the residuals, 10 / 0.15**2: as if neighbours differed by 0.15 rad,
and ten observations were worth one, because a model that does not fit errs the same way under many lights. Set by
hand."""


class Estimate(NamedTuple):
    """Unknowns of P pixels, over their mean.

    Attributes:
        normal: (P, 3) unit.
        albedo: (P, 1).
        lobes: (P, L).
    """

    normal: Tensor
    albedo: Tensor
    lobes: Tensor


class Quality(NamedTuple):
    """How well the unknowns of P pixels explain their observations, over their mean.

    Attributes:
        noise: (P, 1) robust standard deviation of the residuals.
        residual: (P, 1) mean absolute difference over all lights.
        spread: (P, 1) standard error of the normal in radians if residuals were independent.
    """

    noise: Tensor
    residual: Tensor
    spread: Tensor


def gauss_newton(
    seen: Tensor,
    selected: Tensor,
    mean: Tensor,
    directions: LightDirections,
    material: Material,
    start: Estimate,
    steps: int,
    prior: Tensor | None,
) -> tuple[Estimate, Quality]:
    """Improve the unknowns of every pixel: two tangent angles, albedo and the strengths of lobes.

    Args:
        seen: (P, K) observations over ``mean``.
        selected: (P, K) 1 for those that count, else 0.
        mean: (P, 1).
        directions: to the lights.
        material: what all pixels share.
        start: unknowns to begin with.
        steps: at least one.
        prior: (P, 3) mean normals of the neighbourhood, or None.
    """
    (normal, albedo, lobes), count = start, len(material.exponents)
    rank = median_rank(selected)
    jacobian = seen.new_empty(len(seen), 4 + count, len(directions))
    curvature: list[list[Tensor]] = []
    for _ in range(steps):
        response = respond(material, normal, albedo, lobes, directions, mean)
        residual = seen - response.value
        noise = noise_level(residual, selected, rank)
        tangents = tangent_vectors(normal)
        fill_jacobian(jacobian, response, tangents, directions)
        jacobian[:, -1] = residual
        matrix, right = _normal_equations(jacobian, geman_mcclure(selected, residual, noise))
        curvature = [row[:] for row in matrix]
        for axis, row in enumerate(matrix):
            row[axis] = row[axis] * (1 + DAMPING) + 1e-9 * len(directions)
        if prior is not None:
            # Pixels at the noise floor fit perfectly and need no neighbours.
            weight = NEIGHBOUR_WEIGHT * (noise[:, 0].square() - NOISE_FLOOR**2)
            for axis, tangent in enumerate(tangents):
                matrix[axis][axis] = matrix[axis][axis] + weight
                right[axis] = right[axis] + weight * ((prior - normal) * tangent).sum(1)
        for axis in range(3, 3 + count):
            matrix[axis][axis] = matrix[axis][axis] + LOBE_RIDGE
            right[axis] = right[axis] - LOBE_RIDGE * lobes[:, axis - 3]
        step = _nonnegative_step(matrix, right, lobes)
        normal = tilted(normal, tangents, torch.stack(step[:2], 1))
        albedo = (albedo + step[2][:, None]).clamp_min(1e-6)
        if count:
            lobes = (lobes + torch.stack(step[3:], 1)).clamp_min(0)
    residual = seen - respond(material, normal, albedo, lobes, directions, mean).value
    noise = noise_level(residual, selected, rank)
    residual = residual.abs().mean(1, keepdim=True)
    return Estimate(normal, albedo, lobes), Quality(noise, residual, noise * _unit_spread(curvature))


def fill_jacobian(
    jacobian: Tensor, response: Response, tangents: tuple[Tensor, Tensor], directions: LightDirections
) -> None:
    """Write derivatives by two tangent angles, albedo and lobes into the first rows of (P, N, K)."""
    for axis, tangent in enumerate(tangents):
        column = cosines(tangent, directions.light) * response.by_light
        if response.by_view is not None:
            column += response.by_view * tangent[:, 2:]
        if response.by_half is not None:
            column += response.by_half * cosines(tangent, directions.half)
        jacobian[:, axis] = column
    for axis, column in enumerate(response.columns):
        jacobian[:, 2 + axis] = column


def _normal_equations(jacobian: Tensor, weight: Tensor) -> tuple[list[list[Tensor]], list[Tensor]]:
    """Matrix and right side, entries (P,), from N derivatives and the residual in the last row of (P, N + 1, K)."""
    size = jacobian.shape[1] - 1
    products = torch.bmm(jacobian[:, :size] * weight[:, None], jacobian.mT).permute(1, 2, 0)
    matrix = [list(row.unbind(0)) for row in products[:, :size].contiguous()]
    return matrix, list(products[:, size].contiguous().unbind(0))


def _nonnegative_step(matrix: list[list[Tensor]], right: list[Tensor], lobes: Tensor) -> list[Tensor]:
    """The step; lobes that it would take below 0 stop there and the rest is solved again."""
    step = solve_symmetric(matrix, right)
    for axis in range(lobes.shape[1]):
        at = 3 + axis
        below = (lobes[:, axis] + step[at] < 0).to(lobes)
        penalty = 1e4 * matrix[at][at] * below
        right[at] = right[at] * (1 - below) - penalty * lobes[:, axis]
        matrix[at][at] = matrix[at][at] + penalty
    return solve_symmetric(matrix, right) if lobes.shape[1] else step


def tilted(normal: Tensor, tangents: tuple[Tensor, Tensor], angles: Tensor) -> Tensor:
    """Normals tilted by two tangent angles (P, 2), at most by `MAX_TILT`."""
    angles = angles * (MAX_TILT / angles.norm(dim=1, keepdim=True).clamp_min(MAX_TILT))
    return camera_facing(normal + tangents[0] * angles[:, :1] + tangents[1] * angles[:, 1:])


def _unit_spread(matrix: Sequence[Sequence[Tensor]]) -> Tensor:
    """Square root of the summed variances of both tangent angles for residuals of variance 1, (P, 1)."""
    trace = torch.zeros_like(matrix[0][0])
    for axis in (0, 1):
        basis = [torch.full_like(trace, float(i == axis)) for i in range(len(matrix))]
        trace = trace + solve_symmetric(matrix, basis)[axis]
    return torch.where(trace > 0, trace, torch.inf).sqrt()[:, None]
