from __future__ import annotations

from pathlib import Path

import pytest
import torch

from tests.support.example_code import load
from tests.support.objects import Scene
from torch_orennayar import OrenNayar, save_mesh
from torch_orennayar.geometry.primitives import bumpy_ball
from torch_orennayar.io.capture import save_capture
from torch_orennayar.io.images import read_image


@pytest.mark.slow
def test_fit_roughness_finds_the_truth() -> None:
    albedo, degrees = load("fit_roughness").main()
    assert torch.allclose(albedo, torch.tensor([0.8, 0.5, 0.2]), atol=0.01)
    assert degrees == pytest.approx(35, abs=1)


def test_shade_mesh_draws_two_rows_of_three(tmp_path: Path) -> None:
    save_mesh(tmp_path / "mesh.ply", *bumpy_ball())
    load("shade_mesh").main(str(tmp_path / "mesh.ply"), str(tmp_path / "picture.png"))
    picture = read_image(tmp_path / "picture.png")
    assert picture.shape == (512, 768)
    assert (picture[:256] != picture[256:]).mean() > 0.1


@pytest.mark.slow
def test_fit_silhouette_finds_the_truth(tmp_path: Path) -> None:
    place, size, losses = load("fit_silhouette").main(str(tmp_path / "picture.png"))
    assert place == pytest.approx([0.3, -0.2], abs=0.005)
    assert size == pytest.approx(1.5, abs=0.01)
    assert losses[-1] < losses[0] / 100
    assert read_image(tmp_path / "picture.png").ndim == 3


@pytest.mark.slow
def test_custom_reflectance_draws_and_exports(tmp_path: Path) -> None:
    import onnxruntime

    from torch_orennayar import MODELS, OrenNayar
    from torch_orennayar.reflectance.models import unregister_model

    example = load("custom_reflectance")
    try:
        example.main(str(tmp_path / "custom.png"))
        assert read_image(tmp_path / "custom.png").ndim == 3
        session = onnxruntime.InferenceSession(str(tmp_path / "custom.onnx"))
        normal = torch.tensor([0.0, 0.6, 0.8]).reshape(1, 3, 1, 1)
        up = torch.tensor([0.0, 0.0, 1.0]).reshape(1, 3, 1, 1)
        feeds = {"normal": normal, "light": up, "view": up, "albedo": torch.ones(1, 1, 1, 1)}
        feeds["roughness"] = torch.full((1, 1, 1, 1), 0.2)
        (tone,) = session.run(None, {k: v.numpy() for k, v in feeds.items()})
        wanted = OrenNayar("toon")(normal, up.reshape(1, 3), roughness=0.2)
        assert abs(tone.item() - wanted.item()) <= 1e-5
        # The second step, at ci = 0.8, is half taken: two tones and a half of three.
        assert wanted.item() == pytest.approx(2.5 / 3, abs=1e-3)
        assert {"minnaert", "toon"} <= set(MODELS)
    finally:
        for name in ("minnaert", "toon"):
            unregister_model(name)


@pytest.mark.slow
def test_inverse_rendering_mends_the_lights(tmp_path: Path, rough: Scene) -> None:
    save_capture(tmp_path / "capture", rough.images, rough.lights, rough.mask)
    found = load("inverse_rendering").main(str(tmp_path / "capture"), str(tmp_path / "out"))
    assert found["lights off after"] < 0.5 * found["lights off before"]
    assert found["roughness, degrees"] == pytest.approx(30, abs=3)
    assert found["last loss"] < found["first loss"]
    assert read_image(tmp_path / "out" / "relit.png").ndim == 3
    assert (tmp_path / "out" / "loss.png").is_file()


@pytest.mark.slow
def test_shape_from_one_picture_is_learned_through_the_layer(tmp_path: Path) -> None:
    """A minute of what takes longer: the re-rendered picture comes nearer, more so with the rough model in the loss."""
    example = load("train_shape_from_shading")
    pictures = example.draw(8, 0, 32)
    before = example.misfit(OrenNayar("vcavity"), example.Bender()(pictures), pictures, True).item()
    after, normals = {}, {}
    for model in ("lambert", "vcavity"):
        network, losses = example.train(pictures, 200, model, 0)
        assert sum(losses[-10:]) < sum(losses[:10])
        with torch.no_grad():
            normals[model] = network(pictures)
            after[model] = example.misfit(OrenNayar("vcavity"), normals[model], pictures, True).item()
    assert after["vcavity"] < 0.8 * before
    assert after["vcavity"] < after["lambert"]
    normal = normals["vcavity"]
    inside = pictures.mask.expand_as(normal) > 0
    assert torch.allclose(normal.norm(dim=1)[inside[:, 0]], torch.ones(()), atol=1e-5)
