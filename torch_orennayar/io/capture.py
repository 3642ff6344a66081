"""Load a photometric-stereo capture: a folder of photographs and a file of lights."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from torch import Tensor

from ..core.defaults import independent_of_defaults
from ..core.errors import FileError, RangeError
from ..core.findings import Finding
from ..geometry.primitives import Ball
from ..stereo.calibrate import own_intensities, unequal_intensities
from .ball_photographs import BallLights, lights_of_ball, lights_of_ball_beside, seen_off_axis
from .capture_lights import GivenLights, given_ball, lights_from_photographs, read_lights
from .encoding import check_encoding
from .encoding_choice import choose_encoding
from .images import write_image
from .light_files import DIRECTIONS_FILE, INTENSITIES_FILE, read_intensities
from .light_order import doubt_order
from .masks import find_mask, read_mask
from .object_mask import disc, find_object
from .optics import View, stated_field_of_view
from .photographs import find_ambient, odd_pictures, read_photographs
from .region import Region
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
        ball: the outline of a mirror ball among the photographs that the lights come from, or None.
        ball_picture: (3, h, w) that ball with its outline and highlights drawn, or one of a folder of its own; or None.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> lights, images = torch.eye(3), torch.full((3, 3, 4, 5), 0.5)
        >>> mask = torch.ones(1, 4, 5, dtype=torch.bool)
        >>> capture = ton.Capture(images, lights, torch.ones(3, 3), mask, None, ("a.png", "b.png", "c.png"))
        >>> capture.images.shape, capture.notes
        (torch.Size([3, 3, 4, 5]), ())
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
    ball: Ball | None = None
    ball_picture: Tensor | None = None

    @independent_of_defaults
    def with_own_intensities(self, *, seed: int = 0) -> Capture:
        """The capture divided by light intensities estimated from itself instead of those it was loaded with.

        Args:
            seed: of the random sample of pixels that the estimate looks at.

        Raises:
            CaptureError: fewer than 5 lights.
        """
        raw = self.images * self.intensities[:, :, None, None].to(self.images)
        return self._divided(raw, own_intensities(raw, self.lights, self.mask, seed=seed))

    def _divided(self, raw: Tensor, found: Tensor) -> Capture:
        """The capture with ``raw`` images, which are overwritten, divided by intensities (K, 1) found from them."""
        text = f"intensities of the lights found from the capture itself, {found.min():.2f} to {found.max():.2f}."
        kept = (note for note in self.notes if note.code not in ("no-intensities", "intensities-from-capture"))
        notes = (*kept, Finding(text, "intensities-from-capture"))
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
    unit: str | None = None,
    ambient: str | os.PathLike[str] | None = None,
    encoding: str = "auto",
    ball: Ball | Sequence[float] | None = None,
    ball_mask: str | os.PathLike[str] | None = None,
    crop: Sequence[int] | None = None,
    scale: float = 1.0,
    fov_y: float | None = None,
) -> Capture:
    """Load a capture: a DiLiGenT folder, a folder with a light file, an ``.lp`` file, or images with a mirror ball.

    The folder may hold: ``filenames.txt`` (without it, all images but the mask, in natural order: 2 before 10);
    ``light_directions.txt``, ``lights.txt`` or ``lights.csv`` (one line ``x y z`` per image, with or without its name,
    or a table whose first line names its columns), or one ``*.lp``; ``light_intensities.txt`` (1 or 3 numbers per line;
    default 1, or what 8 photographs or more show where they differ); a mask, any picture with ``mask`` in its name (the
    opaque part where alpha varies, every label but 0, or what is brighter than half the maximum); a photograph with all
    lights off (``ambient.*``, or a name that ends with ``off`` or ``dark``), which is subtracted; ``Normal_gt.mat`` or
    ``normal_gt.npy``, true normals (H, W, 3). Pictures called ``ref`` or ``preview``, or whose names end so, are left
    out.

    Without a mask the object is found where it stands before a dark background; otherwise every pixel counts. Without a
    light file a mirror ball beside the object is looked for, and then the lights are found from the photographs
    themselves (`find_lights`), taken as equally bright unless these show that they are not. Notes say what was done.

    Args:
        path: the folder, or an ``.lp`` file beside its images.
        lights: a light file outside the folder.
        mask: a mask image outside the folder; white is the object. ``"whole"``: every pixel.
        chrome: a folder of photographs of a mirror ball under the same lights, of the same names or in the same order,
            optionally with a ``mask.png`` of the ball; directions are measured from its highlights and no light file
            is read.
        positions: a file of the positions of near lights, instead of a light file.
        unit: of these positions, ``mm``, ``cm``, ``m`` or ``in``, where the file states none; default: millimetres.
        ambient: a photograph with all lights off, outside the folder.
        encoding: ``"linear"``, ``"srgb"``, or ``"auto"``: what the files state (profile, sRGB or gamma chunk, Exif),
            else 8-bit files are sRGB-encoded, unless under 8 lights or more they predict lights that are left out far
            better as linear light, and all others linear.
        ball: the outline of a mirror ball, column and row of its centre and radius in pixels of the whole photographs:
            those of ``chrome`` where it is given, else those of ``path``; no light file is read.
        ball_mask: a mask of that ball instead, white on the ball.
        crop: left, top, width and height of the part that is kept, in pixels of the upright photographs.
        scale: factor in (0, 1] by which it is reduced, in linear light.
        fov_y: vertical angle of view of the whole upright photographs, radians, for the lights of a ball that the
            camera sees from the side; default: what Exif states, or else as seen along the axis.

    Returns:
        A `Capture`.

    Raises:
        FileError: a file is missing, damaged or truncated, or lies outside the folder; images differ in size,
            orientation, bit depth or encoding; the numbers of lights and images differ.
        RangeError: unknown encoding, lights that are not unit vectors, intensities that are not positive, a crop that
            leaves the pictures, a scale out of range.
        CaptureError: no ball where one is marked, or a photograph without a highlight on it.
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
    check_encoding(encoding)
    if fov_y is not None and not 0 < fov_y < math.pi:
        raise RangeError("fov_y", expected="radians in (0, pi)", got=str(fov_y), mend="use math.radians")
    source = Path(path)
    if not source.exists():
        raise FileError(
            str(source), expected="a capture folder or .lp file", got="nothing there", mend="check the path"
        )
    folder = source if source.is_dir() else source.parent
    mask_file = None if mask == "whole" else Path(mask) if mask is not None else find_mask(folder)
    ambient_file = Path(ambient) if ambient is not None else find_ambient(folder)
    others = tuple(f for f in (mask_file, ambient_file) if f is not None)
    marked = given_ball(ball, ball_mask)
    given = read_lights(
        source, others, lights=lights, chrome=chrome, positions=positions, unit=unit, ball=marked, encoding=encoding
    )
    plan = _Plan(
        folder,
        given,
        mask_file,
        ambient_file,
        Region(crop, scale),
        marked if chrome is None else None,
        whole=mask == "whole",
        notes=odd_pictures(folder, (*given.files, *others)),
        fov_y=fov_y,
    )
    capture = _read(plan, encoding)
    if encoding != "auto" or given.positions is not None or "read-as-srgb" not in {n.code for n in capture.notes}:
        return _judged(capture, by_order=given.by_order)
    is_linear, chosen = choose_encoding(capture.images, capture.lights, capture.intensities, capture.mask[0])
    capture = _read(plan, "linear") if is_linear else capture
    return _judged(replace(capture, notes=(*capture.notes, *chosen)), by_order=given.by_order)


