"""Whether light directions that were given agree with the photographs, and better ones where they do not.

Photographs tell lights from each other to a fraction of a degree, but all of them together, up to a linear map, only to
a few. So lights that are wrong on their own are mended in the frame of those that are given, and all together only
where they differ from what the photographs say by far more than that is uncertain.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.checks import check_mask
from ..core.findings import Finding
from ..core.warn import warn
from .robust_stats import MAD_TO_SIGMA, angle_between
from .unknown_lights import FoundLights, search_lights

WRONG = 2.0
"""Degrees from which a light that was given is replaced; set by hand, several times what right ones differ by on
photographs."""
TOGETHER, STANDARD_ERRORS = 3.0, 2.0
"""Degrees, and standard errors of the lights found, beyond both of which given ones are all wrong; set by hand."""
MANY = 0.25
"""Share of lights that are wrong on their own from which the others may be wrong too; set by hand."""
REWEIGHTINGS = 10
"""Of the linear map between the lights found and given; set by hand."""


def refine_lights(images: Tensor, lights: Tensor, mask: Tensor, valid: Tensor | None = None) -> FoundLights:
    """Lights that were given, with those replaced that the photographs contradict.

    Args:
        images: (K, C, H, W) linear light of equally bright lights.
        lights: (K, 3) unit directions.
        mask: (1, H, W) bool, the object; its edge is taken as the object's outline.
        valid: the samples that count.

    Returns:
        The lights, with a finding on what was replaced, or that none was.

    Raises:
        CaptureError: as `find_lights`.
    """
    found = search_lights(images, check_mask(mask, images), "equal", valid)
    given = lights.detach().cpu().double()
    seen = found.directions.double()
    mapped = F.normalize(seen @ _linear_map(seen, given), dim=1)
    refined = mapped if _agree(seen, mapped, given, found.uncertainty) else seen
    apart = angle_between(refined, given).rad2deg()
    wrong = apart > WRONG
    findings = [f for f in found.findings if f.code == "lights-unequal"]
    for finding in findings:
        warn(finding)
    if not bool(wrong.any()):
        text = f"the photographs agree with the lights that were given, within {apart.max():.1f} degrees."
        findings.append(Finding(text, "lights-kept", apart.max().item()))
    else:
        count = int(wrong.sum())
        which = "all of them" if count == len(given) else ", ".join(str(int(k) + 1) for k in wrong.nonzero()[:12])
        text = (
            f"{count} of {len(given)} lights that were given contradict the photographs, by {apart[wrong].mean():.1f} "
            f"degrees in the mean, and were replaced: {which}"
            + (f" (the lights found are uncertain by {found.uncertainty:.1f} degrees)." if refined is seen else ".")
        )
        findings.append(Finding(text, "lights-refined", apart[wrong].mean().item()))
        warn(text)
    directions = torch.where(wrong[:, None], refined, given).float()
    return found._replace(directions=directions, findings=tuple(findings))


def _agree(seen: Tensor, mapped: Tensor, given: Tensor, uncertainty: float) -> bool:
    """Whether the lights given, all together, may be right.

    They are not where they differ from those found by a linear map beyond its uncertainty, nor where so many are wrong
    on their own that the map, of nine numbers, is less certain than the lights found.
    """
    together = angle_between(seen, mapped).rad2deg().median().item()
    apart = angle_between(mapped, given).rad2deg()
    frame = apart.median().item() * math.sqrt(9 / (2 * len(given)))
    many_wrong = float((apart > WRONG).double().mean()) > MANY
    return together <= max(TOGETHER, STANDARD_ERRORS * uncertainty) and not (many_wrong and frame > uncertainty / 2)


def _linear_map(found: Tensor, given: Tensor) -> Tensor:
    """The matrix (3, 3) that takes most of the lights found to those given, by reweighted least squares."""
    weight = torch.ones_like(found[:, :1])
    length = torch.ones_like(weight)
    matrix = torch.eye(3, dtype=found.dtype)
    for _ in range(REWEIGHTINGS):
        matrix = torch.linalg.lstsq(found * weight, length * given * weight).solution
        mapped = found @ matrix
        length = (mapped * given).sum(1, keepdim=True)
        length = length / length.mean()
        apart = (F.normalize(mapped, dim=1) - given).norm(dim=1, keepdim=True)
        scale = 2 * MAD_TO_SIGMA * apart.median() + math.radians(0.1)
        weight = 1 / (1 + (apart / scale).square())
    return matrix
