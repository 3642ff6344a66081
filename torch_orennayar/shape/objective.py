"""The cost of a surface: how far its shading is from the picture, and the priors. `surface_fit` minimises it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from ..geometry.height_field import normals, to_centers
from ..reflectance.models import get_model
from ..shading import tiled
from ..shading.inputs import ShadingInputs
from .scene import PictureScene

# All weights and thresholds below were set by hand; `scripts/benchmarks/evaluate_shape_from_shading.py` measures what
# they give on made and real pictures.
TWIST_WEIGHT = 0.02
"""Weight, per pixel and squared pixel of height, against the checkerboard of corner heights, which normals lack."""
CONTOUR_WEIGHT = 4.0
"""Weight, per border pixel, of the occluding contour."""
CONTOUR_COSINE = 0.95
"""Cosine of a border normal to the outward direction from which on the contour costs nothing."""
SLANT_WEIGHT = 0.02
"""Weight, per pixel, against a slant of the whole surface where no contour determines it."""
UNLIT_WEIGHT = 1.0
"""Weight, per pixel, that turns bright pixels toward the light: shading itself has no slope where it is 0."""
OUTLIER_SCALE = 0.15
"""Share of the picture's peak; a residual of this size costs half its square (Geman-McClure), larger ones ever less:
cast shadows, highlights."""
KNOWN_WEIGHT = 0.05
"""Weight of a known height, per squared pixel of height."""
LIT_SHARE = 0.05
"""Share of the picture's peak, above ambient light, from which a pixel counts as facing the light."""
CONTOUR_BLUR = (3, 2)
"""Radii in pixels of the two box blurs of the mask before its gradient gives the outward direction."""

MAX_ROUGHNESS = 1.1
"""Radians; upper end of an estimated roughness. Set by hand, just above what the models are made for (60 degrees)."""
MAX_ALBEDO = 4.0
"""Times the picture's peak; upper end of an estimated albedo. Set by hand."""
MAX_AMBIENT = 0.3
"""Share of the light's irradiance; upper end of estimated ambient light. Set by hand."""


@dataclass(frozen=True)
class FitSettings:
    """The reflectance model, the weights of the priors that a caller sets, and which quantities are estimated."""

    model: str
    contour: bool
    smoothness: float
    silhouette: float
    estimate_albedo: bool
    estimate_roughness: bool
    estimate_ambient: bool


@dataclass(frozen=True)
class FitParameters:
    """The unknowns of the fit.

    Attributes:
        height: (1, H + 1, W + 1), of the corners of pixels.
        albedo: (1, 1, 1), logit of its share of `MAX_ALBEDO`, used where it is estimated.
        roughness: (1, 1, 1), logit of its share of `MAX_ROUGHNESS`, used where it is estimated.
        ambient: (1, 1, 1), logit of its share of `MAX_AMBIENT`, used where it is estimated.
    """

    height: Tensor
    albedo: Tensor
    roughness: Tensor
    ambient: Tensor

    @staticmethod
    def starting_at(scene: PictureScene, height: Tensor) -> FitParameters:
        """Parameters of a surface with the scene's mean albedo, roughness and ambient light."""
        return FitParameters(
            height,
            _logit(scene.albedo.mean() / (MAX_ALBEDO * scene.peak)),
            _logit(scene.roughness.mean() / MAX_ROUGHNESS),
            _logit(scene.ambient.mean() / MAX_AMBIENT),
        )


def _logit(share: Tensor) -> Tensor:
    return share.clamp(0.01, 0.99).logit().reshape(1, 1, 1)  # the ends have no slope to leave them by


@dataclass(frozen=True)
class Reflectance:
    """Albedo, roughness and ambient light, given or estimated; shapes as in `PictureScene`."""

    albedo: Tensor
    roughness: Tensor
    ambient: Tensor

    @staticmethod
    def of(scene: PictureScene, parameters: FitParameters, settings: FitSettings) -> Reflectance:
        """What the parameters say where a quantity is estimated, otherwise what the scene holds."""
        albedo, roughness, ambient = scene.albedo, scene.roughness, scene.ambient
        if settings.estimate_albedo:
            albedo = MAX_ALBEDO * scene.peak * parameters.albedo.sigmoid()
        if settings.estimate_roughness:
            roughness = MAX_ROUGHNESS * parameters.roughness.sigmoid()
        if settings.estimate_ambient:
            ambient = MAX_AMBIENT * parameters.ambient.sigmoid()
        return Reflectance(albedo, roughness, ambient)


def shade(scene: PictureScene, reflectance: Reflectance, normal: Tensor, model: str) -> Tensor:
    """The pictures (K, C, H, W) that normals (3, H, W) give; ambient light is reflected as by a matt surface."""
    albedo = reflectance.albedo
    inputs = ShadingInputs(normal[None], scene.light, scene.view[None], albedo[None], reflectance.roughness[None])
    return tiled.shade(get_model(model), inputs, -3, normal.dtype) + albedo * reflectance.ambient


def lit_pixels(scene: PictureScene, reflectance: Reflectance) -> Tensor:
    """Pixels to whose brightness the light itself contributes, (K, 1, H, W) bool."""
    direct = (scene.image - reflectance.albedo * reflectance.ambient).mean(1, keepdim=True)
    return (direct >= LIT_SHARE * scene.peak) & (scene.mask > 0)


