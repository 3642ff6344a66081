"""Directions of distant lights that nobody measured, from the photographs and the object's outline.

The inflated outline gives the first normals; lights and normals are then found from each other by robust regression,
which leaves a linear ambiguity: any invertible 3 x 3 matrix between them. That all lights are equally bright fixes it
up to a rotation (Hayakawa 1994), and that the normals are those of a surface fixes the rotation.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.checks import check_floating, check_mask
from ..core.defaults import independent_of_defaults
from ..core.errors import CaptureError, ShapeError
from ..core.findings import Finding
from ..core.progress import track
from ..core.warn import warn
from ..geometry.height_field import silhouette_normals
from .linear_systems import solve_symmetric
from .pixel_sample import gather_reduced
from .robust_fit import CHUNK
from .robust_stats import (
    BRIGHT,
    MAD_TO_SIGMA,
    MIDDLE_RANKS,
    SHADOW,
    ascending,
    between_ranks,
    geman_mcclure,
    mean_brightness,
    median_rank,
    noise_level,
)
from .surface_rotation import SmoothNormals, rotation_to_surface

PIXELS = 20_000
"""Pixels of the reduced photographs, about, that the lights are found from; set by hand, for seconds."""
MIN_LIGHTS = 6
"""Fewest photographs: equal brightness gives one equation for each, and the matrix that it fixes has six unknowns."""
ROUNDS, LATER_ROUNDS = 6, 3
"""Alternations between lights and normals before the ambiguity is resolved, and with it. Set by hand."""
REWEIGHTINGS = 4
"""Of each robust regression; set by hand."""
BRIGHTEST_LEFT_OUT = 0.85
"""Quantile of a photograph's pixels above which they are highlights or spoiled by them; set by hand."""
LEAST_FACING = 0.1
"""Cosine to the view by which the brightness of the outline's normals is divided at least; set by hand."""
BORDER_SHARE = 0.25
"""Share of the outline that may lie on the picture's border, where it is none of the object's; set by hand."""
UNEQUAL = 0.1
"""Standard deviation of the logarithm of the lights' brightness from which they are not equally bright; set by hand."""
UNCERTAIN = 3.0
"""Degrees of `FoundLights.uncertainty` from which a warning is issued; set by hand."""
MAX_SPREAD = 100.0
"""Condition number of the six equations of equal brightness above which the lights do not fix them; set by hand."""


class FoundLights(NamedTuple):
    """What the photographs say of their lights.

    Attributes:
        directions: (K, 3) float32 unit, camera frame.
        brightness: (K,) float32, of mean 1, as the fit finds it: about 1 where the lights are equally bright.
        uncertainty: degrees by which the lights of one half of the object differ from those of the whole, RMS over
            halves by place and by normal; infinite where a half does not determine them.
        findings: what was assumed and what stays open.
    """

    directions: Tensor
    brightness: Tensor
    uncertainty: float
    findings: tuple[Finding, ...]


@torch.no_grad()
@independent_of_defaults
def find_lights(images: Tensor, mask: Tensor) -> FoundLights:
    """Find the directions of distant, equally bright lights from the photographs of an object with a visible outline.

    The object is taken as convex on the whole: a hollow one gives lights from the other side. Not differentiable.

    Args:
        images: (K, C, H, W) linear light, K at least 6.
        mask: (1, H, W) bool, the object; its edge is taken as the object's outline.

    Returns:
        The `FoundLights`.

    Raises:
        ShapeError: other shapes or types.
        CaptureError: too few photographs, an outline that is cut by the picture's border, lights that do not determine
            each other.

    Source:
        Hayakawa 1994, "Photometric stereo under a light source with arbitrary motion"; Yuille & Snow 1997, "Shape and
        albedo from multiple images using integrability".

    Example:
        >>> import torch, torch_orennayar as ton
        >>> from torch_orennayar.geometry.primitives import Ball, spiral_lights
        >>> normal, mask = Ball(31.5, 31.5, 30.0).normals((64, 64))
        >>> lights = spiral_lights(12)
        >>> images = ton.OrenNayar("lambert")(normal[None], lights[None], albedo=0.6)[0]
        >>> found = ton.find_lights(images, mask)
        >>> (found.directions * lights).sum(1).min().item() > 0.99
        True
    """
    check_floating(images=images)
    if images.ndim != 4:
        raise ShapeError("images", expected="(K, C, H, W)", got=str(tuple(images.shape)), mend="stack the images")
    inside = check_mask(mask, images)
    _check_outline(inside[0], len(images))
    grey, small = gather_reduced(images, inside[0], PIXELS)
    seen = _Observations.of(grey)
    outline = silhouette_normals(small[None])[:, small].T.to(grey)
    scaled = outline * (grey.mean(1, keepdim=True) / outline[:, 2:].clamp_min(LEAST_FACING))
    lights = seen.regress_lights(scaled)
    for _ in track(range(ROUNDS), "finding lights", ROUNDS):
        scaled = seen.regress_normals(lights)
        lights = seen.regress_lights(scaled)
    spread = lights.new_zeros(())
    for _ in track(range(LATER_ROUNDS), "turning lights", LATER_ROUNDS):
        root = _equal_brightness(lights)
        lights, scaled = lights @ root, scaled @ torch.linalg.inv(root)
        turn = rotation_to_surface(SmoothNormals.of(F.normalize(scaled, dim=1), small))
        lights = lights @ turn
        brightness = lights.norm(dim=1)
        spread = MAD_TO_SIGMA * (brightness.log() - brightness.log().median()).abs().median()
        scaled = seen.regress_normals(F.normalize(lights, dim=1))
        lights = seen.regress_lights(scaled)
    brightness = lights.norm(dim=1)
    directions = F.normalize(lights, dim=1)
    uncertainty = _uncertainty(directions, seen, small)
    findings = _describe(len(lights), float(spread), uncertainty)
    return FoundLights(directions.float(), (brightness / brightness.mean()).float(), uncertainty, tuple(findings))


