"""The direction to the light of one picture whose light nobody knows, from its outline and its shading."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.checks import check_mask
from ..core.errors import CaptureError, RangeError
from ..core.findings import Finding
from ..core.progress import track
from ..core.warn import warn
from ..geometry.height_field import silhouette_normals
from .picture_network import learned_normals, load_picture_network
from .prior import DARKEST, misfit
from .scene import MEDIAN_OF_NORMAL, Picture, check_finite, peak_brightness

SIDE = 96
"""Pixels, about, of the longer side of the reduced object that is looked at; set by hand, for seconds."""
CANDIDATES = ((8, 8), (22, 12), (36, 15), (50, 15), (62, 15))
"""Slants of the lights that are tried, degrees off the view, and how many around it; 8 to 22 degrees apart, by hand."""
BETWEEN = 6.0
"""Degrees; how far, in the root mean square, a direction is from the nearest of them."""
FEWEST = 100
"""Bright pixels of the reduced picture below which it says nothing of its light; set by hand."""
OUTLINE_WEIGHT, SOFTNESS = 1.0, 0.1
"""What one minus the cosine to the outline's light adds to the misfit as a share of the least one, and by how much that
may be larger for a light to count a third. Set by hand: on 8 photographs and 26 renders the light found errs by 11
degrees in the mean, 13 in the root mean square, and the spread of what counts is 14."""
UNKNOWN = 30.0
"""Degrees of the standard error from which the light counts as not found; set by hand."""
UNEXPLAINED = 0.25
"""Least misfit, as a share of the brightness, from which no light explains the picture. Set by hand: up to .16 on 7
photographs and 26 renders, .3 on one of a surface full of folds and on noise."""
ROUNDS = 20
"""Rounds of reweighting in which the outline's light is found; set by hand."""
FAR_OFF = 2.0
"""Robust scales from which a pixel counts a quarter; set by hand."""


def with_found_light(picture: Picture, *, contour: bool) -> tuple[Picture, list[Finding]]:
    """One picture (C, H, W) with the direction to its light, and what is said of it.

    Raises:
        RangeError: several pictures, no occluding contour, without which nothing tells the light, or NaN in it.
        CaptureError: the picture does not determine its light within `UNKNOWN`.
    """
    inside = check_mask(picture.mask, picture.image[None]) if picture.image.ndim == 3 else None
    if inside is None or bool(inside.all()) or not contour:
        raise RangeError(
            "light",
            expected="given where there is no mask or its edge is no occluding contour, and for several pictures",
            got="None",
            mend="give the direction to the light, or the mask of an object whose outline is seen",
        )
    check_finite("image", picture.image, inside)
    direction, spread = search_light(picture.image, inside)
    if spread > UNKNOWN:
        raise CaptureError(
            "image",
            expected=f"a picture that determines its light within {UNKNOWN:.0f} degrees, where it is not given",
            got=f"one that leaves it uncertain by {spread:.0f} degrees",
            mend="give the direction to the light",
        )
    x, y, z = direction.tolist()
    text = (
        f"no light was given: {x:.2f}, {y:.2f}, {z:.2f} (right, up, toward the viewer) was found from outline and "
        f"shading, within {spread:.0f} degrees; the light's direction and the object's slant look much the same."
    )
    warn(text)
    return replace(picture, light=direction.to(picture.image)), [Finding(text, "light-found", spread)]


@torch.no_grad()
def search_light(image: Tensor, inside: Tensor) -> tuple[Tensor, float]:
    """Unit direction (3,) to the light and its standard error in degrees, 90 where no light explains the picture.

    For every candidate the network reads the normals, and the less these explain the picture under that light, the less
    the candidate counts; one far from the light that fits the inflated silhouette counts less, too.

    Args:
        image: (C, H, W) linear light.
        inside: (1, H, W) bool.
    """
    image, inside = image.cpu(), inside.cpu()  # one picture, reduced: a GPU would not be quicker
    extent = max(int(inside[0].any(axis).sum()) for axis in (0, 1))
    step = max(1, round(extent / SIDE))
    grey = torch.where(inside, image.mean(0, keepdim=True), 0).double()
    seen, share = F.avg_pool2d(torch.cat((grey, inside.double()))[None], step, ceil_mode=True)[0].split(1)
    mask = share > min(0.5, float(share.max()) / 2)
    small = torch.where(mask, seen / share.clamp_min(0.1), 0).float()
    brightness = small[0][mask[0]].double()
    lit = brightness > DARKEST * peak_brightness(small, mask)
    outline = _light_of(silhouette_normals(mask)[:, mask[0]].double(), brightness, lit)
    tried, unlike, network = _directions(outline), list[float](), load_picture_network()
    for direction in track(tried, "seeking the light", len(tried)):
        normal = learned_normals(small, direction.float().reshape(3, 1, 1), mask, network).normal[:, mask[0]].double()
        shaded = (normal * direction[:, None]).sum(0).clamp_min(0)
        unlike.append(misfit(brightness[lit], shaded[lit], scaled=True))
    score = torch.tensor(unlike, dtype=torch.float64)
    if float(score.min()) > UNEXPLAINED or int(lit.sum()) < FEWEST:
        return outline, 90.0
    score = score / score.min().clamp_min(1e-9) - 1 + OUTLINE_WEIGHT * (1 - tried @ outline)
    weight = (-(score - score.min()) / SOFTNESS).exp()
    found = F.normalize((weight[:, None] * tried).sum(0), dim=0)
    squared = (tried @ found).clamp(-1, 1).acos().square()
    spread = math.degrees(float(((weight * squared).sum() / weight.sum()).sqrt()))
    return found, math.hypot(spread, BETWEEN)


def _directions(like: Tensor) -> Tensor:
    """The directions that are tried, (N, 3)."""
    lights = [
        (math.sin(slant) * math.cos(turn), math.sin(slant) * math.sin(turn), math.cos(slant))
        for slant, turn in (
            (math.radians(degrees), 2 * math.pi * k / count) for degrees, count in CANDIDATES for k in range(count)
        )
    ]
    return torch.tensor(lights).to(like)


def _light_of(normal: Tensor, brightness: Tensor, lit: Tensor) -> Tensor:
    """Unit direction (3,) to the light under which normals (3, P) of a matt surface have a brightness (P,) at best.

    Robust (Geman-McClure) least squares with ambient light, over what is lit.
    """
    rows = torch.cat((normal, torch.ones_like(normal[:1])))[:, lit].T
    seen = brightness[lit]
    weight = torch.ones_like(seen)
    solved = rows.new_zeros(4)
    for _ in range(ROUNDS):
        solved = torch.linalg.lstsq(rows * weight.sqrt()[:, None], seen * weight.sqrt()).solution
        off = (seen - rows @ solved).abs()
        scale = (off.median() / MEDIAN_OF_NORMAL).clamp_min(1e-9)
        weight = (1 + (off / (FAR_OFF * scale)).square()).square().reciprocal()
    direction = solved[:3] + solved.new_tensor((0.0, 0.0, 1e-9))
    return F.normalize(direction, dim=0)
