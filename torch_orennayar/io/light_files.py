"""Text files of light directions and intensities: found in a capture's folder, read, checked and written."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..core.checks import UNIT_TOLERANCE
from ..core.errors import FileError, RangeError
from ..core.files import atomic_path
from ..core.findings import Finding

DIRECTIONS_FILE = "light_directions.txt"
"""Name of the file of light directions in DiLiGenT's folders (Shi et al. 2016), and of those written here."""
INTENSITIES_FILE = "light_intensities.txt"
"""Name of the file of light intensities, from the same source."""
LIGHT_FILES = (DIRECTIONS_FILE, "lights.txt")
"""Names of files of light directions; the first that exists is read."""
INTENSITY_FILES = (INTENSITIES_FILE, "intensities.txt")
"""Names of files of light intensities; the first that exists is read."""


def find_light_file(source: Path) -> Path:
    """The light file of a folder: one of `LIGHT_FILES`, else its only ``.lp`` file; ``source`` itself if it is a file.

    Raises:
        FileError: none, or several ``.lp`` files.
    """
    if source.is_file():
        return source
    found = [source / name for name in LIGHT_FILES if (source / name).is_file()] or sorted(source.glob("*.lp"))
    if len(found) > 1 and found[0].suffix == ".lp":
        raise FileError(str(source), expected="one .lp file", got=str(len(found)), mend="give the path of one of them")
    if not found:
        raise FileError(
            str(source),
            expected=f"{' or '.join(LIGHT_FILES)} or an .lp file",
            got="none of them",
            mend="write one line 'x y z' per image, or pass lights= (--lights)",
        )
    return found[0]


def find_intensity_file(folder: Path) -> Path | None:
    """The file of light intensities in ``folder``, if it has one."""
    return next((folder / name for name in INTENSITY_FILES if (folder / name).is_file()), None)


def read_words(file: Path) -> list[list[str]]:
    """The words of every line, split at blanks and commas; ``#`` starts a comment, and empty lines are skipped.

    Byte-order marks and line ends of all systems are accepted.

    Raises:
        FileError: no such file, or no UTF-8 text.
    """
    if not file.is_file():
        raise FileError(str(file), expected="a text file", got="nothing there", mend="check the name")
    try:
        text = file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileError(str(file), expected="a text file", got="binary data", mend="save it as UTF-8") from error
    rows = (line.split("#")[0].replace(",", " ").split() for line in text.splitlines())
    return [row for row in rows if row]


def read_directions(file: Path) -> tuple[list[str], Tensor]:
    """Image names, or none, and unit directions (K, 3) float32 from lines ``[name] x y z``.

    An ``.lp`` file starts with the number of its lines, as in reflectance transformation imaging.

    Raises:
        FileError: an empty file, a wrong count, lines of another form, names in some lines only.
        RangeError: a direction that is not of unit length, or not finite.
    """
    rows = read_words(file)
    if not rows:
        raise FileError(str(file), expected="one line 'x y z' per image", got="an empty file", mend="fill it")
    if len(rows[0]) == 1:
        count = rows.pop(0)[0]
        if count != str(len(rows)):
            raise FileError(
                str(file),
                expected=f"{count} lights as its first line says",
                got=str(len(rows)),
                mend="correct the first line",
            )
    names = [" ".join(row[:-3]) for row in rows if len(row) > 3]
    if names and len(names) != len(rows):
        raise FileError(
            str(file), expected="a name in all lines or in none", got="both", mend="add or remove the names"
        )
    directions = _numbers(file, [row[-3:] if names else row for row in rows], (3,))
    length = directions.norm(dim=1, keepdim=True)
    for index in ((length - 1).abs() > UNIT_TOLERANCE).flatten().nonzero().flatten().tolist():
        raise RangeError(
            f"{file} entry {index + 1}",
            expected="a unit vector",
            got=f"length {length[index].item():.4g}",
            mend=f"divide it by its length; intensities belong in {INTENSITIES_FILE}",
        )
    return names, (directions / length).float()


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
    values = _numbers(file, read_words(file), (1, 3))
    if len(values) != count:
        raise FileError(
            str(file), expected=f"{count} lines, one per image", got=str(len(values)), mend="write one line per image"
        )
    if not bool((values > 0).all()):
        raise RangeError(str(file), expected="positive intensities", got=f"{values.min():g}", mend="correct the file")
    return values.expand(-1, 3).float().contiguous(), ()


def write_lights(folder: str | os.PathLike[str], name: str, values: Tensor) -> Path:
    """Write light directions (K, 3) or intensities (K, 1|3), one line per light, as `load_capture` reads them.

    Raises:
        FileError: the place cannot be written.
    """
    target = Path(folder) / name
    with atomic_path(target) as temporary:
        np.savetxt(temporary, values.cpu().double().numpy(), fmt="%.8f")
    return target


def _numbers(file: Path, rows: list[list[str]], widths: tuple[int, ...]) -> Tensor:
    """A table of finite numbers, float64, with one of ``widths`` columns."""
    table: list[list[float]] = []
    for index, row in enumerate(rows):
        try:
            values = [float(word) for word in row]
        except ValueError:
            values = []
        if len(values) not in widths or len(values) != len(table[0] if table else values):
            raise FileError(
                f"{file} entry {index + 1}",
                expected=f"{' or '.join(str(w) for w in widths)} numbers, the same count in every line",
                got=" ".join(row)[:60],
                mend="correct the line",
            )
        table.append(values)
    result = torch.tensor(table, dtype=torch.float64).reshape(len(table), -1)
    if not bool(result.isfinite().all()):
        raise RangeError(str(file), expected="finite numbers", got="NaN or infinity", mend="correct the file")
    return result