@dataclass(frozen=True)
class Objective:
    """The cost of parameters in one scene, and the parts of it that do not depend on them.

    Attributes:
        scene: the picture at one resolution.
        settings: model and weights.
        border: (1, H, W), 1 at border pixels of the mask that are an occluding contour.
        outward: (3, H, W) unit directions across the mask's edge, perpendicular to the view.
        across: (1, H, W - 1), 1 where a pixel and its right neighbour are inside.
        along: (1, H - 1, W), 1 where a pixel and the one below are inside.
        lit: `lit_pixels`, or None where they change with the parameters.
    """

    scene: PictureScene
    settings: FitSettings
    border: Tensor
    outward: Tensor
    across: Tensor
    along: Tensor
    lit: Tensor | None

    @staticmethod
    def of(scene: PictureScene, start: FitParameters, settings: FitSettings) -> Objective:
        """The objective of a scene; ``start`` are any parameters of it."""
        mask = scene.mask
        interior = -F.max_pool2d(-F.pad(mask, (1, 1, 1, 1)), 3, 1)
        lit = None
        if not (settings.estimate_albedo or settings.estimate_ambient):
            lit = lit_pixels(scene, Reflectance.of(scene, start, settings))
        return Objective(
            scene=scene,
            settings=settings,
            border=mask * (interior < 1) * settings.contour,
            outward=_outward(mask, scene.view),
            across=mask[:, :, 1:] * mask[:, :, :-1],
            along=mask[:, 1:] * mask[:, :-1],
            lit=lit,
        )

    def residual(self, parameters: FitParameters, normal: Tensor) -> Tensor:
        """Squared difference from the pictures (1, H, W) in units of their peak, robust (Geman-McClure), summed."""
        scene = self.scene
        reflectance = Reflectance.of(scene, parameters, self.settings)
        difference = (shade(scene, reflectance, normal, self.settings.model) - scene.image) / scene.peak
        squared = difference.square().mean(1, keepdim=True) * scene.mask
        return (squared / (1 + squared / OUTLIER_SCALE**2)).sum(0)

    def cost(self, parameters: FitParameters, prior_weight: Tensor | None) -> Tensor:
        """Sum over pixels of the residual and all priors.

        ``prior_weight``, of any shape that fits (1, H, W), is that of the normals to expect: see `surface_fit.fit`.
        """
        scene = self.scene
        normal = normals(parameters.height, scene.corner_rays, scene.pixel_angle)
        total = self.residual(parameters, normal).sum()
        if scene.prior is not None and prior_weight is not None:
            difference = (normal - scene.prior.normal).square() * scene.mask
            total = total + (prior_weight * difference).sum()
        total = total + self.settings.smoothness * self._bending(normal)
        total = total + TWIST_WEIGHT * self._twist(parameters.height, normal)
        total = total + CONTOUR_WEIGHT * self._turned_from_outward(normal)
        if not self.settings.contour:
            slant = (normal[:2] * scene.mask).flatten(1).sum(1) / scene.mask.sum().clamp_min(1)
            total = total + SLANT_WEIGHT * slant.square().sum() * scene.mask.sum()
        total = total + UNLIT_WEIGHT * self._turned_from_light(parameters, normal)
        is_known = scene.known_height.isfinite()
        if bool(is_known.any()):
            difference = to_centers(parameters.height) - scene.known_height.nan_to_num(0)
            total = total + KNOWN_WEIGHT * difference.square().mul(is_known).sum()
        return total

    def _bending(self, normal: Tensor) -> Tensor:
        """Squared differences of the normals of neighbours."""
        bends = ((normal[:, :, 1:] - normal[:, :, :-1]).square() * self.across).sum()
        return bends + ((normal[:, 1:] - normal[:, :-1]).square() * self.along).sum()

    def _twist(self, height: Tensor, normal: Tensor) -> Tensor:
        """Squared second mixed difference of the corner heights; foreshortened pixels count less."""
        twist = height[:, :-1, :-1] + height[:, 1:, 1:] - height[:, 1:, :-1] - height[:, :-1, 1:]
        return (twist * normal[2:] * self.scene.mask).square().sum()

    def _turned_from_outward(self, normal: Tensor) -> Tensor:
        """How far border normals fail to point outward."""
        cosine = (normal * self.outward).sum(0, keepdim=True)
        return ((CONTOUR_COSINE - cosine).clamp_min(0).square() * self.border).sum()

    def _turned_from_light(self, parameters: FitParameters, normal: Tensor) -> Tensor:
        """How far the normals of bright pixels lie beyond the terminator."""
        scene = self.scene
        away = -(normal * scene.light).sum(1, keepdim=True)
        lit = self.lit
        if lit is None:
            lit = lit_pixels(scene, Reflectance.of(scene, parameters, self.settings))
        return (away.clamp_min(0).square() * lit).sum()


def _outward(mask: Tensor, view: Tensor) -> Tensor:
    """Unit directions (3, H, W) down the gradient of the blurred mask, perpendicular to the view."""
    reach = sum(CONTOUR_BLUR) + 1  # the blurs and the difference use what lies beyond the picture
    blurred = F.pad(mask, (reach, reach, reach, reach))
    for radius in CONTOUR_BLUR:
        blurred = F.avg_pool2d(blurred, 2 * radius + 1, 1)
    falling = torch.cat((blurred[:, 1:-1, :-2] - blurred[:, 1:-1, 2:], blurred[:, 2:, 1:-1] - blurred[:, :-2, 1:-1]))
    outward = F.pad(F.normalize(falling, dim=0), (0, 0, 0, 0, 0, 1))
    return F.normalize(outward - (outward * view).sum(0, keepdim=True) * view, dim=0)
