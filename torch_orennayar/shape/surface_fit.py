"""Fit a height field to one shaded picture by L-BFGS, from coarse to fine, through the shading layer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from ..core.progress import track
from ..core.threads import one_thread
from ..geometry.height_field import normals, resize
from .objective import FitParameters, FitSettings, Objective
from .scene import PictureScene

# All of these were set by hand; `scripts/benchmarks/evaluate_shape_from_shading.py` measures what they give.
COARSEST_SIDE = 24
"""Pixels; a level is halved while its shorter side stays at least as long as this."""
STEPS = 100
"""L-BFGS iterations per level; the script above charts accuracy and time against it, from 10 to 250."""
HISTORY = 10
"""Updates that L-BFGS keeps."""
TOLERANCE_CHANGE, TOLERANCE_GRADIENT = 1e-7, 1e-6
"""L-BFGS stops below this change of cost or parameters, or this largest gradient."""
SCALES = 6
"""Resolutions, each half of the one before, at which a level's step is sought at once; by Barron & Malik 2015. On
heights of full resolution alone L-BFGS would take thousands of iterations."""
SCALE_GAIN = 1.4
"""Factor by which the step of a scale outweighs that of the next finer one."""
ONE_THREAD_PIXELS = 50_000
"""Pixels below which a fit uses one thread: a second one gains a tenth, as timed on 2 cores, and costs a factor of 30
where another process keeps the cores busy."""
UNEXPLAINED = 0.03
"""Share of the picture's peak that the residual must exceed the noise by for half the weight of the silhouette's
normals: where the reflectance explains the picture, they are not used."""
MIN_SILHOUETTE_WEIGHT = 0.003
"""Weight of the silhouette's normals up to which a level is not solved again with them."""


class LevelFit(NamedTuple):
    """The fit at one resolution.

    Attributes:
        parameters: of least cost.
        cost: mean over the mask.
        unexplained: mean robust squared residual beyond the picture's noise, in units of its peak squared.
    """

    parameters: FitParameters
    cost: float
    unexplained: float


def coarse_to_fine(scene: PictureScene) -> list[PictureScene]:
    """The scene at every resolution, the coarsest first."""
    levels = [scene]
    while min(levels[-1].mask.shape[1:]) >= 2 * COARSEST_SIDE:
        levels.append(levels[-1].halved())
    return levels[::-1]


def fit(
    levels: Sequence[PictureScene],
    start: FitParameters,
    settings: FitSettings,
    *,
    progress: str = "",
    max_cost: float = math.inf,
) -> tuple[FitParameters, float]:
    """Fit one level after the other, each from the result of the one before.

    At the last level but one, which is fine enough to show whether the reflectance explains the picture, the normals
    of the inflated silhouette get the weight ``settings.silhouette * u**2 / (u**2 + UNEXPLAINED**4)`` with ``u`` the
    unexplained variance.

    Args:
        levels: from coarse to fine.
        start: parameters of any resolution.
        settings: model and weights.
        progress: caption of a progress bar, or none.
        max_cost: a fit without the silhouette's normals that costs more is not repeated with them: it could only cost
            more.

    Returns:
        The parameters at the last level and their mean cost.
    """
    parameters, cost, silhouette_weight = start, math.nan, 0.0
    for k, level in enumerate(track(levels, progress) if progress else levels):
        scale = level.mask.shape[1] / (parameters.height.shape[1] - 1)
        parameters = replace(parameters, height=resize(parameters.height, level.corner_size) * scale)
        parameters, cost, unexplained = _fit_level(level, parameters, settings, silhouette_weight)
        if level.silhouette_normal is not None and k == max(len(levels) - 2, 0):
            silhouette_weight = settings.silhouette * unexplained**2 / (unexplained**2 + UNEXPLAINED**4)
            if silhouette_weight > MIN_SILHOUETTE_WEIGHT and cost < max_cost:
                parameters, cost, _ = _fit_level(level, parameters, settings, silhouette_weight)
    return parameters, cost


def _fit_level(scene: PictureScene, start: FitParameters, settings: FitSettings, silhouette_weight: float) -> LevelFit:
    """Minimise the cost at one resolution."""
    with torch.enable_grad():
        objective = Objective.of(scene, start, settings)
        steps = [start.height.new_zeros(1, *size).requires_grad_() for size in _scale_sizes(scene.corner_size)]
        albedo = start.albedo.clone().requires_grad_(settings.estimate_albedo)
        roughness = start.roughness.clone().requires_grad_(settings.estimate_roughness)
        ambient = start.ambient.clone().requires_grad_(settings.estimate_ambient)
        optimiser = torch.optim.LBFGS(
            [*steps, *(p for p in (albedo, roughness, ambient) if p.requires_grad)],
            max_iter=STEPS,
            history_size=HISTORY,
            line_search_fn="strong_wolfe",
            tolerance_change=TOLERANCE_CHANGE,
            tolerance_grad=TOLERANCE_GRADIENT,
        )

        def current() -> FitParameters:
            height = start.height
            for k, step in enumerate(steps):
                height = height + SCALE_GAIN**k * (step if k == 0 else resize(step, scene.corner_size))
            return FitParameters(height, albedo, roughness, ambient)

        def closure() -> Tensor:
            optimiser.zero_grad()
            cost = objective.cost(current(), silhouette_weight)
            cost.backward()
            return cost

        with one_thread() if scene.mask.numel() < ONE_THREAD_PIXELS else nullcontext():
            optimiser.step(closure)
    found = current()
    found = FitParameters(*(p.detach() for p in (found.height, found.albedo, found.roughness, found.ambient)))
    pixels = scene.mask.sum().clamp_min(1)
    residual = objective.residual(found, normals(found.height, scene.corner_rays, scene.pixel_angle))
    return LevelFit(
        found,
        cost=float(objective.cost(found, silhouette_weight) / pixels),
        unexplained=max(float(residual.sum() / pixels) - scene.noise_variance, 0.0),
    )


def _scale_sizes(size: tuple[int, int]) -> list[tuple[int, int]]:
    """Sizes of the corner grids of all scales, the finest first."""
    sizes = [size]
    for _ in range(SCALES - 1):
        sizes.append(((sizes[-1][0] + 1) // 2, (sizes[-1][1] + 1) // 2))
    return sizes
