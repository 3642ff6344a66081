"""What a solver found: maps, the material, and pictures of it under other lights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from .core.errors import ShapeError
from .core.findings import Finding
from .reflectance.specular import blinn_phong
from .shading.layer import OrenNayar

HALF_CONFIDENCE = math.radians(2)
"""Standard error of a normal, radians, at which its confidence is 1/2. Set by hand."""


def confidence_from_error(error: Tensor) -> Tensor:
    """Confidence in [0, 1] of normals with a standard error in radians; 0 for an infinite one."""
    return 1 / (1 + (error / HALF_CONFIDENCE) ** 2)


@dataclass(frozen=True)
class Reconstruction:
    """What a solver found; every tensor has B in front for batched input.

    Attributes:
        normal: (3, H, W) unit normals in the camera frame, 0 outside the mask.
        albedo: (C, H, W) linear, in the unit of the images, 0 outside the mask.
        roughness: (1, H, W) radians, 0 for a Lambertian result and outside the mask; one number, or a smooth map where
            the photographs ask for it.
        residual: (1, H, W) mean absolute difference of grey observation and model over all lights; light between parts
            of the surface that was taken away (``report`` says so) is no longer in the observation.
        confidence: (1, H, W) in [0, 1]: ``1 / (1 + (e / 2 deg)**2)`` with e the standard error of the
            normal that the fit's curvature and residuals predict, where misfit that neighbours share counts
            as one observation; 0 outside the mask and where a pixel does not determine its normal.
        model: the diffuse model in use (one per capture of a batch, as a tuple).
        scores: error of every kind of material on held-out lights as a share of the pixel's mean, plus a
            tenth of the angle (radians) between the normals of two fits, lower is better; empty where
            nothing was chosen (one per capture of a batch, as a tuple).
        report: what happened, one sentence each: pixels that could not be solved, warnings, the choice.
        specular: (L, C, H, W) strengths of L `blinn_phong` lobes, or None; captures of a batch share the
            larger L.
        exponents: of the lobes (one tuple per capture of a batch; a lobe that a capture has not is 0).
        falloff: exponent k of Minnaert's law, the diffuse part times ``(n.l n.v)**(k - 1)``; 1 for none (one
            per capture of a batch, as a tuple).
        roughness_error: standard error of the roughness in radians (of a map: of a pixel's), by the fit's curvature and
            by how far parts of the pixels differ; 0 without a roughness, infinite where these photographs do not tell
            it (few lights, all near the view); one per capture of a batch, as a tuple.
        depth: None from photometric stereo; `integrate_normals` gives it.
        ambient: (1, H, W) light from all around as a share of the light, given or found, 0 outside the mask; `shade`
            leaves it out. None from photometric stereo.
    """

    normal: Tensor
    albedo: Tensor
    roughness: Tensor
    residual: Tensor
    confidence: Tensor
    model: str | tuple[str, ...]
    scores: dict[str, float] | tuple[dict[str, float], ...]
    report: tuple[Finding, ...]
    specular: Tensor | None = None
    exponents: tuple[Any, ...] = ()
    falloff: float | tuple[float, ...] = 1.0
    roughness_error: float | tuple[float, ...] = 0.0
    depth: Tensor | None = None
    ambient: Tensor | None = None

    def shade(self, lights: Tensor) -> Tensor:
        """Relight an unbatched result: what it shows under other distant lights, seen from the front.

        Args:
            lights: (K, 3) unit directions, camera frame.

        Returns:
            (K, C, H, W) linear light, 0 outside the mask.

        Example:
            >>> import torch, torch_orennayar as ton
            >>> lights = torch.nn.functional.normalize(torch.tensor([[0.0, 0, 1], [1, 0, 2], [-1, 1, 2]]), dim=-1)
            >>> found = ton.photometric_stereo(torch.full((3, 1, 2, 2), 0.5), lights, model="lambert")
            >>> found.shade(lights[:1]).shape
            torch.Size([1, 1, 2, 2])
        """
        if not isinstance(self.model, str) or not isinstance(self.falloff, float):
            raise ShapeError("self", expected="one capture", got="a batch", mend="take the captures one by one")
        images = []
        for light in lights.to(self.normal):
            layer = OrenNayar(self.model)
            image = layer(self.normal[None], light[None], albedo=self.albedo[None], roughness=self.roughness[None])[0]
            ci = torch.einsum("chw,c->hw", self.normal, light).clamp_min(0)[None]
            co = self.normal[2:].clamp_min(0)
            if self.falloff != 1:
                image = image * (ci * co) ** (self.falloff - 1)
            if self.specular is not None:
                for strength, exponent in zip(self.specular, self.exponents, strict=True):
                    image = image + strength * blinn_phong(ci, co, light[2].expand_as(ci), float(exponent)) * ci
            images.append(image)
        return torch.stack(images)


def stack(found: Sequence[Reconstruction]) -> Reconstruction:
    """Results of several captures of one size as a batch; captures with fewer lobes get lobes of strength 0."""
    most = max(len(r.exponents) for r in found)
    lobes = None
    if most:
        lobes = torch.stack([r.albedo.new_zeros(most, *r.albedo.shape) for r in found])
        for row, r in zip(lobes, found, strict=True):
            if r.specular is not None:
                row[: len(r.specular)] = r.specular
    maps = ("normal", "albedo", "roughness", "residual", "confidence")
    each = ("model", "scores", "exponents", "falloff", "roughness_error")
    values: dict[str, Any] = {name: torch.stack([getattr(r, name) for r in found]) for name in maps}
    values |= {name: tuple(getattr(r, name) for r in found) for name in each}
    return Reconstruction(
        **values,
        specular=lobes,
        report=tuple(
            Finding(f"capture {b}: {line}", line.code, line.value) for b, r in enumerate(found) for line in r.report
        ),
    )
