"""Small pictures of a capture's photographs with the direction of each light, for reports and for inspection."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from .capture import Capture
from .images import picture_bytes
from .srgb import linear_to_srgb

MOST = 24
"""Photographs that are shown, spread over all; set by hand."""
SIDE = 160
"""Pixels of the longer side of a small picture; set by hand."""


class Thumbnail(NamedTuple):
    """A small picture of one photograph.

    Attributes:
        name: of the file.
        picture: (3, h, w) in [0, 1], sRGB-encoded.
        light: x, y, z toward the light, or None.
    """

    name: str
    picture: Tensor
    light: tuple[float, float, float] | None


def thumbnails(capture: Capture, lights: Tensor | None = None) -> list[Thumbnail]:
    """Small pictures of at most `MOST` photographs, all with one exposure.

    Args:
        capture: with its images.
        lights: (K, 3) directions instead of the capture's, where they were found later.
    """
    directions = capture.lights if lights is None else lights
    return small_pictures(capture.images, capture.names, directions, capture.intensities)


def small_pictures(
    images: Tensor, names: Sequence[str], lights: Tensor | None, intensities: Tensor | None = None
) -> list[Thumbnail]:
    """Small pictures of at most `MOST` images in linear light, all with one exposure.

    Args:
        images: (K, 3, H, W).
        names: of their files.
        lights: (K, 3) directions, or None where they are unknown.
        intensities: (K, 3) that the images were divided by, or None.
    """
    count = len(images)
    if count == 0:
        return []
    shown = min(MOST, count)
    chosen = [round(k * (count - 1) / max(shown - 1, 1)) for k in range(shown)]
    small = [_small(images[k]) for k in chosen]
    if intensities is not None:
        small = [s * intensities[k][:, None, None].to(s) for k, s in zip(chosen, small, strict=True)]
    top = max(float(torch.stack([s.flatten().quantile(0.99) for s in small]).max()), 1e-12)
    return [
        Thumbnail(names[k], linear_to_srgb((s / top).clamp(0, 1)), None if lights is None else _three(lights[k]))
        for k, s in zip(chosen, small, strict=True)
    ]


def contact_markup(shown: Sequence[Thumbnail], count: int) -> str:
    """HTML of small pictures, each with its name and a dial that shows where its light stood."""
    figures = "".join(
        f'<figure><img alt="" src="data:image/jpeg;base64,{_jpeg(one.picture)}">'
        f"<figcaption>{_dial(one.light)} {html.escape(one.name)}</figcaption></figure>"
        for one in shown
    )
    more = f"<p>{len(shown)} of {count} photographs, with one exposure.</p>" if len(shown) < count else ""
    return f'<div class="contact">{figures}</div>{more}'


def _small(image: Tensor) -> Tensor:
    factor = SIDE / max(image.shape[1:])
    size = [max(1, round(n * factor)) for n in image.shape[1:]]
    return F.interpolate(image[None].float().cpu(), size, mode="area")[0] if factor < 1 else image.float().cpu()


def _three(light: Tensor) -> tuple[float, float, float]:
    x, y, z = light.tolist()
    return x, y, z


def _jpeg(picture: Tensor) -> str:
    return base64.b64encode(picture_bytes(picture, ".jpg")).decode()


def _dial(light: tuple[float, float, float] | None) -> str:
    """A disc seen from the front: in its middle a light is behind the camera, at its edge it grazes."""
    if light is None:
        return ""
    x, y = 10 + 9 * light[0], 10 - 9 * light[1]
    zenith = math.degrees(math.acos(max(-1.0, min(1.0, light[2]))))
    label = f"light {zenith:.0f} degrees off the view"
    return (
        f'<svg class="dial" viewBox="0 0 20 20" role="img" aria-label="{label}"><title>{label}</title>'
        f'<circle cx="10" cy="10" r="9"/><line x1="10" y1="10" x2="{x:.1f}" y2="{y:.1f}"/>'
        f'<circle class="lamp" cx="{x:.1f}" cy="{y:.1f}" r="2"/></svg>'
    )
