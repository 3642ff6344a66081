"""Pictures of one surface and what is known about it: inputs, their checks, and the scene that is fitted."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.checks import check_mask, check_range, check_unit
from ..core.errors import CaptureError, RangeError, ShapeError
from ..geometry.camera import Camera
from ..geometry.height_field import corner_rays, depth_to_height, pixel_size, resize
from ..shading.precision import working_dtype

START_ROUGHNESS = math.radians(25)
"""Radians; where the search for an unknown roughness starts. Set by hand, in the middle of what materials have."""
START_AMBIENT = 0.01
"""Share of the light's irradiance; where the search for unknown ambient light starts. Set by hand."""
WINDOW_MULTIPLE = 32
"""Pixels; sides of the window are multiples of this, so that they can be halved five times. Set by hand."""
BRIGHT_QUANTILE = 0.99
"""Quantile of the brightness inside the mask that is the picture's peak. Set by hand."""
QUANTILE_LIMIT = 2**23
"""Pixels; of as many or more the peak is the maximum: ``torch.quantile`` refuses more than 2**24 values."""
MEDIAN_OF_NORMAL = 0.6745
"""Median of the absolute value of a standard normal variable."""
MIN_SHARE = 1e-6
"""Smallest share of a coarse pixel inside the mask that is divided by; only keeps 0 / 0 away."""
COARSE_MASK_SHARE = 0.5
"""Share inside the mask from which a pixel of the halved picture is inside."""

Known = float | Tensor | None
"""A number, a map, or None for what is to be estimated."""


@dataclass(frozen=True)
class Picture:
    """The caller's inputs for one surface, with the shapes that `shape_from_shading` documents, or a batch of them."""

    image: Tensor
    light: Tensor | None
    mask: Tensor | None
    albedo: Known
    roughness: Known
    ambient: Known
    depth: Tensor | None
    known: Tensor | None

    def split(self) -> list[Picture]:
        """The surfaces of a batch: tensors are indexed along their first axis, numbers are shared.

        Raises:
            ShapeError: an empty batch, or a tensor of another batch size.
        """
        count = len(self.image)
        if count == 0:
            raise ShapeError("image", expected="at least one image", got=str(tuple(self.image.shape)), mend="add one")
        batched = {n: v for n, v in vars(self).items() if isinstance(v, Tensor) and v.ndim > 0}
        for name, value in batched.items():
            if len(value) != count:
                got = str(tuple(value.shape))
                raise ShapeError(name, expected=f"{count} in a batch", got=got, mend="stack one per image")
        return [replace(self, **{name: value[b] for name, value in batched.items()}) for b in range(count)]

    def as_several(self) -> Picture:
        """One picture (C, H, W) under its light as the first of several, (1, C, H, W)."""
        assert self.light is not None  # it is sought first
        return replace(self, image=self.image[None], light=self.light[None]) if self.image.ndim == 3 else self

    def check(self) -> Tensor:
        """Check shapes and values of pictures (K, C, H, W) of one surface; returns their mask, (1, H, W) bool."""
        image, light = self.image, self.light
        assert light is not None  # it is sought first
        if image.ndim != 4 or 0 in image.shape:
            got = str(tuple(image.shape))
            raise ShapeError("image", expected="(C, H, W) or (K, C, H, W)", got=got, mend="one image, or a batch")
        size, count = tuple(image.shape[2:]), len(image)
        if tuple(light.shape) not in ((count, 3), (count, 3, *size)):
            wanted = "(3,) or " + str((3, *size)) if count == 1 else f"{(count, 3)} or {(count, 3, *size)}"
            got = str(tuple(light.shape[1:] if count == 1 else light.shape))
            raise ShapeError("light", expected=wanted, got=got, mend="one light per picture")
        check_unit("light", light, 1, gaps=light.ndim > 2)
        inside = check_mask(self.mask, image)
        for name, depth in (("depth", self.depth), ("known", self.known)):
            if depth is not None and tuple(depth.shape) != (1, *size):
                got = str(tuple(depth.shape))
                raise ShapeError(name, expected=str((1, *size)), got=got, mend="of the image's size")
        for name, value in (("image", image), ("depth", self.depth)):
            if value is not None:
                check_finite(name, value, inside)
        return inside


def check_finite(name: str, value: Tensor, inside: Tensor) -> None:
    """Check that maps (..., H, W) are finite inside the mask (1, H, W)."""
    if not bool(value[..., inside[0]].isfinite().all()):
        raise RangeError(name, expected="finite values inside the mask", got="NaN or infinity", mend="shrink mask")


