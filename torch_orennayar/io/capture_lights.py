"""The lights of a folder of photographs: paired with them by name or order, or found from them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from torch import Tensor

from ..core.errors import CaptureError, FileError
from ..core.findings import Finding
from ..stereo.unknown_lights import search_lights, warn_of_doubts
from .light_files import LIGHT_FILES, LightList, find_intensity_file
from .listed_names import match_names
from .photographs import list_photographs


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
            mend=f"write one line 'x y z' per image, or pass lights= (--lights); or {error.mend}",
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
