"""Shape from shading: depth and normals from one picture, or few, of a rough surface under known lights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import torch
from torch import Tensor

from ..core.checks import check_floating
from ..core.defaults import independent_of_defaults
from ..core.errors import RangeError
from ..core.findings import Finding
from ..core.warn import warn
from ..geometry.camera import Camera
from ..geometry.height_field import depth_to_height, height_to_depth, inflate, normals, to_centers, to_corners
from ..reconstruction import Reconstruction, confidence_from_error, stack
from ..reflectance.model_choice import simplest_model
from ..reflectance.models import get_model
from ..shading.precision import working_dtype
from .light_search import with_found_light
from .objective import MAX_ROUGHNESS, FitParameters, FitSettings, Reflectance, lit_pixels, shade
from .prior import with_learned_prior
from .scene import MIN_SHARE, Picture, PictureScene, Prior, Window, build_scene
from .surface_fit import coarse_to_fine, fit, follow_prior

FRONTAL = math.radians(10)
"""Radians; a light nearer to the view than this shows dents and bumps alike. Set by hand."""
TWIN_COST_RATIO = 1.25
"""Two surfaces whose costs differ by less than this factor explain the picture equally well. Set by hand."""
MODEL_TOLERANCE = 0.01
"""RMS error of shading over albedo that the automatically chosen model may have: about the noise of a picture."""
MIN_RESIDUAL = 0.01
"""Share of the picture's peak; least error of brightness that the confidence assumes. Set by hand, about the noise."""
TINY_CERTAINTY = 1e-18
"""Per squared radian; least certainty of a normal, only keeps 1 / 0 away."""
CORNER_SHARE = 1e-3
"""Share of a corner's four pixels inside the mask from which the caller's depth sets its height; only excludes 0."""


