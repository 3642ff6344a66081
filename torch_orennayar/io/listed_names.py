"""The photographs that a list names, however its author's machine wrote their names."""

from __future__ import annotations

import unicodedata
from collections.abc import Callable, Sequence
from pathlib import Path

from ..core.errors import FileError
from .picture import IMAGE_SUFFIXES


def path_inside(folder: Path, name: str) -> Path:
    """``folder / name``; links are followed.

    Raises:
        FileError: that is not inside the folder.
    """
    file = folder / name.replace("\\", "/")
    if not file.resolve().is_relative_to(folder.resolve()):
        raise FileError(
            name, expected=f"a file inside {folder}", got="a path that leaves it", mend="move the image into the folder"
        )
    return file


def match_names(
    folder: Path, names: Sequence[str], listing: Path, photographs: Callable[[], Sequence[Path]]
) -> list[Path]:
    """The file in ``folder`` that every name means.

    A list made on another machine gives another folder, spells letters with accents in another way, or names the RAW
    files from which the photographs were developed: the last part of its paths counts, then it without regard to
    letter case and accents, then it without the suffix, then without a number before it. Whole numbers count the
    photographs in their order, from 0 or 1.

    Args:
        folder: of the photographs.
        names: what the list says, one per light.
        listing: the list.
        photographs: lists those of the folder in natural order.

    Raises:
        FileError: a name that no photograph, or more than one, has; two names of one photograph; a link out of the
            folder.
    """
    here = [f for f in folder.iterdir() if f.is_file()]
    found = [_match(folder, name, here) for name in names]
    if not any(found) and all(name.isdecimal() for name in names):
        found = _count_off(list(map(int, names)), photographs())
    for name, file in zip(names, found, strict=True):
        if file is None:
            raise FileError(
                str(listing),
                expected=f"names of photographs in {folder}",
                got=repr(name),
                mend=_mend(name, listing),
            )
    files = [path_inside(folder, str(file.relative_to(folder))) for file in found if file is not None]
    twice = next((f for k, f in enumerate(files) if f in files[:k]), None)
    if twice is not None:
        raise FileError(
            str(listing), expected="every photograph once", got=f"{twice.name} twice", mend="remove one of the lines"
        )
    return files


def _match(folder: Path, name: str, here: Sequence[Path]) -> Path | None:
    """The file that a name means, if exactly one does."""
    path = name.replace("\\", "/")
    inside = folder / path
    if not path.startswith("/") and ".." not in Path(path).parts and inside.is_file():
        return inside
    base = path.rsplit("/", 1)[-1]
    for wanted in (base, *base.split(None, 1)[1:]):  # a number may stand before the name
        for form in _FORMS:
            alike = [f for f in here if form(f.name) == form(wanted) and (f.suffix.lower() in IMAGE_SUFFIXES)]
            if len(alike) == 1:
                return alike[0]
    return None


def _composed(name: str) -> str:
    return unicodedata.normalize("NFC", name)


def _folded(name: str) -> str:
    return _composed(name).casefold()


def _stem(name: str) -> str:
    return _folded(Path(name).stem)


_FORMS: tuple[Callable[[str], str], ...] = (str, _composed, _folded, _stem)
"""What of two names has to be the same, from strict to lenient."""


def _count_off(numbers: Sequence[int], photographs: Sequence[Path]) -> list[Path | None]:
    """The photographs that whole numbers count, from 0 or from 1."""
    start = min(numbers)
    if sorted(numbers) != list(range(start, start + len(photographs))) or start not in (0, 1):
        return [None] * len(numbers)
    return [photographs[number - start] for number in numbers]


def _mend(name: str, listing: Path) -> str:
    """What to do about a name that no photograph has."""
    elsewhere = listing.parent / name.replace("\\", "/")
    if elsewhere.is_file():
        return f"give the folder {elsewhere.resolve().parent} and this list as lights= (--lights)"
    return "correct the name, or remove the names if the lines are in the order of the photographs"
