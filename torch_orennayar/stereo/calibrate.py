"""Calibrate lights: directions from a chrome ball, intensities from a grey ball or from the capture itself."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.checks import check_floating, check_unit
from ..core.defaults import independent_of_defaults
from ..core.errors import CaptureError, RangeError, ShapeError
from ..core.optional import require
from ..geometry.primitives import Ball
from . import robust_fit
from .material import LightDirections, Material
from .pixel_sample import PixelSample
from .robust_fit import PixelFit
from .robust_stats import MAD_TO_SIGMA, mean_brightness

HIGHLIGHT = 0.5
"""Share of the brightest pixel on the ball above which pixels belong to a highlight. Set by hand."""
LARGEST_HIGHLIGHT = 0.1
"""Share of the ball's area; what is larger is no highlight of a mirror ball. Set by hand."""
RIVAL = 0.5
"""Share of the first highlight's area from which a second one makes it unclear which is the light. Set by hand."""
RIM = 0.98
"""Distance from the ball's centre over its radius beyond which a highlight determines no direction. Set by hand."""
LEAST_INCIDENCE, LEAST_VIEW = 0.2, 0.3
"""Least cosines to the light and to the view of pixels of a grey ball that count: away from terminator and rim, where a
small error of the circle matters. Set by hand."""
CIRCLE_PERFECTNESS = 0.6
"""Of a circle in OpenCV's Hough transform, in (0, 1]: lower values find more false circles. Set by hand."""
ROUNDS = 40
"""Alternations between fits and intensities. Set by hand."""
OVERSHOOT = 1.8
"""Over-relaxation: the power of the change of the intensities. The alternation converges slowly with 1. Set by hand."""
CALIBRATION_PIXELS = 4000
"""Pixels from which the intensities are found. Set by hand."""
LIGHTS_TO_JUDGE, LEAST_TO_JUDGE, PIXELS_TO_JUDGE = 8, 64, 1000
"""Fewest lights whose brightness is doubted, fewest and most pixels of the first look. Set by hand."""
EXPLAINED = 0.4
"""Share of the misfit that brightness found must leave at most to be believed. Set by hand: .05 to .33 on four captures
of unequal lights, .5 and more where their lights are in a wrong order, which brightness cannot mend."""
UNEQUAL = 0.12
"""Standard deviation of the logarithm of the lights' brightness, by the first look, from which they are not taken as
equally bright. Set by hand: six captures of equal lights show up to .07, two of unequal ones .33 and .50."""