@torch.no_grad()
@independent_of_defaults
def shape_from_shading(
    image: Tensor,
    light: Tensor | None,
    mask: Tensor | None = None,
    *,
    albedo: float | Tensor | None = 1.0,
    roughness: float | Tensor | None = 0.0,
    ambient: float | Tensor | None = 0.0,
    model: str = "auto",
    contour: bool = True,
    camera: Camera | None = None,
    depth: Tensor | None = None,
    known: Tensor | None = None,
    smoothness: float = 0.05,
    prior: Literal["learned", "silhouette"] = "learned",
    silhouette: float = 0.1,
) -> Reconstruction:
    """Find the surface whose shading is the picture under one known light, or the pictures under a few.

    The unknown is depth, so the surface is integrable; the shading layer itself shades it, and L-BFGS minimises the
    difference from the picture from coarse to fine. The priors are mild: neighbouring normals are similar
    (``smoothness``); with ``contour`` the mask's edge is an occluding contour, where the surface turns away from the
    viewer and normals point outward; pixels whose brightness no surface explains (cast shadows, highlights) count less.
    With a contour the search starts from normals that a small network reads in picture and mask (``prior``), each with
    the error that it expects; the less the picture is explained (paint, light from the surroundings, parts that hide
    each other), and the more its surface differs from them beyond that error, the more they count. Without a contour it
    starts from a plane, and then the mean normal is drawn to the view; from ``depth`` it starts at full resolution.

    From three pictures on `photometric_stereo` needs no contour and no even albedo; see the guide for which is better.

    What one picture does not determine is reported: a light near the view shows dents and bumps alike; estimated
    albedo, roughness and ambient light trade against slope and against each other; without a contour or known depths
    nothing determines which way a symmetric surface bulges. Not differentiable.

    Args:
        image: (C, H, W) or (B, C, H, W) linear light, divided by the light's irradiance; K pictures of each surface as
            (B, K, C, H, W).
        light: (3,) or (B, 3) unit direction to a distant light; of a near one a map, (3, H, W) or (B, 3, H, W). Of K
            pictures (B, K, 3) or (B, K, 3, H, W). None to find it from outline and shading, for one picture of an
            object whose outline is seen: the report says by how much it may err, mostly 5 to 20 degrees.
        mask: (1, H, W) or (B, 1, H, W) bool; default all pixels.
        albedo: number or map (1 or C, H, W), with B in front for batches; None to estimate one number.
        roughness: radians, number or map (1, H, W), with B in front for batches; None to estimate one number.
        ambient: light from all around, as a share of the light's irradiance, 0 to 1: number or map (1, H, W), with B in
            front for batches; None to estimate one number, up to 0.3. It is reflected as by a matt surface. Subtracting
            a photograph taken with the light off is better than either.
        model: a name in ``MODELS``, or ``"auto"``: the simplest that is near enough to the theory for this albedo and
            roughness (`simplest_model`); the report says why.
        contour: whether the mask's edge is an occluding contour.
        camera: None for orthographic views in pixels, or a `Camera`.
        depth: (1, H, W) or (B, 1, H, W) depth to start from, finite inside the mask, in the unit of the result.
        known: of the same shape, depths that are known at some pixels, NaN elsewhere. In perspective they set the
            scale.
        smoothness: weight of squared differences of neighbouring normals against squared brightness.
        prior: normals to start from and to fall back on: those that a network reads in the picture and its mask, each
            with the error that it expects, or those of the inflated silhouette.
        silhouette: weight of these normals in a picture that the model does not explain at all; 0 uses the picture
            alone.

    Returns:
        A `Reconstruction` with depth and, where it was found, the light, or of a batch a `BatchReconstruction`. Depth
        is without a camera the height toward the viewer in pixels, mean 0; with one the distance along its axis, mean 0
        (orthographic) or geometric mean 1 (perspective), unless ``known`` sets it. ``confidence`` is ``1 / (1 + (e / 2
        deg)**2)`` with e the error of the normal toward the light that the residual implies; 0 in shadow. About errors
        across the light one picture says nothing.

    Raises:
        ShapeError: shapes do not fit together.
        RangeError: an unknown prior, no light for several pictures or without a contour, NaN inside the mask, a light
            that is no unit vector or behind the surface, albedo, roughness or ambient light out of range.
        CaptureError: an empty mask, no light in the picture, or a light that it does not determine.
        ModelError: unknown model.

    Source:
        The problem: Horn 1970; rough surfaces: Ahmed & Farag 2006, "A new formulation for shape from shading for
        non-Lambertian surfaces". Optimisation at several scales at once: Barron & Malik 2015, "Shape, illumination and
        reflectance from shading".

    Example:
        >>> import torch, torch_orennayar as ton
        >>> y, x = torch.meshgrid(torch.linspace(1, -1, 48), torch.linspace(-1, 1, 48), indexing="ij")
        >>> inside = (x * x + y * y < 1)[None]
        >>> normal = torch.stack((x, y, (1 - x * x - y * y).clamp_min(0.01).sqrt())) * inside  # a ball
        >>> light = torch.tensor([0.48, 0.0, 0.877])
        >>> image = ton.oren_nayar(normal[None], light.reshape(1, 3, 1, 1), ton.Camera.orthographic().view_directions(
        ...     (48, 48)), 0.8, 0.5, model="vcavity")[0]
        >>> found = ton.shape_from_shading(image, light, inside, albedo=0.8, roughness=0.5)
        >>> bool(ton.angular_error(found.normal, normal, inside).nanmean() < 3)
        True
    """
    check_floating(image=image, light=image if light is None else light)
    if prior not in ("learned", "silhouette"):
        raise RangeError("prior", expected="'learned' or 'silhouette'", got=repr(prior), mend="choose one")
    if model != "auto":
        get_model(model)
    picture = Picture(image, light, mask, albedo, roughness, ambient, depth, known)
    if image.ndim > 3:
        each = picture.split()
        return stack([_solve(one, camera, model, contour, smoothness, prior, silhouette) for one in each])
    return _solve(picture, camera, model, contour, smoothness, prior, silhouette)