def _uncertainty(directions: Tensor, seen: _Observations, inside: Tensor) -> float:
    """How far the lights of halves of the object are from ``directions``, degrees."""
    scaled = seen.regress_normals(directions)
    row, column = inside.nonzero().unbind(1)
    square = []
    for place in (row, column, *(scaled[:, axis] / scaled.norm(dim=1).clamp_min(1e-12) for axis in (0, 1))):
        first = place <= place.median()
        for half in (first, ~first):
            part = seen.part(half)
            try:
                lights = part.regress_lights(part.regress_normals(part.regress_lights(scaled[half])))
                lights = F.normalize(lights @ _equal_brightness(lights), dim=1)
            except (CaptureError, RuntimeError):  # a half that determines nothing; a singular system
                return float("inf")
            square.append((lights * directions).sum(1).clamp(-1, 1).acos().rad2deg().mean().square())
    return float(torch.stack(square).mean().sqrt())


def _check_outline(inside: Tensor, count: int) -> None:
    """Refuse what does not show where its lights are."""
    if count < MIN_LIGHTS:
        raise CaptureError(
            "images",
            expected=f"at least {MIN_LIGHTS} photographs where the lights are not known",
            got=str(count),
            mend="photograph under more lights, or give the lights",
        )
    filled = F.max_pool2d(-inside[None, None].double(), 3, 1, 1)[0, 0]  # beyond the border nothing counts
    rim = inside & (filled > -1)
    border = torch.zeros_like(inside)
    border[0] = border[-1] = border[:, 0] = border[:, -1] = True
    cut = int((inside & border).sum())
    if cut > BORDER_SHARE * (cut + int((rim & ~border).sum())):
        raise CaptureError(
            "mask",
            expected="an object whose outline is seen, where the lights are not known",
            got="one that the picture's border cuts, or no mask",
            mend="give a mask (--mask), photograph the whole object, or give the lights (--lights, --chrome)",
        )


class _Observations(NamedTuple):
    """Grey observations and those of them that count.

    Attributes:
        grey: (P, K) float64.
        middle: (P, K) 1 for observations of a pixel that are of middle rank and in light.
        dim: (P, K) 1 for pixels of a photograph that are in light and not among its brightest.
    """

    grey: Tensor
    middle: Tensor
    dim: Tensor

    @staticmethod
    def of(grey: Tensor) -> _Observations:
        """Which of them count does not depend on lights and normals."""
        bright = ascending(grey.T.contiguous())[:, min(int(BRIGHTEST_LEFT_OUT * len(grey)), len(grey) - 1)]
        level = ascending(grey)[:, min(int(BRIGHT * grey.shape[1]), grey.shape[1] - 1), None]
        dim = ((grey <= bright) & (grey > SHADOW * level)).to(grey)
        return _Observations(grey, between_ranks(grey, *MIDDLE_RANKS), dim)

    def part(self, pixels: Tensor) -> _Observations:
        """Those of some pixels, (P,) bool."""
        return _Observations(self.grey[pixels], self.middle[pixels], self.dim[pixels])

    def regress_lights(self, scaled: Tensor) -> Tensor:
        """Lights (K, 3) times their brightness, from albedo times normals (P, 3)."""
        return _regress(self.grey.T.contiguous(), self.dim.T.contiguous(), scaled)

    def regress_normals(self, lights: Tensor) -> Tensor:
        """Albedo times normals (P, 3), from lights (K, 3) times their brightness."""
        return _regress(self.grey, self.middle, lights)


