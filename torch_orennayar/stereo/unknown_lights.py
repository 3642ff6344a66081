"""Directions and brightness of distant lights that nobody measured, from the photographs and the object's outline.

A first factorisation leaves any linear map between lights and normals open. What resolves it: that the lights are
equally bright (Hayakawa 1994), where they are; how a rough or shiny surface differs from a Lambertian one, which a
linear map does not keep; and, for the rotation that is left, that the normals are those of a surface (Yuille & Snow
1997). How well all that determines the lights is computed with them, and lights that it does not determine are refused.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.linalg import LinAlgError  # type: ignore[attr-defined]

from ..core.checks import check_floating, check_mask
from ..core.defaults import independent_of_defaults
from ..core.errors import CaptureError, RangeError, ShapeError
from ..core.findings import Finding
from ..core.progress import track
from ..core.warn import warn
from ..geometry.height_field import silhouette_normals
from .capture_checks import find_valid, leave_out
from .light_adjustment import LightGuess, Observed, adjust, standard_errors
from .light_factors import factor
from .material import Material
from .material_refinement import with_number
from .material_selection import AUTO_MODEL, MIN_LIGHTS_LOBES
from .pixel_sample import gather_reduced
from .surface_rotation import rotation_to_surface

PIXELS = 2500
"""Pixels of the reduced photographs, about, that the lights are found from; set by hand, for seconds."""
MIN_LIGHTS = 6
"""Fewest photographs: equal brightness gives one equation for each, and the matrix that it fixes has six unknowns."""
UNLIKE = 0.07
"""Mean error of the fit, as a share of the pixels' means and cut at `ERROR_CAP`, above which lights are refused. Set by
hand: .01 to .06 on matt and glossy objects, .07 to .12 on metals and on lamps held by hand."""
SLANTED, OUTWARD = 0.7, 0.4
"""Least slant of the inflated outline's normals that are compared with those found, and least mean cosine between their
directions in the picture; set by hand, right lights give .6 and more."""
DARK = 0.02
"""Mean of a photograph of the object, as a share of the median photograph's, up to which its lamp did not shine. Set by
hand."""
MIN_PIXELS = 200
"""Fewest pixels of an object whose outline says anything of its shape; set by hand."""
EQUAL, USUAL, ANY = 0.05, 0.2, 2.0
"""Standard deviation of the logarithm of the brightness that is expected of equal lights, also for what no model
explains, of lights of a kind, and of any lights, where it is to decide nothing. Set by hand."""
ROUGHNESS, EXPONENT = math.radians(20), 1.05
"""Roughness, radians, and exponent of falloff that the search starts from; set by hand."""
HIGHLIGHTS = (8, 64)
"""Exponents of the two highlights that every pixel may have, a broad and a sharp one; set by hand."""
BEGIN, CONTINUE = 8, 5
"""Rounds of adjustment before the surface is turned for the first time, and after each time; set by hand."""
TURNS = 2
"""Times that the surface is turned; set by hand."""
ROUGHER = 0.8
"""Share of the error of falloff below which that of roughness must lie to be believed: on glossy objects both fit
about as well, and on rough ones it is half. Set by hand."""
BORDER_SHARE = 0.25
"""Share of the outline that may lie on the picture's border, where it is none of the object's; set by hand."""
UNEQUAL = 0.05
"""Standard deviation of the logarithm of the brightness from which lights are not equal. Set by hand: where it is 0.17,
0.08 and more is found when it is released, where it is 0 up to 0.025."""
UNCERTAIN, UNKNOWN = 5.0, 20.0
"""Degrees of `FoundLights.uncertainty` from which a warning is issued, and lights are refused; set by hand."""


class FoundLights(NamedTuple):
    """What the photographs say of their lights.

    Attributes:
        directions: (K, 3) float32 unit, camera frame.
        brightness: (K,) float32, of geometric mean 1; of equal lights within a few percent of it.
        uncertainty: standard error of a direction, degrees, RMS over the lights.
        brightness_uncertainty: standard error of a brightness, as a share.
        findings: what was assumed and what stays open.

    Example:
        >>> import torch_orennayar as ton
        >>> mix = ton.Ingredients.plain(rough=1.0)
        >>> made = ton.SyntheticCaptures("images", seed=1, mix=mix, size=(48, 48), lights=(12, 12)).sample(3)
        >>> found = ton.find_lights(made["images"], made["mask"])
        >>> bool(((found.directions * made["lights"]).sum(1) > 0.9).all()), found.uncertainty < 10
        (True, True)
    """

    directions: Tensor
    brightness: Tensor
    uncertainty: float
    brightness_uncertainty: float
    findings: tuple[Finding, ...]


@torch.no_grad()
@independent_of_defaults
def find_lights(
    images: Tensor,
    mask: Tensor,
    *,
    intensities: Literal["equal", "unknown"] = "equal",
    valid: Tensor | None = None,
) -> FoundLights:
    """Find directions and brightness of distant lights from photographs of an object with a visible outline.

    The object is taken as convex on the whole: a hollow one gives lights from the other side. Not differentiable.

    Args:
        images: (K, C, H, W) linear light, K at least 6.
        mask: (1, H, W) bool, the object; its edge is taken as the object's outline.
        intensities: ``"equal"`` where the lights are equally bright or images were divided by their brightness;
            ``"unknown"``: it is found too, from how the surface differs from a Lambertian one, which needs a rough or
            shiny surface, and for a shiny one 12 lights.
        valid: the samples that count, as for `photometric_stereo`.

    Returns:
        The `FoundLights`.

    Raises:
        ShapeError: other shapes or types.
        RangeError: other ``intensities``, values inside the mask that are not finite.
        CaptureError: too few photographs, an outline that is cut by the picture's border, photographs that do not
            determine their lights: of a surface too flat or too plain, or lights on one ring or one side.

    Source:
        Hayakawa 1994, "Photometric stereo under a light source with arbitrary motion"; Yuille & Snow 1997, "Shape and
        albedo from multiple images using integrability"; Georghiades 2003, "Incorporating the Torrance and Sparrow
        model of reflectance in uncalibrated photometric stereo", on what highlights resolve.

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
    found = search_lights(images, mask, intensities, valid)
    warn_of_doubts(found)
    return found


