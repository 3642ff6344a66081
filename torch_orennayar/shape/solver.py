"""Shape from shading: depth and normals from one picture of a rough surface under a known light."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ..core.checks import check_floating, check_mask, check_range, check_unit
from ..core.errors import CaptureError, RangeError, ShapeError
from ..core.warn import warn
from ..geometry.camera import Camera
from ..reconstruction import Reconstruction, stack
from ..reflectance.model_choice import ModelChoice, simplest_model
from ..reflectance.models import get_model
from . import surface_fit
from .surface_fit import FitSettings, Scene, Surface

FRONTAL = math.radians(10)
"""A light nearer to the view than this shows a dent and a bump alike."""
ALIKE = 1.25
"""Two surfaces whose costs differ by less than this factor explain the picture equally well."""
START_ROUGHNESS, START_AMBIENT = math.radians(25), 0.01
"""Where the search for an unknown roughness and for unknown ambient light begins."""
NEAR_ENOUGH = 0.01
"""Error of shading that the simplest sufficient model may have: about the noise of a picture."""
EASY = 32
"""Pixels of which the sides of the solved window are multiples: as often as they are halved, or nearly."""
NOISE = 0.01
"""Least error of brightness that the confidence reckons with, share of the picture's bright end."""


@torch.no_grad()
def shape_from_shading(
    image: Tensor,
    light: Tensor,
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
    silhouette: float = 0.1,
) -> Reconstruction:
    """Find the surface whose shading is the picture, under one known light.

    The unknown is depth, so the surface is integrable; its shading comes from the layer itself. The search goes from
    coarse to fine by L-BFGS. Priors, all of them mild: neighbouring normals are alike (``smoothness``); with
    ``contour`` the mask's edge is where the surface turns away from the viewer, so normals point outward there;
    pixels whose brightness no surface explains (cast shadows, highlights) count less. A picture that stays unexplained
    as a whole (paint, light from the surroundings) is trusted less, and the normals of the inflated silhouette more
    (``silhouette``). It starts from the inflated silhouette; without a contour from a plane, and then the mean normal
    is drawn to the view; from ``depth`` it starts at full size.

    What one picture does not tell is reported, not hidden: a light near the view shows dents and bumps alike; albedo,
    roughness and ambient light trade against slope and each other when they are estimated; without a contour or known
    depths nothing says which way a symmetric surface bulges. Not differentiable.

    Args:
        image: (C, H, W) or (B, C, H, W) linear light, divided by the light's irradiance.
        light: (3,) or (B, 3) unit direction to a distant light; of a near one a map, (3, H, W) or (B, 3, H, W).
        mask: (1, H, W) or (B, 1, H, W) bool; default all pixels.
        albedo: number or map (1 or C, H, W), with B in front for batches; None to estimate one number.
        roughness: radians, number or map (1, H, W), with B in front for batches; None to estimate one number.
        ambient: light from all around, as a share of the light's irradiance, 0 to 1: number or map (1, H, W), with B in
            front for batches; None to estimate one number, up to 0.3. It is shaded as by a matt surface. A photograph
            with the light off, subtracted, is better than either.
        model: a name in ``MODELS``, or ``"auto"``: the simplest that is near enough to the theory for this albedo and
            roughness (`simplest_model`); the report says why.
        contour: whether the mask's edge is an occluding contour.
        camera: None for orthographic views in pixels, or a `Camera`.
        depth: (1, H, W) or (B, 1, H, W) where to start, finite inside the mask, in the unit of the result.
        known: the same shape, a few depths that are known, NaN elsewhere. In perspective they set the scale.
        smoothness: weight of bends of the normals against squared brightness.
        silhouette: weight of the inflated silhouette's normals in a picture that is not understood at all; 0 trusts the
            picture alone.

    Returns:
        A `Reconstruction` with depth: without a camera height toward the viewer in pixels, mean 0; with one distance
        along its axis, mean 0 (orthographic) or geometric mean 1 (perspective), unless ``known`` says where it lies.
        ``confidence`` is ``1 / (1 + (e / 2 deg)**2)`` with e the error of the normal toward the light that the
        residual means; across the light one picture says nothing. 0 in shadow.

    Raises:
        ShapeError: shapes do not fit together.
        RangeError: NaN inside the mask, a light that is no unit vector or behind the surface, albedo, roughness or
            ambient light out of range.
        CaptureError: an empty mask, or no light in the picture.
        ModelError: unknown model.

    Source:
        The problem: Horn 1970; rough surfaces: Ahmed & Farag 2006, "A new formulation for shape from shading for
        non-Lambertian surfaces". Search at several scales at once: Barron & Malik 2015, "Shape, illumination and
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
    check_floating(image=image, light=light)
    if model != "auto":
        get_model(model)
    if image.ndim == 4:
        return _solve_batch(
            image,
            {
                "light": light,
                "mask": mask,
                "albedo": albedo,
                "roughness": roughness,
                "ambient": ambient,
                "depth": depth,
                "known": known,
            },
            {
                "model": model,
                "contour": contour,
                "camera": camera,
                "smoothness": smoothness,
                "silhouette": silhouette,
            },
        )
    inside = _check(image, light, mask, {"depth": depth, "known": known})
    scene = _scene(image, light, inside, albedo, roughness, ambient, known, camera)
    full, window = (inside.shape[1], inside.shape[2]), _window(inside)
    scene = scene.cropped(*window)
    reasons = []
    if model == "auto":
        model = _simplest(scene, albedo is None, roughness is None)
        reasons.append(model.reason)
    wish = FitSettings(str(model), contour, smoothness, silhouette, albedo is None, roughness is None, ambient is None)
    there = None if depth is None else _to_height(depth.to(scene.image), camera, full)[:, window[0], window[1]]
    height = _start(scene, there, contour)
    if contour and depth is None:
        scene = replace(scene, likely=surface_fit.normals(height, None, 1.0))
    start = Surface(
        height,
        _logit(scene.albedo.mean() / (surface_fit.WHITEST * scene.unit)),
        _logit(scene.roughness.mean() / surface_fit.ROUGHEST),
        _logit(scene.ambient.mean() / surface_fit.STRONGEST_AMBIENT),
    )
    levels = surface_fit.coarse_to_fine(scene) if depth is None else [scene]
    report = [*reasons, *_say_light(scene)]
    if contour and depth is None:
        start, alike = _choose_side(levels[0], start, wish)
        levels, report = levels[1:] or levels, [*report, *alike]
    found, _ = surface_fit.fit(levels, start, wish, show="shape from shading")
    return _result(scene, found, wish, camera, full, window, report)


def _scene(
    image: Tensor,
    light: Tensor,
    inside: Tensor,
    albedo: float | Tensor | None,
    roughness: float | Tensor | None,
    ambient: float | Tensor | None,
    known: Tensor | None,
    camera: Camera | None,
) -> Scene:
    """Everything in the working precision; what is outside the mask becomes 0."""
    size = (image.shape[1], image.shape[2])
    values = torch.where(inside, image, 0)
    values = values if values.dtype == torch.float64 else values.float()
    unit = float(values[:, inside[0]].flatten().quantile(0.99)) if inside.sum() < 2**23 else float(values.max())
    if unit <= 0:
        raise CaptureError("image", expected="light inside the mask", got="none", mend="check exposure and mask")

    def chart(name: str, value: float | Tensor | None, instead: float, most: float, mend: str) -> Tensor:
        tensor = torch.as_tensor(instead if value is None else value).to(values)
        tensor = tensor.reshape(1, 1, 1) if tensor.ndim == 0 else tensor
        channels = (1, len(image)) if name == "albedo" else (1,)
        if tensor.ndim != 3 or tensor.shape[0] not in channels or tuple(tensor.shape[1:]) not in ((1, 1), size):
            expected, got = f"a number or {(channels[-1], *size)}", str(tuple(tensor.shape))
            raise ShapeError(name, expected=expected, got=got, mend="one number for all, or one per pixel")
        tensor = tensor if tensor.shape[1:] == (1, 1) else torch.where(inside, tensor, 0)
        check_range(name, tensor, 0.0, most, mend)
        return tensor

    view = values.new_tensor((0.0, 0.0, 1.0)).reshape(3, 1, 1)
    rays, pixel = None, 1.0
    if camera is not None and camera.is_perspective:
        view = camera.view_directions(size)[0].to(values)
        rays, pixel = _corner_rays(camera, size).to(values), 2 / (size[0] * float(camera.focal[0, 1]))
    told = chart("ambient", ambient, START_AMBIENT, 1.0, "it is a share of the light: 0.1 for a tenth")
    paint = chart("albedo", albedo, unit, math.inf, "albedo is never negative")
    if albedo is not None and ambient is not None and not bool((values > paint * told)[:, inside[0]].any()):
        raise RangeError("ambient", expected="less light than in the picture", got="more", mend="0.1 is a tenth")
    heights = torch.full_like(values[:1], torch.nan) if known is None else _to_height(known.to(values), camera, size)
    return Scene(
        image=values,
        unit=unit,
        mask=inside.to(values),
        light=light.to(values).reshape(3, 1, 1) if light.ndim == 1 else torch.where(inside, light.to(values), 0),
        view=view,
        rays=rays,
        albedo=paint,
        roughness=chart("roughness", roughness, START_ROUGHNESS, math.pi / 2, "roughness is in radians"),
        ambient=told,
        known=torch.where(inside, heights, torch.nan),
        pixel=pixel,
        likely=None,
        noise=_noise(values / unit, inside),
    )


def _simplest(scene: Scene, any_albedo: bool, any_roughness: bool) -> ModelChoice:
    """The simplest model near enough to the theory for what the scene holds."""
    rho, sigma = (
        t[(scene.mask > 0).expand_as(t)] if t.shape[1:] != (1, 1) else t for t in (scene.albedo, scene.roughness)
    )
    return simplest_model(
        albedo=(0.0, 1.0) if any_albedo else rho.clamp_max(1.0),
        roughness=(0.0, surface_fit.ROUGHEST) if any_roughness else sigma,
        tolerance=NEAR_ENOUGH,
    )


def _noise(image: Tensor, inside: Tensor) -> float:
    """Variance of an image's noise, from second differences both ways, which smooth shading has none of.

    Source: Immerkaer, Fast noise variance estimation, 1996, with a median for its mean.
    """
    kernel = image.new_tensor([[1.0, -2, 1], [-2, 4, -2], [1, -2, 1]]).reshape(1, 1, 3, 3) / 6
    rough = torch.nn.functional.conv2d(image[:, None], kernel, padding=1)[:, 0].abs()
    within = -torch.nn.functional.max_pool2d(-torch.nn.functional.pad(inside.to(image), (1, 1, 1, 1)), 3, 1) > 0
    if not bool(within.any()):
        return 0.0
    return float((rough[:, within[0]].median() / 0.6745) ** 2)


def _logit(share: Tensor) -> Tensor:
    return share.clamp(0.01, 0.99).logit().reshape(1, 1, 1)


def _corner_rays(camera: Camera, size: tuple[int, int]) -> Tensor:
    """Lines of sight through the corners of pixels, (3, H + 1, W + 1); they are linear in row and column."""
    few = camera.rays(size)[0] if min(size) > 1 else camera.rays((size[0] + 1, size[1] + 1))[0]
    right, down = few[:, :1, 1:2] - few[:, :1, :1], few[:, 1:2, :1] - few[:, :1, :1]
    rows, columns = (torch.arange(n + 1).to(few) - 0.5 for n in size)
    return few[:, :1, :1] + right * columns.reshape(1, 1, -1) + down * rows.reshape(1, -1, 1)


def _to_height(depth: Tensor, camera: Camera | None, size: tuple[int, int]) -> Tensor:
    """Depth as heights toward the viewer in pixels."""
    if camera is None:
        return depth
    pixel = 2 / (size[0] * float(camera.focal[0, 1]))
    return -(depth.log() if camera.is_perspective else depth) / pixel


def _to_depth(height: Tensor, camera: Camera | None, size: tuple[int, int]) -> Tensor:
    """The way back."""
    if camera is None:
        return height
    distance = -height * (2 / (size[0] * float(camera.focal[0, 1])))
    return distance.exp() if camera.is_perspective else distance


def _window(inside: Tensor) -> tuple[slice, slice]:
    """Rows and columns that the mask reaches: nothing else costs time.

    Where the picture has room, at least half as wide as long, and easy to halve.
    """
    reached = [inside[0].any(axis).nonzero().flatten()[[0, -1]].tolist() for axis in (1, 0)]
    least = max(last - first + 1 for first, last in reached) // 2
    window = []
    for (first, last), size in zip(reached, inside.shape[1:], strict=True):
        length = min(size, -(-max(last - first + 1, least) // EASY) * EASY)
        start = min(max(0, (first + last + 1 - length) // 2), size - length)
        window.append(slice(start, start + length))
    return window[0], window[1]


def _start(scene: Scene, height: Tensor | None, contour: bool) -> Tensor:
    """Heights of corners to begin with, from those of pixels where they are told."""
    if height is None:
        return surface_fit.inflate(scene.mask) if contour else torch.zeros_like(surface_fit.corners(scene.mask))
    height = torch.where(scene.mask > 0, height, 0)
    share = surface_fit.corners(scene.mask).clamp_min(1e-6)
    return torch.where(share > 1e-3, surface_fit.corners(height) / share, 0)


def _choose_side(coarsest: Scene, start: Surface, wish: FitSettings) -> tuple[Surface, list[str]]:
    """The surface at the smallest size, from the start or its inside-out twin, and what to say of the other."""
    found, cost = surface_fit.fit([coarsest], start, wish)
    twin = replace(start, height=-start.height)
    turned, other = surface_fit.fit([coarsest], twin, wish, most=cost * ALIKE)
    alike = [
        "the same surface inside out, dents for bumps, explains the picture about as well: depth= or known= decides."
    ]
    if other < cost / ALIKE:
        return turned, []
    return found, alike if other < cost * ALIKE else []


def _say_light(scene: Scene) -> list[str]:
    """What the direction of the light keeps from being known."""
    facing = float((scene.light * scene.view).sum(0).expand_as(scene.mask)[scene.mask > 0].mean())
    if facing <= 0:
        raise RangeError(
            "light",
            expected="a light on the camera's side (x right, y up, z toward the camera)",
            got=f"z {facing:.2f}",
            mend="use swap_opencv_frame if it is in OpenCV's frame",
        )
    if facing < math.cos(FRONTAL):
        return []
    said = f"the light is within {math.degrees(FRONTAL):.0f} degrees of the view: dents and bumps look alike."
    warn(said)
    return [said]


def _result(
    scene: Scene,
    found: Surface,
    wish: FitSettings,
    camera: Camera | None,
    size: tuple[int, int],
    window: tuple[slice, slice],
    report: list[str],
) -> Reconstruction:
    """Maps of the surface in the whole picture of ``size``."""
    inside = scene.mask > 0
    with torch.enable_grad():
        normal = surface_fit.normals(found.height, scene.rays, scene.pixel).detach().requires_grad_()
        shaded = surface_fit.shade(scene, found, normal, wish)
        (slope,) = torch.autograd.grad(shaded.mean(0).sum(), normal)
    normal = normal.detach()
    missed = (shaded.detach() - scene.image).abs().mean(0, keepdim=True)
    along = (slope - (slope * normal).sum(0, keepdim=True) * normal).norm(dim=0, keepdim=True)
    error = (missed.square() + (NOISE * scene.unit) ** 2).sqrt() / along.clamp_min(1e-9)
    height = surface_fit.centres(found.height)
    if not bool(scene.known.isfinite().any()):
        height = height - height[inside].mean()
    albedo, roughness, ambient = surface_fit.unknowns(scene, found, wish)
    if wish.free_albedo:
        report.append(
            f"albedo {albedo.item():.3f}, estimated: a darker surface that leans more to the light looks much the same."
        )
    if wish.free_roughness:
        report.append(
            f"roughness {math.degrees(roughness.item()):.0f} degrees, estimated from one picture: take it as a guess."
        )
    if wish.free_ambient:
        report.append(f"ambient light {ambient.item():.3f} of the light, estimated: it pales slopes as roughness does.")
    if wish.free_albedo and wish.free_roughness:
        report.append("albedo and roughness together are not told by one picture.")
    if not wish.contour:
        report.append("no occluding contour: a slant of the whole surface shows only as brightness.")
    dark = int((inside & ~surface_fit.lit(scene, found, wish)).sum())
    if dark:
        report.append(f"{dark} pixels are in shadow: there the surface goes on smoothly, and confidence is low.")

    def kept(values: Tensor) -> Tensor:
        whole = values.new_zeros(len(values), *size)
        whole[:, window[0], window[1]] = torch.where(inside, values, 0)
        return whole

    return Reconstruction(
        normal=kept(normal),
        albedo=kept(albedo),
        roughness=kept(roughness),
        residual=kept(missed),
        confidence=kept(1 / (1 + (error / math.radians(2)) ** 2)),
        model=wish.model,
        scores={},
        report=tuple(report),
        roughness_error=math.inf if wish.free_roughness else 0.0,
        depth=kept(_to_depth(height, camera, size)),
        ambient=kept(ambient),
    )


def _check(image: Tensor, light: Tensor, mask: Tensor | None, depths: dict[str, Tensor | None]) -> Tensor:
    """Shapes and units; the mask, (1, H, W) bool."""
    if image.ndim != 3 or 0 in image.shape:
        raise ShapeError(
            "image", expected="(C, H, W)", got=str(tuple(image.shape)), mend="one image, or a batch of them"
        )
    size = tuple(image.shape[1:])
    if tuple(light.shape) not in ((3,), (3, *size)):
        raise ShapeError("light", expected=f"(3,) or {(3, *size)}", got=str(tuple(light.shape)), mend="one light")
    check_unit("light", light, 0, gaps=light.ndim > 1)
    inside = check_mask(mask, image)
    for name, value in depths.items():
        if value is not None and tuple(value.shape) != (1, *size):
            raise ShapeError(name, expected=str((1, *size)), got=str(tuple(value.shape)), mend="of the image's size")
    for name, value in (("image", image), ("depth", depths["depth"])):
        if value is not None and not bool(value[:, inside[0]].isfinite().all()):
            raise RangeError(name, expected="finite values inside the mask", got="NaN or infinity", mend="shrink mask")
    return inside


def _solve_batch(image: Tensor, each: Mapping[str, Any], shared: Mapping[str, Any]) -> Reconstruction:
    """One picture after the other; tensors with B in front are taken apart, numbers are shared."""
    if len(image) == 0:
        raise ShapeError("image", expected="at least one image", got=str(tuple(image.shape)), mend="add one")
    for name, value in each.items():
        if isinstance(value, Tensor) and value.ndim > 0 and len(value) != len(image):
            got = str(tuple(value.shape))
            raise ShapeError(name, expected=f"{len(image)} in a batch", got=got, mend="stack one per image")

    def solve(b: int) -> Reconstruction:
        own: dict[str, Any] = {k: v[b] if isinstance(v, Tensor) and v.ndim > 0 else v for k, v in each.items()}
        return shape_from_shading(image[b], **own, **shared)

    found = [solve(b) for b in range(len(image))]
    depth, ambient = (torch.stack([getattr(f, name) for f in found]) for name in ("depth", "ambient"))
    return replace(stack(found), depth=depth, ambient=ambient)
