"""Photographs that contradict the surface that the others show: moved, in the wrong order, with another light on."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ..core.findings import Finding
from ..core.warn import warn
from . import robust_fit
from .material import Material, cosines
from .pixel_sample import PixelSample
from .robust_stats import MISSING, mean_brightness

MIN_LIGHTS = 8
"""Photographs; with fewer, a broken one bends the surface that it is compared with. Set by hand."""
STEPS = 8
"""Of the fits that photographs are compared with; set by hand."""
FACING = 0.3
"""Cosine to a light above which pixels are compared: below it misfits are shadows. Set by hand."""
LEAST_MISFIT, MISFITS = 0.1, 5.0
"""Median misfit of a photograph, as a share of the pixels' means, from which it is left out, and how many times the
others' median that must be. Set by hand: DiLiGenT's photographs have up to .11 and three times the median, rendered
ones of glossy rings 4.7 times; those that were moved, swapped or lit otherwise six times and more, or do no harm."""
ROUNDS = 3
"""Times that photographs are compared, each without those that were found before; set by hand."""
CLEAR = 0.06
"""Median misfit of the others above which none is left out: the surface is too far from a matt one. Set by hand."""
ROUGH = tuple(Material("vcavity", math.radians(degrees)) for degrees in (15, 30, 45))
"""Materials that must contradict a photograph too, where they explain the others better than a matt one: lit from the
camera, a rough surface is up to .3 brighter toward its outline, which is no mistake. Set by hand."""
MOST = 1 / 4
"""Share of the photographs above which none is left out: then it is not photographs that are wrong. Set by hand."""


def find_broken_frames(sample: PixelSample) -> tuple[Tensor, list[Finding]]:
    """Which photographs contradict the others, (K,) bool, and a finding on them, which is also a warning."""
    broken, misfit = judge_frames(sample)
    if not bool(broken.any()):
        return broken, []
    numbers = ", ".join(str(int(k) + 1) for k in broken.nonzero())
    text = (
        f"photographs {numbers} (the first is 1) were left out: they differ from what the others show by "
        f"{100 * misfit[broken].median():.0f} %, where the others differ by {100 * misfit[~broken].median():.0f} %; "
        "moved, in another order, or under another light?"
    )
    warn(text)
    return broken, [Finding(text, "frames-left-out", int(broken.sum()))]


def judge_frames(sample: PixelSample) -> tuple[Tensor, Tensor]:
    """Which photographs contradict the others, (K,) bool, and the misfit of each, (K,), as a share of pixels' means."""
    count = len(sample.directions)
    none = torch.zeros(count, dtype=torch.bool, device=sample.grey.device)
    misfit = torch.zeros(count, dtype=sample.grey.dtype, device=sample.grey.device)
    if count < MIN_LIGHTS:
        return none, misfit
    broken, misfit = none, _misfit(sample, none, Material())
    for _ in range(ROUNDS):
        before = broken
        broken = misfit > _limit(misfit, broken)
        if torch.equal(broken, before):
            break
        if int(broken.sum()) > MOST * count or misfit[~broken].median() > CLEAR:
            return none, misfit
        misfit = _misfit(sample, broken, Material())
    for material in ROUGH if bool(broken.any()) else ():
        rough = _misfit(sample, broken, material)
        if rough[~broken].median() < misfit[~broken].median():
            misfit, broken = rough, broken & (rough > _limit(rough, broken))
    return broken, misfit


def _limit(misfit: Tensor, broken: Tensor) -> float:
    """Misfit from which a photograph is broken, by those that are not."""
    return max(LEAST_MISFIT, MISFITS * misfit[~broken].median().item())


def _misfit(sample: PixelSample, broken: Tensor, material: Material) -> Tensor:
    """Median misfit of each photograph, (K,), over pixels that face its light, under a fit to those not broken."""
    shown = sample.under(~broken)
    fitted = robust_fit.fit(shown, material, used="middle", steps=STEPS)
    missed = (sample.grey - robust_fit.predict(fitted, sample.directions, material)).abs()
    compared = (cosines(fitted.normal, sample.directions.light) > FACING) & (sample.grey != MISSING)
    share = torch.where(compared, missed / mean_brightness(shown.grey), torch.nan)
    return share.nanmedian(0).values.nan_to_num()