@dataclass(frozen=True)
class Window:
    """The rows and columns of a picture of ``size`` that are solved: those that the mask reaches, and few more."""

    rows: slice
    columns: slice
    size: tuple[int, int]

    @staticmethod
    def around(inside: Tensor) -> Window:
        """The window of a mask (1, H, W), where the picture has room at least half as wide as long."""
        reached = [inside[0].any(axis).nonzero().flatten()[[0, -1]].tolist() for axis in (1, 0)]
        least = max(last - first + 1 for first, last in reached) // 2
        window = []
        for (first, last), size in zip(reached, inside.shape[1:], strict=True):
            length = min(size, -(-max(last - first + 1, least) // WINDOW_MULTIPLE) * WINDOW_MULTIPLE)
            start = min(max(0, (first + last + 1 - length) // 2), size - length)
            window.append(slice(start, start + length))
        return Window(window[0], window[1], (inside.shape[1], inside.shape[2]))

    def crop(self, values: Tensor, more: int = 0) -> Tensor:
        """The window's part of a map (..., H, W); ``more`` is 1 for maps of corners. (..., 1, 1) holds everywhere."""
        if values.shape[-2:] == (1, 1):
            return values
        return values[..., self.rows.start : self.rows.stop + more, self.columns.start : self.columns.stop + more]

    def paste(self, values: Tensor) -> Tensor:
        """Values of the window (C, h, w) in a map of the whole picture, (C, H, W), 0 elsewhere."""
        whole = values.new_zeros(len(values), *self.size)
        whole[:, self.rows, self.columns] = values
        return whole


@dataclass(frozen=True)
class Prior:
    """Normals to expect before the shading is looked at closely.

    Attributes:
        normal: (3, H, W) unit.
        error: (1, H, W) radians, how far they are expected to err; None of the inflated silhouette, which does not say.
    """

    normal: Tensor
    error: Tensor | None


@dataclass(frozen=True)
class PictureScene:
    """The window of pictures at one resolution, with what is known of it: all that the cost of a surface depends on.

    Attributes:
        image: (K, C, H, W) linear light; 0 outside the mask.
        peak: brightness of the pictures' bright end, in the image's unit.
        mask: (1, H, W), 0 or 1.
        light: (K, 3, 1, 1) or (K, 3, H, W) unit directions.
        view: (3, 1, 1) or (3, H, W) unit directions.
        corner_rays: (3, H + 1, W + 1) viewing rays through the corners at depth 1; None for parallel rays.
        albedo: (1 or C, 1, 1) or maps; where it is estimated, the start.
        roughness: (1, 1, 1) or (1, H, W) radians; where it is estimated, the start.
        ambient: (1, 1, 1) or (1, H, W), share of the light's irradiance; where it is estimated, the start.
        known_height: (1, H, W) heights, NaN where unknown.
        pixel_angle: radians; 1 for parallel rays.
        prior: normals to expect; None where nothing is known of them.
        noise_variance: of the pictures, in units of ``peak`` squared.
    """

    image: Tensor
    peak: float
    mask: Tensor
    light: Tensor
    view: Tensor
    corner_rays: Tensor | None
    albedo: Tensor
    roughness: Tensor
    ambient: Tensor
    known_height: Tensor
    pixel_angle: float
    prior: Prior | None
    noise_variance: float

    @property
    def corner_size(self) -> tuple[int, int]:
        """Rows and columns of corners."""
        return self.mask.shape[1] + 1, self.mask.shape[2] + 1

    def halved(self) -> PictureScene:
        """The scene at half the resolution: means over the mask of every four pixels; heights are halved, too."""
        share = _halve(self.mask)

        def mean(values: Tensor) -> Tensor:
            return values if values.shape[-1] == 1 else _halve(values * self.mask) / share.clamp_min(MIN_SHARE)

        is_known = self.known_height.isfinite()
        count = _halve(is_known.to(self.image))
        height = _halve(self.known_height.nan_to_num(0)) / count.clamp_min(MIN_SHARE) / 2
        rays = self.corner_rays
        prior = self.prior
        if prior is not None:
            error = None if prior.error is None else mean(prior.error)
            prior = Prior(F.normalize(mean(prior.normal), dim=0), error)
        return replace(
            self,
            image=mean(self.image),
            mask=(share >= COARSE_MASK_SHARE).to(self.image),
            light=F.normalize(mean(self.light), dim=1),
            view=F.normalize(mean(self.view), dim=0),
            corner_rays=None if rays is None else resize(rays, (share.shape[1] + 1, share.shape[2] + 1)),
            albedo=mean(self.albedo),
            roughness=mean(self.roughness),
            ambient=mean(self.ambient),
            known_height=torch.where(count > 0, height, torch.nan),
            pixel_angle=self.pixel_angle * (1 if rays is None else 2),
            prior=prior,
            noise_variance=self.noise_variance / 4,
        )


def build_scene(
    picture: Picture, inside: Tensor, window: Window, camera: Camera | None, prior: Prior | None
) -> PictureScene:
    """The scene of checked pictures, in working precision and in their window; 0 outside the mask.

    Args:
        picture: the inputs, pictures (K, C, H, W).
        inside: (1, H, W) bool mask.
        window: the part to solve.
        camera: None for parallel rays and heights in pixels.
        prior: normals to expect, in the window, or None.

    Raises:
        CaptureError: the picture holds no light.
        ShapeError: a map has another size than the picture.
        RangeError: albedo, roughness or ambient light out of range, or more ambient light than the picture holds.
    """
    image = torch.where(inside, picture.image, 0).to(working_dtype(picture.image.dtype))
    peak = peak_brightness(image, inside)
    ambient = _map("ambient", picture.ambient, START_AMBIENT, image, inside)
    albedo = _map("albedo", picture.albedo, peak, image, inside)
    given = picture.albedo is not None and picture.ambient is not None
    if given and not bool((image > albedo * ambient)[..., inside[0]].any()):
        raise RangeError("ambient", expected="less light than in the picture", got="more", mend="0.1 is a tenth")
    assert picture.light is not None  # it is sought first
    light = picture.light.to(image)
    view, rays, pixel_angle = image.new_tensor((0.0, 0.0, 1.0)).reshape(3, 1, 1), None, 1.0
    if camera is not None and camera.is_perspective:
        view = camera.view_directions(window.size)[0].to(image)
        rays, pixel_angle = corner_rays(camera, window.size).to(image), pixel_size(camera, window.size)
    known_height = torch.full_like(image[0, :1], torch.nan)
    if picture.known is not None:
        known_height = depth_to_height(picture.known.to(image), camera, window.size)
    return PictureScene(
        image=window.crop(image),
        peak=peak,
        mask=window.crop(inside.to(image)),
        light=light[:, :, None, None] if light.ndim == 2 else window.crop(torch.where(inside, light, 0)),
        view=window.crop(view),
        corner_rays=None if rays is None else window.crop(rays, 1),
        albedo=window.crop(albedo),
        roughness=window.crop(_map("roughness", picture.roughness, START_ROUGHNESS, image, inside)),
        ambient=window.crop(ambient),
        known_height=window.crop(torch.where(inside, known_height, torch.nan)),
        pixel_angle=pixel_angle,
        prior=prior,
        noise_variance=_noise_variance(image / peak, inside),
    )


_RANGES = {
    "albedo": (math.inf, "albedo is never negative"),
    "roughness": (math.pi / 2, "roughness is in radians"),
    "ambient": (1.0, "it is a share of the light: 0.1 for a tenth"),
}
"""Largest value of each input, and the hint of the error for what lies outside 0 to it."""


def _map(name: str, value: Known, start: float, image: Tensor, inside: Tensor) -> Tensor:
    """A number as (1, 1, 1), a map as it is, 0 outside the mask; ``start`` for what is to be estimated."""
    size = tuple(image.shape[2:])
    tensor = torch.as_tensor(start if value is None else value).to(image)
    tensor = tensor.reshape(1, 1, 1) if tensor.ndim == 0 else tensor
    channels = (1, image.shape[1]) if name == "albedo" else (1,)
    if tensor.ndim != 3 or tensor.shape[0] not in channels or tuple(tensor.shape[1:]) not in ((1, 1), size):
        expected, got = f"a number or {(channels[-1], *size)}", str(tuple(tensor.shape))
        raise ShapeError(name, expected=expected, got=got, mend="one number for all, or one per pixel")
    tensor = tensor if tensor.shape[1:] == (1, 1) else torch.where(inside, tensor, 0)
    most, hint = _RANGES[name]
    check_range(name, tensor, 0.0, most, hint)
    return tensor


def peak_brightness(image: Tensor, inside: Tensor) -> float:
    """Brightness of the picture's bright end."""
    if len(image) * inside.sum() < QUANTILE_LIMIT:
        peak = float(image[..., inside[0]].flatten().quantile(BRIGHT_QUANTILE))
    else:
        peak = float(image.max())
    if peak <= 0:
        raise CaptureError("image", expected="light inside the mask", got="none", mend="check exposure and mask")
    return peak


def _noise_variance(image: Tensor, inside: Tensor) -> float:
    """Variance of the noise of pictures (K, C, H, W), from second differences, which smooth shading lacks.

    Source: Immerkaer 1996, "Fast noise variance estimation", with the median in place of the mean.
    """
    kernel = image.new_tensor([[1.0, -2, 1], [-2, 4, -2], [1, -2, 1]]).reshape(1, 1, 3, 3) / 6
    difference = F.conv2d(image.flatten(0, 1)[:, None], kernel, padding=1)[:, 0].abs()
    interior = -F.max_pool2d(-F.pad(inside.to(image), (1, 1, 1, 1)), 3, 1) > 0
    if not bool(interior.any()):
        return 0.0
    return float((difference[:, interior[0]].median() / MEDIAN_OF_NORMAL) ** 2)


def _halve(values: Tensor) -> Tensor:
    return F.avg_pool2d(values, 2, ceil_mode=True, count_include_pad=False)
