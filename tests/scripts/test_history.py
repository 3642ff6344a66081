from __future__ import annotations

from pathlib import Path

import pytest

from scripts.benchmarks import history


@pytest.mark.parametrize(
    ("values", "verdict"),
    [((1.0,), False), ((1.0, 1.05), False), ((1.0, 1.2), True), ((2.0, 1.0, 1.2), True), ((1.0, 0.5), False)],
)
def test_worse_is_above_the_best_before_by_more_than_the_spread(values: tuple[float, ...], verdict: bool) -> None:
    figure = history.Figure("a figure", ("file", "section"), 0.1)
    assert history.worse(figure, {str(k): v for k, v in enumerate(values)}) is verdict


def test_every_figure_is_recorded() -> None:
    for figure in history.FIGURES:
        assert history.value(history.read("", figure.path[0]), figure.path[1:]) is not None, figure.name


def test_charts_are_drawn(tmp_path: Path) -> None:
    history.draw(
        {history.FIGURES[0]: {"v0.1.0": 1.0, "": 1.2}, history.FIGURES[1]: {"": 2.0}}, tmp_path / "history.png"
    )
    assert (tmp_path / "history.png").stat().st_size > 1000


def test_the_page_marks_what_got_worse(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    error, seconds = history.FIGURES[0], history.FIGURES[6]
    monkeypatch.setattr(history, "collect", lambda: {error: {"v0.1.0": 1.0, "": 1.2}, seconds: {"v0.1.0": 1, "": 1.2}})
    history.write(tmp_path)
    lines = (tmp_path / "history.md").read_text().splitlines()
    assert [f"| {history.WORSE} |" in line for line in lines if line.startswith("| `")] == [True, False]
    assert "![The figures over time](history.png)" in lines
