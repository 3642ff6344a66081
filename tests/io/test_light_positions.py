"""Files of the positions of near lights: tables with units, plain lines, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from torch_orennayar import FileError, RangeError
from torch_orennayar.io.light_files import read_directions
from torch_orennayar.io.light_positions import read_positions

POSITIONS = torch.tensor([[180.0, 0, 260], [-90, 155.5, 260], [-90, -155.5, 260]])


@pytest.mark.parametrize(
    "text",
    [
        pytest.param("180 0 260\n-90 155.5 260\n-90 -155.5 260\n", id="plain"),
        pytest.param("1 180 0 260\n2 -90 155.5 260\n3 -90 -155.5 260\n", id="numbered"),
        pytest.param("led,x_mm,y_mm,z_mm\n1,180,0,260\n2,-90,155.5,260\n3,-90,-155.5,260\n", id="mm"),
        pytest.param("x [cm];y [cm];z [cm]\n18;0;26\n-9;15,55;26\n-9;-15,55;26\n", id="cm, decimal commas"),
        pytest.param("X(m)\tY(m)\tZ(m)\n.18\t0\t.26\n-.09\t.1555\t.26\n-.09\t-.1555\t.26\n", id="m, tabulators"),
        pytest.param("# lamps\nlight_x,light_y,light_z\n180,0,260\n-90,155.5,260\n-90,-155.5,260\n", id="comment"),
    ],
)
def test_positions_in_any_form(tmp_path: Path, text: str) -> None:
    file = tmp_path / "positions.txt"
    file.write_text(text)
    listed = read_positions(file)
    assert listed.names == []
    assert torch.allclose(listed.directions, POSITIONS, atol=1e-3)


@pytest.mark.parametrize(
    "text", ["18 0 26\n-9 15.55 26\n-9 -15.55 26\n", "x,y,z\n18,0,26\n-9,15.55,26\n-9,-15.55,26\n"]
)
def test_the_unit_may_be_given(tmp_path: Path, text: str) -> None:
    file = tmp_path / "positions.txt"
    file.write_text(text)
    assert torch.allclose(read_positions(file, "cm").directions, POSITIONS, atol=1e-3)


def test_a_unit_that_the_file_contradicts(tmp_path: Path) -> None:
    file = tmp_path / "positions.csv"
    file.write_text("x_mm,y_mm,z_mm\n180,0,260\n")
    assert read_positions(file, "mm").directions.tolist() == [[180, 0, 260]]
    with pytest.raises(FileError, match="leave the unit out"):
        read_positions(file, "cm")
    with pytest.raises(RangeError, match="one of mm, cm, m, in"):
        read_positions(file, "feet")


@pytest.mark.parametrize(
    "text",
    [
        "a b.jpg 180 0 260\nc.jpg -90 155.5 260\nd.jpg -90 -155.5 260\n",
        "file,x,y,z\na b.jpg,180,0,260\nc.jpg,-90,155.5,260\nd.jpg,-90,-155.5,260\n",
    ],
    ids=["lines", "table"],
)
def test_names_of_photographs(tmp_path: Path, text: str) -> None:
    file = tmp_path / "positions.txt"
    file.write_text(text)
    listed = read_positions(file)
    assert listed.names == ["a b.jpg", "c.jpg", "d.jpg"]
    assert torch.allclose(listed.directions, POSITIONS)


def test_positions_given_as_directions_are_known_by_their_header(tmp_path: Path) -> None:
    file = tmp_path / "lights.csv"
    file.write_text("x_mm,y_mm,z_mm\n180,0,260\n-90,155,260\n-90,-155,260\n")
    with pytest.raises(FileError, match="--positions"):
        read_directions(file)


@pytest.mark.parametrize(
    ("text", "error", "match"),
    [
        pytest.param("", FileError, "an empty file", id="empty"),
        pytest.param("x,y,z\n", FileError, "the first line alone", id="header alone"),
        pytest.param("x_mm,y_cm,z_mm\n1,2,3\n", FileError, "one unit", id="units that differ"),
        pytest.param("x,y,z\n180,0\n", FileError, "line 2", id="too few cells"),
        pytest.param("x,y,z\n180,0,far\n", FileError, "line 2", id="a word"),
        pytest.param("180 0\n", FileError, "3 numbers", id="two numbers"),
        pytest.param("180 0 260 1\n-90 155 260 .8\n", FileError, "intensities belong", id="four numbers"),
        pytest.param("a.jpg 180 0 260\n-90 155.5 260\n", FileError, "a name in all lines", id="names in some"),
        pytest.param("0 0 1\n.6 0 .8\n", RangeError, "name the unit", id="directions"),
        pytest.param("180 0 -260\n-90 155 -260\n", RangeError, "z above 0", id="behind"),
        pytest.param("180 0 nan\n-90 155 260\n", RangeError, "finite", id="not finite"),
    ],
)
def test_what_is_refused(tmp_path: Path, text: str, error: type[Exception], match: str) -> None:
    file = tmp_path / "positions.txt"
    file.write_text(text)
    with pytest.raises(error, match=match):
        read_positions(file)
