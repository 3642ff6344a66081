"""Choose the material that `photometric_stereo` solves with, and say what was found of it."""

from __future__ import annotations

import math
from dataclasses import replace

from torch import Tensor

from ..core.findings import Finding
from ..core.warn import warn
from .material import Material
from .material_refinement import (
    MIN_LIGHTS_HELD_OUT,
    ROUGHNESSES,
    curvature_error,
    find_roughness,
    refine,
    roughness_error,
)
from .material_selection import MaterialChoice, choose_by_held_out_lights
from .pixel_sample import PixelSample
from .roughness_map import RADIUS

STEEP = 1.25
"""Exponent of Minnaert's law above which the encoding of the images is doubted. Set by hand: of 151 measured materials
those under glaze have about 1.1; no script for it is kept."""
IDENTIFIABLE = math.radians(5)
"""Standard error in radians above which a roughness is reported as unknown. Set by hand."""
FRONTAL = math.radians(15)
"""Angle to the view in radians; a roughness is unknown if all lights are nearer to the view. Set by hand."""


def choose_material(sample: PixelSample, model: str, seed: int) -> MaterialChoice:
    """The material for ``model``, which is ``"auto"`` or a name in ``MODELS``, with its numbers and findings."""
    choice = MaterialChoice()
    if model == "auto":
        choice = choose_by_held_out_lights(sample, seed)
        choice = replace(choice, material=refine(sample, choice.material))
    elif model != "lambert":
        choice = replace(choice, material=find_roughness(sample, model))
    material, findings, uncertain = choice.material, list(choice.findings), 0.0
    if material.model != "lambert" and not material.roughness_varies:
        uncertain, found = _judge_roughness(sample, material)
        findings += found
    findings += _falloff_findings(material)
    return replace(choice, findings=tuple(findings), roughness_error=uncertain)


def _judge_roughness(sample: PixelSample, material: Material) -> tuple[float, list[Finding]]:
    """Standard error of the roughness in radians, infinite if the photographs do not determine it, and findings."""
    uncertain, degrees = roughness_error(sample, material), math.degrees(material.roughness)
    limit = " (the end of the search: it may be more)" if material.roughness >= ROUGHNESSES[-1] else ""
    text = (
        f"roughness {degrees:.1f} degrees{limit}, one for the whole capture; standard error "
        f"{math.degrees(uncertain):.1f} degrees."
    )
    findings, directions = [Finding(text, "roughness-found", degrees)], sample.directions
    reasons = []
    if uncertain > IDENTIFIABLE:
        reasons.append("its error is large")
    if len(directions) < MIN_LIGHTS_HELD_OUT:
        reasons.append(f"{len(directions)} lights are few, and noise then looks like a smoother surface")
    if bool((directions.light[..., 2] > math.cos(FRONTAL)).all()):
        reasons.append(f"all lights are within {math.degrees(FRONTAL):.0f} degrees of the view")
    if not reasons:
        return uncertain, findings
    findings.append(Finding(f"take the roughness as unknown: {' and '.join(reasons)}.", "roughness-unreliable"))
    warn(findings[-1])
    return math.inf, findings


def judge_roughness_map(sample: PixelSample, material: Material, found: Tensor) -> tuple[float, Finding]:
    """Standard error of a pixel's roughness in radians, and a finding on the roughnesses (1, P) that were found."""
    some = found[0, :: 1 + found.shape[1] // 2**20]  # torch refuses quantiles of more than 2**24 values
    least, middle, most = some.quantile(found.new_tensor((0.05, 0.5, 0.95))).tolist()
    typical = replace(material, roughness=middle, roughness_varies=False)
    uncertain = curvature_error(sample, typical, (2 * RADIUS + 1) ** 2)
    text = (
        f"roughness differs over the object, from {math.degrees(least):.1f} to {math.degrees(most):.1f} degrees "
        f"(5th and 95th percentile of the pixels); pixels up to {RADIUS} rows and columns apart decide together; "
        f"standard error {math.degrees(uncertain):.1f} degrees from the curvature of the fit."
    )
    return uncertain, Finding(text, "roughness-map", math.degrees(middle))


def _falloff_findings(material: Material) -> list[Finding]:
    """On the exponent of Minnaert's law, where there is one."""
    k = material.minnaert_exponent
    if k == 1:
        return []
    text = f"diffuse light falls off toward grazing angles with exponent {k:.2f}, as under glaze."
    found = [Finding(text, "falloff-found", k)]
    if k > STEEP:
        text = "so large an exponent also comes from linear images that were read as sRGB: check the encoding."
        found.append(Finding(text, "falloff-steep", k))
    return found