def _solve(
    picture: Picture,
    camera: Camera | None,
    model: str,
    contour: bool,
    smoothness: float,
    prior: str,
    silhouette: float,
) -> Reconstruction:
    """`shape_from_shading` of one surface."""
    about_light: list[Finding] = []
    if picture.light is None:
        picture, about_light = with_found_light(picture, contour=contour)
    light = picture.light if about_light else None
    picture = picture.as_several()
    inside = picture.check()
    window = Window.around(inside)
    mask = window.crop(inside.to(working_dtype(picture.image.dtype)))
    inflated = contour and picture.depth is None
    height = _start_height(picture.depth, mask, window, camera, contour)
    scene = build_scene(picture, inside, window, camera, Prior(normals(height, None, 1.0), None) if inflated else None)
    findings = about_light
    if model == "auto":
        model, finding = _choose_model(scene, picture)
        findings.append(finding)
    about_prior: list[Finding] = []
    if inflated and prior == "learned":
        scene, about_prior = with_learned_prior(scene, model, albedo_unknown=picture.albedo is None)
    settings = FitSettings(
        model,
        contour,
        smoothness,
        silhouette,
        estimate_albedo=picture.albedo is None,
        estimate_roughness=picture.roughness is None,
        estimate_ambient=picture.ambient is None,
    )
    findings += _check_light(scene) + about_prior
    start = FitParameters.starting_at(scene, height)
    levels = coarse_to_fine(scene) if picture.depth is None else [scene]
    if scene.prior is not None and scene.prior.error is not None:
        start = follow_prior(levels[0], start, settings)
    if inflated:
        start, ambiguous = _choose_side(levels[0], start, settings)
        findings += ambiguous
        levels = levels[1:] or levels
    found, _ = fit(levels, start, settings, progress="shape from shading")
    result = _result(scene, found, settings, camera, window, findings)
    return result if light is None else replace(result, lights=light[None])


def _start_height(depth: Tensor | None, mask: Tensor, window: Window, camera: Camera | None, contour: bool) -> Tensor:
    """Corner heights to start from: of the caller's depth, else of the inflated silhouette, else of a plane."""
    if depth is None:
        return inflate(mask) if contour else torch.zeros_like(to_corners(mask))
    height = window.crop(depth_to_height(depth.to(mask), camera, window.size))
    share = to_corners(mask).clamp_min(MIN_SHARE)
    return torch.where(share > CORNER_SHARE, to_corners(torch.where(mask > 0, height, 0)) / share, 0)


def _choose_model(scene: PictureScene, picture: Picture) -> tuple[str, Finding]:
    """The simplest model near enough to the theory for the scene's albedo and roughness, and why."""

    def inside(values: Tensor) -> Tensor:
        return values if values.shape[1:] == (1, 1) else values[(scene.mask > 0).expand_as(values)]

    chosen = simplest_model(
        albedo=(0.0, 1.0) if picture.albedo is None else inside(scene.albedo).clamp_max(1.0),
        roughness=(0.0, MAX_ROUGHNESS) if picture.roughness is None else inside(scene.roughness),
        tolerance=MODEL_TOLERANCE,
    )
    return chosen.name, Finding(chosen.reason, "model-chosen")


def _choose_side(
    coarsest: PictureScene, start: FitParameters, settings: FitSettings
) -> tuple[FitParameters, list[Finding]]:
    """The fit at the coarsest level from the start or from its inside-out twin, and a finding where both fit."""
    found, cost = fit([coarsest], start, settings)
    twin = replace(start, height=-start.height)
    turned, twin_cost = fit([coarsest], twin, settings, max_cost=cost * TWIN_COST_RATIO)
    if twin_cost < cost / TWIN_COST_RATIO:
        return turned, []
    if twin_cost >= cost * TWIN_COST_RATIO:
        return found, []
    text = "the same surface inside out, dents for bumps, explains the picture about as well: depth= or known= decides."
    return found, [Finding(text, "inside-out")]


def _check_light(scene: PictureScene) -> list[Finding]:
    """Refuse a light from behind, warn of one near the view."""
    cosine = (scene.light * scene.view).sum(1, keepdim=True)
    facing = min(float(one.expand_as(scene.mask)[scene.mask > 0].mean()) for one in cosine)
    if facing <= 0:
        raise RangeError(
            "light",
            expected="a light on the camera's side (x right, y up, z toward the camera)",
            got=f"z {facing:.2f}",
            mend="use swap_opencv_frame if it is in OpenCV's frame",
        )
    if facing < math.cos(FRONTAL):
        return []
    text = f"the light is within {math.degrees(FRONTAL):.0f} degrees of the view: dents and bumps look alike."
    warn(text)
    return [Finding(text, "light-near-view")]


