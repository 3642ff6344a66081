"""Times of calls, interleaved so that the machine's load affects all alike, and peak memory in fresh processes."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_orennayar.core.progress import track

Call = Callable[[], object]


class Ratio(NamedTuple):
    """Median, smallest and largest of a quotient of times."""

    median: float
    least: float
    most: float

    def __str__(self) -> str:
        """As tables show it."""
        return f"{self.median:.2f} ({self.least:.2f} to {self.most:.2f})"


def interleave(calls: Mapping[str, Call], runs: int, what: str = "", *, warm: int = 2) -> dict[str, list[float]]:
    """Milliseconds of every call in every run except the first ``warm``; the calls take turns, run by run."""
    taken: dict[str, list[float]] = {name: [] for name in calls}
    for _ in track(range(runs + warm), what) if what else range(runs + warm):
        for name, call in calls.items():
            begun = time.perf_counter()
            call()
            if torch.cuda.is_available():
                torch.cuda.synchronize()
            taken[name].append((time.perf_counter() - begun) * 1e3)
    return {name: t[warm:] for name, t in taken.items()}


def allow_recompilations() -> None:
    """Let `torch.compile` hold many versions of one function: all models share a code object."""
    torch._dynamo.config.recompile_limit = 100  # default 8


def ratio(times: Mapping[str, list[float]], name: str, to: str) -> Ratio:
    """Time of ``name`` over that of ``to`` in the same run."""
    quotients = [a / b for a, b in zip(times[name], times[to], strict=True)]
    return Ratio(median(quotients), min(quotients), max(quotients))


def forward(function: Callable[..., Tensor], scene: list[Tensor]) -> Call:
    """A call that computes values only."""

    def call() -> Tensor:
        with torch.no_grad():
            return function(*scene)

    return call


def both(function: Callable[..., Tensor], scene: list[Tensor]) -> Call:
    """A call that computes values and the gradients of all arguments."""
    leaves = [t.clone(memory_format=torch.preserve_format).requires_grad_() for t in scene]
    with torch.no_grad():
        arriving = torch.ones_like(function(*leaves))
    return lambda: torch.autograd.grad(function(*leaves), leaves, arriving, allow_unused=True)


def peak_bytes(make: Callable[..., Call], size: int, *arguments: object) -> int | None:
    """Memory that ``make(size, *arguments)()`` needs beyond what a fresh process held; Linux only."""
    if not Path("/proc/self/clear_refs").exists():
        return None
    needed: int | RuntimeError = alone(_measure, make, size, *arguments)
    if isinstance(needed, RuntimeError):
        raise needed
    return needed


def alone(function: Callable[..., object], *arguments: object) -> Any:
    """What ``function`` returns or raises in a fresh process, where no other library's threads spin."""
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_answer, args=(sender, function, arguments))
    process.start()
    sender.close()
    try:
        result = receiver.recv()
    except EOFError:  # killed by a fault in native code
        result = RuntimeError("the process died")
    process.join()
    return result


def _answer(sender: Connection, function: Callable[..., object], arguments: tuple[object, ...]) -> None:
    try:
        sender.send(function(*arguments))
    except Exception as error:  # reported to the calling process
        sender.send(RuntimeError(f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"))


def _measure(make: Callable[..., Call], size: int, *arguments: object) -> int:
    make(16, *arguments)()  # loads code and starts threads, and keeps little memory
    call = make(size, *arguments)
    forget_peak()
    before = _status("VmRSS")
    call()
    return peak_memory() - before


def forget_peak() -> None:
    """Reset the peak of memory, which a process inherits from its parent."""
    Path("/proc/self/clear_refs").write_text("5")


def peak_memory() -> int:
    """Most bytes that this process has held since `forget_peak`."""
    return _status("VmHWM")


def _status(field: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * int(next(line.split()[1] for line in lines if line.startswith(field + ":")))
