"""Names that libraries can take, and atomic output: a file is moved into place when it is complete."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .errors import FileError


@contextmanager
def utf8_path(path: Path) -> Iterator[Path]:
    """``path``, or a temporary copy where its name is not UTF-8, which libraries in C++ cannot take."""
    try:
        str(path).encode("utf-8")
    except UnicodeEncodeError:
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / f"file{path.suffix.encode('ascii', 'ignore').decode()}"
            shutil.copyfile(path, copy)
            yield copy
        return
    yield path


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary path to write to; the file is moved to ``path`` if the block succeeds, and removed if it fails."""
    target = Path(path)
    with atomic_directory(target.parent) as folder:
        yield folder / target.name


def read_json(file: Path) -> dict[str, Any]:
    """The content of a JSON file that this package wrote.

    Raises:
        FileError: it is missing or damaged.
    """
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FileError(str(file), expected="a whole JSON file", got=str(error)[:80], mend="remove it") from error
    if not isinstance(content, dict):
        raise FileError(str(file), expected="a JSON object", got=type(content).__name__, mend="remove it")
    return content


WRITTEN_LIST = ".torch_orennayar.json"
"""Name of the list, in a folder of results, of the files that this package wrote there."""


def check_output(path: str | os.PathLike[str], names: Iterable[str] = ()) -> None:
    """Check that an output folder can be written, before long work is done for it.

    Args:
        path: the folder.
        names: of the files that will be written there; those of others must not be among them.

    Raises:
        FileError: ``path`` is a file, or cannot be written to, or holds a file of one of these names that this package
            did not write.
    """
    with atomic_directory(path):
        pass
    foreign = sorted(name for name in names if (Path(path) / name).exists() and name not in written_files(path))
    if foreign:
        raise FileError(
            str(Path(path) / foreign[0]),
            expected="no file of that name that this package did not write",
            got=f"one, and {len(foreign) - 1} more" if len(foreign) > 1 else "one",
            mend="choose another output folder",
        )


def written_files(folder: str | os.PathLike[str]) -> set[str]:
    """Names of the files in ``folder`` that `results_directory` wrote and that were not changed since."""
    place = Path(folder)
    try:
        listed = json.loads((place / WRITTEN_LIST).read_text())
        return {name for name, state in listed.items() if (place / name).is_file() and _state(place / name) == state}
    except (OSError, ValueError, AttributeError):
        return set()


def _state(file: Path) -> list[int]:
    """What changes with a file: size and time of its last change, ns."""
    state = file.stat()
    return [state.st_size, state.st_mtime_ns]


@contextmanager
def results_directory(path: str | os.PathLike[str]) -> Iterator[Path]:
    """`atomic_directory` that overwrites no file of others and remembers what it wrote.

    Raises:
        FileError: as `atomic_directory`, or the folder holds a file of the same name that this package did not write.
    """
    with atomic_directory(path) as temporary:
        yield temporary
        names = [file.name for file in temporary.iterdir()]
        check_output(path, names)
    known = {*written_files(path), *names}
    states = {name: _state(Path(path) / name) for name in sorted(known) if (Path(path) / name).is_file()}
    (Path(path) / WRITTEN_LIST).write_text(json.dumps(states, indent=1) + "\n")


@contextmanager
def atomic_directory(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary folder; its files are moved into ``path`` if the block succeeds, and removed if it fails.

    Other files that ``path`` already contains stay. The temporary folder is inside ``path`` if that exists and beside
    it if not, so that a move is a rename within one file system.

    Raises:
        FileError: ``path`` is a file, or cannot be written to.
    """
    target = Path(path)
    if target.exists() and not target.is_dir():
        raise FileError(str(target), expected="a folder", got="a file", mend="choose another output folder")
    parent = target if target.is_dir() else target.absolute().parent
    try:
        parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=parent))
    except OSError as error:
        raise FileError(
            str(target), expected="a writable place", got=str(error), mend="choose another output folder"
        ) from error
    try:
        yield temporary
        blocked = [s for s in temporary.rglob("*") if s.is_file() and (target / s.relative_to(temporary)).is_dir()]
        if blocked:
            raise FileError(
                str(target), expected=f"a place for the file {blocked[0].name}", got="a folder", mend="move it away"
            )
        for source in sorted(temporary.rglob("*")):
            destination = target / source.relative_to(temporary)
            if source.is_dir():
                destination.mkdir(parents=True, exist_ok=True)
            else:
                destination.parent.mkdir(parents=True, exist_ok=True)
                source.replace(destination)
    except OSError as error:
        if isinstance(error, FileError):
            raise
        raise FileError(
            str(target), expected="files that can be written", got=str(error), mend="check space and permissions"
        ) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
