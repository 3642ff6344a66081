"""Photometric stereo: normals, albedo, roughness and highlights from photographs under known lights."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ..core.checks import check_floating
from ..core.defaults import independent_of_defaults
from ..core.errors import CaptureError, ShapeError
from ..core.findings import Finding
from ..core.threads import small_operations
from ..reconstruction import Reconstruction, stack
from ..reflectance.models import get_model
from .broken_frames import find_broken_frames
from .capture_checks import check_directions, check_shapes, find_dark_pixels, find_valid, leave_out
from .interreflection import choose_interreflected_light
from .light_contradiction import check_directions_fit
from .light_frame import check_light_frame
from .light_knowledge import Intensities, doubt_brightness, know_lights
from .material_choice import choose_material, judge_roughness_map
from .material_mixture import choose_mixture, mixture_findings
from .material_refinement import MIN_LIGHTS_HELD_OUT
from .material_selection import MaterialChoice
from .mixed_fit import Mixture
from .near_evidence import check_distant_lights
from .network_solver import NETWORK, TRAINED_LIGHTS, solve_by_network
from .normal_fill import fill_normals
from .pixel_sample import SAMPLE_PIXELS, PixelSample, draw_places, draw_tiles
from .robust_stats import Used
from .row_bands import solve_bands
from .solved_maps import SolvedMaps

WHITE = 1.05
"""Albedo above which a pixel is reported as brighter than white; the excess over 1 allows for noise. Set by hand."""


@torch.no_grad()
@small_operations()
@independent_of_defaults
def photometric_stereo(
    images: Tensor,
    lights: Tensor | None,
    mask: Tensor | None = None,
    *,
    model: str = "auto",
    robust: bool = True,
    intensities: Intensities | Tensor = "equal",
    refine_lights: bool = False,
    valid: Tensor | None = None,
    seed: int = 0,
) -> Reconstruction:
    """Recover normals, albedo, roughness and highlights from images under distant lights, orthographic view.

    The robust solver starts from least squares on each pixel's observations of middle rank that are not in shadow, and
    continues with Gauss-Newton steps under Geman-McClure weights: for ``"lambert"`` on those observations (which leaves
    out highlights), else on all that are not in shadow. With highlights it tries three starts and takes for each pixel
    the one of low cost that agrees with the neighbours. In the last steps the mean normal of the neighbours is a prior,
    whose weight grows with the pixel's misfit. A named model with roughness gets one roughness per capture, of at most
    68 degrees.

    ``auto`` compares four diffuse parts (Lambert; Lambert with Minnaert's falloff, as under glaze; ``vcavity`` with one
    roughness, and with a smooth map of it), each with no, one and two specular lobes, by their error on lights that
    were held out, and takes the simplest within 2 % of the best; a map must gain a tenth to be considered. From 8
    lights on, light between parts of the surface is removed before normals are solved, where that explains hollows
    better; albedo and residual are then those of the remaining light. The albedo that this needs is found from the
    hollows and does not depend on the images' exposure. ``network`` does so too, and takes the surface as Lambertian
    for that.

    From 12 lights on ``auto`` reads the network too, and averages its normals in where they are near and the fit is
    uncertain, except under a map of roughness. From 30 lights on it looks for several materials, and for parts that
    the network's normals explain better than any of them, as on metals: as many as better the error on held-out
    lights. Each pixel then takes what explains it and its neighbours best.

    From 8 photographs on, those that contradict what the others show of the surface are left out and named in the
    report: moved, in the wrong order, or under another light.

    On a CPU numba compiles the fits in float32 for ``lambert``, ``vcavity`` and ``auto``, where it is installed
    (``torch_orennayar[fast]``): the same results to rounding, in a third of the time. Compiling takes about 15
    seconds, once.

    Models with interreflection take albedo in the unit of the images (1 is white), cut to [0, 1]. Not differentiable.
    float64 is solved in float64, all else in float32. The same seed gives the same result on the same machine.

    Args:
        images: (K, C, H, W) or (B, K, C, H, W) linear light; normals come from the mean of the channels.
        lights: (K, 3) or (B, K, 3) unit directions to the lights, camera frame; of near lights maps of each
            pixel's directions, (K, 3, H, W) or (B, K, 3, H, W), as `near_light_stereo` makes them. None where they are
            not known: they are found from the images, by `find_lights`, which needs a mask.
        mask: (1, H, W) or (B, 1, H, W) bool; default all pixels. Outside it images may hold any values.
        model: ``"auto"``, a name in ``MODELS``, which is then used without lobes, or ``"network"``: normals by a small
            network trained on synthetic pixels (12 lights or more), with Lambert's albedo, solved in float32.
        robust: ``False`` is plain least squares over all observations, for ``"lambert"`` only; pixels that fewer than
            three lights reach then keep what it gives, else they continue the normals about them.
        intensities: ``"equal"``, also where images were divided by the lights' brightness; the brightness itself, (K,)
            or (K, C), with B in front in a batch; or ``"unknown"``: it is found, from the shading alone
            under lights that are given, else by `find_lights`.
        refine_lights: whether lights that are given are checked against the images, and replaced where these contradict
            them by degrees; needs a mask, as `find_lights`.
        valid: (K, 1, H, W) or (B, K, 1, H, W) bool, or with C channels: the samples that count, such as
            ``Capture.valid``. Default: all; but where images reach 1, none is brighter and one in a thousand samples
            is exactly 1, these are taken as clipped at full scale.
        seed: draws the pixels and the held-out lights on which roughness and model are decided.

    Returns:
        A `Reconstruction`.

    Raises:
        ShapeError: shapes do not fit together.
        RangeError: NaN inside the mask, or lights that are not unit vectors.
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
    check_floating(images=images, lights=images if lights is None else lights)
    _check_model(model, robust)
    if images.ndim == 5:
        options = {"model": model, "robust": robust, "refine_lights": refine_lights, "seed": seed}
        return _solve_batch(images, lights, mask, intensities, valid, options)
    given = lights is not None and isinstance(intensities, str) and intensities == "equal"
    if images.ndim == 4 and (refine_lights or not given):
        known = know_lights(images, lights, mask, intensities=intensities, refine=refine_lights, valid=valid, seed=seed)
        solved = photometric_stereo(
            known.images, known.lights, mask, model=model, robust=robust, valid=known.valid, seed=seed
        )
        found_or_none = known.lights.float() if lights is None or refine_lights else None
        report = (*known.findings, *solved.report)
        return replace(solved, lights=found_or_none, intensities=known.intensities, report=report)
    assert lights is not None
    return _solve_known(images, lights, mask, model, robust, valid, seed)


