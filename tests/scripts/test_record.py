"""Recorded results, and the tables and charts that are made from them."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scripts.benchmarks import charts, record
from scripts.benchmarks.markdown import least_in_bold, short, table
from scripts.benchmarks.tables import __main__ as tables


def test_tables_are_those_of_the_results() -> None:
    assert tables.update(tables.files(), check=True) == []


def test_every_table_stands_in_a_document() -> None:
    text = "".join(path.read_text(encoding="utf-8") for path in tables.files())
    assert set(tables.BLOCKS) == {found["name"] for found in tables.MARKER.finditer(text)}


def test_a_changed_figure_is_found_and_written(tmp_path: Path) -> None:
    document = tmp_path / "page.md"
    document.write_text("before\n<!-- table: finding codes -->\nold\n<!-- end -->\nafter\n", encoding="utf-8")
    assert tables.update([document], check=True)
    assert "old" in document.read_text(encoding="utf-8")
    tables.update([document], check=False)
    text = document.read_text(encoding="utf-8")
    assert "`dark-pixels`" in text
    assert text.startswith("before\n<!-- table")
    assert text.endswith("<!-- end -->\nafter\n")
    assert tables.update([document], check=True) == []


def test_a_table_without_results_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> str:
        raise record.NotMeasuredError("nothing")

    monkeypatch.setitem(tables.BLOCKS, "photographs", missing)
    assert "Not measured yet" in tables.fill("<!-- table: photographs -->\n<!-- end -->")


def test_a_partial_run_keeps_the_other_sections(tmp_path: Path) -> None:
    record.record("some", {"a": {"x": 1.23456789}, "b": 2}, folder=tmp_path)
    first = json.loads((tmp_path / "some.json").read_text(encoding="utf-8"))
    record.record("some", {"b": 3}, folder=tmp_path)
    record.record("some", {"a": {"x": 9}}, quick=["a"], folder=tmp_path)
    second = json.loads((tmp_path / "some.json").read_text(encoding="utf-8"))
    assert second["a"] == first["a"]
    assert record.load_section("some", "a", tmp_path).results == {"x": 1.2345679}
    assert record.load_section("some", "b", tmp_path).results == 3
    assert set(second) == {"a", "b", "a (quick)"}
    with pytest.raises(record.NotMeasuredError):
        record.load_section("some", "c", tmp_path)
    run = second["b"]["run"]
    assert {"commit", "changed", "date", "command", "processor", "threads", "versions"} <= set(run)
    assert {"python", "torch", "numpy"} <= set(run["versions"])


def test_a_quick_section_stands_in_for_the_full_one(tmp_path: Path) -> None:
    record.record("some", {"a": 1}, quick=["a"], folder=tmp_path)
    assert record.load_section("some", "a", tmp_path).results == 1
    record.record("some", {"a": 2}, folder=tmp_path)
    assert record.load_section("some", "a", tmp_path).results == 2


def test_objects_of_one_kind_are_found_together(tmp_path: Path) -> None:
    record.record("some", {"photographs, cat": 1}, folder=tmp_path)
    record.record("some", {"photographs, ball": 2}, folder=tmp_path)
    found = record.load_sections("some", "photographs", tmp_path)
    assert {name: section.results for name, section in found.items()} == {"ball": 2, "cat": 1}
    assert record.sources(*found.values()).count("<sub>") <= 2


def test_results_become_plain_json() -> None:
    given: Any = {1.5: (np.float64(1 / 3), np.int64(2), math.nan), "x": [True, None, math.inf]}
    assert record.simplify(given) == {"1.5": [0.33333333, 2, None], "x": [True, None, None]}
    with pytest.raises(TypeError, match="set"):
        record.simplify({"x": {1}})


def test_numbers_are_printed_in_few_digits() -> None:
    assert [short(v) for v in (0.0, 0.123, 1.26, 73_412.0, 1.5e-5, None)] == [
        *("0", "0.12", "1.3", "73,000", "1.5e-05", "–")
    ]
    assert least_in_bold([2.0, None, 1.0], ["2", "–", "1"]) == ["2", "–", "**1**"]
    assert table(["a", "b"], [["1", "2"]]) == "| a | b |\n|---|---|\n| 1 | 2 |"


SAMPLE: dict[str, dict[str, Any]] = {
    "evaluate_stereo": {
        "photographs, ball": {"methods": {"auto": {"mean": 1.0, "seconds": 2.0}}},
        "rendered": {"bumps, delrin": {"auto": {"mean": 1.0, "seconds": 2.0}}},
        "few lights": {"object": "cat", "curves": {"auto": {"3": 5.0, "12": 3.0}}},
        "confidence": {"ball": {"1.0": 1.1, "2.0": 2.3}},
    },
    "evaluate_unknown_lights": {
        "photographs": {"ball": {k: {"normals": 1.0, "seconds": 2.0} for k in ("known", "equal", "unknown")}},
    },
    "evaluate_shape_from_shading": {
        "steps": {"found": {"10": {"median": 3.0, "seconds": 0.5}}},
        "surfaces": {"found": {"bumpy ellipsoid, 30 degrees": {"inflated": {"median": 9.0, "seconds": 0.1}}}},
        "failures": {"found": {k: {"light 0, roughness 30": 4.0} for k in ("contour", "no contour")}},
    },
    "chart_reflectance": {
        "models": {
            "roughness_degrees": [5, 60],
            "entries": {
                "vcavity": {
                    "kind": "model",
                    "rms": 0.01,
                    "cells": [[0.1], [0.2]],
                    "time": {"compiled forward": 1.0, "eager both": 2.0},
                }
            },
        }
    },
    "benchmark_renderer": {
        "accuracy": [{"shape": s, "renderer": "this package", "ms": 1.0, "degrees": 0.1} for s in ("sphere", "torus")],
        "costs": {k: [{k: n, "all": n / 10, "front": n / 20} for n in (10, 100)] for k in ("triangles", "pixels")},
    },
    "stability": {
        "map": {
            "implementations": ["acos", "vcavity"],
            "formats": ["64", "32"],
            "copied": 1,
            "values": {"usual": {"acos": "w.", "vcavity": ".."}},
            "gradients": {"usual": {"acos": "NN", "vcavity": "r."}},
        }
    },
}


@pytest.mark.slow
def test_charts_are_drawn_from_the_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, sections in SAMPLE.items():
        record.record(name, sections, folder=tmp_path)
    for load in ("load_section", "load_sections"):
        original = getattr(record, load)
        monkeypatch.setattr(charts, load, lambda name, title, load=original: load(name, title, tmp_path))
    for name, draw in charts.CHARTS.items():
        draw().savefig(tmp_path / f"{name}.png", dpi=20)
    assert len(list(tmp_path.glob("*.png"))) == len(charts.CHARTS)
