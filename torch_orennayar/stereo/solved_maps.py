"""Maps of a solved picture, before they become a `Reconstruction`."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class SolvedMaps:
    """Maps of one picture, or of a band of its rows, 0 outside the mask.

    Attributes:
        normal: (3, H, W) unit.
        albedo: (C, H, W).
        albedo_grey: (1, H, W) that of the grey observations.
        residual: (1, H, W) mean absolute difference of grey observations and model.
        confidence: (1, H, W) in [0, 1].
        roughness: (1, H, W) radians.
        specular: (L C, H, W) strengths of L `blinn_phong` lobes, lobe by lobe, or None.
    """

    normal: Tensor
    albedo: Tensor
    albedo_grey: Tensor
    residual: Tensor
    confidence: Tensor
    roughness: Tensor
    specular: Tensor | None = None

    def tensors(self) -> list[Tensor]:
        """All maps in the order of the arguments, without ``specular`` where there is none."""
        maps = [self.normal, self.albedo, self.albedo_grey, self.residual, self.confidence, self.roughness]
        return maps if self.specular is None else [*maps, self.specular]
