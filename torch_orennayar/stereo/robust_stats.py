"""Robust statistics of a pixel's observations: which of them count, how much, and how noisy they are.

Observations are (P, K): P pixels, K lights. Selections exist in two forms: 0 or 1 for the iterative solver, and
continuous ones for the closed-form solver, whose ONNX graph takes any number of lights.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import torch
from torch import Tensor

Used = Literal["middle", "lit", "all"]
"""Observations that count: those of middle rank and in light, all that are not in shadow, or all."""

MISSING = -(2.0**-24)
"""What takes the place of an observation that was not measured: below 0, so that every fit takes it for a shadow, and a
value that no other observation has, so that plain least squares leaves it out. The smallest number of float16."""
SHADOW = 0.08
"""Observations below this share of the pixel's bright level are in shadow. Set by hand; the weights that ship with
`set_network` were trained with it."""
SHADOW_RAMP = 0.04
"""Width, as a share of the bright level, of the step from shadow to light around `SHADOW` in the continuous selection.
Set by hand."""
BRIGHT = 0.9
"""Quantile of a pixel's observations that is its bright level: a few highlights lie above it. Set by hand."""
MIDDLE_RANKS = (0.2, 0.8)
"""Shares of a pixel's ranks between which observations are of middle rank: shadows lie below, highlights above. Set by
hand; the weights that ship with `set_network` were trained with them."""
MIN_LIGHTS_RANKED = 10
"""Number of lights; with fewer no ranks are left out, only shadows. Set by hand."""
MIN_RANKED = 6
"""Number of observations; where fewer lie between the ranks and in light, all in light count. Set by hand."""
MAD_TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation, 1 / Phi^-1(3/4)."""
NOISE_FLOOR = 0.01
"""Least standard deviation of the residuals, as a share of the pixel's mean. Set by hand, about the noise of a
photograph."""
CUTOFF = 2.0
"""Standard deviations of the residuals that are the scale of Geman-McClure weights. Set by hand."""
ERROR_CAP = 0.15
"""Share of a pixel's mean at which errors are cut when materials are compared, so that cast shadows and highlights
weigh little. Set by hand."""


MAX_ANGLE = math.radians(20)
"""Radians at which angles between normals are cut when materials are compared; set by hand."""


def angle_between(first: Tensor, second: Tensor) -> Tensor:
    """Angles between unit vectors (P, 3), (P,) radians."""
    return torch.atan2(torch.linalg.cross(first, second).norm(dim=1), (first * second).sum(1))


def capped_angle(first: Tensor, second: Tensor) -> Tensor:
    """`angle_between`, each cut at `MAX_ANGLE`."""
    return angle_between(first, second).clamp(max=MAX_ANGLE)


def mean_brightness(grey: Tensor) -> Tensor:
    """Mean absolute value of every pixel's observations, (P, 1), above 0."""
    return grey.abs().mean(1, keepdim=True).clamp_min(1e-12)


def select(grey: Tensor, used: Used) -> Tensor:
    """1 for the observations that count, 0 for the others, (P, K)."""
    if used == "all":
        return (grey != MISSING).to(grey)
    return in_light(grey) if used == "lit" else between_ranks(grey, *MIDDLE_RANKS)


def ascending(values: Tensor) -> Tensor:
    """``values`` (P, K) in ascending order along K, without gradients.

    On a processor NumPy sorts them, whose vector instructions take a seventh of torch's time for 96 lights.
    """
    if values.device.type != "cpu":
        return values.sort(1).values
    return torch.from_numpy(np.sort(values.detach().numpy(), axis=1))


def in_light(grey: Tensor) -> Tensor:
    """1 for observations that are not in shadow, (P, K); at least for the three brightest."""
    return _in_light(grey, ascending(grey))


