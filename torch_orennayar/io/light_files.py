"""Text files of light directions and intensities: found in a capture's folder, read, checked and written."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..core.checks import UNIT_TOLERANCE
from ..core.errors import FileError, RangeError
from ..core.files import atomic_path
from ..core.findings import Finding
from .light_text import Row, clean_name, read_lines, split_row

DIRECTIONS_FILE = "light_directions.txt"
"""Name of the file of light directions in DiLiGenT's folders (Shi et al. 2016), and of those written here."""
INTENSITIES_FILE = "light_intensities.txt"
"""Name of the file of light intensities, from the same source."""
LIGHT_FILES = (DIRECTIONS_FILE, "lights.txt", "lights.csv")
"""Names of files of light directions; the first that exists is read."""
INTENSITY_FILES = (INTENSITIES_FILE, "intensities.txt")
"""Names of files of light intensities; the first that exists is read."""
POSITION_FROM = 1.5
"""Length from which all vectors of a file are positions, not directions that were rounded; set by hand."""
COLUMNS: dict[str, str] = {
    **dict.fromkeys(("name", "filename", "file", "image", "photo", "photograph"), "name"),
    **dict.fromkeys(("x", "lx", "nx", "dx", "light_x", "dir_x"), "x"),
    **dict.fromkeys(("y", "ly", "ny", "dy", "light_y", "dir_y"), "y"),
    **dict.fromkeys(("z", "lz", "nz", "dz", "light_z", "dir_z"), "z"),
    **dict.fromkeys(("azimuth", "azimuth_deg", "azimuth_degrees", "phi"), "azimuth"),
    **dict.fromkeys(("elevation", "elevation_deg", "elevation_degrees", "altitude"), "elevation"),
    **dict.fromkeys(("intensity", "brightness"), "intensity"),
    **{channel: channel for channel in "rgb"},
}
"""What the first line may call a column, in small letters, and what that is."""


class LightList(NamedTuple):
    """What a light file says.

    Attributes:
        names: of the images, or none.
        directions: (K, 3) float32, unit.
        intensities: (K, 1|3) float32 where the file has them beside the directions, or None.
    """

    names: list[str]
    directions: Tensor
    intensities: Tensor | None = None


def find_light_file(source: Path) -> Path | None:
    """The light file of a folder: one of `LIGHT_FILES`, else its only ``.lp`` file; ``source`` itself if it is a file.

    Raises:
        FileError: several ``.lp`` files.
    """
    if source.is_file():
        return source
    found = [source / name for name in LIGHT_FILES if (source / name).is_file()] or sorted(source.glob("*.lp"))
    if len(found) > 1 and found[0].suffix == ".lp":
        raise FileError(str(source), expected="one .lp file", got=str(len(found)), mend="give the path of one of them")
    return found[0] if found else None


def find_intensity_file(folder: Path) -> Path | None:
    """The file of light intensities in ``folder``, if it has one."""
    return next((folder / name for name in INTENSITY_FILES if (folder / name).is_file()), None)


def read_directions(file: Path) -> LightList:
    """Image names, or none, and unit directions from lines ``[name] x y z``, in any of the forms that people write.

    The name may follow the numbers; an intensity, or three, may follow x, y and z; the first line may name the columns,
    azimuth and elevation in degrees among them; three lines of K numbers are the transposed table. An ``.lp`` file
    starts with the number of its lines, as in reflectance transformation imaging.

    Raises:
        FileError: an empty file, a wrong count, lines of another form, names in some lines only, positions.
        RangeError: a direction that is not of unit length, or not finite, or all behind the object.
    """
    lines = read_lines(file)
    if not lines:
        raise FileError(str(file), expected="one line 'x y z' per image", got="an empty file", mend="fill it")
    columns = _columns(lines[0][1])
    if columns is not None:
        return _read_columns(file, columns, lines[1:])
    rows = [split_row(number, text) for number, text in lines]
    stated = _count(rows[0])
    if stated is not None:
        rows.pop(0)
        if stated != len(rows):
            raise FileError(
                str(file),
                expected=f"{stated} lights as its first line says",
                got=str(len(rows)),
                mend="correct the first line",
            )
    if not rows:
        raise FileError(str(file), expected="one line 'x y z' per image", got="no lights", mend="write them")
    if len(rows) == 3 and len({len(row.numbers) for row in rows}) == 1 and len(rows[0].numbers) > 3:
        across = torch.tensor([row.numbers for row in rows], dtype=torch.float64).T
        if _unit(across).all() and not any(row.name(len(row.numbers)) for row in rows):
            return LightList([], _directions(file, across))
    return _read_rows(file, rows)


