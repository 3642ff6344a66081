"""Feed mutated files to every reader of the package and count what happens.

    scripts/fuzz [--seconds 60 | --inputs 100000] [--readers NAME...] [--seed 0] [--save out/fuzz] [--record]

Every reader is called in a process of its own. Counted are inputs that were read, clean errors (of the package's
family), foreign exceptions, crashes (the process died), hangs (more than ten seconds) and inputs that took more than
1 GB. Inputs of the last four kinds are saved, with their traceback. The exit status is 1 if there were any. With
``--record`` the counts become a section of ``scripts/benchmarks/results/fuzz.json``.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import random
import sys
import time
import traceback
import warnings
from collections import Counter
from contextlib import suppress
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from scripts.fuzzing.corpus import Reader, readers
from scripts.fuzzing.mutate import mutate
from torch_orennayar import TorchOrenNayarError
from torch_orennayar.core.progress import track

if TYPE_CHECKING:
    from multiprocessing.queues import SimpleQueue

HANG = 10.0
"""Seconds after which an input counts as one that hangs."""
MEMORY = 1 << 30
"""Bytes beyond those of the idle process from which an input counts as one that takes too much."""
BATCH = 500
"""Inputs between two reports of a worker."""
KINDS = ("inputs", "read", "clean errors", "foreign exceptions", "crashes", "hangs", "over 1 GB")
BAD = KINDS[3:]


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


def fuzz(name: str, seed: int, *, seconds: float, inputs: int, save: Path) -> Counter[str]:
    """Counts of one reader, over ``seconds`` or ``inputs``, whichever ends first."""
    context = multiprocessing.get_context("spawn")
    counts: Counter[str] = Counter(dict.fromkeys(KINDS, 0))
    position, end, begun = seed, seed + inputs, time.monotonic()
    while position < end and time.monotonic() - begun < seconds:
        at: Synchronized[int] = context.Value("q", position)
        answers: SimpleQueue[Any] = context.SimpleQueue()
        process = context.Process(target=work, args=(name, position, end, at, answers), daemon=True)
        process.start()
        seen, since = -1, time.monotonic()
        bad: tuple[str, int, str] | None = None
        while process.is_alive() or not answers.empty():
            if not answers.empty():
                position, found, bad = answers.get()
                counts += found
                if bad is not None:
                    keep(save, name, *bad)
            elif at.value != seen:
                seen, since = at.value, time.monotonic()
                time.sleep(0.05)
            elif time.monotonic() - since > HANG + (60 if seen == position else 0):  # the first one imports torch
                process.kill()
                process.join()
                position = _count_lost(counts, "hangs", position, seen, save, name)
                break
            else:
                time.sleep(0.05)
            if time.monotonic() - begun > seconds:
                process.kill()
                break
        else:
            if process.exitcode:
                position = _count_lost(counts, "crashes", position, at.value, save, name)
        process.join()
    return counts


def _count_lost(counts: Counter[str], kind: str, reported: int, index: int, save: Path, name: str) -> int:
    """Count the inputs of a process that was lost with input ``index``; where to go on."""
    counts += Counter({"inputs": index + 1 - reported, kind: 1})
    keep(save, name, kind, index, "")
    return index + 1


def keep(save: Path, name: str, kind: str, index: int, told: str) -> None:
    """Save an input that found a fault."""
    folder = save / f"{name.replace(' ', '_')}-{index}"
    folder.mkdir(parents=True, exist_ok=True)
    prepare(readers()[name], index, folder)
    (folder / "fault.txt").write_text(f"{kind}\n{told}")
    print(f"{name}, input {index}: {kind}; {told.strip().splitlines()[-1] if told else ''} -> {folder}", flush=True)


def main() -> int:
    """Fuzz the readers one after the other and print the counts."""
    names = list(readers())
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60, help="in all")
    parser.add_argument("--inputs", type=int, default=10**9, help="per reader; --seconds does not count then")
    parser.add_argument("--readers", nargs="+", choices=names, default=names)
    parser.add_argument("--seed", type=int, default=0, help="number of the first input")
    parser.add_argument("--save", type=Path, default=Path("out/fuzz"))
    parser.add_argument("--record", action="store_true")
    options = parser.parse_args()
    seconds = options.seconds / len(options.readers) if options.inputs == 10**9 else float("inf")
    found = {}
    with suppress(KeyboardInterrupt):
        for name in track(options.readers, "readers", len(options.readers)):
            found[name] = fuzz(name, options.seed, seconds=seconds, inputs=options.inputs, save=options.save)
            print(f"{name:20}" + ", ".join(f"{found[name][kind]:,} {kind}" for kind in KINDS), flush=True)
    if options.record:
        from scripts.benchmarks.record import record

        record("fuzz", {"counts": {name: {kind: c[kind] for kind in KINDS} for name, c in found.items()}})
    return int(any(counts[kind] for counts in found.values() for kind in BAD))


if __name__ == "__main__":
    sys.exit(main())
