"""What a folder of photographs holds and how it is understood, before anything is solved."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.findings import Finding
from .ball_photographs import BallLights, lights_of_ball_beside
from .capture_lights import GivenLights, read_lights
from .contact_sheet import Thumbnail, small_pictures
from .masks import find_mask, read_mask
from .object_mask import disc, find_object
from .photographs import find_ambient, odd_pictures, read_photographs
from .picture import read_picture
from .region import Region
from .srgb import linear_to_srgb

OUTLINE_RED = (1.0, 0.2, 0.2)
"""RGB of the mask's outline."""
INSPECTED_SIDE = 900
"""Pixels of the longer side at which photographs are looked at; set by hand, for seconds instead of minutes."""


@dataclass(frozen=True)
class Inspection:
    """What was seen in a folder.

    Attributes:
        count: of the photographs.
        rows: what was looked for, and what was found.
        findings: of the readers.
        shown: small pictures of the photographs.
        ball_picture: (3, h, w) the mirror ball as it was found, or None.
        mask: (1, H, W) bool of the whole photographs, as it was found in them, or None where a file holds it.
        mask_picture: (3, h, w) the photographs' mean with the outline of the mask.
    """

    count: int
    rows: tuple[tuple[str, str], ...]
    findings: tuple[Finding, ...]
    shown: tuple[Thumbnail, ...]
    ball_picture: Tensor | None
    mask: Tensor | None
    mask_picture: Tensor


def inspect_folder(
    source: Path,
    encoding: str = "auto",
    *,
    lights: Path | None = None,
    mask: Path | None = None,
    chrome: Path | None = None,
) -> Inspection:
    """Look at a capture as `load_capture` would, at a reduced size, without finding lights from shading.

    Args:
        source: a folder or ``.lp`` file.
        encoding: as `load_capture` takes it.
        lights: a light file outside the folder.
        mask: a mask outside the folder.
        chrome: a folder of photographs of a mirror ball under the same lights.

    Raises:
        FileError: as `load_capture`.
    """
    folder = source if source.is_dir() else source.parent
    mask_file, ambient = mask or find_mask(folder), find_ambient(folder)
    others = tuple(f for f in (mask_file, ambient) if f is not None)
    given = read_lights(
        source, others, lights=lights, chrome=chrome, positions=None, unit=None, ball=None, encoding=encoding
    )
    height, width = read_picture(given.files[0]).samples.shape[:2]
    region = Region(scale=min(1.0, INSPECTED_SIDE / max(height, width)))
    read = read_photographs(given.files, encoding, torch.ones(len(given.files), 3), ambient, region)
    if mask_file is None:
        inside, about_mask = find_object(read.images)
        notes: tuple[Finding, ...] = (about_mask,)
    else:
        whole, notes = read_mask(mask_file, read.size)
        inside = region.apply_mask(whole)
    ball = lights_of_ball_beside(read.images, inside) if given.directions is None else None
    if ball is not None and mask_file is None:
        inside = inside & ~disc(ball.ball, (read.images.shape[2], read.images.shape[3]))
    directions = ball.directions if ball is not None else given.directions
    covered = f"{inside.float().mean().item():.0%} of the picture"
    clipped = "none" if read.valid is None else f"{1 - read.valid[:, inside].float().mean().item():.2%} of the object"
    rows = (
        (
            "photographs",
            f"{len(given.files)}, {given.files[0].name} to {given.files[-1].name}, {width} x {height} pixels",
        ),
        ("lights", _lights_text(given, ball, region)),
        ("spread of the lights", "unknown" if directions is None else _spread_text(directions)),
        ("mask", f"{'sought' if mask_file is None else mask_file.name}: {covered}, outlined below"),
        ("light with all lamps off", "none" if ambient is None else f"{ambient.name}, subtracted"),
        ("samples at full scale", clipped),
    )
    odd = odd_pictures(folder, (*given.files, *others))
    shown = small_pictures(read.images, [f.name for f in given.files], directions)
    picture = None if ball is None else ball.picture
    found = None if mask_file is not None else F.interpolate(inside[None].float(), size=(height, width))[0] > 0.5
    findings = (*read.findings, *notes, *odd)
    outlined = _outline(read.images, inside)
    return Inspection(len(given.files), rows, findings, tuple(shown), picture, found, outlined)


def _outline(images: Tensor, inside: Tensor) -> Tensor:
    """The mean (3, h, w) of images (K, 3, h, w), brightened, with the edge of the mask drawn over it."""
    mean = images.float().mean(0)
    white = mean.flatten()[:: 1 + mean.numel() // 2**20].quantile(0.99).clamp_min(1e-9)
    shown = linear_to_srgb((mean / white).clamp(0, 1))
    mask = inside.float()[None]
    edge = (F.max_pool2d(mask, 5, 1, 2) - mask)[0] > 0
    return torch.where(edge, shown.new_tensor(OUTLINE_RED).reshape(3, 1, 1), shown)


def _lights_text(given: GivenLights, ball: BallLights | None, region: Region) -> str:
    if ball is not None:
        x, y = region.to_whole(ball.ball.x, ball.ball.y)
        radius = ball.ball.radius / region.scale
        return f"from a mirror ball at column {x:.0f}, row {y:.0f}, radius {radius:.0f} pixels"
    if given.directions is not None:
        return f"{len(given.directions)} from a light file"
    return "no light file and no mirror ball: they will be sought in the photographs, which takes a minute and may fail"


def _spread_text(directions: Tensor) -> str:
    zenith = directions[:, 2].clamp(-1, 1).acos()
    return f"{math.degrees(zenith.min()):.0f} to {math.degrees(zenith.max()):.0f} degrees off the view"
