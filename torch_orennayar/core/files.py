"""Outputs appear whole or not at all: written under a temporary name, then renamed."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .errors import FileError


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary file beside ``path`` to write to; renamed to ``path`` if the block succeeds, else removed."""
    target = Path(path)
    with atomic_directory(target.parent) as folder:
        yield folder / target.name


def check_output(path: str | os.PathLike[str]) -> None:
    """Refuse an output folder that cannot be written, before any work is done for it.

    Raises:
        FileError: ``path`` is a file, or the place cannot be written.
    """
    with atomic_directory(path):
        pass


@contextmanager
def atomic_directory(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary folder; its files move into ``path`` if the block succeeds, else they vanish.

    Files that ``path`` already holds under other names stay. The temporary folder lies inside ``path``
    where that exists, else beside it, so that moving is a rename on one file system.

    Raises:
        FileError: ``path`` is a file, or the place cannot be written.
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
            goal = target / source.relative_to(temporary)
            if source.is_dir():
                goal.mkdir(parents=True, exist_ok=True)
            else:
                goal.parent.mkdir(parents=True, exist_ok=True)
                source.replace(goal)
    except OSError as error:
        if isinstance(error, FileError):
            raise
        raise FileError(
            str(target), expected="files that can be written", got=str(error), mend="check space and permissions"
        ) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