def _solve_known(
    images: Tensor,
    lights: Tensor,
    mask: Tensor | None,
    model: str,
    robust: bool,
    valid: Tensor | None,
    seed: int,
) -> Reconstruction:
    """Solve one capture whose lights are known and equally bright."""
    inside = check_shapes(images, lights, mask)
    images, clipped = leave_out(images, find_valid(images, inside, valid), inside)
    dark = find_dark_pixels(images, inside)
    sample = PixelSample.gather(images, lights, draw_places(inside & ~dark, SAMPLE_PIXELS, seed))
    findings = check_directions(sample.directions) + clipped
    if lights.ndim == 2:  # maps of near lights are refined with the surface, and misfit until then
        kept, judged = _judge_lights(sample, inside) if robust else (None, [])
        if kept is not None:
            images, lights, sample = images[kept], lights[kept], sample.under(kept)
        if "lights-contradicted" not in {finding.code for finding in judged}:
            judged += check_light_frame(images, lights, inside)
        findings += judged
    choice = choose_material(sample, model, seed) if robust and model != NETWORK else MaterialChoice()
    choice, mixture = _choose_materials(images, lights, inside & ~dark, choice, seed)
    findings += choice.findings
    material, uncertain = choice.material, choice.roughness_error
    interreflected = None
    if choice.scores or (model == NETWORK and len(images) >= MIN_LIGHTS_HELD_OUT):
        mixed = mixture is not None and mixture.is_mixed
        interreflected, found = choose_interreflected_light(images, lights, inside, material, seed, mixed=mixed)
        findings.append(found)
    if model == NETWORK:
        findings += _network_findings(len(images))
        maps, _ = solve_by_network(images, lights, inside, interreflected=interreflected)
    else:
        maps = solve_bands(images, lights, inside, material, _observations_used(model, robust), interreflected, mixture)
    if mixture is not None:
        findings += mixture_findings(mixture, maps)
        material = mixture.as_one(maps)
    elif material.roughness_varies:
        uncertain, found = judge_roughness_map(sample, material, maps.roughness[:, inside])
        findings.append(found)
    findings += _doubtful_pixels(dark, maps, len(images), material.model)
    unknown = dark if len(images) > 3 else inside
    return Reconstruction(
        normal=fill_normals(maps.normal, dark, inside) if robust and bool(dark.any()) else maps.normal,
        albedo=maps.albedo,
        roughness=maps.roughness,
        residual=maps.residual,
        confidence=maps.confidence.masked_fill_(unknown, 0),
        model=material.model,
        scores=choice.scores,
        report=tuple(findings),
        specular=None if maps.specular is None else maps.specular.unflatten(0, (len(material.exponents), -1)),
        exponents=material.exponents,
        falloff=float(material.minnaert_exponent),
        roughness_error=uncertain,
        material=None if maps.material is None else maps.material - 1,
        falloffs=() if maps.material is None or mixture is None else mixture.falloffs,
    )


