"""Maps of a solved picture, before they become a `Reconstruction`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any

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
        material: (1, H, W) int64, one more than the index of the pixel's material among several, or None.
    """

    normal: Tensor
    albedo: Tensor
    albedo_grey: Tensor
    residual: Tensor
    confidence: Tensor
    roughness: Tensor
    specular: Tensor | None = None
    material: Tensor | None = None

    def tensors(self) -> list[Tensor]:
        """All maps there are, in the order of the arguments."""
        return [value for value in self._all() if value is not None]

    def like(self, tensors: Iterable[Tensor]) -> SolvedMaps:
        """The same maps with other `tensors`."""
        given = iter(tensors)
        maps: list[Any] = [None if value is None else next(given) for value in self._all()]
        return SolvedMaps(*maps)

    def plus(self, other: SolvedMaps) -> SolvedMaps:
        """The maps of other pixels added."""
        return self.like(a + b for a, b in zip(self.tensors(), other.tensors(), strict=True))

    def _all(self) -> list[Tensor | None]:
        return [getattr(self, f.name) for f in fields(self)]
