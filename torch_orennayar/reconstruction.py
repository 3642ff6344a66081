"""What a solver found: maps, the material, and pictures of it under other lights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NoReturn

import torch
from torch import Tensor

from .core.errors import ShapeError
from .core.findings import Finding
from .reflectance.specular import blinn_phong
from .shading.layer import OrenNayar

HALF_CONFIDENCE = math.radians(2)
"""Standard error of a normal, radians, at which its confidence is 1/2. Set by hand."""


@dataclass(frozen=True)
class Reconstruction:
    """What a solver found for one capture or picture; of a batch the solvers return a `BatchReconstruction`.

    Attributes:
        normal: (3, H, W) unit normals in the camera frame, 0 outside the mask.
        albedo: (C, H, W) linear, in the unit of the images, 0 outside the mask.
        roughness: (1, H, W) radians, 0 for a Lambertian result and outside the mask; one number, or a smooth map where
            the photographs show that it differs.
        residual: (1, H, W) mean absolute difference of grey observation and model over all lights; light between parts
            of the surface that was removed (finding ``interreflection-removed``) is no longer in the observation.
        confidence: (1, H, W) in [0, 1]: ``1 / (1 + (e / 2 deg)**2)`` with e the standard error of the
            normal that the fit's curvature and residuals predict, where misfit that neighbours share counts
            as one observation; 0 outside the mask and where a pixel does not determine its normal.
        model: name of the diffuse model in use.
        scores: error of every kind of material on held-out lights as a share of the pixel's mean, plus a
            tenth of the angle (radians) between the normals of two fits, lower is better; empty where
            nothing was chosen.
        report: `Finding` objects, one sentence each: the choice of a model, what the input does not determine, pixels
            that could not be solved.
        specular: (L, C, H, W) strengths of L `blinn_phong` lobes, or None.
        exponents: of the L lobes.
        falloff: exponent k of Minnaert's law, the diffuse part times ``(n.l n.v)**(k - 1)``; 1 for none.
        roughness_error: standard error of the roughness in radians (of a map: of a pixel's), by the fit's curvature and
            by how far parts of the pixels differ; 0 without a roughness, infinite where the photographs do not
            determine it (few lights, or all near the view), and of several materials.
        depth: (1, H, W); None from photometric stereo under distant lights, where `integrate_normals` gives it.
        ambient: (1, H, W) light from all around as a share of the light, given or estimated, 0 outside the mask;
            `shade` leaves it out. None from photometric stereo.
        lights: (K, 3) unit directions that were found where none were given, or refined; else None.
        intensities: (K, 1) or (K, C) brightness of the lights by which it divided the images; None where that was 1.
        material: (1, H, W) int64 index of each pixel's material where photometric stereo found several, -1 outside the
            mask; the finding ``materials`` describes them. ``model`` is then ``"lambert"`` only if all are,
            ``exponents`` are those of all, and ``falloff`` is that of most pixels. None for one material.
        falloffs: exponent k of each material; empty for one.
    """

    normal: Tensor
    albedo: Tensor
    roughness: Tensor
    residual: Tensor
    confidence: Tensor
    model: str
    scores: dict[str, float]
    report: tuple[Finding, ...]
    specular: Tensor | None = None
    exponents: tuple[int, ...] = ()
    falloff: float = 1.0
    roughness_error: float = 0.0
    depth: Tensor | None = None
    ambient: Tensor | None = None
    lights: Tensor | None = None
    intensities: Tensor | None = None
    material: Tensor | None = None
    falloffs: tuple[float, ...] = ()

    def shade(self, lights: Tensor) -> Tensor:
        """Relight the result: what it shows under other distant lights, seen from the front.

        Args:
            lights: (K, 3) unit directions, camera frame.

        Returns:
            (K, C, H, W) linear light, 0 outside the mask.

        Raises:
            ShapeError: the result is that of a batch.

        Example:
            >>> import torch, torch_orennayar as ton
            >>> lights = torch.nn.functional.normalize(torch.tensor([[0.0, 0, 1], [1, 0, 2], [-1, 1, 2]]), dim=-1)
            >>> found = ton.photometric_stereo(torch.full((3, 1, 2, 2), 0.5), lights, model="lambert")
            >>> found.shade(lights[:1]).shape
            torch.Size([1, 1, 2, 2])
        """
        images = []
        for light in lights.to(self.normal):
            layer = OrenNayar(self.model)
            image = layer(self.normal[None], light[None], albedo=self.albedo[None], roughness=self.roughness[None])[0]
            ci = torch.einsum("chw,c->hw", self.normal, light).clamp_min(0)[None]
            co = self.normal[2:].clamp_min(0)
            if self.material is not None:
                falloff = image.new_tensor((*self.falloffs, 1.0))[self.material]  # the last is that outside the mask
                image = image * (ci * co) ** (falloff - 1)
            elif self.falloff != 1:
                image = image * (ci * co) ** (self.falloff - 1)
            if self.specular is not None:
                for strength, exponent in zip(self.specular, self.exponents, strict=True):
                    image = image + strength * blinn_phong(ci, co, light[2].expand_as(ci), float(exponent)) * ci
            images.append(image)
        return torch.stack(images)


@dataclass(frozen=True)
class BatchReconstruction(Reconstruction):
    """What a solver found for a batch: every tensor has B in front, every other field is a tuple with one per capture.

    Attributes:
        model: one name per capture.
        scores: one dictionary per capture.
        report: all findings; their sentences begin with "capture b: ".
        specular: (B, L, C, H, W), L the largest number of lobes; strengths of lobes that a capture lacks are 0.
        exponents: one tuple per capture.
        falloff: one exponent per capture.
        roughness_error: radians, one per capture.
        falloffs: exponents of each capture's materials; ``material`` is None unless all captures hold several.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> lights = torch.nn.functional.normalize(torch.tensor([[0.0, 0, 1], [1, 0, 2], [-1, 1, 2]]), dim=-1)
        >>> images = torch.full((2, 3, 1, 4, 4), 0.5)
        >>> found = ton.photometric_stereo(images, lights.expand(2, 3, 3), model="lambert")
        >>> isinstance(found, ton.BatchReconstruction), found.model, tuple(found.normal.shape)
        (True, ('lambert', 'lambert'), (2, 3, 4, 4))
    """

    # A static type cannot tell a batch by its number of axes: the solvers' type is that of one capture, and who solves
    # batches narrows it with isinstance.
    model: tuple[str, ...]  # type: ignore[assignment]
    scores: tuple[dict[str, float], ...]  # type: ignore[assignment]
    exponents: tuple[tuple[int, ...], ...] = ()  # type: ignore[assignment]
    falloff: tuple[float, ...] = ()  # type: ignore[assignment]
    roughness_error: tuple[float, ...] = ()  # type: ignore[assignment]
    falloffs: tuple[tuple[float, ...], ...] = ()  # type: ignore[assignment]

    def shade(self, lights: Tensor) -> NoReturn:
        """A batch cannot be relit as one.

        Raises:
            ShapeError: always.
        """
        raise ShapeError("self", expected="one capture", got="a batch", mend="take the captures one by one")


def confidence_from_error(error: Tensor) -> Tensor:
    """Confidence in [0, 1] of normals with a standard error in radians; 0 for an infinite one."""
    return 1 / (1 + (error / HALF_CONFIDENCE) ** 2)


def stack(found: Sequence[Reconstruction]) -> BatchReconstruction:
    """Results of several captures of one size as a batch; captures with fewer lobes get lobes of strength 0."""
    most = max(len(r.exponents) for r in found)
    lobes = None
    if most:
        lobes = torch.stack([r.albedo.new_zeros(most, *r.albedo.shape) for r in found])
        for row, r in zip(lobes, found, strict=True):
            if r.specular is not None:
                row[: len(r.specular)] = r.specular
    return BatchReconstruction(
        normal=torch.stack([r.normal for r in found]),
        albedo=torch.stack([r.albedo for r in found]),
        roughness=torch.stack([r.roughness for r in found]),
        residual=torch.stack([r.residual for r in found]),
        confidence=torch.stack([r.confidence for r in found]),
        model=tuple(r.model for r in found),
        scores=tuple(r.scores for r in found),
        report=tuple(
            Finding(f"capture {b}: {finding}", finding.code, finding.value)
            for b, r in enumerate(found)
            for finding in r.report
        ),
        specular=lobes,
        exponents=tuple(r.exponents for r in found),
        falloff=tuple(r.falloff for r in found),
        roughness_error=tuple(r.roughness_error for r in found),
        depth=_stack_known([r.depth for r in found]),
        ambient=_stack_known([r.ambient for r in found]),
        lights=_stack_known([r.lights for r in found]),
        intensities=_stack_known([r.intensities for r in found]),
        material=_stack_known([r.material for r in found]),
        falloffs=tuple(r.falloffs for r in found),
    )


def _stack_known(values: Sequence[Tensor | None]) -> Tensor | None:
    """The values stacked, or None where one is missing."""
    known = [value for value in values if value is not None]
    return torch.stack(known) if len(known) == len(values) else None
