"""Text files of the positions of near lights, in millimetres or the unit that they state."""

from __future__ import annotations

import re
from pathlib import Path

import torch
from torch import Tensor

from ..core.errors import FileError, RangeError
from .light_files import COLUMNS, LightList, split_columns
from .light_text import clean_name, read_lines, split_row

MILLIMETRES = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "": 1.0}
"""Of a unit that the name of a column may state."""
_COORDINATE = re.compile(r"(?:led|light|lamp|pos|position)?[ _]*([xyz])[ _]*[\[(]?(mm|cm|m|in|)[\])]?", re.IGNORECASE)
"""The name of a column of positions: x, y or z, perhaps with a unit."""
LEAST_DISTANCE = 2.0
"""Length of the longest vector up to which positions are taken for directions, millimetres; set by hand."""


def read_positions(file: Path, unit: str | None = None) -> LightList:
    """Names of photographs, or none, and positions (K, 3) of their lights in millimetres.

    One line per light: ``x y z``, with the photograph's name before it or without; or a table whose first line names
    its columns, ``x``, ``y`` and ``z`` perhaps with a unit (``x_mm``, ``y [cm]``); other columns are not read. Without
    a unit numbers are millimetres. The origin is where the camera's axis meets the object, x points right, y up and z
    toward the camera.

    Args:
        file: the text file.
        unit: of its numbers, a key of `MILLIMETRES`, where the first line states none.

    Raises:
        FileError: an empty file, lines of another form, names in some lines only, units that differ.
        RangeError: numbers that are not finite, directions instead of positions, lights all behind the object,
            an unknown unit.
    """
    if unit not in (None, *MILLIMETRES):
        known = ", ".join(filter(None, MILLIMETRES))
        raise RangeError(
            "unit", expected=f"one of {known}", got=repr(unit), mend="convert the positions to one of them"
        )
    lines = read_lines(file)
    if not lines:
        raise FileError(str(file), expected="one line 'x y z' per light", got="an empty file", mend="fill it")
    columns = [_COORDINATE.fullmatch(clean_name(cell)) for cell in split_columns(lines[0][1])]
    if {match[1].lower() for match in columns if match} == {"x", "y", "z"}:
        listed = _read_table(file, lines, unit)
    else:
        listed = _read_rows(file, lines)
        listed = listed._replace(directions=listed.directions * MILLIMETRES[unit or ""])
    _check(file, listed.directions)
    return listed


def _read_table(file: Path, lines: list[tuple[int, str]], unit: str | None) -> LightList:
    """A table whose first line names its columns."""
    header = [clean_name(cell) for cell in split_columns(lines[0][1])]
    places, units = {}, set()
    for place, cell in enumerate(header):
        match = _COORDINATE.fullmatch(cell)
        if match:
            places[match[1].lower()] = place
            units.add(match[2].lower())
    if len(units) > 1:
        raise FileError(
            str(file), expected="one unit", got=", ".join(sorted(units)), mend="write all columns in one unit"
        )
    stated = units.pop() or unit or ""
    if unit not in (None, stated):
        raise FileError(
            str(file), expected=f"positions in {unit}", got=f"{stated} in the first line", mend="leave the unit out"
        )
    named = next((place for place, cell in enumerate(header) if COLUMNS.get(cell.lower()) == "name"), None)
    names, rows = [], []
    for number, text in lines[1:]:
        cells = split_columns(text)
        try:
            rows.append([float(cells[places[axis]].replace(",", ".")) for axis in "xyz"])
            names += [] if named is None else [clean_name(cells[named])]
        except (ValueError, IndexError) as error:
            raise FileError(
                f"{file} line {number}", expected=f"numbers under {', '.join(header)}", got=repr(text[:60]),
                mend="correct the line",
            ) from error  # fmt: skip
    if not rows:
        raise FileError(str(file), expected="a line per light", got="the first line alone", mend="write the positions")
    return LightList(names, torch.tensor(rows, dtype=torch.float64).mul(MILLIMETRES[stated]).float())


def _read_rows(file: Path, lines: list[tuple[int, str]]) -> LightList:
    """Lines of three numbers, with a name or the light's number before them or without."""
    rows = [split_row(number, text) for number, text in lines]
    for row in rows:
        if len(row.numbers) not in (3, 4) or len(row.numbers) != len(rows[0].numbers):
            raise FileError(
                f"{file} line {row.line}",
                expected="3 numbers, x y z, with or without the name of the photograph",
                got=repr(row.text[:60]),
                mend="correct the line, or name the columns in the first line",
            )
    counted = len(rows[0].numbers) == 4
    if counted and [row.numbers[0] for row in rows] not in (list(range(len(rows))), list(range(1, len(rows) + 1))):
        raise FileError(
            str(file),
            expected="3 numbers in a line, or the light's number before them",
            got=repr(rows[0].text[:60]),
            mend="name the columns in the first line; intensities belong in light_intensities.txt",
        )
    names = [] if counted else [row.name(3) for row in rows]
    if any(names) and not all(names):
        raise FileError(str(file), expected="a name in all lines or in none", got="both", mend="add or remove names")
    return LightList(names if any(names) else [], torch.tensor([row.numbers[-3:] for row in rows]))


def _check(file: Path, positions: Tensor) -> None:
    if not bool(positions.isfinite().all()):
        raise RangeError(str(file), expected="finite numbers", got="NaN or infinity", mend="correct the file")
    length = positions.norm(dim=1)
    if float(length.max()) <= LEAST_DISTANCE:
        raise RangeError(
            str(file),
            expected="positions in millimetres, or with their unit in the first line (x_m, y_m, z_m)",
            got=f"vectors of length {length.min().item():.3g} to {length.max().item():.3g}",
            mend="give directions as --lights, or name the unit",
        )
    if bool((positions[:, 2] <= 0).all()):
        raise RangeError(
            str(file),
            expected="lights on the camera's side of the object, z above 0",
            got="z below 0 for all of them",
            mend="count z from the object toward the camera",
        )