def _result(
    scene: PictureScene,
    found: FitParameters,
    settings: FitSettings,
    camera: Camera | None,
    window: Window,
    findings: Sequence[Finding],
) -> Reconstruction:
    """Maps of the surface in the whole picture, and what one picture does not determine."""
    inside = scene.mask > 0
    reflectance = Reflectance.of(scene, found, settings)
    normal = normals(found.height, scene.corner_rays, scene.pixel_angle)
    difference, error = _brightness_and_normal_error(scene, reflectance, normal, settings.model)
    height = to_centers(found.height)
    if not bool(scene.known_height.isfinite().any()):
        height = height - height[inside].mean()
    dark = int((inside & ~lit_pixels(scene, reflectance).any(0)).sum())

    def whole(values: Tensor) -> Tensor:
        return window.paste(torch.where(inside, values, 0))

    return Reconstruction(
        normal=whole(normal),
        albedo=whole(reflectance.albedo),
        roughness=whole(reflectance.roughness),
        residual=whole(difference),
        confidence=whole(confidence_from_error(error)),
        model=settings.model,
        scores={},
        report=(*findings, *_doubts(reflectance, settings, dark)),
        roughness_error=math.inf if settings.estimate_roughness else 0.0,
        depth=whole(height_to_depth(height, camera, window.size)),
        ambient=whole(reflectance.ambient),
    )


def _brightness_and_normal_error(
    scene: PictureScene, reflectance: Reflectance, normal: Tensor, model: str
) -> tuple[Tensor, Tensor]:
    """Mean absolute residual of a pixel, and the error of its normal toward the light that it means; (1, H, W) each."""
    with torch.enable_grad():
        normal = normal.detach().requires_grad_()
        shaded = shade(scene, reflectance, normal, model).mean(1)
        gradients = [torch.autograd.grad(one.sum(), normal, retain_graph=True)[0] for one in shaded]
    normal = normal.detach()
    difference = (shade(scene, reflectance, normal, model) - scene.image).abs().mean(1)
    certainty = torch.zeros_like(scene.mask)
    for missed, gradient in zip(difference, gradients, strict=True):
        slope = gradient - (gradient * normal).sum(0, keepdim=True) * normal  # on the sphere
        certainty += slope.square().sum(0, keepdim=True) / (missed.square() + (MIN_RESIDUAL * scene.peak) ** 2)
    return difference.mean(0, keepdim=True), certainty.clamp_min(TINY_CERTAINTY).rsqrt()


def _doubts(reflectance: Reflectance, settings: FitSettings, dark: int) -> list[Finding]:
    """What one picture does not determine; ``dark`` is the number of pixels in shadow."""
    findings = []
    if settings.estimate_albedo:
        albedo = reflectance.albedo.item()
        text = f"albedo {albedo:.3f}, estimated: a darker surface that leans more to the light looks much the same."
        findings.append(Finding(text, "albedo-estimated", albedo))
    if settings.estimate_roughness:
        degrees = math.degrees(reflectance.roughness.item())
        text = f"roughness {degrees:.0f} degrees, estimated from one picture: take it as a guess."
        findings.append(Finding(text, "roughness-estimated", degrees))
    if settings.estimate_ambient:
        ambient = reflectance.ambient.item()
        text = f"ambient light {ambient:.3f} of the light, estimated: it flattens the shading as roughness does."
        findings.append(Finding(text, "ambient-estimated", ambient))
    if settings.estimate_albedo and settings.estimate_roughness:
        text = "one picture does not determine albedo and roughness together."
        findings.append(Finding(text, "albedo-and-roughness-estimated"))
    if not settings.contour:
        text = "no occluding contour: a slant of the whole surface shows only as brightness."
        findings.append(Finding(text, "no-contour"))
    if dark:
        text = f"{dark} pixels are in shadow: the surface is continued smoothly there, and confidence is low."
        findings.append(Finding(text, "shadow-pixels", dark))
    return findings
