"""The maps of one reconstruction on the CPU: as stored, as drawn, and as a mesh."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from ..core.errors import ShapeError
from ..geometry.integrate import integrate_normals
from ..geometry.mesh import depth_to_mesh
from ..geometry.mesh_files import save_mesh
from ..geometry.metrics import AngularError, angular_error
from ..reconstruction import BatchReconstruction, Reconstruction
from .capture import Capture
from .figures import save_maps
from .srgb import linear_to_srgb

MAX_DEPTH_PIXELS = 4_000_000
"""Pixels of the object above which depth and mesh are made at a fraction of the resolution; set by hand, for memory."""
EXACT_QUANTILE_PIXELS = 10_000_000
"""Pixels from which the display albedo is scaled by the maximum: `torch.quantile` takes at most 16 million values."""


@dataclass(frozen=True)
class ResultMaps:
    """The maps of an unbatched `Reconstruction`, on the CPU.

    Attributes:
        normal, albedo, roughness, residual, confidence, specular: as in `Reconstruction`.
        mask: (1, H, W) bool.
        error: (1, H, W) angular error in degrees against the true normals, or None.
        depth: (1, H / step, W / step) height toward the viewer in pixels.
        step: depth and mesh take every ``step``-th pixel.
        display_albedo: albedo over ``display_top``, cut to [0, 1]: the exposure of a capture is seldom known.
        display_top: the 99th percentile of the albedo.
        material: (1, H, W) as in `Reconstruction`, or None.
    """

    normal: Tensor
    albedo: Tensor
    roughness: Tensor
    residual: Tensor
    confidence: Tensor
    mask: Tensor
    specular: Tensor | None
    error: AngularError | None
    depth: Tensor
    step: int
    display_albedo: Tensor
    display_top: float
    material: Tensor | None = None

    @staticmethod
    def of(found: Reconstruction, capture: Capture) -> ResultMaps:
        """The maps of ``found``, integrated to depth where it has none.

        Raises:
            ShapeError: ``found`` is a batch.
        """
        if isinstance(found, BatchReconstruction):
            mend = "write the results of a batch one by one"
            raise ShapeError("found", expected="one capture", got="a batch", mend=mend)
        mask, normal = capture.mask.cpu(), found.normal.cpu()
        depth, step = (found.depth.cpu(), 1) if found.depth is not None else _integrate(normal, mask)
        display_albedo, top = _scale_for_display(found.albedo.cpu(), mask)
        return ResultMaps(
            normal=normal,
            albedo=found.albedo.cpu(),
            roughness=found.roughness.cpu(),
            residual=found.residual.cpu(),
            confidence=found.confidence.cpu(),
            mask=mask,
            specular=None if found.specular is None else found.specular.cpu(),
            error=None if capture.normal is None else angular_error(normal, capture.normal, mask),
            depth=depth,
            step=step,
            display_albedo=display_albedo,
            display_top=top,
            material=None if found.material is None else found.material.cpu(),
        )

    def arrays(self) -> dict[str, Tensor]:
        """What is stored as ``.npy``, by file name without suffix."""
        names = ("normal", "albedo", "roughness", "residual", "confidence", "depth")
        arrays: dict[str, Tensor] = {name: getattr(self, name) for name in names}
        if self.error is not None:
            arrays["error"] = self.error.as_subclass(torch.Tensor)
        if self.specular is not None:
            arrays["specular"] = self.specular
        if self.material is not None:
            arrays["material"] = self.material
        return arrays

    @property
    def roughness_varies(self) -> bool:
        """Whether the roughness is a map and not one number."""
        inside = self.roughness[self.mask]
        return bool(inside.numel()) and float(inside.max() - inside.min()) > math.radians(0.1)

    def draw(self, folder: Path) -> None:
        """Write residual and confidence as figures, and materials, roughness, highlights and error if there are any."""
        mask = self.mask
        if self.material is not None:  # a palette of ten colours, one for each number
            number = {"material": self.material.clamp_min(0).float()}
            save_maps(folder / "material_map.png", number, mask, unit="number in the report", top=9, palette="tab10")
        if self.roughness_varies:
            degrees = {"roughness": self.roughness.rad2deg()}
            save_maps(folder / "roughness_map.png", degrees, mask, unit="degrees", top=60)
        save_maps(folder / "residual.png", {"residual": self.residual}, mask, unit="image units")
        save_maps(
            folder / "confidence.png", {"confidence": self.confidence}, mask, unit="share", top=1, palette="viridis"
        )
        if self.specular is not None:
            lobes = {f"highlight {k + 1}": lobe.mean(0, True) for k, lobe in enumerate(self.specular)}
            save_maps(folder / "specular.png", lobes, mask, unit="strength", palette="viridis")
        if self.error is not None:
            error = self.error.as_subclass(torch.Tensor)
            save_maps(folder / "error.png", {"angular error": error}, mask, unit="degrees", top=20)

    def thinned(self) -> tuple[Tensor, Tensor]:
        """Display albedo and mask at the resolution of the depth."""
        return self.display_albedo[:, :: self.step, :: self.step], self.mask[:, :: self.step, :: self.step]

    def write_mesh(self, path: Path, unit: float = 1.0) -> None:
        """Write the surface as a mesh with the display albedo as sRGB colours of the vertices; ``unit``: of a pixel."""
        albedo, mask = self.thinned()
        vertices, faces, pixels = depth_to_mesh(self.depth / self.step, mask)
        vertices = vertices * (self.step * unit)
        colours = linear_to_srgb(albedo).expand(3, -1, -1).flatten(1)[:, pixels].T
        save_mesh(path, vertices, faces, colours)


def _integrate(normal: Tensor, mask: Tensor) -> tuple[Tensor, int]:
    """Height toward the viewer in pixels, and the step between the pixels that it was integrated from."""
    step = math.ceil(math.sqrt(max(1.0, int(mask.sum()) / MAX_DEPTH_PIXELS)))
    return integrate_normals(normal[:, ::step, ::step], mask[:, ::step, ::step]) * step, step


def _scale_for_display(albedo: Tensor, mask: Tensor) -> tuple[Tensor, float]:
    values = albedo[:, mask[0]].amax(0)
    exact = values.numel() < EXACT_QUANTILE_PIXELS
    top = max(values.double().quantile(0.99).item() if exact else values.max().item(), 1e-12)
    return (albedo / top).clamp(0, 1), top