def warn_of_doubts(found: FoundLights) -> None:
    """Warn of what speaks against the lights."""
    for finding in found.findings:
        if finding.code in ("lights-uncertain", "lights-unequal"):
            warn(finding)


def search_lights(images: Tensor, mask: Tensor, intensities: str, valid: Tensor | None) -> FoundLights:
    """`find_lights` without warnings."""
    check_floating(images=images)
    if images.ndim != 4:
        raise ShapeError("images", expected="(K, C, H, W)", got=str(tuple(images.shape)), mend="stack the images")
    if intensities not in ("equal", "unknown"):
        raise RangeError("intensities", expected="'equal' or 'unknown'", got=repr(intensities), mend="choose one")
    inside = check_mask(mask, images)
    _check_outline(inside[0], len(images))
    images, _ = leave_out(images, find_valid(images, inside[0], valid), inside[0])
    grey, small = gather_reduced(images, inside[0], PIXELS)
    if not bool(grey.isfinite().all()):
        raise RangeError(
            "images",
            expected="finite values inside the mask",
            got="NaN or infinity",
            mend="take those pixels out of the mask",
        )
    _check_lit(grey)
    equal = intensities == "equal"
    try:
        guess, errors = _solve(grey, small, factor(grey, small), EQUAL if equal else ANY)
    except LinAlgError as error:  # equations without a solution
        raise _undetermined(math.inf, equal=equal) from error
    uncertainty = math.degrees(errors[0])
    if not uncertainty < UNKNOWN:  # or it is not a number
        raise _undetermined(uncertainty, equal=equal)
    _check_fit(guess, grey, small)
    return _describe(guess, errors, unequal=_unequal(grey, guess) if equal else None)


def _solve(grey: Tensor, inside: Tensor, lights: Tensor, spread: float) -> tuple[LightGuess, tuple[float, float]]:
    """Lights and pixels in the material that explains them better, and the standard errors of the lights."""
    tried = []
    for material in track(_materials(len(lights)), "comparing surfaces"):
        observed = Observed(grey, spread)
        guess = adjust(observed, _begin(observed, lights, material), BEGIN)
        tried.append((observed, guess))
    (observed, guess), rough = tried
    rough_is_better = rough[0].error(rough[1]) < ROUGHER * observed.error(guess)
    if rough_is_better:
        observed, guess = rough
    stiffness = None
    for _ in track(range(TURNS), "turning lights", TURNS):
        rotation, stiffness = rotation_to_surface(guess.pixels.normal, inside)
        # Highlights are too coarse a model to trust what they say of the rotation; one roughness is not.
        guess = adjust(observed, guess.turned(rotation), CONTINUE, stiffness if rough_is_better else None)
    assert stiffness is not None  # there is at least one turn
    return guess, standard_errors(observed, guess, stiffness)


def _materials(lights: int) -> tuple[Material, Material]:
    """Lambert's with falloff and a rough one; both with highlights where there are lights enough to see them."""
    lobes = HIGHLIGHTS if lights >= MIN_LIGHTS_LOBES else ()
    smooth = Material(exponents=lobes)
    return with_number(smooth, EXPONENT), Material(AUTO_MODEL, ROUGHNESS, exponents=lobes)


def _begin(observed: Observed, lights: Tensor, material: Material) -> LightGuess:
    """The pixels under the first lights."""
    brightness = lights.norm(dim=1)
    brightness = brightness / brightness.log().mean().exp()
    if observed.spread == EQUAL:
        brightness = torch.ones_like(brightness)
    directions = F.normalize(lights, dim=1)
    pixels = observed.fit(directions, brightness, material, None, 10)
    return LightGuess(directions, brightness, material, pixels)


