"""Names that libraries can take, and atomic output: a file is moved into place when it is complete."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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


def check_output(path: str | os.PathLike[str]) -> None:
    """Check that an output folder can be written, before long work is done for it.

    Raises:
        FileError: ``path`` is a file, or cannot be written to.
    """
    with atomic_directory(path):
        pass


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