def _read_rows(file: Path, rows: Sequence[Row]) -> LightList:
    """Lines of numbers with names before or behind them, or without."""
    short = next((row for row in rows if len(row.numbers) < 3), None)
    if short is not None:
        raise _bad_line(file, short, rows)
    last = torch.tensor([row.numbers[-3:] for row in rows], dtype=torch.float64)
    widths, intensities, kept = {len(row.numbers) for row in rows}, None, 3
    if widths in ({4}, {6}) and not _unit(last).all():
        first = torch.tensor([row.numbers[:3] for row in rows], dtype=torch.float64)
        if _unit(first).all():
            kept = widths.pop()
            last = first
            intensities = torch.tensor([row.numbers[3:] for row in rows], dtype=torch.float64)
    if kept == 3 and not _unit(last).all():
        wide = next((row for row in rows if len(row.numbers) > 4), None)
        if wide is not None:
            raise _bad_line(file, wide, rows)
    names = [row.name(kept) for row in rows]
    if any(names) and not all(names):
        raise FileError(
            str(file), expected="a name in all lines or in none", got="both", mend="add or remove the names"
        )
    if intensities is not None:
        intensities = _intensities(file, intensities)
    return LightList(names if all(names) else [], _directions(file, last), intensities)


_COORDINATES = re.compile(r"\b[xyz][ _]*[\[(]?(mm|cm|m|in)\b", re.IGNORECASE)
"""The name of a column of positions in a unit."""


def _bad_line(file: Path, row: Row, rows: Sequence[Row]) -> FileError:
    """Why a line is not a light."""
    mend = "correct the line"
    if all(len(other.numbers) == 2 for other in rows):
        mend = "write x y z; or, for angles in degrees, 'azimuth elevation' as the first line"
    elif _COORDINATES.search(row.text):
        mend = "these are positions: give the file as positions= (--positions)"
    elif "," in row.text and "." not in row.text:
        mend = "separate the numbers by blanks or semicolons, so that their commas are decimal commas"
    return FileError(
        f"{file} line {row.line}",
        expected="3 numbers, x y z, with or without the name of the image",
        got=repr(row.text[:60]),
        mend=mend,
    )


def _count(row: Row) -> int | None:
    """The number of lines that an ``.lp`` file states first, with or without a word behind it."""
    if len(row.numbers) == 1 and row.text.isdecimal():
        return int(row.text)
    words = row.text.split()
    return int(words[0]) if len(words) == 2 and not row.numbers and words[0].isdecimal() else None


def _columns(text: str) -> list[str] | None:
    """What the columns are, if a first line names them."""
    words = [clean_name(word).lower() for word in split_columns(text)]
    kinds = [COLUMNS.get(word, "") for word in words]
    whole = {"x", "y", "z"} <= set(kinds) or {"azimuth", "elevation"} <= set(kinds)
    return kinds if whole else None


def split_columns(text: str) -> list[str]:
    """The cells of a line of a table with named columns."""
    separator = next((s for s in (";", "\t", ",") if s in text), None)
    return [cell.strip() for cell in text.split(separator)]


def _read_columns(file: Path, columns: list[str], lines: Sequence[tuple[int, str]]) -> LightList:
    """A table whose first line named its columns."""
    if not lines:
        raise FileError(str(file), expected="a line per image", got="the first line alone", mend="write the lights")
    cells: dict[str, list[str]] = {column: [] for column in columns if column}
    for number, text in lines:
        row = split_columns(text)
        if len(row) != len(columns):
            raise FileError(
                f"{file} line {number}",
                expected=f"{len(columns)} cells, as its first line has",
                got=repr(text[:60]),
                mend="correct the line",
            )
        for column, cell in zip(columns, row, strict=True):
            if column:
                cells[column].append(cell)

    def numbers(*names: str) -> Tensor:
        try:
            values = [[float(cell.replace(",", ".")) for cell in cells[name]] for name in names]
        except ValueError as error:
            raise FileError(str(file), expected="numbers", got=str(error), mend="correct the cell") from error
        return torch.tensor(values, dtype=torch.float64).T.reshape(-1, len(names))

    if {"x", "y", "z"} <= set(cells):
        directions = numbers("x", "y", "z")
    else:
        azimuth, elevation = (numbers("azimuth", "elevation") * (math.pi / 180)).unbind(1)
        flat = elevation.cos()
        directions = torch.stack((flat * azimuth.cos(), flat * azimuth.sin(), elevation.sin()), 1)
    found = next((names for names in (("r", "g", "b"), ("intensity",)) if set(names) <= set(cells)), None)
    intensities = None if found is None else _intensities(file, numbers(*found))
    return LightList([clean_name(cell) for cell in cells.get("name", [])], _directions(file, directions), intensities)


