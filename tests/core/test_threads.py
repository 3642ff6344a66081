from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest
import torch
from torch import Tensor

import torch_orennayar as ton
from torch_orennayar.core.threads import in_order, one_thread, side_by_side, small_operations, worker_count


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


def test_small_operations_keep_the_workers(four_threads: int) -> None:
    with small_operations(), small_operations():
        assert torch.get_num_threads() == 1
        assert worker_count() == four_threads
    assert torch.get_num_threads() == worker_count() == four_threads
    with pytest.raises(ValueError, match="within"), small_operations():
        raise ValueError("within")
    assert torch.get_num_threads() == worker_count() == four_threads


def test_results_come_in_order(four_threads: int) -> None:
    begun: list[int] = []

    def work(part: int) -> int:
        begun.append(part)
        time.sleep(0.01 * (3 - part % 4))
        return part * part

    found = in_order(work, range(10), torch.device("cpu"))
    assert next(found) == (0, 0)
    assert len(begun) == four_threads  # only so many are held at once
    assert list(found) == [(n, n * n) for n in range(1, 10)]
    with pytest.raises(ValueError, match="part 3"):
        list(in_order(fail_at_three, range(10), torch.device("cpu")))


def fail_at_three(part: int) -> None:
    if part == 3:
        raise ValueError("part 3")


@pytest.mark.usefixtures("four_threads")
def test_inference_mode_reaches_the_workers() -> None:
    """Values made in inference mode can be changed in it alone, so that chunks and tiles must be in it too."""
    normal = torch.nn.functional.normalize(
        0.3 * torch.randn(1, 3, 200, 200) + torch.tensor([0, 0, 1.0]).view(3, 1, 1), dim=1
    )
    lights = torch.nn.functional.normalize(torch.tensor([[[0.0, 0, 1], [1, 0, 1], [-1, 1, 2], [0, -1, 1]]]), dim=2)

    def compute() -> tuple[Tensor, Tensor]:
        shaded = ton.OrenNayar("vcavity")(normal, lights, roughness=0.4)
        return shaded, ton.photometric_stereo(shaded[0, :, :, :40, :40], lights[0], model="lambert").normal

    plain = compute()
    with torch.inference_mode():
        inferred = compute()
    assert all(torch.equal(a, b) for a, b in zip(inferred, plain, strict=True))


def test_work_side_by_side_may_do_so_itself(four_threads: int) -> None:
    def work(part: int) -> list[int]:
        return side_by_side(lambda n: n + part, [1, 2, 3], workers=worker_count())

    assert side_by_side(work, [10, 20], workers=four_threads) == [[11, 12, 13], [21, 22, 23]]
    assert side_by_side(work, [10, 20], workers=1) == [[11, 12, 13], [21, 22, 23]]
