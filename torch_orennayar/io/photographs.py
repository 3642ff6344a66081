"""The pictures of a capture: found in its folder, read to linear light, all of one size, orientation and encoding."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from ..core.errors import FileError
from ..core.files import written_files
from ..core.findings import Finding
from ..core.progress import track
from .encoding import srgb_curve
from .light_text import clean_name, read_lines
from .listed_names import path_inside
from .masks import is_mask
from .picture import HEIF_SUFFIXES, IMAGE_SUFFIXES, RAW_SUFFIXES, Picture, read_picture, to_unit
from .region import WHOLE, Region

Floats: TypeAlias = npt.NDArray[np.float32]

HALF_FROM = 1 << 28
"""Number of samples of a capture (K x 3 x H x W) from which images are kept in half precision, which rounds each value
by at most 0.05 % and halves the memory; set by hand: 1 GiB in float32."""
DARK_WORDS = ("ambient", "off", "dark", "black")
"""A photograph of one of these names, or whose name ends with one, was taken with all lights off."""
OTHER_WORDS = ("ref", "reference", "preview", "thumbnail", "thumb")
"""A picture of one of these names, or whose name ends with one, shows the scene in some other way."""
READERS = 4
"""Threads that decode photographs, at most; set by hand. Each holds its image several times over."""
ALONE_FROM = 8_000_000
"""Pixels of a photograph from which one is decoded at a time; set by hand, for memory."""


def list_photographs(folder: Path, others: Sequence[Path]) -> list[Path]:
    """Photographs of a capture in natural order: those in ``filenames.txt``, else images that are nothing else.

    Masks, ``others``, `odd_pictures` and results that this package wrote there are something else.

    Raises:
        FileError: a listed name that leads out of the folder, or nothing that can be read.
    """
    listing = folder / "filenames.txt"
    if listing.is_file():
        listed = [path_inside(folder, clean_name(line)) for _, line in read_lines(listing)]
        if not listed:
            raise FileError(str(listing), expected="names of photographs", got="none", mend="fill it, or remove it")
        return listed

    def natural(file: Path) -> list[tuple[int, str]]:
        return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", file.name)]

    known = {other.resolve() for other in others}
    pictures = (f for f in _pictures(folder) if not (is_mask(f) or f.resolve() in known or _is_odd(f)))
    found = sorted(pictures, key=natural)
    if not found:
        kinds = Counter(f.suffix.lower() or "no suffix" for f in folder.iterdir() if f.is_file())
        got = ", ".join(f"{count} {suffix}" for suffix, count in kinds.most_common(6)) or "no files"
        mend = "check the folder"
        if kinds.keys() & (RAW_SUFFIXES | HEIF_SUFFIXES):
            mend = "convert the camera's files: RAW to linear 16-bit TIFF (dcraw -4 -T), HEIC to TIFF or JPEG"
        raise FileError(str(folder), expected="photographs", got=got, mend=mend)
    return found


def find_ambient(folder: Path) -> Path | None:
    """The photograph with all lights off in ``folder``, if it has one: ``ambient.*``, else the only one named so.

    Raises:
        FileError: several, none of which is called ``ambient``.
    """
    found = [f for f in _pictures(folder) if _named(f, DARK_WORDS)]
    exact = [f for f in found if f.stem.lower() == DARK_WORDS[0]]
    if len(exact or found) > 1:
        listed = ", ".join(f.name for f in exact or found)
        mend = "give the right one as ambient= (--ambient), or move the others away"
        raise FileError(str(folder), expected="one photograph with all lights off", got=listed[:200], mend=mend)
    return next(iter(exact or found), None)


def odd_pictures(folder: Path, used: Sequence[Path]) -> tuple[Finding, ...]:
    """A finding that names pictures which are taken for no photographs by their names, ``used`` ones left out."""
    odd = [f.name for f in _pictures(folder) if _is_odd(f) and f.resolve() not in {u.resolve() for u in used}]
    text = (
        f"taken for no photographs by their names: {', '.join(odd)}; list the photographs in filenames.txt if they are."
    )
    return (Finding(text, "not-photographs", len(odd)),) if odd else ()


def _pictures(folder: Path) -> list[Path]:
    results = written_files(folder)
    files = (f for f in sorted(folder.iterdir()) if not f.name.startswith(".") and f.name not in results)
    return [f for f in files if f.suffix.lower() in IMAGE_SUFFIXES]


def _is_odd(file: Path) -> bool:
    return _named(file, DARK_WORDS + OTHER_WORDS)


def _named(file: Path, words: tuple[str, ...]) -> bool:
    """Whether one of ``words`` is the name, or its last part after a sign that joins words."""
    return re.split(r"[ ._-]+", file.stem.lower())[-1] in words


class Photographs(NamedTuple):
    """What `read_photographs` found.

    Attributes:
        images: (K, 3, H, W) linear light.
        size: (height, width) of the whole photographs.
        valid: (K, 1, H, W) bool, where no channel is at full scale; None where that is everywhere.
        findings: what was decided on the way.
    """

    images: Tensor
    size: tuple[int, int]
    valid: Tensor | None
    findings: tuple[Finding, ...]


def read_photographs(
    files: Sequence[Path],
    encoding: str,
    intensities: Tensor,
    ambient: Path | None = None,
    region: Region = WHOLE,
) -> Photographs:
    """Images in linear light divided by ``intensities`` (K, 3).

    Args:
        files: the photographs.
        encoding: as `load_capture` takes it.
        intensities: RGB irradiance per photograph.
        ambient: a photograph with all lights off, which is subtracted before the division.
        region: the part that is kept, and its size.

    Raises:
        FileError: no files, damaged ones, or images of more than one size or bit depth.
    """
    if not files:
        raise FileError("images", expected="image files in the folder", got="none", mend="check the folder")
    first = read_picture(files[0])
    linear, decisions = _choose_encoding(first, encoding)
    size = (first.samples.shape[0], first.samples.shape[1])
    region.check(size)

    def decode(file: Path) -> tuple[Tensor, Tensor]:
        picture = read_picture(file)
        _check_same_kind(file, picture, files[0], first)
        light = torch.from_numpy(linear(to_unit(picture.samples)))
        light = light[None] if light.ndim == 2 else light.permute(2, 0, 1)
        below = region.apply_mask(_below_full_scale(picture)[None], share=1.0)
        return region.apply(light).expand(3, -1, -1), below

    dark = None if ambient is None else decode(ambient)[0]
    kept = region.apply_mask(torch.ones(1, *size, dtype=torch.bool)).shape[1:]
    large = len(files) * 3 * kept.numel() > HALF_FROM
    valid = torch.empty((len(files), 1, *kept), dtype=torch.bool)
    result = torch.empty((len(files), 3, *kept), dtype=torch.float16 if large else torch.float32)

    def fill(index: int) -> None:
        image, valid[index] = decode(files[index])
        if dark is not None:
            image = (image - dark).clamp_min(0)
        result[index] = image / intensities[index][:, None, None]

    alone = large or size[0] * size[1] > ALONE_FROM
    with ThreadPoolExecutor(1 if alone else min(READERS, os.cpu_count() or 1)) as pool:
        try:
            list(track(pool.map(fill, range(len(files))), "reading images", len(files)))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    findings = (*decisions, *_other_findings(first, large, ambient), *_region_finding(region, size, kept))
    return Photographs(result, size, None if bool(valid.all()) else valid, findings)


def _below_full_scale(picture: Picture) -> Tensor:
    """Where no channel has the largest value of its type, (H, W) bool: there the sensor or the file was at its end."""
    samples = picture.samples
    full = {"uint8": 255, "uint16": 65535}.get(samples.dtype.name)
    if full is None:
        return torch.ones(samples.shape[:2], dtype=torch.bool)
    below = np.asarray(samples != full)
    return torch.from_numpy(below if below.ndim == 2 else below.all(2))


def _choose_encoding(picture: Picture, encoding: str) -> tuple[Callable[[Floats], Floats], list[Finding]]:
    """What turns samples into linear light, and why: the caller's word, else the file's, else 8 bits are sRGB."""
    dtype, stated = picture.samples.dtype, picture.stated
    if encoding == "auto" and stated is not None:
        return stated.to_linear, [Finding(f"{dtype} images read as they say: {stated.words}.", "encoding-stated")]
    encoded = encoding == "srgb" or (encoding == "auto" and dtype == np.uint8)
    curve, code, other = (
        ("sRGB-encoded", "read-as-srgb", "linear") if encoded else ("linear light", "read-as-linear", "srgb")
    )
    guess = f"; if they are not, load them with encoding='{other}' (--encoding {other})" if encoding == "auto" else ""
    found = [Finding(f"{dtype} images read as {curve}{guess}.", code)]
    if stated is not None and stated.linear == encoded:
        found.append(Finding(f"the images state another encoding: {stated.words}.", "encoding-overridden"))
    return srgb_curve if encoded else lambda samples: samples, found


def _other_findings(picture: Picture, large: bool, ambient: Path | None) -> list[Finding]:
    found = []
    if picture.orientation != 1:
        said = f"images turned upright as they say (orientation {picture.orientation})"
        text = f"{said}; lights are taken as those of the upright view."
        found.append(Finding(text, "turned-upright", picture.orientation))
    if large:
        text = "a large capture: its images are kept in half precision, 0.05 % of each value."
        found.append(Finding(text, "half-precision"))
    if ambient is not None:
        text = f"{ambient.name}, taken with all lights off, was subtracted."
        found.append(Finding(text, "ambient-subtracted"))
    return found


def _region_finding(region: Region, whole: Sequence[int], kept: Sequence[int]) -> list[Finding]:
    if region.is_whole:
        return []
    text = f"photographs of {whole[1]} x {whole[0]} pixels cut or reduced to {kept[1]} x {kept[0]}."
    return [Finding(text, "size-changed", region.scale)]


def _check_same_kind(file: Path, picture: Picture, first_file: Path, first: Picture) -> None:
    """All images of a capture have one size, orientation, bit depth and encoding."""

    def words(one: Picture) -> str:
        return one.stated.words if one.stated is not None else "no encoding"

    kinds = (
        (
            lambda p: f"orientation {p.orientation}",
            "turn all images alike: the camera was turned between photographs, or an editor turned some of them",
        ),
        (lambda p: f"{p.samples.shape[1]} x {p.samples.shape[0]} pixels", "bring all images of a capture to one size"),
        (lambda p: f"{p.samples.dtype} samples", "export all images of a capture with one bit depth"),
        (words, "export all images of a capture in one encoding"),
    )
    for kind, mend in kinds:
        if kind(picture) != kind(first):
            raise FileError(str(file), expected=f"{kind(first)} as in {first_file.name}", got=kind(picture), mend=mend)
