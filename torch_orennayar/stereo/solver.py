"""Photometric stereo: normals, albedo, roughness and highlights from photographs under known lights."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from ..core.checks import check_floating, check_mask
from ..core.errors import CaptureError, RangeError, ShapeError
from ..core.warn import warn
from ..reconstruction import Reconstruction, stack
from ..reflectance.models import get_model
from ..shading.precision import working_dtype
from . import robust_fit
from .interreflection import InterreflectedLight, choose_interreflected_light
from .material import LightDirections, Material
from .material_selection import (
    IDENTIFIABLE,
    MAX_CONDITION,
    MIN_LIGHTS_HELD_OUT,
    ROUGHNESSES,
    SAMPLE_PIXELS,
    choose,
    condition,
    find_roughness,
    nearby_error,
    refine,
    roughness_error,
)
from .network_solver import NETWORK, TRAINED_LIGHTS, solve_network
from .roughness_map import RADIUS
from .row_bands import band_height, gather, gather_directions, solve_bands

STEEP = 1.25
"""Surfaces seldom fall off with a larger exponent: of 151 measured materials those under glaze have about 1.1."""
FRONTAL = math.radians(15)


@torch.no_grad()
def photometric_stereo(
    images: Tensor,
    lights: Tensor,
    mask: Tensor | None = None,
    *,
    model: str = "auto",
    robust: bool = True,
    seed: int = 0,
) -> Reconstruction:
    """Recover normals, albedo, roughness and highlights from images under known distant lights, orthographic view.

    The robust solver starts from least squares on each pixel's observations in light and of middle rank, and
    goes on with Gauss-Newton steps under Geman-McClure weights: for ``"lambert"`` on those (which leave
    out highlights), else on all that are not in shadow. With highlights it begins from three starts and takes
    what costs little and agrees with the neighbours. In the last steps the neighbours' normals pull at pixels, the
    more the worse these fit. A named model with roughness gets one roughness per capture, of at most 68 degrees.

    ``auto`` weighs four diffuse parts (Lambert; Lambert with Minnaert's falloff, as under glaze; ``vcavity`` with one
    roughness, and with a smooth map of it), each with no, one and two specular lobes, by their error on lights that
    were held out, and takes the simplest within 2 % of the best; a map must gain a tenth to be weighed at all. Where
    hollows are explained better by it, light that parts of the surface send each other is taken away before normals are
    solved (from 8 lights on); albedo and residual are then those of what is left. How white the surface is for that is
    told by the hollows, whatever the images' exposure. ``network`` does so too, and calls the surface matt for that.

    Models with inter-reflection take albedo in the unit of the images (1 is white), cut to [0, 1]. Not
    differentiable. float64 is solved in float64, all else in float32. The same seed gives the same
    result on the same machine.

    Args:
        images: (K, C, H, W) or (B, K, C, H, W) linear light, intensities divided out; normals come from
            the mean of the channels.
        lights: (K, 3) or (B, K, 3) unit directions to the lights, camera frame; of near lights maps of each
            pixel's directions, (K, 3, H, W) or (B, K, 3, H, W), as `near_light_stereo` makes them.
        mask: (1, H, W) or (B, 1, H, W) bool; default all pixels. Outside it images may hold anything.
        model: ``"auto"``, a name in ``MODELS``, which is then used without lobes, or ``"network"``: normals by a small
            network trained on made-up pixels (12 lights or more), with Lambert's albedo, solved in float32.
        robust: ``False`` is plain least squares over all observations, for ``"lambert"`` only.
        seed: picks the pixels and the held-out lights on which roughness and model are decided.

    Returns:
        A `Reconstruction`.

    Raises:
        ShapeError: shapes do not fit together.
        RangeError: NaN inside the mask, or lights that are no unit vectors.
        CaptureError: fewer than 3 lights, lights nearly in one plane or mostly behind the object, an
            empty mask, no pixel that three lights reach, too few lights for a roughness.
        ModelError: unknown model.

    Source:
        Woodham 1980, "Photometric method for determining surface orientation from multiple images";
        weights of Geman & McClure 1987; falloff of Minnaert 1941; lobes of Blinn 1977.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> lights = torch.nn.functional.normalize(torch.tensor([[0.0, 0, 1], [1, 0, 2], [-1, 1, 2]]), dim=-1)
        >>> normal = torch.tensor([0.0, 0.6, 0.8]).reshape(1, 3, 1, 1)
        >>> images = ton.OrenNayar("lambert")(normal, lights[None], albedo=0.5)[0]
        >>> found = ton.photometric_stereo(images, lights, model="lambert")
        >>> [round(v, 3) for v in found.normal.flatten().tolist()], round(found.albedo.item(), 3)
        ([0.0, 0.6, 0.8], 0.5)
    """
    check_floating(images=images, lights=lights)
    if model not in ("auto", NETWORK):
        get_model(model)
    if not robust and model != "lambert":
        raise CaptureError(
            "robust", expected="True, or model='lambert'", got=f"False with {model!r}", mend="change one of them"
        )
    if images.ndim == 5:
        return _solve_batch(images, lights, mask, model, robust, seed)
    inside = _check(images, lights, mask)
    report: list[str] = []
    dark = _validate_and_find_dark(images, inside)
    picked = _sample(dark, inside, seed)
    seen_by = LightDirections.of(gather_directions(lights, picked).to(working_dtype(images.dtype)))
    _check_lights(seen_by.typical(), report)
    scores: dict[str, float] = {}
    material, used, uncertain = Material(), "middle" if robust else "all", 0.0
    if robust and model != NETWORK:
        sample = gather(images, picked)
        if model == "auto":
            places = torch.stack((picked // inside.shape[1], picked % inside.shape[1]), 1)
            chosen = choose(sample, places, seen_by, seed)
            scores = chosen.scores
            report.append(chosen.reason)
            material = refine(sample, seen_by, chosen.material)
        elif model != "lambert":
            material = find_roughness(sample, seen_by, model)
        if material.model != "lambert" and not material.varied:
            uncertain = _report_roughness(sample, seen_by, material, report)
        used = "middle" if model == "lambert" else "lit"
        _report_falloff(material, report)
    interreflected: InterreflectedLight | None = None
    if scores or (model == NETWORK and len(images) >= MIN_LIGHTS_HELD_OUT):
        interreflected, told = choose_interreflected_light(images, lights, inside, material, seed)
        report.append(told)
    if model == NETWORK:
        report.append("normals by a network trained on made-up pixels; albedo is Lambert's under them.")
        if len(images) < TRAINED_LIGHTS:
            report.append(f"{len(images)} lights are fewer than the {TRAINED_LIGHTS} that it was trained on.")
        maps = solve_network(images, lights, inside, interreflected=interreflected)
    else:
        maps = solve_bands(
            images, lights, inside, material, used, interreflected.removed_from if interreflected else None
        )
        if material.varied:
            uncertain = _report_map(sample, seen_by, material, maps["roughness"][:, inside], report)
    _report_doubts(dark, maps, len(images), material.model, report)
    hopeless = dark if len(images) > 3 else inside
    return Reconstruction(
        normal=maps["normal"],
        albedo=maps["albedo"],
        roughness=maps["roughness"],
        residual=maps["residual"],
        confidence=maps["confidence"].masked_fill_(hopeless, 0),
        model=material.model,
        scores=scores,
        report=tuple(report),
        specular=maps["specular"].unflatten(0, (len(material.exponents), -1)) if material.exponents else None,
        exponents=material.exponents,
        falloff=float(material.falloff),
        roughness_error=uncertain,
    )


def _report_roughness(sample: Tensor, rays: LightDirections, material: Material, report: list[str]) -> float:
    """Say what roughness was found, and how well the photographs tell it; its standard error."""
    uncertain = roughness_error(sample, rays, material)
    limit = " (the end of the search: it may be more)" if material.roughness >= ROUGHNESSES[-1] else ""
    report.append(
        f"roughness {math.degrees(material.roughness):.1f} degrees{limit}, one for the whole capture; standard error "
        f"{math.degrees(uncertain):.1f} degrees from the curvature of the fit."
    )
    reasons = []
    if uncertain > IDENTIFIABLE:
        reasons.append("its error is large")
    if len(rays) < MIN_LIGHTS_HELD_OUT:
        reasons.append(f"{len(rays)} lights are few, and noise then passes for a smoother surface")
    if bool((rays.light[..., 2] > math.cos(FRONTAL)).all()):
        reasons.append(f"all lights are within {math.degrees(FRONTAL):.0f} degrees of the view")
    if reasons:
        report.append(f"take the roughness as unknown: {' and '.join(reasons)}.")
        warn(report[-1])
        return math.inf
    return uncertain


def _report_map(sample: Tensor, rays: LightDirections, material: Material, found: Tensor, report: list[str]) -> float:
    """Say which roughnesses (1, P) were found; the standard error of a pixel's."""
    some = found[0, :: 1 + found.shape[1] // 2**20]  # quantiles of very many are refused
    least, middle, most = some.quantile(found.new_tensor((0.05, 0.5, 0.95))).tolist()
    typical = replace(material, roughness=middle, varied=False)
    uncertain = nearby_error(sample, rays, typical, (2 * RADIUS + 1) ** 2)
    report.append(
        f"roughness differs over the object, from {math.degrees(least):.1f} to {math.degrees(most):.1f} degrees (5 % "
        f"and 95 % of the pixels): found for every pixel together with those up to {RADIUS} rows and columns away; "
        f"standard error {math.degrees(uncertain):.1f} degrees from the curvature of the fit."
    )
    return uncertain


def _report_falloff(material: Material, report: list[str]) -> None:
    if material.falloff == 1:
        return
    report.append(f"matt light falls off toward grazing with exponent {material.falloff:.2f}, as under glaze.")
    if material.falloff > STEEP:
        report.append("a falloff as steep as this also comes from linear images read as sRGB: check the encoding.")


def _validate_and_find_dark(images: Tensor, inside: Tensor) -> Tensor:
    """Where fewer than three observations are clearly above zero, (H, W) bool; all must be finite."""
    rows = band_height(len(images), inside)
    dark = torch.zeros_like(inside)
    broken = 0
    for top in range(0, len(inside), rows):
        part = inside[top : top + rows]
        grey = gather(images[:, :, top : top + rows], part.flatten())
        broken += int((~grey.isfinite()).any(1).sum())
        level = robust_fit.SHADOW * grey.amax(1, keepdim=True)
        dark[top : top + rows][part] = (grey > level.clamp_min(0)).sum(1) < 3
    if broken:
        raise RangeError(
            "images",
            expected="finite values inside the mask",
            got=f"NaN or infinity in {broken} pixels",
            mend="take those pixels out of the mask",
        )
    if bool((dark == inside).all()):
        raise CaptureError(
            "images",
            expected="pixels that at least 3 lights reach",
            got="none inside the mask",
            mend="check exposure, mask and the order of the lights",
        )
    return dark


def _report_doubts(dark: Tensor, maps: dict[str, Tensor], lights: int, model: str, report: list[str]) -> None:
    """Pixels that get no confidence, and albedo outside the unit of the images."""
    if bool(dark.any()):
        report.append(f"{int(dark.sum())} pixels are lit by fewer than 3 lights; their confidence is 0.")
    if lights == 3:
        report.append("3 lights leave no observation to check the normals with: all confidence is 0.")
    beyond = int((maps["albedo_grey"] > 1.05).sum())
    if model != "lambert" and beyond:
        report.append(
            f"albedo is above 1 in {beyond} pixels: images are not in units of white, and light between facets "
            "is taken as of a white surface there."
        )


def _solve_batch(
    images: Tensor, lights: Tensor, mask: Tensor | None, model: str, robust: bool, seed: int
) -> Reconstruction:
    """One capture after the other: each has its own model and roughness."""
    batch = len(images)
    for name, value, axes in (("lights", lights, (3, 5)), ("mask", mask, (4,))):
        if value is not None and (value.ndim not in axes or len(value) != batch):
            raise ShapeError(
                name, expected=f"{batch} captures in a batch", got=str(tuple(value.shape)), mend="stack one per capture"
            )
    found = [
        photometric_stereo(
            images[b], lights[b], None if mask is None else mask[b], model=model, robust=robust, seed=seed
        )
        for b in range(batch)
    ]
    if not found:
        raise ShapeError("images", expected="at least one capture", got=str(tuple(images.shape)), mend="add one")
    return stack(found)


def _check(images: Tensor, lights: Tensor, mask: Tensor | None) -> Tensor:
    """Shapes and units; the mask as (H, W) bool."""
    if images.ndim != 4 or 0 in images.shape:
        raise ShapeError("images", expected="(K, C, H, W)", got=str(tuple(images.shape)), mend="stack the images")
    size = tuple(images.shape[-2:])
    wanted = (len(images), 3)
    if tuple(lights.shape) not in (wanted, (*wanted, *size)):
        raise ShapeError(
            "lights", expected=f"{wanted} or {(*wanted, *size)}", got=str(tuple(lights.shape)), mend="one per image"
        )
    return check_mask(mask, images)[0]


def _check_lights(lights: Tensor, report: list[str]) -> None:
    """Lights must be in front and span space: warn from a condition number of 10, refuse above 30."""
    behind = int((lights[:, 2] <= 0).sum())
    if 2 * behind > len(lights):
        raise CaptureError(
            "lights",
            expected="most lights on the camera's side (z > 0: x right, y up, z toward the camera)",
            got=f"{behind} of {len(lights)} behind the object",
            mend="use swap_opencv_frame if they are in OpenCV's frame",
        )
    if len(lights) < 3:
        raise CaptureError("lights", expected="at least 3", got=str(len(lights)), mend="photograph under more lights")
    spanned = condition(lights)
    if spanned > MAX_CONDITION:
        raise CaptureError(
            "lights",
            expected="directions that span space (condition number up to 30)",
            got=f"{spanned:.3g}" if spanned < 1e6 else "directions in one plane",
            mend="photograph under lights from more directions",
        )
    if spanned > 10:
        report.append(f"lights lie close together (condition number {spanned:.1f}): noise is amplified.")
        warn(report[-1])


def _sample(dark: Tensor, inside: Tensor, seed: int) -> Tensor:
    """Indices of the pixels that decide, drawn among those that are lit."""
    lit = (inside & ~dark).flatten().nonzero().flatten()
    generator = torch.Generator().manual_seed(seed)
    return lit[torch.randperm(len(lit), generator=generator)[:SAMPLE_PIXELS].to(lit.device)]