def _judged(capture: Capture, *, by_order: bool) -> Capture:
    """The capture with what its photographs say of its lights, divided by their brightness if no file states it.

    ``by_order``: lights belong to photographs by their order, not by names.
    """
    if by_order:
        notes = doubt_order(capture.images, capture.lights, capture.mask, capture.names)
        capture = replace(capture, notes=(*notes, *capture.notes))
    if capture.positions is not None or "no-intensities" not in {note.code for note in capture.notes}:
        return capture
    if {"lights-found", "lights-unequal"} & {note.code for note in capture.notes}:
        return capture  # their brightness was judged when they were found
    found = unequal_intensities(capture.images, capture.lights, capture.mask)
    return capture if found is None else capture._divided(capture.images, found)  # its stated intensities are 1


@dataclass(frozen=True)
class _Plan:
    """What is known of a capture before its photographs are read: files, lights, region, marked ball."""

    folder: Path
    given: GivenLights
    mask: Path | None
    ambient: Path | None
    region: Region
    ball: Ball | None
    whole: bool
    notes: tuple[Finding, ...]
    fov_y: float | None


def _read(plan: _Plan, encoding: str) -> Capture:
    """The capture read in that encoding, its mask and its lights found where they are not known."""
    given, region, lights = plan.given, plan.region, plan.given.directions
    intensities, no_intensities = read_intensities(plan.folder, len(given.files))
    if given.intensities is not None:
        intensities, no_intensities = given.intensities.expand(-1, 3).contiguous(), ()
    images, size, valid, decisions = read_photographs(given.files, encoding, intensities, plan.ambient, region)
    inside, about_mask = _mask(plan, images, size)
    beside = _ball_beside(plan, images, inside, size) if lights is None else None
    if plan.fov_y is not None and beside is None:
        mend = "leave it out; it corrects the lights of a ball that is seen from the side"
        raise RangeError("fov_y", expected="a mirror ball in the photographs", got="none", mend=mend)
    ball = beside or given.ball
    about_lights: tuple[Finding, ...] = (ball.finding,) if ball is not None else ()
    if beside is not None:
        lights = beside.directions
        if plan.mask is None and not plan.whole:
            inside = inside & ~disc(beside.ball, (images.shape[2], images.shape[3]))
    elif lights is None:
        lights, brightness, about_lights = lights_from_photographs(plan.folder, images, inside, valid)
        images, intensities = images.div_(brightness[:, :, None, None]), intensities * brightness
    return Capture(
        images=images,
        lights=lights,
        intensities=intensities,
        mask=inside,
        normal=region.apply_normals(read_truth(plan.folder, size)),
        names=tuple(f.name for f in given.files),
        notes=(*about_lights, *no_intensities, *decisions, *plan.notes, *about_mask),
        valid=valid,
        positions=given.positions,
        ball=None if beside is None else beside.ball,
        ball_picture=None if ball is None else ball.picture,
    )


def _ball_beside(plan: _Plan, images: Tensor, inside: Tensor, size: tuple[int, int]) -> BallLights | None:
    """The ball that is marked, or else one seen in the photographs, which are ``size`` high and wide when whole."""
    marked = None if plan.ball is None else plan.region.move(plan.ball)
    found = lights_of_ball_beside(images, inside) if marked is None else lights_of_ball(images, marked)
    height = plan.fov_y or stated_field_of_view(plan.given.files[0])
    return found if found is None or height is None else seen_off_axis(found, View(plan.region, size, height))


def _mask(plan: _Plan, images: Tensor, size: tuple[int, int]) -> tuple[Tensor, tuple[Finding, ...]]:
    """The mask of the region, from its file or from the images, and what was decided."""
    if plan.mask is None and not plan.whole:
        found = find_object(images)
        return found.inside, (found.finding,)
    inside, findings = read_mask(plan.mask, size)
    return plan.region.apply_mask(inside), findings


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
