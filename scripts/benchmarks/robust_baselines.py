"""Published methods of photometric stereo for Lambertian surfaces with outliers, written from their papers.

Each takes observations (P, K) and unit lights (K, 3) and returns albedo times normal, (P, 3). They are here to be
measured beside this package's solvers, not to be used.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

Solver = Callable[[Tensor, Tensor], Tensor]


def weighted(grey: Tensor, lights: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """Weighted least squares, and the inverse of its normal matrix (P, 3, 3)."""
    outer = (lights[:, :, None] * lights[:, None, :]).reshape(-1, 9)
    inverse = torch.linalg.inv((weight @ outer).reshape(-1, 3, 3) + 1e-9 * torch.eye(3).to(grey))
    return (inverse @ ((weight * grey) @ lights)[:, :, None])[:, :, 0], inverse


def trimmed(grey: Tensor, lights: Tensor) -> Tensor:
    """Least squares on each pixel's observations from the 20th to the 80th percentile."""
    count = grey.shape[1]
    order = grey.argsort(1)[:, round(0.2 * count) : round(0.8 * count)]
    return weighted(grey, lights, torch.zeros_like(grey).scatter_(1, order, 1.0))[0]


def least_absolute(grey: Tensor, lights: Tensor, steps: int = 40) -> Tensor:
    """L1 residual minimisation by iteratively reweighted least squares."""
    unit = grey.mean(1, keepdim=True).clamp_min(1e-6)
    seen = grey / unit
    solution = weighted(seen, lights, torch.ones_like(seen))[0]
    for _ in range(steps):
        residual = (seen - solution @ lights.T).abs()
        solution = weighted(seen, lights, 1 / residual.clamp_min(1e-4))[0]
    return solution * unit


def sparse_bayesian(grey: Tensor, lights: Tensor, steps: int = 100, noise: float = 1e-3) -> Tensor:
    """Sparse Bayesian regression (Ikehata, Wipf, Matsushita & Aizawa 2012), by expectation maximisation."""
    unit = grey.mean(1, keepdim=True).clamp_min(1e-6)
    seen = grey / unit
    variance = torch.ones_like(seen)
    solution = torch.zeros(len(grey), 3).to(grey)
    for _ in range(steps):
        solution, covariance = weighted(seen, lights, 1 / (variance + noise))
        share = variance / (variance + noise)
        outlier = share * (seen - solution @ lights.T)
        spread = ((lights @ covariance) * lights).sum(2)
        variance = outlier.square() + share * noise + share.square() * spread
    return solution * unit


def low_rank(grey: Tensor, lights: Tensor, steps: int = 100) -> Tensor:
    """Robust principal components by the inexact augmented Lagrangian (Lin, Chen & Ma 2010), then least squares.

    As photometric stereo: Wu, Ganesh, Shi, Matsushita, Wang & Ma 2010. The matrix is pixels by lights.
    """
    matrix = grey.double()
    sparse_weight = 1 / matrix.shape[0] ** 0.5
    norm = torch.linalg.matrix_norm(matrix, 2)
    dual = matrix / torch.maximum(norm, matrix.abs().max() / sparse_weight)
    sparse, step, scale = torch.zeros_like(matrix), 1.25 / norm, torch.linalg.matrix_norm(matrix)
    rank = torch.zeros_like(matrix)
    for _ in range(steps):
        u, s, v = torch.linalg.svd(matrix - sparse + dual / step, full_matrices=False)
        rank = (u * (s - 1 / step).clamp_min(0)) @ v
        left = matrix - rank + dual / step
        sparse = left.sign() * (left.abs() - sparse_weight / step).clamp_min(0)
        missed = matrix - rank - sparse
        dual, step = dual + step * missed, step * 1.5
        if torch.linalg.matrix_norm(missed) < 1e-7 * scale:
            break
    return weighted(rank, lights.double(), torch.ones_like(matrix))[0].to(grey)


SOLVERS: dict[str, Solver] = {
    "trimmed": trimmed,
    "L1": least_absolute,
    "SBL": sparse_bayesian,
    "RPCA": low_rank,
}
"""The methods by the name that tables print."""
