"""Load a photometric-stereo capture: a folder of photographs and a file of lights."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.defaults import independent_of_defaults
from ..core.errors import FileError, RangeError
from ..core.findings import Finding
from ..stereo.calibrate import find_ball, find_circle, light_directions, own_intensities
from .capture_lights import lights_from_photographs, pair_with_lights
from .encoding_choice import choose_encoding
from .images import write_image
from .light_files import (
    DIRECTIONS_FILE,
    INTENSITIES_FILE,
    LightList,
    find_light_file,
    read_directions,
    read_intensities,
)
from .light_positions import read_positions
from .masks import find_mask, read_mask
from .photographs import find_ambient, list_photographs, read_photographs
from .truth import read_truth


@dataclass(frozen=True)
class Capture:
    """Photographs of one object under known lights, in linear light.

    Attributes:
        images: (K, 3, H, W) float32 (float16 for captures of more than half a billion samples), linear, each
            divided by its light's intensity; 1 is a white Lambertian surface facing the light where intensities
            are calibrated so.
        lights: (K, 3) unit directions to the light, camera frame (x right, y up, z to the viewer), read or found.
        intensities: (K, 3) RGB irradiance that the images were divided by.
        mask: (1, H, W) bool, the object.
        normal: (3, H, W) true normals, or None.
        names: file names of the images.
        notes: what the loader decided or assumed (encoding, mask, intensities), one `Finding` each.
        valid: (K, 1, H, W) bool, False where a sample is at full scale and so not measured; None where none is.
        positions: (K, 3) of near lights, millimetres from where the camera's axis meets the object (x right, y up, z to
            the camera), where a file of them was read; ``lights`` are then their directions from there. Else None.
    """

    images: Tensor
    lights: Tensor
    intensities: Tensor
    mask: Tensor
    normal: Tensor | None
    names: tuple[str, ...]
    notes: tuple[Finding, ...] = field(default=())
    valid: Tensor | None = None
    positions: Tensor | None = None

    @independent_of_defaults
    def with_own_intensities(self, *, seed: int = 0) -> Capture:
        """The capture divided by light intensities estimated from itself instead of those it was loaded with.

        Args:
            seed: of the random sample of pixels that the estimate looks at.

        Raises:
            CaptureError: as `own_intensities`.
        """
        raw = self.images * self.intensities[:, :, None, None].to(self.images)
        found = own_intensities(raw, self.lights, self.mask, seed=seed)
        text = f"intensities of the lights found from the capture itself, {found.min():.2f} to {found.max():.2f}."
        notes = (*self.notes, Finding(text, "intensities-from-capture"))
        images = raw.div_(found[:, :, None, None])
        return replace(self, images=images, intensities=found.expand(-1, 3).float(), notes=notes)


@independent_of_defaults
def load_capture(
    path: str | os.PathLike[str],
    *,
    lights: str | os.PathLike[str] | None = None,
    mask: str | os.PathLike[str] | None = None,
    chrome: str | os.PathLike[str] | None = None,
    positions: str | os.PathLike[str] | None = None,
    ambient: str | os.PathLike[str] | None = None,
    encoding: str = "auto",
) -> Capture:
    """Load a capture: a DiLiGenT folder, a folder with a light file, an ``.lp`` file, or images with a mirror ball.

    The folder may hold: ``filenames.txt`` (without it, all images but the mask, in natural order);
    ``light_directions.txt``, ``lights.txt`` or ``lights.csv`` (one line ``x y z`` per image, with or without its name,
    or a table whose first line names its columns), or one ``*.lp``; ``light_intensities.txt`` (1 or 3 numbers per line,
    default 1); a mask, any picture with ``mask`` in its name (the opaque part where alpha varies, every label but 0, or
    what is brighter than half the maximum; default: all pixels); ``ambient.*``, a photograph with all lights off, which
    is subtracted; ``Normal_gt.mat`` or ``normal_gt.npy``, true normals (H, W, 3).

    Without a light file the lights are found from the photographs (`find_lights`), taken as equally bright unless these
    show that they are not; a note says so.

    Args:
        path: the folder, or an ``.lp`` file beside its images.
        lights: a light file outside the folder.
        mask: a mask image outside the folder; white is the object.
        chrome: a folder of photographs of a mirror ball under the same lights in the same order, optionally with a
            ``mask.png`` of the ball; directions are measured from its highlights and no light file is read.
        positions: a file of the positions of near lights (`read_positions`), instead of a light file.
        ambient: a photograph with all lights off, outside the folder.
        encoding: ``"linear"``, ``"srgb"``, or ``"auto"``: what the files state (profile, sRGB or gamma chunk, Exif),
            else 8-bit files are sRGB-encoded, unless under 8 lights or more they predict lights that are left out far
            better as linear light, and all others linear.

    Returns:
        A `Capture`.

    Raises:
        FileError: a file is missing, damaged or truncated, or lies outside the folder; images differ in size,
            orientation, bit depth or encoding; the numbers of lights and images differ.
        RangeError: unknown encoding, lights that are not unit vectors, intensities that are not positive.
        MissingPackageError: a package that reads the files is not installed.

    Source:
        File layout of Shi et al., "A Benchmark Dataset and Evaluation for Non-Lambertian and Uncalibrated
        Photometric Stereo" (DiLiGenT), 2016; ``.lp`` as in reflectance transformation imaging.

    Example:
        >>> import tempfile, torch, torch_orennayar as ton
        >>> from torch_orennayar.io.capture import save_capture
        >>> lights = torch.nn.functional.normalize(torch.tensor([[0.0, 0, 1], [1, 0, 1], [0, 1, 1]]), dim=-1)
        >>> folder = tempfile.mkdtemp()
        >>> save_capture(folder, torch.full((3, 3, 4, 5), 0.25), lights, torch.ones(1, 4, 5, dtype=torch.bool))
        >>> ton.load_capture(folder).images.shape
        torch.Size([3, 3, 4, 5])
    """
    _check_encoding(encoding)
    source = Path(path)
    if not source.exists():
        raise FileError(
            str(source), expected="a capture folder or .lp file", got="nothing there", mend="check the path"
        )
    folder = source if source.is_dir() else source.parent
    mask_file = Path(mask) if mask is not None else find_mask(folder)
    ambient_file = Path(ambient) if ambient is not None else find_ambient(folder)
    others = tuple(f for f in (mask_file, ambient_file) if f is not None)
    files, listed, near, notes = _read_lights(source, others, lights, chrome, positions, encoding)
    intensities, no_intensities = read_intensities(folder, len(files))
    if listed.intensities is not None:
        intensities, no_intensities = listed.intensities.expand(-1, 3).contiguous(), ()

    def photographed(encoding: str) -> Capture:
        """The capture read in that encoding, its lights found where they are not known."""
        images, valid, decisions = read_photographs(files, encoding, intensities, ambient_file)
        size = (images.shape[2], images.shape[3])
        inside, about_mask = read_mask(mask_file, size)
        directions, divisor, found = listed.directions, intensities, notes
        if not len(directions):
            directions, brightness, about_lights = lights_from_photographs(folder, images, inside, valid)
            found = (*notes, *about_lights)
            images, divisor = images.div_(brightness[:, :, None, None]), intensities * brightness
        return Capture(
            images=images,
            lights=directions,
            intensities=divisor,
            mask=inside,
            normal=read_truth(folder, size),
            names=tuple(f.name for f in files),
            notes=(*found, *no_intensities, *decisions, *about_mask),
            valid=valid,
            positions=near,
        )

    capture = photographed(encoding)
    if encoding != "auto" or near is not None or "read-as-srgb" not in {note.code for note in capture.notes}:
        return capture
    is_linear, chosen = choose_encoding(capture.images, capture.lights, capture.intensities, capture.mask[0])
    capture = photographed("linear") if is_linear else capture
    return replace(capture, notes=(*capture.notes, *chosen))


def _read_lights(
    source: Path,
    others: tuple[Path, ...],
    lights: str | os.PathLike[str] | None,
    chrome: str | os.PathLike[str] | None,
    positions: str | os.PathLike[str] | None,
    encoding: str,
) -> tuple[list[Path], LightList, Tensor | None, tuple[Finding, ...]]:
    """Image files, their lights or an empty list, positions of near lights, and what was found."""
    folder = source if source.is_dir() else source.parent
    if sum(given is not None for given in (chrome, lights, positions)) > 1:
        raise FileError(
            str(chrome or positions),
            expected="a light file, a chrome ball or a file of positions",
            got="more than one",
            mend="leave the others out",
        )
    if positions is not None:
        files, listed = pair_with_lights(folder, Path(positions), others, read_positions)
        return files, listed._replace(directions=F.normalize(listed.directions, dim=1)), listed.directions, ()
    if chrome is not None:
        files = list_photographs(folder, others)
        directions, note = _ball_directions(Path(chrome), len(files), encoding)
        return files, LightList([], directions), None, (note,)
    light_file = Path(lights) if lights is not None else find_light_file(source)
    if light_file is not None:
        return *pair_with_lights(folder, light_file, others, read_directions), None, ()
    return list_photographs(folder, others), LightList([], torch.empty(0, 3)), None, ()


def _check_encoding(encoding: str) -> None:
    if encoding not in ("auto", "linear", "srgb"):
        raise RangeError("encoding", expected="'auto', 'linear' or 'srgb'", got=repr(encoding), mend="choose one")


@independent_of_defaults
def load_photograph(
    path: str | os.PathLike[str],
    light: Tensor,
    *,
    mask: str | os.PathLike[str] | None = None,
    encoding: str = "auto",
) -> Capture:
    """Read one photograph under one light, for `shape_from_shading`.

    Args:
        path: the picture.
        light: (3,) unit direction to the light.
        mask: its mask file; white is the object; default: all pixels.
        encoding: as in `load_capture`.

    Returns:
        A `Capture` with K = 1.

    Raises:
        FileError: a file is missing, damaged or of another size.
        RangeError: unknown encoding.
    """
    _check_encoding(encoding)
    images, valid, notes = read_photographs([Path(path)], encoding, torch.ones(1, 3))
    size = (images.shape[2], images.shape[3])
    inside, about_mask = read_mask(None if mask is None else Path(mask), size)
    notes = (*notes, *about_mask)
    return Capture(images, light[None], torch.ones(1, 3), inside, None, (Path(path).name,), notes, valid)


@independent_of_defaults
def save_capture(
    path: str | os.PathLike[str],
    images: Tensor,
    lights: Tensor,
    mask: Tensor,
    normal: Tensor | None = None,
) -> None:
    """Write a capture that `load_capture` reads: 16-bit linear PNG files, each scaled to the full range.

    Args:
        path: the folder, made if need be.
        images: (K, 3, H, W) linear light, >= 0; the scale of each goes into ``light_intensities.txt``.
        lights: (K, 3) unit directions to the light.
        mask: (1, H, W) bool.
        normal: (3, H, W) true normals, or None.
    """
    folder = Path(path)
    folder.mkdir(parents=True, exist_ok=True)
    top = images.amax((1, 2, 3)).clamp_min(1e-6)
    names = [f"{index + 1:03d}.png" for index in range(len(images))]
    for name, image, scale in zip(names, images, top, strict=True):
        write_image(folder / name, image / scale, bits=16)
    (folder / "filenames.txt").write_text("\n".join(names) + "\n")
    np.savetxt(folder / DIRECTIONS_FILE, lights.cpu().numpy(), fmt="%.8f")
    np.savetxt(folder / INTENSITIES_FILE, (1 / top)[:, None].expand(-1, 3).cpu().numpy(), fmt="%.8g")
    write_image(folder / "mask.png", mask.float())
    if normal is not None:
        np.save(folder / "normal_gt.npy", normal.permute(1, 2, 0).cpu().numpy())


@independent_of_defaults
def load_ball(
    path: str | os.PathLike[str], *, mask: str | os.PathLike[str] | None = None, encoding: str = "auto"
) -> tuple[Tensor, Tensor | None]:
    """Read photographs of a calibration ball whose lights are not known.

    Args:
        path: a folder; ``mask.png`` in it is the ball's mask, white on the ball.
        mask: a mask outside the folder.
        encoding: as in `load_capture`.

    Returns:
        Images (K, 3, H, W) in linear light, and the mask (1, H, W) bool or None.

    Raises:
        FileError: as `load_capture`.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise FileError(str(folder), expected="a folder of photographs", got="no folder", mend="check the name")
    mask_file = Path(mask) if mask is not None else find_mask(folder)
    files = list_photographs(folder, () if mask_file is None else (mask_file,))
    images = read_photographs(files, encoding, torch.ones(len(files), 3)).images
    if mask_file is None:
        return images, None
    inside, _ = read_mask(mask_file, (images.shape[2], images.shape[3]))
    return images, inside


def _ball_directions(folder: Path, count: int, encoding: str) -> tuple[Tensor, Finding]:
    """Light directions (K, 3) from photographs of a mirror ball."""
    images, mask = load_ball(folder, encoding=encoding)
    if len(images) != count:
        raise FileError(
            str(folder),
            expected=f"{count} photographs, one per light",
            got=str(len(images)),
            mend="give one photograph of the ball per image",
        )
    ball = find_circle(images) if mask is None else find_ball(mask)
    text = f"lights from the chrome ball at ({ball.x:.1f}, {ball.y:.1f}), radius {ball.radius:.1f} pixels."
    return light_directions(images, ball), Finding(text, "lights-from-ball", ball.radius)
