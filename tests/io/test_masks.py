from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import PIL.Image
import pytest

from torch_orennayar import FileError
from torch_orennayar.io.masks import find_mask, is_mask, read_mask

SIZE = (24, 24)
ROWS, COLUMNS = np.mgrid[: SIZE[0], : SIZE[1]]
INSIDE = (ROWS - 11.5) ** 2 + (COLUMNS - 11.5) ** 2 < 64
WHITE = (INSIDE * 255).astype(np.uint8)
COLOURS = np.array([[0, 0, 0], [64, 0, 20], [0, 192, 0]], np.uint8)
PHOTO = np.random.default_rng(0).integers(90, 160, (*SIZE, 3)).astype(np.uint8)


def palette(colours: list[int], **options: int) -> Callable[[Path], None]:
    def save(file: Path) -> None:
        picture = PIL.Image.fromarray(INSIDE.astype(np.uint8), "P")
        picture.putpalette(colours + [0] * (768 - len(colours)))
        picture.save(file, None, **options)

    return save


def array(values: npt.NDArray[np.generic], **options: int) -> Callable[[Path], None]:
    return lambda file: PIL.Image.fromarray(values).save(file, None, **options)


WAYS: dict[str, tuple[str, Callable[[Path], None]]] = {
    "white on black": (".png", array(WHITE)),
    "0 and 1": (".png", array(INSIDE.astype(np.uint8))),
    "one bit": (".png", array(INSIDE)),
    "sixteen bits": (".png", array(WHITE.astype(np.uint16) * 257)),
    "white cut out": (".png", array(np.dstack([np.full((*SIZE, 3), 255, np.uint8), WHITE]))),
    "black cut out": (".png", array(np.dstack([np.zeros((*SIZE, 3), np.uint8), WHITE]))),
    "photograph cut out": (".png", array(np.dstack([PHOTO, WHITE]))),
    "grey cut out": (".png", array(np.dstack([np.full(SIZE, 255, np.uint8), WHITE]))),
    "palette, black and white": (".png", palette([0, 0, 0, 255, 255, 255])),
    "palette, dark red label": (".png", palette([0, 0, 0, 128, 0, 0])),
    "palette, transparent ground": (".png", palette([255] * 6, transparency=0)),
    "labels 1 and 2": (".png", array(INSIDE * np.where(COLUMNS < 12, 1, 2).astype(np.uint8))),
    "labels in colours": (".png", array(COLOURS[INSIDE * np.where(COLUMNS < 12, 1, 2)])),
    "grey above dark noise": (".png", array(np.where(INSIDE, 120, 3).astype(np.uint8))),
    "blue": (".png", array(np.dstack([0 * WHITE, 0 * WHITE, WHITE]))),
    "tiff": (".tif", array(WHITE)),
    "bmp": (".bmp", array(WHITE)),
    "gif": (".gif", array(WHITE)),
    "pgm": (".pgm", array(WHITE)),
}  # fmt: skip


@pytest.mark.parametrize("way", WAYS)
def test_masks_are_read_as_people_make_them(tmp_path: Path, way: str) -> None:
    suffix, save = WAYS[way]
    file = tmp_path / f"mask{suffix}"
    save(file)
    found, notes = read_mask(file, SIZE)
    assert np.array_equal(found[0].numpy(), INSIDE)
    assert [note.code for note in notes] == (
        ["mask-from-alpha"]
        if "cut out" in way or "transparent" in way
        else ["mask-from-labels"]
        if "label" in way or way in ("blue", "palette, dark red label")
        else []
    )


def test_a_mask_that_holds_the_corners_may_be_inverted(tmp_path: Path) -> None:
    PIL.Image.fromarray(255 - WHITE).save(tmp_path / "mask.png")
    found, notes = read_mask(tmp_path / "mask.png", SIZE)
    assert np.array_equal(found[0].numpy(), ~INSIDE)
    assert [note.code for note in notes] == ["mask-may-be-inverted"]


def test_soft_edges_of_jpeg_end_at_half(tmp_path: Path) -> None:
    PIL.Image.fromarray(WHITE).save(tmp_path / "mask.jpg", quality=80)
    found, _ = read_mask(tmp_path / "mask.jpg", SIZE)
    assert (found[0].numpy() ^ INSIDE).sum() < 8


@pytest.mark.parametrize(
    "name", ["mask.png", "Mask.png", "MASK.PNG", "object_mask.png", "Image.mask.png", "masks/mask.png"]
)
def test_masks_are_found_by_name(tmp_path: Path, name: str) -> None:
    (tmp_path / name).parent.mkdir(exist_ok=True)
    PIL.Image.fromarray(WHITE).save(tmp_path / name, "PNG")
    PIL.Image.fromarray(WHITE).save(tmp_path / "photograph.png")
    assert find_mask(tmp_path) == tmp_path / name
    assert is_mask(tmp_path / name)


def test_of_several_masks_the_one_called_mask_counts(tmp_path: Path) -> None:
    for name in ("left_mask.png", "right_mask.png"):
        PIL.Image.fromarray(WHITE).save(tmp_path / name)
    with pytest.raises(FileError, match="left_mask"):
        find_mask(tmp_path)
    PIL.Image.fromarray(WHITE).save(tmp_path / "mask.png")
    assert find_mask(tmp_path) == tmp_path / "mask.png"


def test_a_mask_that_leaves_nothing_out_says_so_and_an_empty_one_is_refused(tmp_path: Path) -> None:
    PIL.Image.fromarray(np.full(SIZE, 255, np.uint8)).save(tmp_path / "mask.png")
    found, notes = read_mask(tmp_path / "mask.png", SIZE)
    assert found.all()
    assert [note.code for note in notes] == ["mask-covers-everything"]
    PIL.Image.fromarray(np.zeros(SIZE, np.uint8)).save(tmp_path / "mask.png")
    with pytest.raises(FileError, match="empty"):
        read_mask(tmp_path / "mask.png", SIZE)
    with pytest.raises(FileError, match="24 x 24"):
        read_mask(tmp_path / "mask.png", (25, 24))
    assert [note.code for note in read_mask(None, SIZE)[1]] == ["no-mask"]
