from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.command_line import Run
from torch_orennayar import RangeError, save_mesh
from torch_orennayar.cli.options import join_vectors, parse_vector
from torch_orennayar.geometry.primitives import bumpy_ball

FORMS = ("-0.3,0.4,0.86", "-0.3 0.4 0.86", "-0.3, 0.4, 0.86", "-.3 4e-1 +0.86")


@pytest.mark.parametrize("option", ["--light", "--circle"])
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("equals", [False, True])
def test_vectors_with_commas_and_with_spaces(option: str, form: str, equals: bool) -> None:
    first, *rest = form.split()
    words = [f"{option}={first}", *rest] if equals else [option, first, *rest]
    joined = join_vectors(["stay", *words, "7", "-o", "out"])
    assert (joined[0], joined[2:]) == ("stay", ["7", "-o", "out"])
    assert parse_vector(option, joined[1].partition("=")[2]) == [-0.3, 0.4, 0.86]


@pytest.mark.parametrize("text", ["", "1", "1,2", "1,2,3,4", "1,2,x", "1,,3", "nan,0,1", "0,inf,1"])
def test_other_vectors_are_named(text: str) -> None:
    with pytest.raises(RangeError, match=r"--light: expected three numbers.*--light 0\.3,0\.4,0\.86"):
        parse_vector("--light", text)


@pytest.mark.slow
def test_all_forms_render_the_same(orennayar: Run, tmp_path: Path) -> None:
    save_mesh(tmp_path / "ball.ply", *bumpy_ball())
    command = ("render", tmp_path / "ball.ply", "--size", 32, "--light")
    for number, form in enumerate(FORMS):
        result = orennayar(*command, *form.split(), "-o", tmp_path / str(number))
        assert result.status == 0, result.err
    pictures = [(tmp_path / str(number) / "shaded.png").read_bytes() for number in range(len(FORMS))]
    assert len(set(pictures)) == 1
    assert orennayar(*command, 0.3, 0.4, 0.86, "-o", tmp_path / "other").status == 0
    assert (tmp_path / "other" / "shaded.png").read_bytes() != pictures[0]
    assert np.load(tmp_path / "0" / "normal.npy").shape == (3, 32, 32)


@pytest.mark.parametrize("words", [("1",), ("1", "2"), ("1,2",), ("1,2,x",), ("nan", "0", "1")])
def test_wrong_vectors_are_one_line(orennayar: Run, tmp_path: Path, words: tuple[str, ...]) -> None:
    result = orennayar("shape", tmp_path / "absent.png", "--light", *words, "-o", tmp_path / "out")
    assert result.status in (1, 2)
    assert "--light" in result.err or "extra argument" in result.err
    assert list(tmp_path.iterdir()) == []
