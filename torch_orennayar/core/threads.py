"""Side-by-side work without threads that wait for each other.

Every small operation of torch ends at a barrier for all of its threads, which on a busy machine, or where workers run
side by side, takes a hundred times the arithmetic. Here each worker computes on one thread of its own. OpenMP keeps
the number of threads per calling thread, so neither the process's own number changes nor that of another thread.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import lru_cache
from typing import Any, TypeVar

import torch

from .optional import available, require
from .progress import track

Part = TypeVar("Part")
Result = TypeVar("Result")


def one_thread() -> AbstractContextManager[Any]:
    """Limit torch to one thread in the calling thread, from the call on; where threadpoolctl is missing, do nothing."""
    if not available("threadpoolctl"):
        return nullcontext()
    torch.get_num_threads()  # at its first call in a thread torch sets the number itself, over the one set here
    limits: AbstractContextManager[Any] = _openmp().limit(limits=1)
    return limits


@lru_cache(1)
def _openmp() -> Any:
    """The OpenMP libraries of the process, torch's among them; looking for them takes milliseconds."""
    require("threadpoolctl")
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="openmp")


_local = threading.local()


def worker_count() -> int:
    """How many parts are worked on side by side: as many as torch has threads outside of `small_operations`."""
    return getattr(_local, "workers", None) or torch.get_num_threads()


@contextmanager
def small_operations() -> Iterator[None]:
    """Run torch's operations of this thread on itself alone, while `side_by_side` keeps its workers."""
    before = getattr(_local, "workers", None)
    _local.workers = worker_count()
    try:
        with one_thread():
            yield
    finally:
        _local.workers = before


def side_by_side(
    work: Callable[[Part], Result], parts: Sequence[Part], *, workers: int, progress: str = ""
) -> list[Result]:
    """``work`` on every part, without gradients, each on one thread; stops at the first error or Ctrl-C.

    Args:
        work: a function of one part.
        parts: what it is called with, in the order of the results.
        workers: how many run at once.
        progress: label of the progress bar; empty for none.
    """
    inference = torch.is_inference_mode_enabled()  # threads do not inherit it

    def quietly(part: Part) -> Result:
        with torch.inference_mode(inference), torch.no_grad():
            return work(part)

    if workers == 1:
        with small_operations():
            return [quietly(part) for part in (track(parts, progress) if progress else parts)]
    pool = _pool(os.getpid(), workers)
    futures = [pool.submit(quietly, part) for part in parts]
    done = (future.result() for future in futures)
    try:
        return list(track(done, progress, len(parts)) if progress else done)
    except BaseException:
        for future in futures:
            future.cancel()
        wait(futures)
        raise


def in_order(
    work: Callable[[Part], Result], parts: Sequence[Part], device: torch.device
) -> Iterator[tuple[Part, Result]]:
    """Each part with ``work`` on it, in order: on a processor as many side by side as torch has threads.

    Only so many results are held at once. What is added up in this order does not depend on the number of threads.
    """
    together = worker_count() if device.type == "cpu" else 1
    if len(parts) == 1 or together == 1:
        for part in parts:
            yield part, work(part)
        return
    for first in range(0, len(parts), together):
        some = parts[first : first + together]
        yield from zip(some, side_by_side(work, some, workers=together), strict=True)


@lru_cache(4)
def _pool(process: int, workers: int) -> ThreadPoolExecutor:
    """The workers, which are kept, as a thread takes 3 ms to start; a forked process has none of its parent's."""
    return ThreadPoolExecutor(workers, initializer=one_thread)
