"""The process in which inputs are read: it may crash or hang."""

from __future__ import annotations

import os
import random
import sys
import traceback
import warnings
from collections import Counter
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from scripts.fuzzing.corpus import Reader, readers
from scripts.fuzzing.mutate import mutate
from torch_orennayar import TorchOrenNayarError

if TYPE_CHECKING:
    from multiprocessing.queues import SimpleQueue

MEMORY = 1 << 30
"""Bytes beyond those of the idle process from which an input counts as one that takes too much."""
BATCH = 500
"""Inputs between two reports of a worker."""


def work(name: str, start: int, stop: int, at: Synchronized[int], answers: SimpleQueue[Any]) -> None:
    """Read inputs ``start`` to ``stop``, telling which one is being read and, at the end of each batch, the counts."""
    warnings.simplefilter("ignore")
    sys.stderr = open(os.devnull, "w")  # noqa: SIM115, PTH123 - for the life of the process
    os.dup2(sys.stderr.fileno(), 2)  # libraries in C complain there
    reader = readers()[name]
    place = "/dev/shm" if Path("/dev/shm").is_dir() else None
    with TemporaryDirectory(dir=place) as folder:
        idle = _peak()
        counts: Counter[str] = Counter()
        for index in range(start, stop):
            at.value = index
            kind, told = _try(reader, index, Path(folder))
            if _peak() > idle + MEMORY:
                answers.put((index + 1, counts + Counter({"inputs": 1, "over 1 GB": 1}), ("over 1 GB", index, "")))
                return
            counts += Counter({"inputs": 1, kind: 1})
            if kind == "foreign exceptions":
                answers.put((index + 1, counts, (kind, index, told)))
                counts = Counter()
            elif (index + 1 - start) % BATCH == 0:
                answers.put((index + 1, counts, None))
                counts = Counter()
        answers.put((stop, counts, None))


def prepare(reader: Reader, index: int, folder: Path) -> str:
    """Write input number ``index``; the name of its file."""
    for old in folder.iterdir():
        old.unlink()
    name = random.Random(index).choice(list(reader.files))
    for beside, contents in reader.files.items() if reader.together else ():
        (folder / beside).write_bytes(contents[0])
    (folder / name).write_bytes(mutate(index, reader.files[name]))
    return name


def _try(reader: Reader, index: int, folder: Path) -> tuple[str, str]:
    name = prepare(reader, index, folder)
    try:
        reader.read(folder, name)
    except TorchOrenNayarError:
        return "clean errors", ""
    except Exception:
        return "foreign exceptions", traceback.format_exc()
    return "read", ""


def _peak() -> int:
    """Most bytes that this process has held."""
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