def _judge_lights(sample: PixelSample, inside: Tensor) -> tuple[Tensor | None, list[Finding]]:
    """Which photographs do not contradict the others, (K,) bool or None for all, and what pixels say of the lights."""
    findings = check_distant_lights(sample, inside) + doubt_brightness(sample)
    broken, left_out = find_broken_frames(sample)
    findings += left_out
    if not {"lights-near", "lights-unequal"} & {finding.code for finding in findings}:
        findings += check_directions_fit(sample.under(~broken))
    return ~broken if left_out else None, findings


def _choose_materials(
    images: Tensor, lights: Tensor, lit: Tensor, choice: MaterialChoice, seed: int
) -> tuple[MaterialChoice, Mixture | None]:
    """`choose_mixture`, and the choice without what holds for its single material where there is more than that."""
    if not choice.scores:
        return choice, None
    mixture = choose_mixture(PixelSample.gather(images, lights, draw_tiles(lit, seed)), choice, seed)
    if mixture is None or not mixture.is_mixed:
        return choice, mixture
    uncertain = math.inf if any(material.model != "lambert" for material in mixture.materials) else 0.0
    return replace(choice, findings=choice.findings[:1], roughness_error=uncertain), mixture


def _check_model(model: str, robust: bool) -> None:
    """Check that the model exists and can be solved that way."""
    if model not in ("auto", NETWORK):
        get_model(model)
    if not robust and model != "lambert":
        raise CaptureError(
            "robust", expected="True, or model='lambert'", got=f"False with {model!r}", mend="change one of them"
        )


def _observations_used(model: str, robust: bool) -> Used:
    """Lambert's model alone cannot show highlights, and leaves out the observations that may hold them."""
    if not robust:
        return "all"
    return "middle" if model == "lambert" else "lit"


def _network_findings(lights: int) -> list[Finding]:
    """What a user must know of the network's result."""
    text = "normals come from a network trained on synthetic pixels; the albedo is Lambert's under them."
    found = [Finding(text, "network-normals")]
    if lights < TRAINED_LIGHTS:
        text = f"{lights} lights are fewer than the {TRAINED_LIGHTS} that the network was trained on."
        found.append(Finding(text, "network-few-lights", lights))
    return found


def _doubtful_pixels(dark: Tensor, maps: SolvedMaps, lights: int, model: str) -> list[Finding]:
    """Pixels without confidence, and albedo outside the unit of the images."""
    found = []
    count = int(dark.sum())
    if count:
        text = f"{count} pixels are lit by fewer than 3 lights: normals continue those about them, confidence is 0."
        found.append(Finding(text, "dark-pixels", count))
    if lights == 3:
        text = "3 lights leave no observation to check the normals with: all confidence is 0."
        found.append(Finding(text, "three-lights"))
    beyond = int((maps.albedo_grey > WHITE).sum())
    if model != "lambert" and beyond:
        text = (
            f"albedo is above 1 in {beyond} pixels: the images are not in units of white, and interreflection between "
            "facets is computed as for a white surface there."
        )
        found.append(Finding(text, "albedo-above-one", beyond))
    return found


def _solve_batch(
    images: Tensor,
    lights: Tensor | None,
    mask: Tensor | None,
    intensities: Intensities | Tensor,
    valid: Tensor | None,
    options: dict[str, Any],
) -> Reconstruction:
    """Solve one capture after the other: each has its own model and roughness."""
    batch = len(images)
    shared = intensities if isinstance(intensities, str) else None
    each = None if isinstance(intensities, str) else intensities
    given = (("lights", lights, (3, 5)), ("mask", mask, (4,)), ("valid", valid, (5,)), ("intensities", each, (2, 3)))
    for name, value, axes in given:
        if value is not None and (value.ndim not in axes or len(value) != batch):
            raise ShapeError(
                name, expected=f"{batch} captures in a batch", got=str(tuple(value.shape)), mend="stack one per capture"
            )
    found = [
        photometric_stereo(
            images[b],
            None if lights is None else lights[b],
            None if mask is None else mask[b],
            intensities=each[b] if each is not None else shared or "equal",
            valid=None if valid is None else valid[b],
            **options,
        )
        for b in range(batch)
    ]
    if not found:
        raise ShapeError("images", expected="at least one capture", got=str(tuple(images.shape)), mend="add one")
    return stack(found)
