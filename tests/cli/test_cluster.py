"""`orennayar batch --scheduler` on a Dask cluster of three processes."""

from __future__ import annotations

import json
import os
import shutil
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.support.command_line import Run
from torch_orennayar.core.optional import available

if TYPE_CHECKING:
    from distributed import LocalCluster

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not available("distributed"), reason="Dask is not installed")]


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Iterator[LocalCluster]:
    from distributed import LocalCluster

    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    with LocalCluster(
        n_workers=3, threads_per_worker=1, memory_limit="1.5GB", processes=True, dashboard_address=":0"
    ) as started:
        yield started


def copies(capture_folder: Path, tmp_path: Path, count: int) -> list[Path]:
    return [Path(shutil.copytree(capture_folder, tmp_path / "in" / f"{k:02d}")) for k in range(count)]


def test_captures_of_a_killed_worker_are_done_by_others(
    orennayar: Run, capture_folder: Path, tmp_path: Path, cluster: LocalCluster
) -> None:
    """A worker is killed when the first results are there; a capture without photographs fails alone."""
    folders, out = copies(capture_folder, tmp_path, 9), tmp_path / "out"
    (tmp_path / "in" / "empty").mkdir()

    def kill_one() -> None:
        while not list(out.glob("*/result.json")):
            time.sleep(0.05)
        os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)

    killer = threading.Thread(target=kill_one, daemon=True)
    killer.start()
    command = ("batch", *folders, tmp_path / "in" / "empty", "-o", out, "--model", "lambert", "--no-report")
    result = orennayar(*command, "--scheduler", cluster.scheduler_address)
    killer.join(1)
    assert not killer.is_alive()
    assert result.status == 1
    assert "expected photographs" in result.out
    results = sorted(out.glob("*/result.json"))
    assert [file.parent.name for file in results] == [f.name for f in folders]
    assert all(json.loads(file.read_text())["model"] == "lambert" for file in results)
    before = {file: file.stat().st_mtime_ns for file in results}
    orennayar(*command, "--scheduler", cluster.scheduler_address)
    assert {file: file.stat().st_mtime_ns for file in results} == before


def test_no_scheduler(orennayar: Run, capture_folder: Path, tmp_path: Path) -> None:
    result = orennayar("batch", capture_folder, "-o", tmp_path / "out", "--scheduler", "nowhere")
    assert result.status == 1
    assert "dask scheduler" in result.err
