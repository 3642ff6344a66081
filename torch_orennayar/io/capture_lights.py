"""The lights of a folder of photographs: paired with them by name or order, or found from them."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeAlias

import torch.nn.functional as F
from torch import Tensor

from ..core.errors import CaptureError, FileError, RangeError
from ..core.findings import Finding
from ..geometry.primitives import Ball
from ..stereo.calibrate import find_ball
from ..stereo.unknown_lights import search_lights, warn_of_doubts
from .ball_photographs import BallLights, lights_of_ball_folder
from .light_files import LIGHT_FILES, LightList, find_intensity_file, find_light_file, read_directions
from .light_positions import read_positions
from .listed_names import match_names
from .masks import read_mask_alone
from .photographs import list_photographs

PathLike: TypeAlias = str | os.PathLike[str]


class GivenLights(NamedTuple):
    """The photographs of a capture, and what is known of their lights before they are looked at.

    Attributes:
        files: the photographs.
        directions: (K, 3), or None where the photographs must tell them.
        intensities: (K, 1 or 3), or None.
        positions: (K, 3) of near lights in mm, or None.
        ball: the ball in photographs of its own that told the directions, or None.
        by_order: the lights belong to the photographs by order, as no names say which to which.
    """

    files: list[Path]
    directions: Tensor | None = None
    intensities: Tensor | None = None
    positions: Tensor | None = None
    ball: BallLights | None = None
    by_order: bool = False


def read_lights(
    source: Path,
    others: tuple[Path, ...],
    *,
    lights: PathLike | None,
    chrome: PathLike | None,
    positions: PathLike | None,
    unit: str | None,
    ball: Ball | None,
    encoding: str,
) -> GivenLights:
    """The photographs of a folder or ``.lp`` file and their lights, from the one source that is given.

    Args:
        source: the folder or ``.lp`` file.
        others: pictures that are no photographs.
        lights: a light file.
        chrome: a folder of photographs of a ball.
        positions: a file of near lights.
        unit: of its numbers, where it states none.
        ball: a marked ball, in the photographs of ``chrome`` or else in those of the capture.
        encoding: of the photographs of the ball.

    Raises:
        FileError: more than one source, a file that cannot be read, or numbers that differ.
    """
    folder = source if source.is_dir() else source.parent
    sources = [s for s in (chrome, lights, positions, ball if chrome is None else None) if s is not None]
    if len(sources) > 1:
        raise FileError(
            str(sources[0]),
            expected="a light file, a mirror ball or a file of positions",
            got="more than one",
            mend="leave the others out",
        )
    if positions is not None:
        files, listed = pair_with_lights(folder, Path(positions), others, partial(read_positions, unit=unit))
        toward = F.normalize(listed.directions, dim=1)
        return GivenLights(files, toward, listed.intensities, listed.directions)
    if chrome is not None:
        files = list_photographs(folder, others)
        found = lights_of_ball_folder(Path(chrome), [f.name for f in files], encoding, ball)
        return GivenLights(files, found.directions, ball=found)
    light_file = Path(lights) if lights is not None else find_light_file(source)
    if light_file is not None and ball is None:
        files, listed = pair_with_lights(folder, light_file, others, read_directions)
        listed_files = (folder / "filenames.txt").is_file()
        return GivenLights(files, listed.directions, listed.intensities, by_order=not listed.names and not listed_files)
    return GivenLights(list_photographs(folder, others))


def given_ball(ball: Ball | Sequence[float] | None, mask: PathLike | None) -> Ball | None:
    """The ball that is marked by its outline or by its mask.

    Raises:
        RangeError: both, or no outline.
        CaptureError: a mask that is not round.
    """
    if mask is not None and ball is not None:
        raise RangeError("ball", expected="an outline or a mask of the ball", got="both", mend="leave one of them out")
    if mask is not None:
        return find_ball(read_mask_alone(Path(mask)))
    if ball is None or isinstance(ball, Ball):
        return ball
    if len(ball) != 3 or not ball[2] > 0:
        mend = "give column, row and radius in pixels"
        raise RangeError("ball", expected="(x, y, radius) with radius > 0", got=str(ball), mend=mend)
    return Ball(*(float(v) for v in ball))


def lights_from_photographs(
    folder: Path, images: Tensor, inside: Tensor, valid: Tensor | None
) -> tuple[Tensor, Tensor, tuple[Finding, ...]]:
    """Directions (K, 3) and brightness (K, 1) of the lights of a folder without a light file, from its photographs.

    Raises:
        FileError: the photographs do not show where their lights are.
    """
    try:
        found = search_lights(images.float(), inside, "equal", valid)
        if "lights-unequal" in {finding.code for finding in found.findings}:
            found = search_lights(images.float(), inside, "unknown", valid)
    except CaptureError as error:
        raise FileError(
            str(folder),
            expected=f"a light file ({', '.join(LIGHT_FILES)} or .lp), or photographs that show their lights",
            got=f"no such file, and {error.got}",
            mend=f"write one line 'x y z' per image, or pass lights= (--lights); mark a mirror ball that is in the "
            f"photographs (--ball X,Y,RADIUS in pixels); or {error.mend}",
        ) from error
    warn_of_doubts(found)
    return found.directions, found.brightness[:, None], found.findings


def pair_with_lights(
    folder: Path, light_file: Path, others: tuple[Path, ...], read: Callable[[Path], LightList]
) -> tuple[list[Path], LightList]:
    """Image files and their lights, matched by name where the light file has names."""
    listed = read(light_file)
    extra = find_intensity_file(folder)
    if extra and (listed.names or listed.intensities is not None):
        raise FileError(
            str(extra),
            expected="no intensities beside lights that have names or intensities of their own",
            got="lines that may be in another order, or say another thing",
            mend="remove it, or give the lights without names and intensities, in the order of the images",
        )
    if listed.names:
        return match_names(folder, listed.names, light_file, partial(list_photographs, folder, others)), listed
    files = list_photographs(folder, others)
    if len(files) != len(listed.directions):
        raise FileError(
            str(light_file),
            expected=f"{len(files)} lights, one per image ({files[0].name} to {files[-1].name})",
            got=str(len(listed.directions)),
            mend="add the missing lines, or list the images that count in filenames.txt"
            if len(listed.directions) < len(files)
            else "remove the lines that have no image",
        )
    return files, listed
