from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest
import torch

from torch_orennayar.core.threads import one_thread, side_by_side


@pytest.fixture
def four_threads() -> Iterator[int]:
    before = torch.get_num_threads()
    torch.set_num_threads(4)
    yield 4
    torch.set_num_threads(before)


def test_each_worker_has_one_thread_and_the_caller_keeps_its_own(four_threads: int) -> None:
    together = threading.Barrier(3, timeout=10)

    def work(part: int) -> tuple[int, int, bool]:
        together.wait()  # all three at once, so that none serves two parts
        return part, torch.get_num_threads(), torch.is_grad_enabled()

    assert side_by_side(work, [0, 1, 2], workers=3) == [(0, 1, False), (1, 1, False), (2, 1, False)]
    assert torch.get_num_threads() == four_threads
    assert side_by_side(lambda _: torch.zeros(3).sum().item(), [], workers=2) == []


def test_a_thread_that_computes_on_one_leaves_the_others_theirs(four_threads: int) -> None:
    seen: list[int] = []
    with one_thread():
        other = threading.Thread(target=lambda: seen.append(torch.get_num_threads()))
        other.start()
        other.join()
        assert torch.get_num_threads() == 1
    assert seen == [four_threads]
    assert torch.get_num_threads() == four_threads


def test_the_first_error_ends_the_work() -> None:
    begun: list[int] = []

    def work(part: int) -> None:
        begun.append(part)
        time.sleep(0.02)  # so that the caller sees the error before the worker has tried all parts
        raise ValueError(f"part {part}")

    with pytest.raises(ValueError, match="part 0"):
        side_by_side(work, list(range(100)), workers=1)
    assert len(begun) < 100
