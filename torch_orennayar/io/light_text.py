"""Words and numbers of hand-made text files: any encoding, decimal commas, names with blanks, brackets, comments."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from ..core.errors import FileError

_QUOTES = "\"'"
_BRACKETS = "[](){},"
"""What may stand about a number."""
_FIELD = re.compile(r"\"[^\"]*\"|[^\s;]+")
"""A quoted name, or what stands between blanks and semicolons."""
_FIELD_BETWEEN_COMMAS = re.compile(r"\"[^\"]*\"|[^\s;,]+")
_NUMBER = re.compile(r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?|[-+]?(nan|inf)", re.IGNORECASE)
_COMMENT = re.compile(r"(\"[^\"]*\")|(?:^|\s)(?:#|//).*")
"""A quoted name, or a comment, which begins a line or follows a blank: file names contain these characters too."""
_CONTROL = re.compile(r"[\0-\x08\x0e-\x1f]")
"""Characters that no text holds."""


class Row(NamedTuple):
    """One line: the name before or behind its numbers, or nothing, and the numbers.

    Attributes:
        line: its number in the file, from 1.
        text: the line.
        numbers: the last run of numbers, or the first where a name follows them.
        starts: where each number begins in ``text``.
        last_name: the words behind the numbers.
    """

    line: int
    text: str
    numbers: tuple[float, ...]
    starts: tuple[int, ...]
    last_name: str

    def name(self, kept: int) -> str:
        """What is not one of the last ``kept`` numbers."""
        if self.last_name or not self.numbers:
            return self.last_name
        return clean_name(self.text[: self.starts[-kept]])


def clean_name(text: str) -> str:
    """A name without separators and quotes about it."""
    return text.strip(" \t,;").strip(_QUOTES).strip()


def read_text(file: Path) -> str:
    """The text of a file in UTF-8, UTF-16 with a byte-order mark, or else Windows' western encoding.

    Raises:
        FileError: no such file, or binary data.
    """
    if not file.is_file():
        raise FileError(str(file), expected="a text file", got="nothing there", mend="check the name")
    try:
        data = file.read_bytes()
    except OSError as error:
        raise FileError(str(file), expected="a readable file", got=str(error), mend="check permissions") from error
    marked = data.startswith((b"\xff\xfe", b"\xfe\xff"))
    for encoding in ("utf-16",) if marked else ("utf-8-sig", "cp1252"):
        with suppress(UnicodeDecodeError):
            text = data.decode(encoding)
            if not _CONTROL.search(text):
                return text
    raise FileError(str(file), expected="a text file", got="binary data", mend="save it as UTF-8")


def read_lines(file: Path) -> list[tuple[int, str]]:
    """Number and text of every line that is more than a comment.

    Raises:
        FileError: as `read_text`.
    """
    lines = enumerate(read_text(file).splitlines(), 1)
    bare = [(number, _COMMENT.sub(lambda found: found[1] or "", line).strip()) for number, line in lines]
    return [(number, line) for number, line in bare if line]


def split_row(number: int, text: str) -> Row:
    """The numbers at one end of a line, and the name at the other.

    Numbers are separated by blanks, semicolons or commas. A comma between digits is a decimal comma where blanks or
    semicolons separate the numbers.
    """
    alone = _value(text)
    if alone is not None:
        return Row(number, text, (alone,), (0,), "")
    for pattern in (_FIELD, _FIELD_BETWEEN_COMMAS):
        fields = list(pattern.finditer(text))
        values = [_value(field.group()) for field in fields]
        first = next((i for i in range(len(fields), -1, -1) if i and values[i - 1] is None), 0)  # after the last word
        if len(fields) - first > 1:
            kept = slice(first, None)
            behind = ""
        else:
            stop = next((i for i, value in enumerate(values) if value is None), len(fields))
            kept = slice(0, stop)
            behind = clean_name(text[fields[stop].start() :]) if stop < len(fields) else ""
        found = tuple(value for value in values[kept] if value is not None)
        if len(found) > 1:
            return Row(number, text, found, tuple(field.start() for field in fields[kept]), behind)
    return Row(number, text, (), (), "")


def _value(field: str) -> float | None:
    """The number that a field is, brackets about it aside."""
    bare = field.strip(_BRACKETS)
    return float(bare.replace(",", ".")) if _NUMBER.fullmatch(bare) else None
