"""Values, gradients and results on every device that the machine has, against float64 on the processor."""

from __future__ import annotations

import dataclasses

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from tests.support.objects import Scene
from torch_orennayar import (
    MODELS,
    Camera,
    OrenNayar,
    SyntheticCaptures,
    antialias,
    cast_shadows,
    decode_normals,
    depth_to_normals,
    encode_normals,
    integrate_normals,
    oren_nayar,
    photometric_stereo,
    point_light,
    render_normals,
)
from torch_orennayar.geometry.primitives import bumpy_ball

SMOOTH = ["eon", "fujii", "full", "lambert", "qualitative", "qualitative-0.57", "vcavity"]
"""Models with gradients in closed form; `theory` takes as long as all others together."""


def pixels(device: torch.device, dtype: torch.dtype) -> dict[str, Tensor]:
    """The same random pixels for all, away from horizon and kinks."""
    generator = torch.Generator().manual_seed(3)
    draw = [torch.randn(2, 3, 9, 7, generator=generator, dtype=torch.float64) for _ in range(3)]
    up = torch.tensor([0.0, 0.0, 2.5], dtype=torch.float64).reshape(3, 1, 1)
    normal, light, view = (F.normalize(0.6 * d + up, dim=1) for d in draw)
    albedo = 0.2 + 0.6 * torch.rand(2, 3, 9, 7, generator=generator, dtype=torch.float64)
    roughness = 0.1 + 0.8 * torch.rand(2, 1, 9, 7, generator=generator, dtype=torch.float64)
    known = {"normal": normal, "light": light, "view": view, "albedo": albedo, "roughness": roughness}
    return {name: value.to(device, dtype) for name, value in known.items()}


def value_and_gradients(known: dict[str, Tensor], model: str) -> list[Tensor]:
    leaves = [value.requires_grad_() for value in known.values()]
    normal, light, view, albedo, roughness = leaves
    shading = oren_nayar(normal, light, view, albedo, roughness, model=model)
    weight = torch.linspace(0.5, 1.5, shading.numel(), device=shading.device, dtype=shading.dtype).reshape(
        shading.shape
    )
    return [shading.detach(), *torch.autograd.grad((weight * shading).sum(), leaves)]


@pytest.mark.parametrize("model", SMOOTH)
def test_layer_values_and_gradients(device: torch.device, model: str) -> None:
    wanted = value_and_gradients(pixels(torch.device("cpu"), torch.float64), model)
    for dtype, tolerance in ((torch.float64, 1e-12), (torch.float32, 2e-5)):
        found = value_and_gradients(pixels(device, dtype), model)
        for f, w in zip(found, wanted, strict=True):
            assert f.device.type == device.type
            assert f.dtype == dtype
            assert (f.cpu().double() - w).abs().max() <= tolerance * max(1.0, float(w.abs().max()))


def test_all_models_are_covered() -> None:
    assert set(SMOOTH) | {"theory"} <= set(MODELS)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.bfloat16, torch.float16])
def test_the_layer_keeps_dtype_and_device(device: torch.device, dtype: torch.dtype) -> None:
    known = pixels(device, dtype)
    lights = F.normalize(torch.tensor([[[0.0, 0.3, 1.0], [0.4, 0.0, 1.0]]] * 2), dim=-1).to(device, dtype)
    images = OrenNayar("vcavity").to(device)(known["normal"], lights, albedo=known["albedo"], roughness=0.5)
    assert images.shape == (2, 2, 3, 9, 7)
    assert (images.device.type, images.dtype) == (device.type, dtype)
    assert images.isfinite().all()


def test_near_lights(device: torch.device) -> None:
    points = torch.zeros(1, 3, 4, 5, device=device)
    light, irradiance = point_light(points, torch.tensor([0.0, 0.0, 2.0], device=device).reshape(3, 1, 1), 4.0)
    assert {light.device.type, irradiance.device.type} == {device.type}
    assert torch.allclose(irradiance.cpu(), torch.ones(()))


@pytest.fixture
def ball(device: torch.device) -> tuple[Tensor, Tensor]:
    vertices, faces = bumpy_ball()
    return vertices.to(device), faces.to(device)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_renderer(device: torch.device, ball: tuple[Tensor, Tensor], dtype: torch.dtype) -> None:
    vertices, faces = ball[0].to(dtype).requires_grad_(), ball[1]
    wanted = render_normals(vertices.detach().cpu().double(), faces.cpu(), Camera.orthographic(1.05), (48, 40))
    found = render_normals(vertices, faces, Camera.orthographic(1.05), (48, 40))
    for field in dataclasses.fields(found):
        value = getattr(found, field.name)
        if isinstance(value, Tensor):
            assert value.device.type == device.type, field.name
    assert found.normal.dtype == dtype
    same = (found.face.cpu() == wanted.face) & wanted.mask
    assert same.sum() >= 0.995 * wanted.mask.sum()  # pixel centres on an edge within rounding
    assert (found.normal.detach().cpu().double() - wanted.normal).abs()[same.expand_as(wanted.normal)].max() <= 1e-4
    soft = antialias(found.mask.to(dtype), found, vertices, faces)
    (gradient,) = torch.autograd.grad(soft.sum() + found.normal[:, 2].sum(), vertices)
    assert gradient.device.type == device.type
    assert gradient.isfinite().all()
    assert gradient.abs().max() > 0


def test_shadows(device: torch.device, ball: tuple[Tensor, Tensor]) -> None:
    def reached(vertices: Tensor, faces: Tensor) -> Tensor:
        seen = render_normals(vertices, faces, Camera.orthographic(1.05), (32, 32))
        light = F.normalize(torch.tensor([[0.9, 0.0, 0.3]]), dim=-1).to(vertices)
        return cast_shadows(vertices, faces, seen, light, resolution=128)

    found, wanted = reached(*ball), reached(*(part.cpu() for part in ball))
    assert found.device.type == device.type
    assert (found.cpu() - wanted).abs().mean() <= 0.005


def test_photometric_stereo(device: torch.device, smooth: Scene) -> None:
    given = (smooth.images, smooth.lights, smooth.mask)
    found = photometric_stereo(*(value.to(device) for value in given), model="lambert")
    wanted = photometric_stereo(
        *(value.double() if value.is_floating_point() else value for value in given), model="lambert"
    )
    inside = smooth.mask
    for name in ("normal", "albedo", "residual", "confidence"):
        value, truth = getattr(found, name), getattr(wanted, name)
        assert value.device.type == device.type, name
        assert (value.cpu().double() - truth).abs()[inside.expand_as(truth)].quantile(0.99) <= 1e-3, name


def test_maps_stay_on_their_device(device: torch.device, smooth: Scene) -> None:
    normal, mask = smooth.normal.to(device), smooth.mask.to(device)
    depth = integrate_normals(normal, mask)
    again = depth_to_normals(depth)
    coded = decode_normals(encode_normals(normal))
    assert {depth.device.type, again.device.type, coded.device.type} == {device.type}


def test_synthetic_samples_are_made_on_their_device(device: torch.device) -> None:
    source = SyntheticCaptures("images", device=device, lights=(3, 3), size=(24, 20))
    for index in range(4):  # both kinds of camera among them
        sample = source.sample(index)
        assert {sample[name].device.type for name in ("images", "lights", "mask", "normal")} == {device.type}
        assert sample["images"].isfinite().all()
        assert (sample["normal"].norm(dim=0) - 1)[sample["mask"][0]].abs().max() <= 1e-5