def _check_outline(inside: Tensor, count: int) -> None:
    """Refuse what does not show where its lights are."""
    if int(inside.sum()) < MIN_PIXELS:
        raise CaptureError(
            "mask",
            expected=f"at least {MIN_PIXELS} pixels, where the lights are not known",
            got=str(int(inside.sum())),
            mend="give a mask of the whole object, or the lights",
        )
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


def _check_lit(grey: Tensor) -> None:
    """Refuse photographs whose lamp did not shine, or all of whose samples are clipped."""
    level = grey.clamp_min(0).mean(0)
    dark = [str(k + 1) for k in (level <= DARK * level.median()).nonzero()[:, 0].tolist()]
    if dark:
        raise CaptureError(
            "images",
            expected="light on the object in every photograph, where the lights are not known",
            got=f"none in {len(dark)} of {grey.shape[1]}: {', '.join(dark[:8])}{' ...' if len(dark) > 8 else ''} "
            "(the first is 1), or nothing but clipped samples",
            mend="leave these out",
        )


def _unequal(grey: Tensor, guess: LightGuess) -> float:
    """How much the brightness of lights taken as equal differs where it may: standard deviation as a share."""
    released = adjust(Observed(grey, USUAL), guess, CONTINUE)
    return float(released.brightness.log().std())


def _check_fit(guess: LightGuess, grey: Tensor, inside: Tensor) -> None:
    """Refuse lights under which the surface does not show what was photographed, or leans against its outline."""
    outline = silhouette_normals(inside[None])[:, inside].T.to(grey)
    rim = outline[:, :2].norm(dim=1) > SLANTED
    outward = F.normalize(guess.pixels.normal[rim, :2], dim=1) * F.normalize(outline[rim, :2], dim=1)
    error = Observed(grey, EQUAL).error(guess)
    reason = ""
    if error > UNLIKE:
        reason = f"photographs that no matt or glossy surface explains (error {error:.0%})"
    elif float(outward.sum(1).mean()) < OUTWARD:
        reason = "a surface that does not lean outward along its outline"
    if reason:
        raise CaptureError(
            "images",
            expected="one object, no metal, that does not move, under lamps far away, where the lights are not known",
            got=reason,
            mend="give the lights (--lights, --chrome), or check the mask",
        )


def _undetermined(uncertainty: float, *, equal: bool) -> CaptureError:
    """What is said of lights that the photographs do not determine."""
    reason = "on one ring or one side, or " if equal else "of unknown brightness, on "
    return CaptureError(
        "images",
        expected=f"photographs that determine their lights within {UNKNOWN:.0f} degrees, where they are not known",
        got=f"lights that stay uncertain by {min(90.0, uncertainty):.0f} degrees: {reason}a surface that is flat or "
        "shows the same to all sides",
        mend="give the lights (--lights, --chrome)"
        + ("" if equal else ", or their brightness (light_intensities.txt)"),
    )


def _describe(guess: LightGuess, errors: tuple[float, float], *, unequal: float | None) -> FoundLights:
    """What was found, what was assumed, and what speaks against it; ``unequal`` is None where nothing was assumed."""
    uncertainty, brightness = math.degrees(errors[0]), guess.brightness
    lights = (
        "equally bright"
        if unequal is not None
        else f"of brightness {float(brightness.min()):.2f} to {float(brightness.max()):.2f} (within {errors[1]:.0%})"
    )
    rough = guess.material.model != "lambert"
    resolved = [] if unequal is None else ["equal brightness"]
    resolved += ["roughness"] if rough else ["highlights"] if guess.material.exponents else []
    text = (
        f"no lights were given: {len(brightness)} directions were found from the photographs, within "
        f"{uncertainty:.1f} degrees, for lights far away and {lights}. The bas-relief ambiguity was resolved by "
        f"{' and '.join(resolved) or 'nothing'}, the rotation by the surface's slopes; that the object bulges toward "
        "the camera was assumed."
    )
    findings = [Finding(text, "lights-found", uncertainty)]
    if unequal is None:
        text = f"the brightness of the lights was found with them, within {errors[1]:.0%}."
        findings.append(Finding(text, "brightness-found", 100 * errors[1]))
    if uncertainty > UNCERTAIN:
        text = (
            f"the directions found are uncertain by {uncertainty:.1f} degrees; photograph a mirror ball under the "
            "lights, or more lights from all around."
        )
        findings.append(Finding(text, "lights-uncertain", uncertainty))
    if unequal is not None and unequal > UNEQUAL:
        text = (
            f"the lights differ in brightness by about {unequal:.0%}: they are not equally bright, and their "
            "directions are not to be trusted; give light_intensities.txt or the lights, or intensities='unknown'."
        )
        findings.append(Finding(text, "lights-unequal", 100 * unequal))
    return FoundLights(guess.directions.float(), brightness.float(), uncertainty, errors[1], tuple(findings))