def _in_light(grey: Tensor, ordered: Tensor) -> Tensor:
    """`in_light` of observations whose ascending order is known."""
    count = grey.shape[1]
    bright, third = (ordered[:, max(1, rank) - 1, None] for rank in (round(BRIGHT * count), count - 2))
    threshold = SHADOW * bright
    return (grey >= torch.minimum(threshold, third)).to(grey)


def between_ranks(grey: Tensor, low: float, high: float) -> Tensor:
    """1 for observations in light between two shares of their pixel's ranks; for all in light where these are few."""
    count, ordered = grey.shape[1], ascending(grey)
    lit = _in_light(grey, ordered)
    if count < MIN_LIGHTS_RANKED:
        return lit
    least, most = (ordered[:, rank, None] for rank in (math.floor(low * count), math.ceil(high * count) - 1))
    both = ((grey >= least) & (grey <= most)).to(grey) * lit
    enough = (both.sum(1, keepdim=True) >= MIN_RANKED).to(grey)
    return both * enough + lit * (1 - enough)


def geman_mcclure(selected: Tensor, residual: Tensor, noise: Tensor) -> Tensor:
    """Weights of Geman & McClure 1987 times ``selected``, (P, K), for residuals of standard deviation ``noise``."""
    share = residual / (CUTOFF * noise)
    return selected / (1 + share * share) ** 2


def geman_mcclure_cost(residual: Tensor, noise: Tensor) -> Tensor:
    """The cost in [0, 1) whose minimum those weights find, (P, K)."""
    share = (residual / (CUTOFF * noise)).square()
    return share / (1 + share)


def median_rank(selected: Tensor) -> Tensor:
    """Rank of the median among each pixel's selected observations, (P, 1)."""
    return ((selected.sum(1, keepdim=True) - 1) / 2).long().clamp_min(0)


def noise_level(residual: Tensor, selected: Tensor, rank: Tensor) -> Tensor:
    """Standard deviation of the selected residuals by their median absolute value, whose rank is given, (P, 1)."""
    magnitude = ascending(residual.abs() + (1 - selected) * 1e9)
    return (MAD_TO_SIGMA * magnitude.gather(1, rank)).clamp_min(NOISE_FLOOR)


def quantile(ordered: Tensor, share: Tensor) -> Tensor:
    """A quantile of observations (P, K) in ascending order, (P, 1), linear between ranks; ``share`` is (1, 1).

    The number of lights is counted from the tensor, so that a graph does not fix it.
    """
    last = torch.ones_like(ordered[:1]).sum(1, keepdim=True) - 1
    place = share * last
    low = place.floor()
    high = torch.minimum(low + 1, last)
    count = ordered.shape[0]
    below, above = (ordered.gather(1, rank.long().expand(count, 1)) for rank in (low, high))
    return below + (place - low) * (above - below)


def soft_in_light(grey: Tensor) -> Tensor:
    """`in_light` with a ramp instead of a step, (P, K) in [0, 1]."""
    bright = quantile(grey.sort(1)[0], torch.full_like(grey[:1, :1], BRIGHT)).clamp_min(1e-9)
    return ((grey / bright - (SHADOW - SHADOW_RAMP / 2)) / SHADOW_RAMP).clamp(0.0, 1.0)


def soft_middle(grey: Tensor) -> Tensor:
    """Observations of middle rank and in light, without a step, (P, K) in [0, 1].

    From 12 lights down to 6 the ranks that are left out shrink to none: few lights are all needed.
    """
    ordered = grey.sort(1)[0]
    count = torch.ones_like(grey[:1]).sum(1, keepdim=True)
    cut = MIDDLE_RANKS[0] * ((count - 6) / 6).clamp(0.0, 1.0)
    low, high = quantile(ordered, cut), quantile(ordered, 1 - cut)
    outside = torch.maximum(low - grey, grey - high).clamp_min(0.0)
    return (1 - outside / (0.1 * (high - low)).clamp_min(1e-6)).clamp(0.0, 1.0) * soft_in_light(grey)
