"""Samples of image files, image files and animations written, normal-map encodings."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from ..core.checks import check_encoded, check_floating, check_tensors
from ..core.errors import FileError, RangeError, ShapeError
from ..core.files import atomic_path
from ..core.optional import require
from .picture import read_picture

ANIMATIONS = frozenset({".gif", ".mp4"})
"""Suffixes that `write_animation` writes."""
FRAME_RATE = 12
"""Frames a second of an animation; set by hand."""
UNIT_LENGTHS = (0.5, 1.3)
"""Lengths between which a decoded colour is a normal: averaged ones are shorter than 1, grey has 0, white and black
have 1.73. Set by hand."""
GIF_PALETTE_PIXELS = 1_000_000
"""Pixels from all frames, about, that the palette of a GIF is computed from; set by hand, for memory."""


def read_image(path: str | os.PathLike[str]) -> npt.NDArray[np.generic]:
    """Read a picture's samples as stored, turned upright as the file says; alpha is dropped.

    Args:
        path: any of `picture.IMAGE_SUFFIXES`; the contents decide on the format.

    Returns:
        (H, W) or (H, W, 3) RGB, uint8, uint16 or float32. No curve is undone, whatever encoding the file states.

    Raises:
        FileError: as `read_picture`.
        MissingPackageError: OpenImageIO or Pillow is not installed.

    Example:
        >>> import tempfile, pathlib, torch, torch_orennayar as ton
        >>> from torch_orennayar.io.images import read_image, write_image
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "grey.png"
        >>> write_image(path, torch.full((1, 2, 3), 0.5), bits=16)
        >>> int(read_image(path)[0, 0])
        32768
    """
    return read_picture(path).samples


def write_image(path: str | os.PathLike[str], image: Tensor, *, bits: int = 8) -> None:
    """Write (C, H, W) values in [0, 1] as an 8- or 16-bit file; no sRGB curve is applied.

    Args:
        path: the file; its suffix names the format, and its folder is made if need be.
        image: (1|3, H, W) in [0, 1]; values outside are clamped, NaN is written as 0.
        bits: 8 or 16.

    Raises:
        ShapeError: not (1|3, H, W).
        FileError: the format cannot hold it, or the place cannot be written.
    """
    if image.ndim != 3 or image.shape[0] not in (1, 3):
        raise ShapeError("image", expected="(1, H, W) or (3, H, W)", got=str(tuple(image.shape)), mend="reshape it")
    file = Path(path)
    if bits not in (8, 16) or (bits == 16 and file.suffix.lower() not in (".png", ".tif", ".tiff")):
        raise FileError(
            str(file), expected="8 bits, or 16 bits as .png or .tiff", got=f"{bits} bits", mend="change one of them"
        )
    with atomic_path(file) as temporary:
        temporary.write_bytes(picture_bytes(image, file.suffix, bits=bits, name=str(file)))


def picture_bytes(image: Tensor, suffix: str, *, bits: int = 8, name: str = "image") -> bytes:
    """The content of a picture file.

    Args:
        image: (1|3, H, W) in [0, 1]; values outside are clamped, NaN is written as 0.
        suffix: of the format, as ``".png"``.
        bits: 8 or 16.
        name: of the file, for the error.

    Raises:
        FileError: a format that OpenCV does not write.
    """
    require("cv2")
    import cv2

    kind, top = (np.uint8, 255) if bits == 8 else (np.uint16, 65535)
    values = image.detach().cpu().double().nan_to_num(0.0).clamp(0, 1) * top
    array = values.round().permute(1, 2, 0).numpy().astype(kind)[..., ::-1]
    try:
        done, data = cv2.imencode(suffix, array)
    except cv2.error:
        done, data = False, np.empty(0, np.uint8)
    if not done:
        raise FileError(name, expected="a .png or .tiff name", got=suffix or "no suffix", mend="rename it")
    return bytes(data.tobytes())


def write_animation(path: str | os.PathLike[str], frames: Sequence[Tensor]) -> None:
    """Write frames as a GIF that repeats, or as an MP4 video.

    Args:
        path: a .gif or .mp4 name; the file appears whole or not at all.
        frames: (1|3, H, W) floating-point in [0, 1] each; no sRGB curve is applied. MP4 needs even H and W.

    Raises:
        ShapeError: no frames, not floating-point (1|3, H, W), sizes that differ, or odd ones for MP4.
        FileError: another suffix, or the place cannot be written.
    """
    file = Path(path)
    if file.suffix.lower() not in ANIMATIONS:
        raise FileError(str(file), expected="a .gif or .mp4 name", got=file.suffix or "no suffix", mend="rename it")
    shapes = {tuple(f.shape[1:]) for f in frames}
    fits = len(shapes) == 1 and all(f.ndim == 3 and f.shape[0] in (1, 3) and f.is_floating_point() for f in frames)
    odd = file.suffix.lower() == ".mp4" and any(n % 2 for n in next(iter(shapes), ()))
    if not fits or odd:
        raise ShapeError(
            "frames",
            expected="floating-point (1|3, H, W) all of one size" + ", even for .mp4" * odd,
            got=str([f"{tuple(f.shape)} {f.dtype}" for f in frames[:3]]),
            mend="pad them" if odd else "divide bytes by 255; crop to one size",
        )
    pixels = [(f.detach().cpu().expand(3, -1, -1).clamp(0, 1) * 255).round().byte().permute(1, 2, 0) for f in frames]
    with atomic_path(file) as temporary:
        if file.suffix.lower() == ".gif":
            _write_gif(temporary, pixels)
        else:
            _write_mp4(temporary, pixels)


def _write_gif(path: Path, pixels: Sequence[Tensor]) -> None:
    require("PIL")
    import PIL.Image

    # One palette for all frames, or colours flicker.
    step = max(1, round((len(pixels) * pixels[0][..., 0].numel() / GIF_PALETTE_PIXELS) ** 0.5))
    strip = PIL.Image.fromarray(torch.cat([p[::step, ::step] for p in pixels]).numpy()).quantize(256)
    pictures = [PIL.Image.fromarray(p.numpy()).quantize(palette=strip) for p in pixels]
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=round(1000 / FRAME_RATE), loop=0)


def _write_mp4(path: Path, pixels: Sequence[Tensor]) -> None:
    require("cv2")
    import cv2

    height, width = pixels[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), FRAME_RATE, (width, height))
    if not writer.isOpened():
        raise FileError(str(path), expected="an OpenCV that writes MP4", got="one that does not", mend="write a .gif")
    for picture in pixels:
        writer.write(picture.numpy()[..., ::-1].copy())
    writer.release()


def encode_normals(normal: Tensor, mask: Tensor | None = None, *, green: str = "up") -> Tensor:
    """Normals as colours in [0, 1], ``(n + 1) / 2``; the background is black.

    Args:
        normal: (..., 3, H, W) unit normals in the camera frame (y up); differentiable.
        mask: (..., 1, H, W) bool; default: where the normal is not zero.
        green: ``"up"`` (OpenGL: green grows upwards) or ``"down"`` (DirectX).

    Returns:
        (..., 3, H, W) in [0, 1].

    Raises:
        ShapeError: no floating-point tensor.
        RangeError: another ``green``.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> ton.encode_normals(torch.tensor([0.0, 1.0, 0.0]).reshape(3, 1, 1)).flatten().tolist()
        [0.5, 1.0, 0.5]
    """
    check_floating(normal=normal)
    check_tensors(mask=mask)
    if mask is None:
        mask = (normal != 0).any(-3, keepdim=True)
    return ((normal * _green_sign(normal, green) + 1) / 2) * mask


def decode_normals(image: Tensor, *, green: str = "up") -> Tensor:
    """Unit normals from their colours; colours that are no unit vector, as black, grey or white, are the background.

    Args:
        image: (..., 3, H, W) in [0, 1], as stored (no sRGB curve); differentiable.
        green: as in `encode_normals`.

    Returns:
        (..., 3, H, W), unit; zero in the background: where the vector is shorter than 0.5 or longer than 1.3.

    Raises:
        ShapeError: integers, or an axis of channels elsewhere.
        RangeError: values outside [0, 1], or another ``green``.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> n = torch.nn.functional.normalize(torch.randn(3, 4, 4, generator=torch.manual_seed(0)), dim=0)
        >>> bool(torch.allclose(ton.decode_normals(ton.encode_normals(n, green="down"), green="down"), n, atol=1e-6))
        True
    """
    check_encoded("image", image, (3,))
    normal = (2 * image - 1) * _green_sign(image, green)
    length = normal.detach().norm(dim=-3, keepdim=True)
    background = (length < UNIT_LENGTHS[0]) | (length > UNIT_LENGTHS[1])
    return torch.nn.functional.normalize(normal, dim=-3).masked_fill(background, 0.0)


def _green_sign(like: Tensor, green: str) -> Tensor:
    if green not in ("up", "down"):
        raise RangeError("green", expected="'up' (OpenGL) or 'down' (DirectX)", got=repr(green), mend="choose one")
    return like.new_tensor((1.0, 1.0 if green == "up" else -1.0, 1.0)).reshape(3, 1, 1)
