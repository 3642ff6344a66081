"""Light files as people write them: every spelling gives the same lights, or an error with its true reason."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Callable
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torch_orennayar import FileError, TorchOrenNayarError, load_capture
from torch_orennayar.geometry.primitives import spiral_lights
from torch_orennayar.io.light_files import read_directions
from torch_orennayar.io.light_text import split_row

COUNT = 6
LIGHTS = spiral_lights(COUNT)
ROWS = LIGHTS.tolist()


def name(k: int) -> str:
    return f"IMG_{k + 1:03d}.png"


def numbers(k: int, between: str = " ") -> str:
    return between.join(f"{v:.6f}" for v in ROWS[k])


def commas(k: int, between: str = " ") -> str:
    return numbers(k, between).replace(".", ",")


def lines(row: Callable[[int], str], head: str = f"{COUNT}\n") -> str:
    return head + "\n".join(map(row, range(COUNT))) + "\n"


def photographs(folder: Path, names: Callable[[int], str] = name) -> None:
    """Pictures whose brightness says which they are."""
    folder.mkdir(parents=True, exist_ok=True)
    for k in range(COUNT):
        PIL.Image.fromarray(np.full((4, 5), 1000 * (k + 1), np.uint16)).save(folder / names(k), "PNG")


def check(folder: Path, lights: Path | None = None) -> None:
    """The photographs with the lights of their own, in whatever order."""
    capture = load_capture(folder, lights=lights)
    which = (capture.images[:, 0, 0, 0] * 65535 / 1000).round().long() - 1
    assert sorted(which.tolist()) == list(range(COUNT))
    assert torch.allclose(capture.lights, LIGHTS[which], atol=1e-5)


@pytest.mark.parametrize(
    "text",
    [
        lines(lambda k: f"{name(k)} {numbers(k)}"),
        lines(lambda k: f"{name(k)} {numbers(k)}", head=""),
        lines(lambda k: f"{name(k)} {numbers(k)}", head=f"{COUNT} images\n"),
        lines(lambda k: f"{name(k)} {numbers(k)}", head=f"0{COUNT}\n"),
        lines(lambda k: f"{name(k)} {numbers(k)}  # lamp {k}", head="# made by hand\n\n"),
        lines(lambda k: f"{name(k)} {numbers(k)}", head="// made by hand\n"),
        b"\xef\xbb\xbf" + lines(lambda k: f"{name(k)} {numbers(k)}").encode(),
        lines(lambda k: f"{name(k)} {numbers(k)}").encode("utf-16"),
        lines(lambda k: f"{name(k)}\t{numbers(k, chr(9))}").replace("\n", "\r\n"),
        lines(lambda k: f"{name(k)} {numbers(k)}").replace("\n", "\r"),
        lines(lambda k: f"C:\\Users\\me\\coin\\jpeg-exports\\{name(k)} {numbers(k)}"),
        lines(lambda k: f"D:/RTI projects/coin/{name(k)} {numbers(k)}"),
        lines(lambda k: f"/Users/me/coin/{name(k)} {numbers(k)}"),
        lines(lambda k: f"../jpeg-exports/{name(k)} {numbers(k)}"),
        lines(lambda k: f"./{name(k)} {numbers(k)}"),
        lines(lambda k: f"{name(k).lower()} {numbers(k)}"),
        lines(lambda k: f"{name(k)[:-4]}.CR2 {numbers(k)}"),
        lines(lambda k: f"{name(k)[:-4]} {numbers(k)}"),
        lines(lambda k: f'"{name(k)}" {numbers(k)}'),
        lines(lambda k: f"{name(k)} {commas(k)}"),
        lines(lambda k: f"{name(k)} {commas(k) if k % 2 else numbers(k)}"),
        lines(lambda k: f"{name(k)};{commas(k, ';')}", head=""),
        lines(lambda k: f"{name(k)};{numbers(k, ';')}", head=""),
        lines(lambda k: f"{name(k)},{numbers(k, ',')}", head=""),
        lines(lambda k: f"{name(k)}, {numbers(k, ', ')}", head=""),
        lines(lambda k: f"{name(k)} {numbers(COUNT - 1 - k)}", head="").replace("IMG", "IMG")
        and lines(lambda k: f"{name(COUNT - 1 - k)} {numbers(COUNT - 1 - k)}"),
        lines(lambda k: f"{k + 1} {name(k)} {numbers(k)}"),
        lines(lambda k: f"{numbers(k)} {name(k)}"),
        lines(commas, head=""),
        lines(lambda k: f"{k + 1} {numbers(k)}", head=""),
        lines(lambda k: f"{k} {numbers(k)}", head=""),
        lines(lambda k: f"{COUNT - k} {numbers(COUNT - 1 - k)}", head=""),
        lines(lambda k: f"[{numbers(k, ', ')}],", head=""),
        lines(lambda k: f"({numbers(k)})", head=""),
        "\n".join(" ".join(f"{v:.6f}" for v in row) for row in LIGHTS.T.tolist()),
        lines(lambda k: f"{name(k)},{numbers(k, ',')}", head="filename,x,y,z\n"),
        lines(lambda k: f"{numbers(k, ';')};{name(k)}", head="lx;ly;lz;image\n"),
        lines(lambda k: f"{commas(k, ';')};7", head="LX;LY;LZ;lamp\n"),
        lines(lambda k: numbers(k), head="x y z\n"),
        lines(
            lambda k: f"{math.degrees(math.atan2(ROWS[k][1], ROWS[k][0]))},{math.degrees(math.asin(ROWS[k][2]))}",
            head="azimuth,elevation\n",
        ),
    ],
)
def test_spellings_of_the_same_lights(tmp_path: Path, text: str | bytes) -> None:
    photographs(tmp_path)
    (tmp_path / "lights.txt").write_bytes(text.encode() if isinstance(text, str) else text)
    check(tmp_path)


@pytest.mark.parametrize(
    "names",
    [
        lambda k: f"coin#{k + 1}.png",
        lambda k: f"coin # {k + 1}.png",
        lambda k: f"coin, front {k + 1}.png",
        lambda k: f"coin  {k + 1}.png",
        lambda k: f"coin {k + 1}.png",
        lambda k: f"{k + 1} coin.png",
        lambda k: f"coin (copy) {k + 1}.png",
        lambda k: f"münze_{k + 1}.png",
        lambda k: f"0.{k}.png",
    ],
)
def test_names_of_photographs(tmp_path: Path, names: Callable[[int], str]) -> None:
    photographs(tmp_path, names)
    quoted = "#" in names(0) and " " in names(0)
    text = lines(lambda k: f'"{names(k)}" {numbers(k)}' if quoted else f"{names(k)} {numbers(k)}")
    (tmp_path / "set.lp").write_text(text, encoding="utf-8")
    check(tmp_path)


def test_accents_of_another_system_and_encoding(tmp_path: Path) -> None:
    photographs(tmp_path, lambda k: unicodedata.normalize("NFD", f"münze_{k}.png"))
    text = lines(lambda k: f"{unicodedata.normalize('NFC', f'münze_{k}.png')} {numbers(k)}")
    for encoding in ("utf-8", "cp1252"):
        (tmp_path / "set.lp").write_text(text, encoding=encoding)
        check(tmp_path)


def test_natural_order_with_superscript_digits(tmp_path: Path) -> None:
    photographs(tmp_path, lambda k: f"m²_{k + 8}.png")
    (tmp_path / "lights.txt").write_text(lines(numbers, head=""))
    assert load_capture(tmp_path).names == tuple(f"m²_{k + 8}.png" for k in range(COUNT))
    check(tmp_path)


@pytest.mark.parametrize("columns", [1, 3])
def test_intensities_behind_the_directions(tmp_path: Path, columns: int) -> None:
    photographs(tmp_path)
    bright = [[1 + 0.1 * k + c for c in range(columns)] for k in range(COUNT)]
    (tmp_path / "set.lp").write_text(lines(lambda k: f"{name(k)} {numbers(k)} {' '.join(map(str, bright[k]))}"))
    capture = load_capture(tmp_path)
    assert torch.allclose(capture.intensities, torch.tensor(bright).expand(-1, 3))
    assert "no-intensities" not in {note.code for note in capture.notes}
    (tmp_path / "light_intensities.txt").write_text("1\n" * COUNT)
    with pytest.raises(FileError, match="another thing"):
        load_capture(tmp_path)


def test_intensities_with_decimal_commas(tmp_path: Path) -> None:
    photographs(tmp_path)
    (tmp_path / "lights.txt").write_text(lines(numbers, head=""))
    (tmp_path / "light_intensities.txt").write_text("0,5\n" * COUNT)
    assert torch.equal(load_capture(tmp_path).intensities, torch.full((COUNT, 3), 0.5))


def test_a_list_in_another_folder_than_the_photographs(tmp_path: Path) -> None:
    """The layout of RTIBuilder."""
    photographs(tmp_path / "jpeg-exports")
    listing = tmp_path / "assembly-files" / "set.lp"
    listing.parent.mkdir()
    listing.write_text(lines(lambda k: f"../jpeg-exports/{name(k)} {numbers(k)}"))
    check(tmp_path / "jpeg-exports", lights=listing)
    with pytest.raises(FileError, match=r"give the folder .*jpeg-exports and this list as lights="):
        load_capture(listing)
    (tmp_path / "set.lp").write_text(lines(lambda k: f"jpeg-exports\\{name(k)} {numbers(k)}"))
    check(tmp_path / "set.lp")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (lines(lambda k: f"{name(k)} {numbers(k)}", head="7\n"), "expected 7 lights as its first line says, got 6"),
        (lines(lambda k: f"photo{k}.jpg {numbers(k)}"), "'photo0.jpg'.*remove the names"),
        (lines(lambda k: f"../../{name(k)[:-5]}.png {numbers(k)}"), "correct the name"),
        (lines(lambda k: f"{name(0)} {numbers(k)}"), "IMG_001.png twice"),
        (lines(lambda k: f"{k + 5} {numbers(k)}", head=""), "'5'.*correct the name"),
        (lines(lambda k: " ".join(f"{300 * v:.2f}" for v in ROWS[k]), head=""), "positions; of near lights"),
        (lines(lambda k: commas(k, ","), head=""), "separate the numbers by blanks or semicolons"),
        (lines(lambda k: f"{60 * k} 45", head=""), "'azimuth elevation' as the first line"),
        (lines(lambda k: numbers(k).rsplit(" ", 1)[0] + f" {-ROWS[k][2]:.6f}", head=""), "turn the sign of z"),
        (lines(lambda k: f"{name(k)} {numbers(k)}" if k else numbers(k), head=""), "both"),
        (lines(lambda k: f"{numbers(k, ',')}", head="x,y,z,name\n"), "4 cells"),
        (lines(lambda k: f"a,{numbers(k, ',')}".replace("0.", "o."), head="name,x,y,z\n"), "expected numbers"),
        (lines(lambda k: f"{numbers(k)} 0"), "positive intensities"),
        ("0 0 0\n" * COUNT, "length 0"),
        ("\n# nothing\n", "empty file"),
        ("0\n", "no lights"),
        ("x y z\n", "the first line alone"),
        ("0 0 1\0\n", "binary data"),
    ],
)
def test_what_is_refused_and_why(tmp_path: Path, text: str, words: str) -> None:
    photographs(tmp_path)
    (tmp_path / "lights.txt").write_text(text)
    with pytest.raises(TorchOrenNayarError, match=words):
        load_capture(tmp_path)


@pytest.mark.parametrize(("text", "words"), [("", "expected names"), ("a\0.png\n", "binary data"), ("# x\n", "names")])
def test_lists_of_no_photographs(tmp_path: Path, text: str, words: str) -> None:
    photographs(tmp_path)
    (tmp_path / "lights.txt").write_text(lines(numbers, head=""))
    (tmp_path / "filenames.txt").write_text(text)
    with pytest.raises(FileError, match=words):
        load_capture(tmp_path)


@given(
    st.lists(st.floats(-9e3, 9e3).map(lambda v: float(f"{v:.4g}")), min_size=3, max_size=4),
    st.sampled_from([" ", "\t", ";", "; ", ", ", "  "]),
    st.booleans(),
    st.text(st.sampled_from("aZ 9_#-(é"), max_size=8).map(lambda t: f"n{t.strip()}.png"),
    st.booleans(),
)
def test_numbers_are_read_as_written(values: list[float], between: str, comma: bool, label: str, named: bool) -> None:
    text = between.join(repr(v) for v in values)
    if comma and "," not in between:
        text = text.replace(".", ",")
    row = split_row(1, f"{label}{between}{text}" if named else text)
    assert list(row.numbers) == values
    assert row.name(len(values)) == (label if named else "")


@given(st.integers(1, 30), st.integers(0, 1000))
def test_what_is_written_is_read(tmp_path_factory: pytest.TempPathFactory, count: int, seed: int) -> None:
    from torch_orennayar.io.light_files import DIRECTIONS_FILE, write_lights

    drawn = torch.randn(count, 3, generator=torch.Generator().manual_seed(seed))
    lights = torch.nn.functional.normalize(torch.cat((drawn[:, :2], drawn[:, 2:].abs() + 0.1), 1), dim=1)
    file = write_lights(tmp_path_factory.mktemp("lights"), DIRECTIONS_FILE, lights)
    found = read_directions(file)
    assert found.names == []
    assert torch.allclose(found.directions, lights, atol=1e-6)
