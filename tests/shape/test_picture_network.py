"""The network that shape from shading starts from: its frame, its file, its errors on figures that it never saw."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch
import torch.nn.functional as F
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from tests.support import height_fields
from tests.support.height_fields import light_at, photograph
from tests.support.objects import run_graph
from torch_orennayar import (
    FileError,
    Ingredients,
    SyntheticCaptures,
    SyntheticImages,
    angular_error,
    export_onnx,
    shape_from_shading,
    silhouette_normals,
)
from torch_orennayar.shape.picture_network import (
    SIDE,
    WEIGHTS,
    Frame,
    LearnedNormals,
    PictureNetwork,
    learned_normals,
    load_picture_network,
    save_picture_network,
)


def disc(size: tuple[int, int], row: float, column: float, radius: float) -> Tensor:
    rows, columns = torch.meshgrid(*(torch.arange(n).float() for n in size), indexing="ij")
    return (torch.hypot(rows - row, columns - column) < radius)[None]


@given(
    st.floats(-math.pi, math.pi), st.floats(30, 50), st.floats(35, 60), st.floats(12, 28), st.sampled_from([1.0, 3.0])
)
@settings(deadline=None, max_examples=30)
def test_what_is_taken_into_the_frame_comes_back(
    azimuth: float, row: float, column: float, radius: float, scale: float
) -> None:
    """Small pictures and large ones, which are reduced first; smooth maps, vectors too."""
    size = (int(80 * scale), int(96 * scale))
    mask = disc(size, row * scale, column * scale, radius * scale)
    frame = Frame.around(mask, torch.tensor([math.cos(azimuth), math.sin(azimuth), 1.0]))
    rows, columns = torch.meshgrid(*(torch.arange(n) / (20 * scale) for n in size), indexing="ij")
    smooth = torch.stack((rows.sin(), (columns + rows).cos(), 0.3 * columns))
    back = frame.give(frame.take(smooth), size)
    assert (back - smooth)[:, mask[0]].abs().max() < 0.03
    light = torch.tensor([math.cos(azimuth), math.sin(azimuth), 1.0]).reshape(3, 1, 1)
    assert torch.allclose(frame.take_vectors(light).flatten(), torch.tensor([1.0, 0.0, 1.0]), atol=1e-6)
    assert torch.allclose(frame.give_vectors(frame.take_vectors(light)), light, atol=1e-6)


def quarter_turn(vectors: Tensor) -> Tensor:
    """A map of vectors and its picture, turned counter-clockwise."""
    x, y, z = vectors.rot90(1, (1, 2))
    return torch.stack((-y, x, z))


def test_turning_picture_and_light_turns_the_answer() -> None:
    field, light = height_fields.make("bumpy ellipsoid", 96), light_at(35, 20)
    image = photograph(field, light, 0.5)
    found = learned_normals(image, light.reshape(3, 1, 1), field.mask).normal
    turned = quarter_turn(light.reshape(3, 1, 1))
    again = learned_normals(image.rot90(1, (1, 2)), turned, field.mask.rot90(1, (1, 2))).normal
    assert angular_error(again, quarter_turn(found), field.mask.rot90(1, (1, 2))).summary()["p90"] < 2


def unseen(count: int) -> list[SyntheticImages]:
    """Pictures of painted, shiny, shadowed figures under one light each, of a seed that training does not use."""
    mix = Ingredients(rough=0.4, glossy=0.6, metal=0.05, clipped=0.1)
    captures = SyntheticCaptures("images", mix=mix, seed=11, meshes="figures", lights=(1, 1), size=(96, 96))
    samples = (captures.sample(k) for k in range(4 * count))
    return [s for s in samples if s["mask"].sum() > 800 and s["true_lights"][0, 2] > 0.5][:count]


def read(sample: SyntheticImages) -> LearnedNormals:
    return learned_normals(sample["images"][0], sample["true_lights"][0].reshape(3, 1, 1), sample["mask"])


def test_figures_never_seen_are_read_better_than_their_outlines() -> None:
    """And the error that the network expects is about the error that it makes."""
    found, inflated, ratios = [], [], []
    for sample in unseen(12):
        normal, error = read(sample)
        mask = sample["mask"]
        assert torch.allclose(normal[:, mask[0]].norm(dim=0), torch.ones(()), atol=1e-5)
        assert not normal[:, ~mask[0]].any()
        missed = angular_error(normal, sample["normal"], mask)
        found.append(missed.summary()["mean"])
        inflated.append(angular_error(silhouette_normals(mask), sample["normal"], mask).summary()["mean"])
        rms = torch.deg2rad(missed[mask]).square().mean().sqrt()
        ratios.append(float(2**0.5 * error[mask].square().mean().sqrt() / rms))
    assert sum(found) < 0.65 * sum(inflated)
    assert 0.6 < sorted(ratios)[len(ratios) // 2] < 1.6


def test_a_ball_is_a_ball() -> None:
    field = height_fields.make("sphere cap", 96)
    for degrees in (0, 40):
        image = photograph(field, light_at(30), math.radians(degrees))
        found = learned_normals(image, light_at(30).reshape(3, 1, 1), field.mask).normal
        assert angular_error(found, field.normal.float(), field.mask).summary()["mean"] < 7


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (300, 2)])
def test_tiny_and_thin_masks(size: tuple[int, int]) -> None:
    mask = torch.ones(1, *size, dtype=torch.bool)
    normal, error = learned_normals(torch.full((1, *size), 0.4), torch.tensor([0.0, 0.6, 0.8]).reshape(3, 1, 1), mask)
    assert normal.shape == (3, *size)
    assert normal.isfinite().all()
    assert (error > 0).all()


def test_what_lies_outside_the_mask_does_not_count() -> None:
    field, light = height_fields.make("bumpy ellipsoid", 64), light_at(30).reshape(3, 1, 1)
    image = photograph(field, light_at(30), 0.5)
    wild = torch.where(field.mask, image, math.nan)
    assert torch.equal(*(learned_normals(i, light, field.mask).normal for i in (image, wild)))


@pytest.mark.slow
def test_paint_and_shine_are_read_better_with_the_network() -> None:
    errors: dict[str, list[float]] = {"learned": [], "silhouette": []}
    for sample in unseen(6):
        for prior, list_of in errors.items():
            found = shape_from_shading(
                sample["images"][0],
                sample["true_lights"][0],
                sample["mask"],
                albedo=None,
                prior=prior,  # type: ignore[arg-type]
            )
            list_of.append(angular_error(found.normal, sample["normal"], sample["mask"]).summary()["mean"])
    assert sum(errors["learned"]) < 0.75 * sum(errors["silhouette"])


def test_the_file_is_small_and_another_one_can_be_written(tmp_path: Path) -> None:
    assert WEIGHTS.stat().st_size <= 2_000_000
    torch.manual_seed(0)
    network = PictureNetwork((8, 16))
    save_picture_network(tmp_path / "small.pt", network)
    maps = torch.rand(2, 8, SIDE, SIDE)
    wanted, found = (n(maps)[0] for n in (network.half().float(), load_picture_network(tmp_path / "small.pt")))
    assert (wanted - found).abs().max() < 1e-3
    (tmp_path / "rubbish.pt").write_bytes(b"rubbish")
    for name in ("rubbish.pt", "absent.pt"):
        with pytest.raises(FileError, match="save_picture_network"):
            load_picture_network(tmp_path / name)


def test_untrained_it_returns_the_inflated_silhouette() -> None:
    field = height_fields.make("sphere cap", 96)
    image, light = photograph(field, light_at(30), 0.0), light_at(30).reshape(3, 1, 1)
    torch.manual_seed(0)
    found = learned_normals(image, light, field.mask, PictureNetwork()).normal
    assert angular_error(found, silhouette_normals(field.mask), field.mask).summary()["median"] < 2
    assert F.cosine_similarity(found, silhouette_normals(field.mask), dim=0)[field.mask[0]].mean() > 0.99


@pytest.mark.slow
def test_the_network_becomes_a_graph(tmp_path: Path) -> None:
    """For any number of pictures; the weights do not matter."""
    torch.manual_seed(0)
    network = PictureNetwork((8, 16, 16, 16)).eval()
    for parameter in network.mend.parameters():
        torch.nn.init.normal_(parameter, std=0.1)
    names, example = ("normal", "error"), (torch.rand(2, 8, 64, 64),)
    target = tmp_path / "network.onnx"
    path = export_onnx(network, target, example_inputs=example, input_names=("maps",), output_names=names)
    maps = torch.rand(3, 8, 64, 64)
    with torch.no_grad():
        wanted = dict(zip(names, network(maps), strict=True))
    for name, found in run_graph(path, 0, maps=maps).items():
        assert torch.allclose(found, wanted[name], atol=1e-5)
