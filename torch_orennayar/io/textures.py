"""Textures of a reconstruction at the capture's size, with nothing drawn on them: what renderers and engines take."""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..core.errors import FileError
from ..core.files import utf8_path
from ..core.optional import require
from .images import encode_normals, write_image
from .result_maps import ResultMaps
from .srgb import as_rgb, linear_to_srgb

FULL_ANGLE = math.pi / 2
"""Radians of surface roughness that `roughness_sigma.png` stores as 1."""
FAINT = 0.02
"""Strength of highlights over the albedo below which a pixel counts as matt."""


def write_textures(folder: Path, maps: ResultMaps, exponents: Sequence[int], height_unit: float = 1.0) -> None:
    """Write the maps of a result as textures, EXR files and the mask.

    ``normal_gl.png`` (16 bit, green up), ``normal_dx.png`` (green down), and ``normal.png``, the former again.
    ``albedo.png`` (sRGB, divided by the albedo's 99th percentile). ``roughness.png`` (`perceptual_roughness`) and
    ``roughness_sigma.png`` (16 bit, the standard deviation of the facets' slope angle over 90 degrees). ``height.exr``
    and ``normal.exr`` (32-bit float). ``object_mask.png``, to be edited and given again.

    Args:
        folder: where they are written.
        maps: of the result.
        exponents: of the highlights in ``maps.specular``.
        height_unit: factor of the height, which is in pixels.

    Raises:
        FileError: a file cannot be written.
        MissingPackageError: OpenCV or OpenImageIO is not installed.
    """
    mask = maps.mask
    write_image(folder / "normal_gl.png", encode_normals(maps.normal, mask), bits=16)
    shutil.copyfile(folder / "normal_gl.png", folder / "normal.png")
    write_image(folder / "normal_dx.png", encode_normals(maps.normal, mask, green="down"), bits=16)
    write_image(folder / "albedo.png", linear_to_srgb(as_rgb(maps.display_albedo)) * mask)
    write_image(folder / "roughness.png", perceptual_roughness(maps, exponents) * mask)
    write_image(folder / "roughness_sigma.png", maps.roughness / FULL_ANGLE * mask, bits=16)
    write_image(folder / "object_mask.png", mask.float())
    write_exr(folder / "height.exr", maps.depth * height_unit, ("Y",))
    write_exr(folder / "normal.exr", maps.normal, ("R", "G", "B"))


def perceptual_roughness(maps: ResultMaps, exponents: Sequence[int]) -> Tensor:
    """Roughness (1, H, W) of the highlights as glTF, Unity and Blender's Principled BSDF take it; 1 where matt.

    A highlight of exponent p has the width ``alpha = sqrt(2 / (p + 2))`` (Walter et al. 2007), and ``alpha`` is the
    square of the perceptual roughness. Of several highlights the mean by strength counts.
    """
    matt = torch.ones_like(maps.roughness)
    if maps.specular is None or not exponents:
        return matt
    strength = maps.specular.mean(1)  # (L, H, W)
    each = torch.tensor([(2 / (p + 2)) ** 0.25 for p in exponents]).to(strength)
    total = strength.sum(0, keepdim=True)
    mean = (strength * each[:, None, None]).sum(0, keepdim=True) / total.clamp_min(1e-12)
    return torch.where(total > FAINT * maps.albedo.mean(0, keepdim=True), mean, matt)


def write_exr(path: Path, picture: Tensor, channels: Sequence[str]) -> None:
    """Write (C, H, W) as 32-bit float EXR.

    Raises:
        FileError: the file cannot be written.
        MissingPackageError: OpenImageIO is not installed.
    """
    require("OpenImageIO")
    import OpenImageIO

    array = np.ascontiguousarray(picture.float().permute(1, 2, 0).numpy())
    about = OpenImageIO.ImageSpec(array.shape[1], array.shape[0], array.shape[2], OpenImageIO.FLOAT)
    about.channelnames = tuple(channels)
    with utf8_path(path) as name:
        file = OpenImageIO.ImageOutput.create(str(name))
        done = file is not None and file.open(str(name), about) and file.write_image(array) and file.close()
    if not done:
        mend = "check space and permissions"
        raise FileError(str(path), expected="an EXR file that can be written", got=OpenImageIO.geterror(), mend=mend)
