"""Whether a result can be trusted, in plain words, from its findings and numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from ..core.findings import Finding
from .result_maps import ResultMaps

DOUBTFUL = {
    "lights-unequal": "The lights were taken as equally bright, and are not.",
    "lights-out-of-order": "The lines of the light file seem to belong to other photographs.",
    "lights-contradicted": "The photographs contradict the light directions that were given.",
    "lights-mirrored": "The normals oppose the object's outline: the lights' axes may be mirrored.",
    "falloff-steep": "The pictures darken toward grazing light more than a surface does: is their encoding right?",
    "lights-near": "The lights stood near, and were taken as far away: the surface found is bent.",
    "mask-may-be-inverted": "The mask holds all four corners: it may be inverted.",
}
"""Findings with which a result is not to be trusted."""
WORTH_A_LOOK = {
    "lights-uncertain": "The lights were found from the photographs, and are uncertain.",
    "lights-refined": "The lights of the file contradicted the photographs and were replaced.",
    "lights-close-together": "The lights stood close together: normals are sensitive to noise.",
    "frames-left-out": "Some photographs contradict the others and were left out.",
    "no-contour": "No outline is known: how far the surface leans as a whole is a guess.",
    "no-mask": "There is no mask, and no dark background: everything in the picture was solved.",
    "clipped-samples": "Some samples are at full scale and were left out.",
    "dark-pixels": "Some pixels are reached by fewer than 3 lights.",
    "three-lights": "With 3 lights nothing is left to check the result with.",
    "network-few-lights": "There are fewer lights than the network was trained on.",
    "roughness-unreliable": "The photographs do not determine the roughness.",
}
"""Findings that say where to look."""
LIGHTS_DOUBTFUL = 10.0
"""Degrees of standard error of lights that were found from which a result is not to be trusted; set by hand."""
MISFIT, MISFIT_DOUBTFUL = 0.1, 0.25
"""Mean misfit over the mean brightness that is worth a look, and that is doubtful; set by hand."""
MUCH_CLIPPED = 1.0
"""Percent of samples at full scale that are worth a look; set by hand."""
UNSURE, MUCH_UNSURE = 0.5, 0.2
"""Confidence below which a pixel is unsure, and the share of such pixels that is worth a look; set by hand."""
FEW_PIXELS = 500
"""Pixels of the object below which a result is worth a look; set by hand: a relief of 22 x 22."""


class Verdict(NamedTuple):
    """How far a result can be trusted.

    Attributes:
        word: ``"good"``, ``"look"`` or ``"doubtful"``.
        title: the same in a sentence.
        reasons: why, one sentence each.
    """

    word: str
    title: str
    reasons: tuple[str, ...]


def verdict(report: Sequence[str], maps: ResultMaps) -> Verdict:
    """The verdict on a result with these findings.

    Args:
        report: findings of loader and solver.
        maps: of the result.
    """
    found = {entry.code: entry for entry in report if isinstance(entry, Finding)}
    doubts = [text for code, text in DOUBTFUL.items() if code in found]
    looks = [t for code, t in WORTH_A_LOOK.items() if code in found and not _is_minor(found[code])]
    uncertain = found.get("lights-uncertain")
    if uncertain is not None and (uncertain.value or 0.0) >= LIGHTS_DOUBTFUL:
        looks.remove(WORTH_A_LOOK["lights-uncertain"])
        doubts.append(f"The lights were found from the photographs only to about {uncertain.value:.0f} degrees.")
    inside = maps.mask[0]
    level = maps.albedo[:, inside].mean().item()
    misfit = maps.residual[:, inside].mean().item() / max(level, 1e-12)
    if misfit > MISFIT:
        text = f"The result misses the photographs by {misfit:.0%} of the surface's brightness in the mean."
        (doubts if misfit > MISFIT_DOUBTFUL else looks).append(text)
    unsure = (maps.confidence[:, inside] < UNSURE).float().mean().item()
    if unsure > MUCH_UNSURE:
        looks.append(f"Confidence is low in {unsure:.0%} of the pixels: see the map of confidence.")
    pixels = int(inside.sum())
    if pixels < FEW_PIXELS:
        looks.append(f"Only {pixels} pixels were solved: use larger photographs, or a larger --scale.")
    if doubts:
        return Verdict("doubtful", "Do not trust this result", tuple(doubts + looks))
    if looks:
        return Verdict("look", "Usable; look at what is named here", tuple(looks))
    agree = f"The result agrees with the photographs to {misfit:.1%} of the surface's brightness in the mean"
    return Verdict("good", "Good", (f"{agree}, and nothing contradicts it.",))


def _is_minor(finding: Finding) -> bool:
    return finding.code == "clipped-samples" and (finding.value or 0.0) < MUCH_CLIPPED
