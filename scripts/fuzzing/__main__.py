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
import sys
import time
from collections import Counter
from contextlib import suppress
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scripts.fuzzing.corpus import readers
from scripts.fuzzing.worker import prepare, work
from torch_orennayar.core.progress import track

if TYPE_CHECKING:
    from multiprocessing.queues import SimpleQueue

HANG = 10.0
"""Seconds after which an input counts as one that hangs."""
KINDS = ("inputs", "read", "clean errors", "foreign exceptions", "crashes", "hangs", "over 1 GB")
BAD = KINDS[3:]


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
