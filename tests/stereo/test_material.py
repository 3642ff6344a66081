from __future__ import annotations

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from torch_orennayar import blinn_phong, oren_nayar
from torch_orennayar.geometry.primitives import spiral_lights
from torch_orennayar.stereo.material import LightDirections, Material, cosines, respond

MATERIALS = [
    Material(),
    Material(minnaert_exponent=1.1),
    Material("qualitative", 0.5),
    Material("vcavity", 0.5),
    Material("full", 0.4, exponents=(16,)),
    Material(exponents=(8, 64)),
    Material(minnaert_exponent=1.15, exponents=(32,)),
]


def scene(count: int, near: bool) -> tuple[Tensor, Tensor, Tensor, LightDirections, Tensor]:
    """Normals, albedo, strengths of lobes, lights (distant, or each pixel's own), mean brightness of the pixels."""
    generator = torch.Generator().manual_seed(0)
    draw = torch.rand(20, 3, generator=generator, dtype=torch.float64) - torch.tensor((0.5, 0.5, -0.2))
    normal = F.normalize(draw, dim=1)
    albedo, lobes = (
        0.2 + 0.6 * torch.rand(20, 1, generator=generator).double(),
        torch.rand(20, count, generator=generator).double(),
    )
    lights = spiral_lights(9).double()
    if near:
        lights = F.normalize(lights + 0.25 * torch.rand(20, 9, 3, generator=generator).double(), dim=-1)
    return normal, albedo, lobes, LightDirections.of(lights), torch.full((20, 1), 0.8).double()


@pytest.mark.parametrize("near", [False, True], ids=["distant", "near"])
@pytest.mark.parametrize("material", MATERIALS, ids=str)
def test_value_is_the_layers_and_the_lobes(material: Material, near: bool) -> None:
    normal, albedo, lobes, directions, mean = scene(len(material.exponents), near)
    found = respond(material, normal, albedo, lobes, directions, mean).value * mean
    lights = directions.light.expand(20, -1, -1)
    view = torch.tensor((0.0, 0.0, 1.0)).double()
    matt = oren_nayar(
        normal[:, None], lights, view, (albedo * mean)[:, None], material.roughness, model=material.model, dim=2
    )[..., 0]
    ci, co = torch.einsum("pc,pkc->pk", normal, lights).clamp_min(0), normal[:, 2:]
    wanted = matt * (ci * co) ** (material.minnaert_exponent - 1)
    for k, p in enumerate(material.exponents):
        lobe = blinn_phong(ci, co.expand_as(ci), lights[..., 2], float(p)) * 8 / (p + 8)
        wanted = wanted + lobes[:, k : k + 1] * mean * lobe * ci
    assert torch.allclose(found, wanted, atol=1e-9)


@pytest.mark.parametrize("near", [False, True], ids=["distant", "near"])
@pytest.mark.parametrize("material", MATERIALS, ids=str)
def test_derivatives_are_those_of_differences(material: Material, near: bool) -> None:
    normal, albedo, lobes, directions, mean = scene(len(material.exponents), near)
    view = torch.tensor((0.0, 0.0, 1.0)).double()
    response = respond(material, normal, albedo, lobes, directions, mean, by_roughness=True)
    step = 1e-6

    def slope(forward: Tensor, backward: Tensor) -> Tensor:
        return (forward - backward) / (2 * step)

    away = (cosines(normal, directions.light).abs() > 1e-3).double()  # from the terminator
    for axis in range(3):
        shift = torch.zeros(3).double()
        shift[axis] = step
        ahead, behind = (
            respond(material, normal + d, albedo, lobes, directions, mean).value for d in (shift, -shift)
        )  # the normal need not be a unit vector for this
        by = response.by_light * directions.light[..., axis]
        if response.by_view is not None:
            by = by + response.by_view * view[axis]
        if response.by_half is not None:
            by = by + response.by_half * directions.half[..., axis]
        assert torch.allclose(by * away, slope(ahead, behind) * away, atol=1e-5)
    ahead, behind = (respond(material, normal, albedo + d, lobes, directions, mean).value for d in (step, -step))
    assert torch.allclose(response.columns[0], slope(ahead, behind), atol=1e-6)
    for k in range(len(material.exponents)):
        shift = torch.zeros(len(material.exponents)).double()
        shift[k] = step
        ahead, behind = (respond(material, normal, albedo, lobes + d, directions, mean).value for d in (shift, -shift))
        assert torch.allclose(response.columns[1 + k], slope(ahead, behind), atol=1e-6)
    if response.by_roughness is not None:
        ahead, behind = (
            respond(replace(material, roughness=material.roughness + d), normal, albedo, lobes, directions, mean).value
            for d in (step, -step)
        )
        assert torch.allclose(response.by_roughness, slope(ahead, behind), atol=1e-6)