def find_ball(mask: Tensor) -> Ball:
    """The circle around a mask of a ball.

    Args:
        mask: (1, H, W) bool, the ball alone.

    Returns:
        The `Ball`.

    Raises:
        ShapeError: another shape or type.
        CaptureError: an empty mask, or one that is not round (a ball cut by the picture's edge, or two objects).

    Example:
        >>> import torch
        >>> from torch_orennayar.geometry.primitives import Ball
        >>> from torch_orennayar.stereo.calibrate import find_ball
        >>> mask = Ball(20.0, 15.0, 10.0).normals((32, 40))[1]
        >>> ball = find_ball(mask)
        >>> abs(ball.x - 20) < 0.6, abs(ball.radius - 10) < 0.6
        (True, True)
    """
    require("cv2")
    import cv2
    import numpy as np

    if mask.ndim != 3 or mask.shape[0] != 1 or mask.dtype != torch.bool:
        raise ShapeError("mask", expected="(1, H, W) bool", got=f"{tuple(mask.shape)} {mask.dtype}", mend="mask > 0.5")
    outlines, _ = cv2.findContours(mask[0].cpu().numpy().astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not outlines:
        raise CaptureError("mask", expected="a ball", got="an empty mask", mend="paint the ball white")
    (x, y), radius = cv2.minEnclosingCircle(max(outlines, key=len))
    covered = int(mask.sum()) / (math.pi * radius * radius)
    if not 0.9 < covered < 1.1:
        raise CaptureError(
            "mask",
            expected="one whole round ball",
            got=f"a shape that fills {covered:.0%} of its circle",
            mend="paint the ball alone, or give the circle as Ball(x, y, radius)",
        )
    return Ball(float(x), float(y), float(radius))


def find_circle(images: Tensor) -> Ball:
    """The most prominent circle in photographs of a ball, by OpenCV's Hough transform.

    Args:
        images: (K, C, H, W) linear light; the ball must differ from its background in their maximum.

    Returns:
        The `Ball`.

    Raises:
        CaptureError: no circle stands out.
    """
    require("cv2")
    import cv2
    import numpy as np

    bright = images.amax(0).mean(0)
    top = bright.flatten().double().quantile(0.99).item() if bright.numel() < 10_000_000 else bright.max().item()
    picture = ((bright / max(top, 1e-12)).clamp(0, 1) ** 0.3 * 255).cpu().numpy().astype(np.uint8)
    least = max(1, min(picture.shape) // 12)
    found = cv2.HoughCircles(
        cv2.medianBlur(picture, 5),
        cv2.HOUGH_GRADIENT_ALT,
        1.5,
        least,
        param1=150,
        param2=CIRCLE_PERFECTNESS,
        minRadius=least,
        maxRadius=max(picture.shape),
    )
    if found is None:
        raise CaptureError(
            "images",
            expected="a ball whose outline shows",
            got="no circle",
            mend="give a mask.png of the ball, or its circle (--circle X Y RADIUS)",
        )
    x, y, radius = (float(v) for v in found.reshape(-1, found.shape[-1])[0][:3])
    return Ball(x, y, radius)


def light_directions(images: Tensor, ball: Ball) -> Tensor:
    """Directions to distant lights from photographs of a mirror ball, orthographic view.

    The centre of the highlight determines the normal there; the light is the view reflected about that normal, which
    lies halfway between both. What the ball mirrors under most lights, a window say, is subtracted from 3 images on.

    Args:
        images: (K, C, H, W) linear light, one per light.
        ball: its outline.

    Returns:
        (K, 3) unit directions, camera frame.

    Raises:
        ShapeError: another shape.
        CaptureError: a ball outside the pictures; no highlight, two of them, or one at the ball's very edge, with the
            image's number.

    Example:
        >>> import torch
        >>> from torch_orennayar.geometry.primitives import Ball
        >>> from torch_orennayar.stereo.calibrate import light_directions
        >>> picture = torch.zeros(1, 1, 41, 41)
        >>> picture[0, 0, 20, 30] = 1.0  # half a radius to the right: the normal there leans 30 degrees
        >>> [round(v, 3) for v in light_directions(picture, Ball(20.0, 20.0, 20.0))[0].tolist()]
        [0.866, 0.0, 0.5]
    """
    require("cv2")
    import cv2
    import numpy as np

    _check_images(images)
    height, width = images.shape[2:]
    if not bool(ball.normals((height, width))[1].any()):
        expected, got = f"a circle inside {width} x {height} pixels", f"{ball.x:.0f}, {ball.y:.0f}, {ball.radius:.0f}"
        raise CaptureError("ball", expected=expected, got=got, mend="give column, row and radius in pixels")
    left, top = (max(int(at - ball.radius), 0) for at in (ball.x, ball.y))
    images = images[:, :, top : int(ball.y + ball.radius) + 2, left : int(ball.x + ball.radius) + 2]
    ball = Ball(ball.x - left, ball.y - top, ball.radius)
    _, inside = ball.normals((images.shape[2], images.shape[3]))
    lights = []
    greys = images.float().mean(1).cpu()
    steady = greys.median(0).values if len(greys) >= 3 else torch.zeros_like(greys[0])
    for index, image in enumerate(greys):
        grey = torch.where(inside[0], (image - steady).clamp_min(0), 0.0)
        bright = grey >= HIGHLIGHT * grey.max()
        where = f"image {index + 1}"
        if not bool(grey.max() > 0) or bool(bright.sum() > LARGEST_HIGHLIGHT * inside.sum()):
            raise CaptureError(where, expected="a small highlight", got="none", mend="photograph a mirror ball")
        count, labels, areas, _ = cv2.connectedComponentsWithStats(bright.numpy().astype(np.uint8))
        order = 1 + areas[1:, cv2.CC_STAT_AREA].argsort()[::-1]
        if count > 2 and areas[order[1], cv2.CC_STAT_AREA] > RIVAL * areas[order[0], cv2.CC_STAT_AREA]:
            raise CaptureError(
                where, expected="one highlight", got="two alike", mend="cover other lights, or paint the second black"
            )
        weight = grey * torch.from_numpy(labels == order[0])
        row, column = torch.meshgrid(torch.arange(grey.shape[0]), torch.arange(grey.shape[1]), indexing="ij")
        x = float((weight * column).sum() / weight.sum() - ball.x) / ball.radius
        y = float(ball.y - (weight * row).sum() / weight.sum()) / ball.radius
        if x * x + y * y > RIM**2:
            raise CaptureError(
                where, expected="a highlight on the ball", got="one at its edge", mend="check the ball's circle"
            )
        z = math.sqrt(1 - x * x - y * y)
        lights.append((2 * z * x, 2 * z * y, 2 * z * z - 1))
    return F.normalize(torch.tensor(lights, dtype=images.dtype), dim=1)


def ball_intensities(images: Tensor, lights: Tensor, ball: Ball) -> Tensor:
    """Intensities of the lights from photographs of a matt grey ball, normalised to a mean of 1 in each channel.

    Args:
        images: (K, C, H, W) linear light.
        lights: (K, 3) unit directions.
        ball: its outline.

    Returns:
        (K, C): divide the images by them.

    Raises:
        ShapeError: shapes do not fit together.
        CaptureError: a light that does not reach the ball; names the image.
    """
    _check_images(images)
    _check_lights(images, lights)
    normal, inside = ball.normals((images.shape[2], images.shape[3]))
    cosine = torch.einsum("kc,chw->khw", lights.to(images), normal.to(images)).clamp_min(0)
    lit = (inside & (cosine > LEAST_INCIDENCE) & (normal[2:] > LEAST_VIEW))[:, None].to(images)
    amount = (images * cosine[:, None] * lit).sum((2, 3)) / (cosine.square()[:, None] * lit).sum((2, 3)).clamp_min(1e-9)
    if not bool((amount > 0).all()):
        dark = int((amount <= 0).any(1).nonzero()[0])
        raise CaptureError(f"image {dark + 1}", expected="light on the ball", got="none", mend="check its light")
    return amount / amount.mean(0)


@torch.no_grad()
@independent_of_defaults
def own_intensities(images: Tensor, lights: Tensor, mask: Tensor | None = None, *, seed: int = 0) -> Tensor:
    """Intensities of the lights from the capture itself (semi-calibrated), normalised to a mean of 1.

    Alternates between robust Lambertian fits and the intensities that explain them best. Directions must be known, and
    the surface must have normals in many directions: on a plane an intensity cannot be separated from a slant. One
    number per light; colours of lights need a grey ball.

    Args:
        images: (K, C, H, W) linear light.
        lights: (K, 3) unit directions.
        mask: (1, H, W) bool; default all pixels.
        seed: picks the pixels.

    Returns:
        (K, 1): divide the images by them.

    Raises:
        ShapeError: shapes do not fit together.
        CaptureError: fewer than 5 lights, which do not determine 3 numbers per pixel and one per light.

    Source: the setting of Cho, Matsushita, Tai & Kweon 2016, "Semi-calibrated photometric stereo".

    Example:
        >>> import torch, torch_orennayar as ton
        >>> from torch_orennayar.stereo.calibrate import own_intensities
        >>> from torch_orennayar.geometry.primitives import spiral_lights
        >>> toward = torch.rand(1, 3, 16, 16) + torch.tensor([-0.5, -0.5, 1]).reshape(3, 1, 1)
        >>> normal = torch.nn.functional.normalize(toward)
        >>> lights, strength = spiral_lights(12), torch.linspace(0.8, 1.2, 12)[:, None]
        >>> images = ton.OrenNayar("lambert")(normal, lights[None])[0] * strength[:, :, None, None]
        >>> bool((own_intensities(images, lights) - strength).abs().max() < 0.01)
        True
    """
    _check_images(images)
    _check_lights(images, lights)
    if len(images) < 5:
        raise CaptureError("images", expected="at least 5", got=str(len(images)), mend="calibrate with a grey ball")
    return find_brightness(_draw_sample(images, lights, mask, seed), ROUNDS)[0].to(images)


def unequal_intensities(images: Tensor, lights: Tensor, mask: Tensor | None = None, *, seed: int = 0) -> Tensor | None:
    """`own_intensities` (K, 1) where the photographs say that the lights are not equally bright, else None."""
    return unequal_brightness(_draw_sample(images, lights, mask, seed))


def unequal_brightness(sample: PixelSample) -> Tensor | None:
    """Brightness (K, 1) of the lights of pixels that say that it differs, else None.

    A first look at few pixels decides, and the middle of the lights, so that single broken photographs do not.
    """
    if sample.grey.shape[1] < LIGHTS_TO_JUDGE or len(sample) < LEAST_TO_JUDGE:
        return None
    first = find_brightness(sample[:PIXELS_TO_JUDGE], 1)[0].log()
    spread = MAD_TO_SIGMA * float((first - first.median()).abs().median())
    if not spread > UNEQUAL:
        return None
    found, misfits = find_brightness(sample[:CALIBRATION_PIXELS], ROUNDS)
    return found if misfits[-1] < EXPLAINED * misfits[0] else None


def _draw_sample(images: Tensor, lights: Tensor, mask: Tensor | None, seed: int) -> PixelSample:
    """Pixels that 3 lights or more reach."""
    inside = torch.ones(images.shape[2:], dtype=torch.bool) if mask is None else mask[0]
    grey = images.mean(1)[:, inside].T.float()
    places = inside.flatten().nonzero().flatten()
    lit = (grey > 0).sum(1) >= 3
    grey, places = grey[lit], places[lit]
    generator = torch.Generator().manual_seed(seed)
    some = torch.randperm(len(grey), generator=generator)[:CALIBRATION_PIXELS].to(grey.device)
    return PixelSample(grey[some], LightDirections.of(lights.to(grey)), places[some], images.shape[3])


def find_brightness(sample: PixelSample, rounds: int) -> tuple[Tensor, list[float]]:
    """Brightness (K, 1) of the lights after so many fits, each under the brightness before, and the fits' misfits."""
    intensity, misfits = torch.ones_like(sample.grey[:1]), list[float]()
    fitted: PixelFit | None = None
    for _ in range(rounds):
        scaled = replace(sample, grey=sample.grey / intensity)
        if fitted is None:
            fitted = robust_fit.fit(scaled, Material(), steps=8)
        else:
            fitted = robust_fit.fit(scaled, Material(), start=fitted, steps=3)
        predicted = robust_fit.predict(fitted, sample.directions, Material())
        misfits.append(float(((scaled.grey - predicted).abs() / mean_brightness(scaled.grey)).median()))
        weight = robust_fit.weights(fitted, scaled.grey, predicted, "lit") / mean_brightness(scaled.grey).square()
        gain = (weight * scaled.grey * predicted).sum(0) / (weight * predicted.square()).sum(0).clamp_min(1e-12)
        intensity = intensity * gain**OVERSHOOT
        intensity = intensity / intensity.mean()
    return intensity.T, misfits


def _check_images(images: Tensor) -> None:
    check_floating(images=images)
    if images.ndim != 4 or 0 in images.shape:
        raise ShapeError("images", expected="(K, C, H, W)", got=str(tuple(images.shape)), mend="stack the images")
    if not bool(images.isfinite().all()):
        raise RangeError("images", expected="finite values", got="NaN or infinity", mend="check the files")


def _check_lights(images: Tensor, lights: Tensor) -> None:
    if lights.shape != (len(images), 3):
        raise ShapeError(
            "lights", expected=f"({len(images)}, 3)", got=str(tuple(lights.shape)), mend="one light per image"
        )
    check_unit("lights", lights, 1, gaps=False)
