"""The guides to captures, followed command by command on small photographs, end where they say."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from tests.support.command_line import Run
from tests.support.guides import blocks, follow, normal_error
from torch_orennayar import angular_error


@pytest.fixture
def must(orennayar: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run the command in an empty folder; it must succeed."""
    monkeypatch.chdir(tmp_path)

    def run(*words: object) -> object:
        result = orennayar(*words)
        assert result.status == 0, result.err
        return result

    return run  # type: ignore[return-value]


def light_error(file: str) -> Tensor:
    """Error of each light in degrees."""
    found, true = (torch.from_numpy(np.loadtxt(f)) for f in (file, "truth/light_directions.txt"))
    return (found * true).sum(1).clamp(-1, 1).arccos().rad2deg()


@pytest.mark.slow
def test_mirror_ball(must: Run) -> None:
    follow("mirror-ball.md", must)
    errors = {name: normal_error(name) for name in ("out", "marked", "out-alone")}
    assert max(errors.values()) < 5, errors
    assert light_error("lights/light_directions.txt").mean() < 2
    assert Path("out/ball.png").is_file()


@pytest.mark.slow
def test_unknown_lights(must: Run) -> None:
    follow("unknown-lights.md", must)
    assert light_error("out/light_directions.txt").mean() < 4
    assert normal_error("out") < 6
    assert normal_error("checked") < 6


@pytest.mark.slow
def test_near_lamps(must: Run) -> None:
    with pytest.warns(UserWarning, match="explain the photographs better than distant ones"):
        follow("near-lamps.md", must)
    error = {name: normal_error(name) for name in ("found", "out", "distant")}
    assert max(error["found"], error["out"]) < 0.6 * error["distant"]
    names: dict[str, Any] = {}
    for block in blocks("near-lamps.md", "python"):
        exec(block, names)
    inside = torch.from_numpy(np.load("truth/part.npy") == 0)
    truth = torch.from_numpy(np.load("truth/normal.npy"))
    assert angular_error(names["near"].normal, truth, inside[None]).summary()["mean"] < 0.6 * error["distant"]
