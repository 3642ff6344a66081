"""The training script: killed and resumed, with torn checkpoints, in one process and in two."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
import torch

from tests.support.example_code import EXAMPLES, load
from torch_orennayar import FileError

TRAINER = EXAMPLES / "train_photometric_stereo.py"
SMALL = ("--groups", "2", "--observations", "256", "--scenes", "2", "--threads", "1", "--device", "cpu")


def command(folder: Path, steps: int, every: int) -> list[str]:
    return [str(TRAINER), *SMALL, "--steps", str(steps), "--every", str(every), "-o", str(folder)]


def train(folder: Path, steps: int = 12, every: int = 4, *more: str) -> str:
    asked = [sys.executable, *command(folder, steps, every), *more]
    done = subprocess.run(asked, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


def weights(folder: Path) -> dict[str, torch.Tensor]:
    """The weights and the optimiser's state of the checkpoint, not the rounded weights of network.pt."""
    state = torch.load(folder / "checkpoint.pt", weights_only=True)
    optimiser = {f"{k} {n}": v for k, values in state["optimiser"]["state"].items() for n, v in values.items()}
    return {**state["network"], **{f"average {n}": v for n, v in state["average"].items()}, **optimiser}


def curve(folder: Path) -> list[list[float]]:
    """Step, loss, degrees."""
    with (folder / "curve.csv").open(newline="") as stream:
        return [[float(value) for value in row[:3]] for row in list(csv.reader(stream))[1:]]


def same(a: Path, b: Path) -> bool:
    first, second = weights(a), weights(b)
    return first.keys() == second.keys() and all(torch.equal(first[n], second[n]) for n in first)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Trained without a break."""
    folder = tmp_path_factory.mktemp("whole")
    train(folder)
    return folder


@pytest.mark.slow
def test_killed_and_resumed_to_the_bit(tmp_path: Path, whole: Path) -> None:
    process = subprocess.Popen([sys.executable, *command(tmp_path, 12, 4)], stderr=subprocess.DEVNULL)
    begun = time.monotonic()
    while not (tmp_path / "checkpoint.pt").exists():
        assert process.poll() is None
        assert time.monotonic() - begun < 120
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    reached = torch.load(tmp_path / "checkpoint.pt", weights_only=True)["step"]
    said = train(tmp_path)
    assert f"going on from step {reached}" in said
    assert same(tmp_path, whole)
    assert curve(tmp_path) == curve(whole)


@pytest.mark.slow
def test_workers_make_the_same_samples(tmp_path: Path, whole: Path) -> None:
    """Broken off and resumed among other workers' samples, too."""
    train(tmp_path, 12, 4, "--workers", "2")
    assert same(tmp_path, whole)
    (tmp_path / "checkpoint.pt").unlink()
    assert "going on from step 8" in train(tmp_path, 12, 4, "--workers", "3")
    assert same(tmp_path, whole)


@pytest.mark.slow
def test_a_torn_checkpoint_gives_way_to_the_one_before(tmp_path: Path, whole: Path) -> None:
    train(tmp_path)
    torn = tmp_path / "checkpoint.pt"
    torn.write_bytes(torn.read_bytes()[:-2000])
    said = train(tmp_path)
    assert "cannot be read" in said
    assert "going on from step 8" in said
    assert same(tmp_path, whole)


def test_two_torn_checkpoints_are_an_error(tmp_path: Path) -> None:
    for name in ("checkpoint.pt", "previous.pt"):
        (tmp_path / name).write_bytes(b"torn")
    example = load("train_photometric_stereo")
    with pytest.raises(FileError, match="another --output"):
        example.train(example.parse([*SMALL, "--steps", "2", "-o", str(tmp_path)]))


@pytest.mark.slow
def test_a_checkpoint_of_another_task_is_an_error(whole: Path) -> None:
    example = load("train_photometric_stereo")
    with pytest.raises(FileError, match="'steps': 13"):
        example.train(example.parse([*SMALL, "--steps", "13", "-o", str(whole)]))


@pytest.mark.parametrize("workers", ["0", "1"])
@pytest.mark.slow
def test_two_processes_equal_one(tmp_path: Path, whole: Path, workers: str) -> None:
    launcher = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, *launcher, *command(tmp_path, 12, 4), "--workers", workers],
        capture_output=True, text=True, env=environment, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for together, alone in zip(curve(tmp_path), curve(whole), strict=True):
        assert together[0] == alone[0]
        assert together[1] == pytest.approx(alone[1], abs=1e-5)
        assert together[2] == pytest.approx(alone[2], abs=2e-3)


@pytest.mark.slow
def test_training_learns(tmp_path: Path) -> None:
    train(tmp_path, steps=200, every=20)
    losses = [row[1] for row in curve(tmp_path)]
    assert losses[-1] < 0.9 * losses[0]


@pytest.mark.slow
def test_three_processes_share_two_samples_and_outlive_the_death_of_one(tmp_path: Path, whole: Path) -> None:
    """The world does not divide the batch, one process is killed, and torchrun starts all three again."""
    launcher = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "3", "--max-restarts", "1"]
    process = subprocess.Popen(
        [sys.executable, *launcher, *command(tmp_path, 12, 4)],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=os.environ | {"OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    begun = time.monotonic()
    while not (tmp_path / "checkpoint.pt").exists():
        assert process.poll() is None
        assert time.monotonic() - begun < 120
        time.sleep(0.01)
    psutil.Process(process.pid).children()[-1].kill()
    said, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    assert said.count("going on from step") == 3
    for together, alone in zip(curve(tmp_path), curve(whole), strict=True):
        assert together[0] == alone[0]
        assert together[1] == pytest.approx(alone[1], abs=1e-5)
        assert together[2] == pytest.approx(alone[2], abs=2e-3)


@pytest.mark.slow
def test_train_normals_improves_on_least_squares(tmp_path: Path) -> None:
    errors = load("train_normals").main(["--steps", "60", "--workers", "0", "-o", str(tmp_path)])
    assert errors[-1] < errors[0] - 0.2
    assert (tmp_path / "curve.csv").read_text().startswith("0,")
    assert (tmp_path / "normals.png").stat().st_size > 1000
