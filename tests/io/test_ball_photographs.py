from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor

from torch_orennayar import FileError, OrenNayar, RangeError, load_capture
from torch_orennayar.geometry.primitives import Ball, spiral_lights
from torch_orennayar.io.images import write_image


def photograph_scene(folder: Path, *, odd: bool = False) -> tuple[Tensor, Tensor]:
    """Six photographs of a matt dome before black, a mirror ball beside it; the lights and the dome's mask."""
    lights = spiral_lights(6)
    dome, inside = Ball(40.0, 40.0, 30.0).normals((80, 130))
    images = OrenNayar("lambert")(dome[None], lights[None], albedo=0.6)[0]
    own, on_ball = Ball(100.0, 45.0, 18.0).normals((80, 130))
    mirrored = 2 * own[2:] * own - torch.tensor((0.0, 0.0, 1.0)).reshape(3, 1, 1)
    cosine = torch.einsum("kc,chw->khw", lights, mirrored)[:, None]
    images = torch.where(on_ball, 0.03 + 20 * torch.exp((cosine - 1) / 0.05**2), images).clamp(0, 1)
    for name, image in zip("abcdef", images.expand(-1, 3, -1, -1), strict=True):
        write_image(folder / f"{name}.png", image, bits=16)
    if odd:
        for name in ("ref.png", "a_off.png", "contact-preview.png"):
            write_image(folder / name, torch.zeros(3, 80, 130), bits=16)
    return lights, inside


def test_lights_of_a_ball_beside_the_object(tmp_path: Path) -> None:
    lights, inside = photograph_scene(tmp_path)
    found = load_capture(tmp_path)
    assert {"lights-from-ball", "mask-found"} <= {note.code for note in found.notes}
    assert (found.lights * lights).sum(1).clamp(max=1).acos().rad2deg().max() <= 4
    assert found.ball is not None
    assert abs(found.ball.radius - 18) <= 1
    assert found.ball_picture is not None
    assert ((found.mask & inside).sum() / (found.mask | inside).sum()).item() >= 0.95
    marked = load_capture(tmp_path, ball=(100.0, 45.0, 18.0), mask="whole")
    assert (marked.lights * lights).sum(1).clamp(max=1).acos().rad2deg().max() <= 3
    assert bool(marked.mask.all())
    painted = tmp_path / "elsewhere"
    painted.mkdir()
    write_image(painted / "ball.png", Ball(100.0, 45.0, 18.0).normals((80, 130))[1].float())
    assert (load_capture(tmp_path, ball_mask=painted / "ball.png").lights - marked.lights).abs().max() <= 0.1


def test_pictures_that_are_no_photographs_are_named(tmp_path: Path) -> None:
    photograph_scene(tmp_path, odd=True)
    found = load_capture(tmp_path)
    assert found.names == ("a.png", "b.png", "c.png", "d.png", "e.png", "f.png")
    codes = {note.code: note for note in found.notes}
    assert codes["not-photographs"].value == 2
    assert "ref.png" in codes["not-photographs"]
    assert "contact-preview.png" in codes["not-photographs"]
    assert "a_off.png" in codes["ambient-subtracted"]
    write_image(tmp_path / "b_off.png", torch.zeros(3, 80, 130), bits=16)
    with pytest.raises(FileError, match=r"one photograph with all lights off, got a_off\.png, b_off\.png"):
        load_capture(tmp_path)


def test_photographs_of_a_ball_are_paired_by_name(tmp_path: Path) -> None:
    (tmp_path / "object").mkdir()
    (tmp_path / "ball").mkdir()
    lights, _ = photograph_scene(tmp_path / "object")
    photograph_scene(tmp_path / "ball")
    write_image(tmp_path / "ball" / "try.png", torch.zeros(3, 80, 130), bits=16)
    for name in "abc":
        (tmp_path / "object" / f"{name}.png").unlink()
    found = load_capture(tmp_path / "object", chrome=tmp_path / "ball")
    assert (found.lights * lights[3:]).sum(1).clamp(max=1).acos().rad2deg().max() <= 4
    (tmp_path / "object" / "f.png").rename(tmp_path / "object" / "g.png")
    with pytest.raises(FileError, match=r"3 photographs, one per light, got 7.*the same name or in the same order"):
        load_capture(tmp_path / "object", chrome=tmp_path / "ball")


def test_one_source_of_lights(tmp_path: Path) -> None:
    photograph_scene(tmp_path)
    with pytest.raises(FileError, match="got more than one; leave the others out"):
        load_capture(tmp_path, lights=tmp_path / "lights.txt", ball=(1.0, 2.0, 3.0))
    with pytest.raises(RangeError, match="an outline or a mask of the ball, got both"):
        load_capture(tmp_path, ball=(1.0, 2.0, 3.0), ball_mask=tmp_path / "a.png")
    with pytest.raises(RangeError, match="radius > 0"):
        load_capture(tmp_path, ball=(1.0, 2.0, 0.0))