def _unit(vectors: Tensor) -> Tensor:
    """Which of (K, 3) have unit length."""
    unit: Tensor = (vectors.norm(dim=1) - 1).abs() <= UNIT_TOLERANCE
    return unit


def _directions(file: Path, vectors: Tensor) -> Tensor:
    """Unit directions (K, 3) float32, checked."""
    if not bool(vectors.isfinite().all()):
        raise RangeError(str(file), expected="finite numbers", got="NaN or infinity", mend="correct the file")
    length = vectors.norm(dim=1, keepdim=True)
    if bool((length > POSITION_FROM).all()):
        raise RangeError(
            str(file),
            expected="unit vectors toward the lights",
            got=f"vectors of length {length.min().item():.4g} to {length.max().item():.4g}, which look like positions",
            mend="of near lights give the positions (--positions, near_light_stereo), of far ones directions",
        )
    for index in (~_unit(vectors)).nonzero().flatten().tolist():
        raise RangeError(
            f"{file} entry {index + 1}",
            expected="a unit vector",
            got=f"({', '.join(f'{v:.4g}' for v in vectors[index].tolist())}), length {length[index].item():.4g}",
            mend=f"correct the numbers; intensities belong behind them or in {INTENSITIES_FILE}",
        )
    if bool((vectors[:, 2] <= 0).all()):
        raise RangeError(
            str(file),
            expected="lights on the camera's side, z above 0",
            got="z below 0 for all of them",
            mend="turn the sign of z, and of y if it points down (swap_opencv_frame)",
        )
    unit: Tensor = (vectors / length).float()
    return unit


def _intensities(file: Path, values: Tensor) -> Tensor:
    """Intensities (K, 1|3) float32, checked."""
    if not bool(((values > 0) & values.isfinite()).all()):
        raise RangeError(str(file), expected="positive intensities", got=f"{values.min():g}", mend="correct the file")
    return values.float()


def read_intensities(folder: Path, count: int) -> tuple[Tensor, tuple[Finding, ...]]:
    """RGB intensities (count, 3) float32, all 1 without a file, and what was assumed.

    Raises:
        FileError: lines of another form, or another number of them.
        RangeError: intensities that are not positive and finite.
    """
    file = find_intensity_file(folder)
    if file is None:
        text = "no light intensities: all lights are taken as equally bright."
        return torch.ones(count, 3), (Finding(text, "no-intensities"),)
    rows = [split_row(number, text) for number, text in read_lines(file)]
    for row in rows:
        if len(row.numbers) not in (1, 3) or len(row.numbers) != len(rows[0].numbers) or row.name(len(row.numbers)):
            raise FileError(
                f"{file} line {row.line}",
                expected="1 or 3 numbers, the same count in every line",
                got=repr(row.text[:60]),
                mend="correct the line",
            )
    if len(rows) != count:
        raise FileError(
            str(file), expected=f"{count} lines, one per image", got=str(len(rows)), mend="write one line per image"
        )
    values: Tensor = _intensities(file, torch.tensor([row.numbers for row in rows], dtype=torch.float64))
    return values.expand(-1, 3).clone(), ()


def write_lights(folder: str | os.PathLike[str], name: str, values: Tensor) -> Path:
    """Write light directions (K, 3) or intensities (K, 1|3), one line per light, as `load_capture` reads them.

    Raises:
        FileError: the place cannot be written.
    """
    target = Path(folder) / name
    with atomic_path(target) as temporary:
        np.savetxt(temporary, values.cpu().double().numpy(), fmt="%.8f")
    return target
