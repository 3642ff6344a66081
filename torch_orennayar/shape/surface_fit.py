"""Fit a height field to one shaded picture by L-BFGS, from coarse to fine, through the shading layer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.progress import track
from ..core.threads import one_thread
from ..geometry.height_field import normals, resize
from .objective import FitParameters, FitSettings, Objective
from .scene import PictureScene, Prior

# All of these were set by hand; `scripts/benchmarks/evaluate_shape_from_shading.py` measures what they give.
COARSEST_SIDE = 24
"""Pixels; a level is halved while its shorter side stays at least as long as this."""
STEPS = 100
"""L-BFGS iterations per level; the script above charts accuracy and time against it, from 10 to 250."""
PAINTED_STEPS = 50
"""The same where a learned prior outweighs a picture of unknown albedo: half the time for .2 degrees on 4 renders."""
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
MIN_PRIOR_WEIGHT = 0.003
"""Weight of the normals to expect up to which a level is not solved again with them."""
START_WEIGHT = 10.0
"""Weight of the normals to expect where the search starts: nothing else counts much."""
PRIOR_GAIN = 8.0
"""Weight of a learned prior over the ratio of variances, at the default of ``silhouette``."""
BRIGHTNESS_SLOPE = 0.5
"""Shares of the picture's peak by which a radian changes the brightness, about."""
PAINT = 0.01
"""Variance of brightness, in units of the picture's peak squared, by paint that one albedo for all does not show."""
MIN_ERROR = 0.03
"""Radians; a learned prior is taken for no better than this."""


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
    to expect get their weight: see `_prior_weight`.

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
    parameters, cost, prior_weight = start, math.nan, None
    for k, level in enumerate(track(levels, progress) if progress else levels):
        scale = level.mask.shape[1] / (parameters.height.shape[1] - 1)
        parameters = replace(parameters, height=resize(parameters.height, level.corner_size) * scale)
        if prior_weight is not None:
            prior_weight = F.interpolate(prior_weight[None], size=level.mask.shape[1:], mode="nearest")[0]
        found = _fit_level(level, parameters, settings, prior_weight)
        if level.prior is not None and k == max(len(levels) - 2, 0):
            prior_weight = _prior_weight(level, level.prior, found, settings)
            if float(prior_weight.max()) > MIN_PRIOR_WEIGHT and found.cost < max_cost:
                found = _fit_level(level, found.parameters, settings, prior_weight)
        parameters, cost = found.parameters, found.cost
    return parameters, cost


def follow_prior(scene: PictureScene, start: FitParameters, settings: FitSettings) -> FitParameters:
    """Parameters whose normals are near those to expect, to start from."""
    scale = scene.mask.shape[1] / (start.height.shape[1] - 1)
    start = replace(start, height=resize(start.height, scene.corner_size) * scale)
    return _fit_level(scene, start, settings, scene.mask.new_full((1, 1, 1), START_WEIGHT)).parameters


def _prior_weight(scene: PictureScene, prior: Prior, found: LevelFit, settings: FitSettings) -> Tensor:
    """Weight (1, H, W) or (1, 1, 1) of the normals to expect, by what the picture alone has found.

    Of the inflated silhouette ``silhouette * g`` with ``g = u**2 / (u**2 + UNEXPLAINED**4)`` and ``u`` the unexplained
    variance. Of normals that state their error ``s``: where the surface differs from them by more than ``s``, the
    reflectance is wrong, and by how much the surface errs is what is left of the difference. The weight is the ratio of
    both variances, in units of brightness, times ``g``; where the albedo is estimated `PAINT` is added.
    """
    unexplained = found.unexplained**2 / (found.unexplained**2 + UNEXPLAINED**4)
    if prior.error is None:
        return scene.mask.new_full((1, 1, 1), settings.silhouette * unexplained)
    normal = normals(found.parameters.height, scene.corner_rays, scene.pixel_angle)
    difference = (normal - prior.normal).square().sum(0, keepdim=True)
    variance = prior.error.clamp_min(MIN_ERROR).square()
    sure = scene.mask / variance.square()  # what is known well tells most of the picture's own error
    excess = ((difference - 2 * variance) * sure).sum() / sure.sum().clamp_min(1e-9)
    brightness = unexplained * (found.unexplained + BRIGHTNESS_SLOPE**2 * excess.clamp_min(0) / 2)
    if settings.estimate_albedo:
        brightness = brightness + PAINT
    return settings.silhouette * PRIOR_GAIN * brightness / variance


def _iterations(scene: PictureScene, settings: FitSettings) -> int:
    """L-BFGS iterations of a level."""
    learned = scene.prior is not None and scene.prior.error is not None
    return PAINTED_STEPS if learned and settings.estimate_albedo else STEPS


def _fit_level(
    scene: PictureScene, start: FitParameters, settings: FitSettings, prior_weight: Tensor | None
) -> LevelFit:
    """Minimise the cost at one resolution."""
    with torch.enable_grad():
        objective = Objective.of(scene, start, settings)
        steps = [start.height.new_zeros(1, *size).requires_grad_() for size in _scale_sizes(scene.corner_size)]
        albedo = start.albedo.clone().requires_grad_(settings.estimate_albedo)
        roughness = start.roughness.clone().requires_grad_(settings.estimate_roughness)
        ambient = start.ambient.clone().requires_grad_(settings.estimate_ambient)
        optimiser = torch.optim.LBFGS(
            [*steps, *(p for p in (albedo, roughness, ambient) if p.requires_grad)],
            max_iter=_iterations(scene, settings),
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
            cost = objective.cost(current(), prior_weight)
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
        cost=float(objective.cost(found, prior_weight) / pixels),
        unexplained=max(float(residual.sum() / pixels) / len(scene.image) - scene.noise_variance, 0.0),
    )


def _scale_sizes(size: tuple[int, int]) -> list[tuple[int, int]]:
    """Sizes of the corner grids of all scales, the finest first."""
    sizes = [size]
    for _ in range(SCALES - 1):
        sizes.append(((sizes[-1][0] + 1) // 2, (sizes[-1][1] + 1) // 2))
    return sizes
