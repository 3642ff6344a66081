"""Small linear systems, one per pixel, entry by entry: the same operations in torch and in an ONNX graph."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

MIN_NORMAL_Z = 0.02
"""Least cosine between a normal and the view before it is normalised again: pixels that are seen face the camera. Set
by hand."""
LEAST_PIVOT = 1e-7
"""Share of its diagonal entry below which a pivot counts as 0: about the rounding of float32."""


def solve_symmetric(matrix: Sequence[Sequence[Tensor]], right: Sequence[Tensor]) -> list[Tensor]:
    """Solve symmetric positive N x N systems by elimination.

    Args:
        matrix: N rows of N entries, (P,) each; the upper triangle is read.
        right: N entries, (P,) each.

    Returns:
        N unknowns, (P,) each; those without a pivot are 0.
    """
    size = len(right)
    rows, target = [list(row) for row in matrix], list(right)
    inverse = []
    for i in range(size):
        pivot = rows[i][i]
        sound = (pivot > LEAST_PIVOT * matrix[i][i]).to(pivot)
        inverse.append(sound / (pivot * sound + (1 - sound)))
        for j in range(i + 1, size):
            factor = rows[i][j] * inverse[i]
            for k in range(j, size):
                rows[j][k] = torch.addcmul(rows[j][k], factor, rows[i][k], value=-1)
            target[j] = torch.addcmul(target[j], factor, target[i], value=-1)
    solution: list[Tensor] = [right[0]] * size
    for i in reversed(range(size)):
        total = target[i]
        for k in range(i + 1, size):
            total = torch.addcmul(total, rows[i][k], solution[k], value=-1)
        solution[i] = total * inverse[i]
    return solution


def weighted_lambert(grey: Tensor, light: Tensor, weight: Tensor) -> Tensor:
    """Weighted Lambertian least squares: albedo times normal, (P, 3).

    `closed_form` and `set_network` solve such systems too, with other regularisations and in another order of
    operations: their figures, and graphs, depend on those to the last digit, so that there are three functions.

    Args:
        grey: (P, K).
        light: (K, 3) or (P, K, 3), unit.
        weight: (P, K).
    """
    # Sums row by row: a product of matrices rounds differently with the pixels that are solved together.
    axes = light.unbind(-1)
    matrix = [[(weight * (a * b)).sum(1) for b in axes] for a in axes]
    ridge = 1e-6 * (matrix[0][0] + matrix[1][1] + matrix[2][2])
    rows = [[matrix[i][j] + ridge if i == j else matrix[i][j] for j in range(3)] for i in range(3)]
    return torch.stack(solve_symmetric(rows, [(weight * grey * axis).sum(1) for axis in axes]), 1)


def camera_facing(vector: Tensor) -> Tensor:
    """Unit vectors along (P, 3), tilted where needed so that they face the camera; (0, 0, 1) for a zero vector."""
    unit = F.normalize(vector, dim=1, eps=torch.finfo(vector.dtype).tiny)
    return F.normalize(torch.cat((unit[:, :2], unit[:, 2:].clamp_min(MIN_NORMAL_Z)), 1), dim=1)


def tangent_vectors(normal: Tensor) -> tuple[Tensor, Tensor]:
    """Two unit tangents of every normal, (P, 3) each."""
    x, _, z = normal.unbind(1)
    first = F.normalize(torch.stack((z, torch.zeros_like(z), -x), 1), dim=1)
    return first, torch.linalg.cross(normal, first)