def _regress(seen: Tensor, used: Tensor, vectors: Tensor) -> Tensor:
    """Robust solutions (N, 3) of ``seen = solution @ vectors.T``, N rows in parts that fit in cache."""
    rows = max(1, CHUNK // seen.shape[1])
    parts = zip(seen.split(rows), used.split(rows), strict=True)
    return torch.cat([_regress_rows(some, some_used, vectors) for some, some_used in parts])


def _regress_rows(seen: Tensor, used: Tensor, vectors: Tensor) -> Tensor:
    outer, weight, rank = (vectors[:, :, None] * vectors[:, None]).flatten(1), used, median_rank(used)
    mean = mean_brightness(seen)
    solution = seen.new_zeros(len(seen), 3)
    for _ in range(REWEIGHTINGS):
        matrix = (weight @ outer).T.view(3, 3, -1)
        ridge = 1e-6 * (matrix[0, 0] + matrix[1, 1] + matrix[2, 2]).clamp_min(1e-12)
        rows = [[matrix[i, j] + ridge if i == j else matrix[i, j] for j in range(3)] for i in range(3)]
        solution = torch.stack(solve_symmetric(rows, list(((weight * seen) @ vectors).T)), 1)
        residual = seen - solution @ vectors.T
        weight = geman_mcclure(used, residual, mean * noise_level(residual / mean, used, rank))
    return solution


def _equal_brightness(lights: Tensor) -> Tensor:
    """The symmetric matrix (3, 3) that makes lights (K, 3) equally bright, by reweighted least squares.

    Raises:
        CaptureError: they do not determine it.
    """
    equations = _squares(lights)
    weight = torch.ones_like(lights[:, :1])
    solution = equations.new_zeros(6)
    for _ in range(2 * REWEIGHTINGS):
        solution = torch.linalg.lstsq(equations * weight, weight).solution[:, 0]
        residual = (equations @ solution - 1).abs()[:, None]
        weight = 1 / (1 + (residual / (2 * MAD_TO_SIGMA * residual.median()).clamp_min(1e-6)) ** 2)
    xx, yy, zz, xy, xz, yz = solution
    matrix = torch.stack((torch.stack((xx, xy, xz)), torch.stack((xy, yy, yz)), torch.stack((xz, yz, zz))))
    values, vectors = torch.linalg.eigh(matrix)
    root: Tensor = vectors @ values.clamp_min(0).sqrt().diag() @ vectors.T
    singular = torch.linalg.svdvals(_squares(lights @ root))
    if bool(values[0] <= 0) or bool(singular[-1] * MAX_SPREAD < singular[0]):
        raise CaptureError(
            "images",
            expected="lights of equal brightness from all around, where they are not known",
            got="lights that do not fit together: of different brightness, on one ring or on one side",
            mend="give the lights (--lights, --chrome)",
        )
    return root


def _squares(lights: Tensor) -> Tensor:
    """The six products of coordinates (K, 6) whose weighted sum is the squared brightness."""
    x, y, z = lights.unbind(1)
    return torch.stack((x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z), 1)


def _describe(count: int, spread: float, uncertainty: float) -> list[Finding]:
    """What was assumed, and what speaks against it."""
    agreed = f"agree within {uncertainty:.1f} degrees" if uncertainty < 90 else "show none"
    text = (
        f"no lights were given: {count} directions were found from the photographs, for lights far away and equally "
        f"bright and an object that is convex on the whole. Those of halves of the object {agreed}; the error may be "
        "several times that."
    )
    findings = [Finding(text, "lights-found", uncertainty)]
    if uncertainty > UNCERTAIN:
        told = f"differ by {uncertainty:.1f} degrees" if uncertainty < 90 else "are not determined"
        text = (
            f"the lights of halves of the object {told}: the directions are uncertain by that and more; photograph a "
            "mirror ball under the lights, or more lights from all around."
        )
        findings.append(Finding(text, "lights-uncertain", uncertainty))
        warn(text)
    if spread > UNEQUAL:
        text = (
            f"the lights found differ in brightness by {100 * spread:.0f} %: they are not equally bright, and their "
            "directions are not to be trusted; give light_intensities.txt or the lights."
        )
        findings.append(Finding(text, "lights-unequal", 100 * spread))
        warn(text)
    return findings
