"""What ``result.json`` of one reconstruction holds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypedDict

import numpy as np

from ..core.findings import Finding
from ..reconstruction import Reconstruction
from .capture import Capture
from .result_maps import ResultMaps
from .verdict import Verdict


class FindingEntry(TypedDict):
    """One `Finding`: its stable code, its value or None, and the sentence."""

    code: str
    value: float | None
    text: str


class ResultNumbers(TypedDict):
    """The content of ``result.json``.

    ``scores`` and ``exponents`` are those of `Reconstruction`; ``roughness_degrees`` is the largest and
    ``roughness_range_degrees`` the 5th and 95th percentile; ``roughness_error_degrees`` is None where the photographs
    do not determine the roughness; ``depth_step`` is the step in pixels between the samples of depth and mesh;
    ``height_unit`` is that of ``height.exr`` and ``mesh.ply``, and ``pixel_mm`` the size of a pixel where it is known;
    ``albedo_exposure`` is the factor of the albedo in ``albedo.png``, and ``verdict`` one of good, look and doubtful;
    ``normal_error_degrees`` is `AngularError.summary` where true normals are known; ``seconds`` is the time to solve;
    ``report`` holds the sentences of loader and solver, ``findings`` those of them that have a code.
    """

    title: str
    images: int
    pixels: int
    model: str
    scores: dict[str, float]
    roughness_degrees: float
    roughness_range_degrees: list[float]
    roughness_error_degrees: float | None
    falloff: float
    exponents: list[int]
    depth_step: int
    height_unit: str
    pixel_mm: float | None
    albedo_exposure: float
    verdict: str
    normal_error_degrees: dict[str, float] | None
    seconds: float | None
    report: list[str]
    findings: list[FindingEntry]


def result_numbers(
    found: Reconstruction,
    capture: Capture,
    maps: ResultMaps,
    *,
    title: str,
    trust: Verdict,
    seconds: float | None,
    pixel_mm: float | None = None,
) -> ResultNumbers:
    """The numbers of one result."""
    error = found.roughness_error
    inside = np.degrees(maps.roughness[maps.mask].numpy())
    report = (*capture.notes, *found.report)
    return {
        "title": title,
        "images": len(capture.lights),
        "pixels": int(maps.mask.sum()),
        "model": found.model,
        "scores": found.scores,
        "roughness_degrees": math.degrees(maps.roughness.max().item()),
        "roughness_range_degrees": np.percentile(inside, (5, 95)).round(2).tolist(),
        "roughness_error_degrees": math.degrees(error) if math.isfinite(error) else None,  # JSON has no infinity
        "falloff": found.falloff,
        "exponents": list(found.exponents),
        "depth_step": maps.step,
        "height_unit": "pixels" if pixel_mm is None else "millimetres",
        "pixel_mm": pixel_mm,
        "albedo_exposure": 1 / maps.display_top,
        "verdict": trust.word,
        "normal_error_degrees": None if maps.error is None else maps.error.summary(),
        "seconds": seconds,
        "report": [str(entry) for entry in report],
        "findings": finding_entries(report),
    }


def finding_entries(report: Sequence[str]) -> list[FindingEntry]:
    """The findings in ``report`` as ``result.json`` holds them."""
    found = [entry for entry in report if isinstance(entry, Finding)]
    return [{"code": entry.code, "value": entry.value, "text": str(entry)} for entry in found]
