from __future__ import annotations

import math

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd import gradcheck

from tests.support import oracles
from torch_orennayar import (
    MODELS,
    ModelError,
    OrenNayar,
    RangeError,
    ShapeError,
    brdf,
    directional_albedo,
    oren_nayar,
    point_light,
)

ALL = sorted(MODELS)
CLOSED = [name for name in ALL if name != "theory"]  # the slow quadrature has tests of its own
UP = torch.tensor([0.0, 0.0, 1.0])


def unit(*shape: int, dim: int = 1, seed: int = 0, dtype: torch.dtype = torch.float64) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return F.normalize(torch.randn(*shape, generator=generator, dtype=dtype), dim=dim)


def random_scene(dtype: torch.dtype = torch.float64) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Normals, light, view, albedo, roughness; about a quarter of the pixels face both."""
    generator = torch.Generator().manual_seed(5)
    return (
        unit(2, 3, 4, 5, seed=1, dtype=dtype),
        unit(2, 3, 1, 1, seed=2, dtype=dtype),
        unit(1, 3, 4, 5, seed=3, dtype=dtype),
        torch.rand(2, 3, 1, 1, generator=generator, dtype=dtype),
        torch.rand(2, 1, 4, 5, generator=generator, dtype=dtype),
    )


@pytest.mark.parametrize("model", ALL)
def test_white_pixel_facing_the_light_is_one(model: str) -> None:
    up = UP.reshape(1, 3, 1, 1)
    assert oren_nayar(up, up, up, 1.0, 0.0, model=model).item() == 1.0
    assert brdf(up, up, up, 1.0, 0.0, model=model).item() == pytest.approx(1 / math.pi, rel=1e-6)


@pytest.mark.parametrize("model", ALL)
def test_smooth_equals_lambert_to_rounding(model: str) -> None:
    normal, light, view, albedo, _ = random_scene(torch.float32)
    smooth = oren_nayar(normal, light, view, albedo, 0.0, model=model)
    assert torch.equal(smooth, oren_nayar(normal, light, view, albedo, 0.0, model="lambert"))


@pytest.mark.parametrize("model", ALL)
def test_lambert_shading_is_albedo_times_cosine(model: str) -> None:
    normal, light, view, albedo, _ = random_scene()
    cosine = (normal * light).sum(1, keepdim=True)
    seen = ((normal * view).sum(1, keepdim=True) > 0) & (cosine > 0)
    wanted = albedo * cosine * seen
    assert torch.allclose(oren_nayar(normal, light, view, albedo, 0.0, model=model), wanted, rtol=0, atol=1e-15)


@pytest.mark.parametrize("model", ALL)
def test_rotation_invariance(model: str) -> None:
    normal, light, view, albedo, roughness = random_scene()
    turn = torch.linalg.qr(unit(3, 3, seed=9)).Q
    straight = oren_nayar(normal, light, view, albedo, roughness, model=model)
    normal, light, view = (torch.einsum("ij,bjhw->bihw", turn, t) for t in (normal, light, view))
    turned = oren_nayar(normal, light, view, albedo, roughness, model=model)
    assert torch.allclose(turned, straight, rtol=0, atol=1e-12)


@pytest.mark.parametrize("model", ALL)
def test_brdf_is_reciprocal(model: str) -> None:
    normal, light, view, albedo, roughness = random_scene()
    there = brdf(normal, light, view, albedo, roughness, model=model)
    assert there.max() > 0
    assert torch.allclose(there, brdf(normal, view, light, albedo, roughness, model=model), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("model", CLOSED)
@pytest.mark.parametrize(("cosine", "degrees"), [(0.2, 20), (0.6, 45), (1.0, 60)])
def test_directional_albedo_against_monte_carlo(model: str, cosine: float, degrees: float) -> None:
    sigma = math.radians(degrees)
    value = directional_albedo(torch.tensor(cosine).double(), 0.8, sigma, model=model).item()
    wanted = oracles.directional_albedo_monte_carlo(MODELS[model].function, cosine, 0.8, sigma)
    assert value == pytest.approx(wanted, abs=3e-3)


@pytest.mark.parametrize(
    ("model", "low", "high"),
    [
        ("lambert", 1 - 1e-9, 1 + 1e-9),
        ("vcavity", 0.98, 1.02),
        ("eon", 0.999, 1.001),
        ("qualitative", 0.55, 1.04),
        ("qualitative-0.57", 0.6, 1.05),
        ("fujii", 0.7, 1.04),
        ("full", 0.7, 1.04),
    ],
)
def test_white_furnace(model: str, low: float, high: float) -> None:
    """What a white surface sends back. Only vcavity and eon keep the light; the others are as they are."""
    cosine = torch.tensor([0.1, 0.3, 0.5, 0.7, 1.0]).double()[:, None]
    sigma = torch.tensor([0.0, 10, 20, 30, 45, 60]).double().deg2rad()
    value = directional_albedo(cosine, 1.0, sigma, model=model)
    assert low <= value.min().item()
    assert value.max().item() <= high


def facing_scene() -> list[Tensor]:
    """Directions well above the horizon and away from every kink."""
    normal = F.normalize(torch.tensor([[0.1, 0.2, 1.0], [-0.2, 0.1, 1.0], [0.0, -0.3, 1.0]]).double(), dim=1)
    light = F.normalize(torch.tensor([[0.5, 0.1, 1.0], [0.4, 0.5, 0.9], [-0.6, 0.3, 0.8]]).double(), dim=1)
    view = F.normalize(torch.tensor([[0.4, -0.1, 1.3], [0.2, 0.1, 1.0], [0.3, -0.2, 1.0]]).double(), dim=1)
    albedo, roughness = torch.tensor([[[0.3], [0.6], [0.9]], [[0.2], [0.5], [0.9]]]).double()
    return [normal, light, view, albedo, roughness]


@pytest.mark.parametrize("model", ALL)
def test_gradients_of_every_argument(model: str) -> None:
    inputs = [t.requires_grad_() for t in facing_scene()]
    assert gradcheck(lambda *a: oren_nayar(*a, model=model), inputs)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.bfloat16, torch.float16])
@pytest.mark.parametrize("model", ALL)
@pytest.mark.slow
def test_values_and_gradients_are_finite_where_others_fail(model: str, dtype: torch.dtype) -> None:
    tiny = 1e-3
    side, low = torch.tensor([1.0, 0, 0]), F.normalize(torch.tensor([1.0, 0, tiny]), dim=0)
    slanted = F.normalize(torch.tensor([0.3, 0.2, 1.0]), dim=0)
    to_light = torch.stack((UP, side, low, slanted, -UP)).repeat_interleave(5, 0)
    to_camera = torch.stack((UP, side, low, -low, slanted)).repeat(5, 1)
    light, view = (t[:, None, None].to(dtype).requires_grad_() for t in (to_light, to_camera))
    normal = UP.expand(25, 1, 1, 3).clone().to(dtype).requires_grad_()
    sigma = torch.tensor([0.0, 1e-8, 0.5, math.pi / 2]).reshape(-1, 1, 1).to(dtype).clamp(max=1.57).requires_grad_()
    rho = torch.tensor([0.0, 0.5, 1.0, 1.5]).reshape(-1, 1).to(dtype)[None, None].requires_grad_()
    value = oren_nayar(normal, light, view, rho.transpose(-1, -2), sigma, model=model, dim=-1)
    assert value.dtype == dtype
    assert value.isfinite().all()
    value.float().sum().backward()
    for leaf in (normal, light, view, sigma, rho):
        assert leaf.grad is not None
        assert leaf.grad.isfinite().all()


@pytest.mark.parametrize("model", ALL)
@pytest.mark.parametrize("broken", [float("nan"), float("inf"), 0.0])
def test_broken_normals_shade_to_zero_and_reach_no_gradient(model: str, broken: float) -> None:
    normal = UP.reshape(1, 3, 1, 1).repeat(1, 1, 2, 2)
    normal[..., 0, 0] = broken
    normal.requires_grad_()
    light = torch.tensor([0.0, 0.6, 0.8]).reshape(1, 3, 1, 1).requires_grad_()
    sigma = torch.tensor(0.4, requires_grad=True)
    value = oren_nayar(normal, light, UP.reshape(1, 3, 1, 1), 0.8, sigma, model=model)
    value.sum().backward()
    assert value[..., 0, 0].item() == 0
    assert (value.flatten()[1:] > 0).all()
    assert normal.grad is not None
    assert (normal.grad[..., 0, 0] == 0).all()
    assert light.grad is not None
    assert light.grad.isfinite().all()


@pytest.mark.parametrize("model", ALL)
def test_facing_away_is_zero_with_zero_gradients(model: str) -> None:
    light, view = (torch.tensor([v]).double().requires_grad_() for v in ([0.6, 0, -0.8], [0.0, 0, 1]))
    normal = UP[None].double().requires_grad_()
    sigma = torch.tensor(0.4).double().requires_grad_()
    for first, second in ((light, view), (view, light)):
        value = oren_nayar(normal, first, second, 0.5, sigma, model=model)
        assert value.item() == 0
        assert all((g == 0).all() for g in torch.autograd.grad(value, (normal, light, view, sigma)))


def test_half_precision_is_computed_in_float32() -> None:
    scene = random_scene(torch.float32)
    half = [t.half() for t in scene]
    wanted = oren_nayar(*(t.float() for t in half), model="vcavity")
    assert torch.equal(oren_nayar(*half, model="vcavity"), wanted.half())


def test_any_axis_and_broadcasting_agree() -> None:
    normal, light, view, albedo, roughness = random_scene()
    image = oren_nayar(normal, light, view, albedo, roughness)
    last = [t.movedim(1, -1) for t in (normal, light, view, albedo, roughness)]
    assert torch.allclose(oren_nayar(*last, dim=-1).movedim(-1, 1), image, rtol=0, atol=1e-15)
    assert oren_nayar(unit(7, 3), UP.double(), UP.double(), 0.5, 0.3, dim=-1).shape == (7, 1)


def test_irradiance_scales() -> None:
    normal, light, view, albedo, roughness = random_scene()
    colour = torch.tensor([1.0, 2.0, 3.0]).double().reshape(1, 3, 1, 1)
    once = oren_nayar(normal, light, view, albedo, roughness)
    assert torch.allclose(oren_nayar(normal, light, view, albedo, roughness, irradiance=colour), once * colour)


def test_layer_accepts_every_layout_of_lights() -> None:
    normal = unit(2, 3, 4, 5, seed=1)
    lights = unit(2, 7, 3, dim=2, seed=2)
    layer = OrenNayar("vcavity")
    several = layer(normal, lights, albedo=torch.rand(2, 3).double(), roughness=torch.rand(2, 1).double())
    assert several.shape == (2, 7, 3, 4, 5)
    albedo, roughness = torch.rand(2, 3, 4, 5).double(), torch.rand(2, 1, 4, 5).double()
    several = layer(normal, lights, albedo=albedo, roughness=roughness)
    for k in range(7):
        assert torch.allclose(layer(normal, lights[:, k], albedo=albedo, roughness=roughness), several[:, k])
    maps = lights[:, 0, :, None, None].expand(2, 3, 4, 5)
    assert torch.allclose(layer(normal, maps, albedo=albedo, roughness=roughness), several[:, 0])
    maps = lights[..., None, None].expand(2, 7, 3, 4, 5)
    power = torch.rand(2, 7, 3).double()
    coloured = layer(normal, maps, albedo=albedo, roughness=roughness, irradiance=power)
    assert torch.allclose(coloured, several * power[..., None, None])


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.bfloat16, torch.float16])
def test_layer_normalises_on_request(dtype: torch.dtype) -> None:
    normal, lights = unit(2, 3, 4, 5, seed=1), unit(2, 7, 3, dim=2, seed=2)
    view = F.normalize(torch.tensor([0.2, -0.1, 1.0]).double(), dim=0)
    wanted = OrenNayar("vcavity")(normal, lights, view.to(dtype).double(), roughness=0.4)
    length = 0.1 + 3 * torch.rand(2, 1, 4, 5, generator=torch.Generator().manual_seed(0)).double()
    scaled, brighter = (normal * length).to(dtype), (lights * 5).to(dtype)
    scaled[0, :, 0, 0], scaled[1, :, 0, 0] = 0, torch.nan
    scaled.requires_grad_()
    found = OrenNayar("vcavity", normalise=True)(scaled, brighter, 3 * view.to(dtype), roughness=0.4)
    assert found.dtype == dtype
    assert (found[..., 0, 0] == 0).all()
    error = (found - wanted).abs()[..., 1:]
    assert error.max() <= 8 * torch.finfo(dtype).eps
    (slopes,) = torch.autograd.grad(found.sum(), scaled)
    assert slopes.isfinite().all()
    assert (slopes[..., 0, 0] == 0).all()
    assert slopes.abs().max() > 0


def test_gradients_through_normalising() -> None:
    layer = OrenNayar("vcavity", dim=-1, normalise=True)
    normal, light, view, albedo, roughness = facing_scene()
    leaves = [(k * t).detach().requires_grad_() for k, t in ((2.0, normal), (0.5, light), (1.0, view))]
    assert gradcheck(lambda *d: layer(d[0], d[1], d[2], albedo, roughness), leaves)


def test_layer_defaults_are_a_white_smooth_surface_seen_orthographically() -> None:
    normal = F.normalize(torch.tensor([[0.3, 0.0, 1.0]]), dim=1).reshape(1, 3, 1, 1)
    assert torch.allclose(OrenNayar()(normal, UP[None]), normal[:, 2:])
    points = unit(6, 3)
    assert OrenNayar(dim=-1)(points, UP.double()).shape == (6, 1)


def test_learnable_parameters_receive_gradients_through_the_layer() -> None:
    normal = unit(1, 3, 8, 8, seed=3).float()
    sigma = torch.tensor(0.3, requires_grad=True)
    albedo = torch.full((1, 3), 0.5, requires_grad=True)
    OrenNayar("vcavity")(normal, UP[None], albedo=albedo, roughness=sigma).sum().backward()
    assert sigma.grad is not None
    assert sigma.grad.abs() > 0
    assert albedo.grad is not None
    assert (albedo.grad > 0).all()


def test_vmap() -> None:
    scene = facing_scene()
    batched = torch.func.vmap(lambda *a: oren_nayar(*(t[None] for t in a))[0])(*scene)
    assert torch.allclose(batched, oren_nayar(*scene))


@pytest.mark.parametrize("model", CLOSED)
@pytest.mark.slow
def test_function_transforms_agree_with_autograd(model: str) -> None:
    """jacrev, jacfwd, vmap of grad, and the vectorised Jacobian of autograd."""
    scene = facing_scene()

    def shade(*a: Tensor) -> Tensor:
        return oren_nayar(*a, model=model)

    wanted = torch.autograd.functional.jacobian(shade, tuple(scene))
    every = tuple(range(5))
    for found in (
        torch.func.jacrev(shade, every)(*scene),
        torch.func.jacfwd(shade, every)(*scene),
        torch.autograd.functional.jacobian(shade, tuple(scene), vectorize=True),
    ):
        for a, b in zip(found, wanted, strict=True):
            assert torch.allclose(a, b, rtol=1e-9, atol=1e-12)
    one_pixel = torch.func.grad(lambda *a: shade(*(t[None] for t in a)).sum(), every)
    compiled = torch.compile(torch.func.vmap(one_pixel), fullgraph=True, backend="aot_eager")
    for transform in (torch.func.vmap(one_pixel), compiled):
        for k, slopes in enumerate(transform(*scene)):
            assert torch.allclose(slopes, wanted[k].sum((0, 1)), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("model", CLOSED)
def test_hessians_agree_between_transforms_and_autograd(model: str) -> None:
    scene = facing_scene()

    def total(normal: Tensor, sigma: Tensor) -> Tensor:
        return oren_nayar(normal, scene[1], scene[2], scene[3], sigma, model=model).square().sum()

    wanted = torch.autograd.functional.hessian(total, (scene[0], scene[4]))
    found = torch.func.hessian(total, (0, 1))(scene[0], scene[4])
    for row, other in zip(found, wanted, strict=True):
        for a, b in zip(row, other, strict=True):
            assert torch.allclose(a, b, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("model", CLOSED)
@pytest.mark.slow
def test_second_derivatives_and_forward_mode(model: str) -> None:
    inputs = [t.requires_grad_() for t in facing_scene()]
    assert torch.autograd.gradgradcheck(lambda *a: oren_nayar(*a, model=model), inputs)
    assert gradcheck(lambda *a: oren_nayar(*a, model=model), inputs, check_forward_ad=True, check_backward_ad=False)


@pytest.mark.parametrize("model", CLOSED)
@pytest.mark.slow
def test_compiles_in_one_graph_with_gradients(model: str) -> None:
    """A background of NaN too: checks are off inside a graph, and it must still reach no gradient."""
    layer = OrenNayar(model)
    compiled = torch.compile(layer, fullgraph=True, backend="aot_eager", dynamic=True)
    for size in (5, 9):
        normal = unit(1, 3, size, size, seed=3).float()
        normal[..., 0, 0] = 0
        albedo = torch.full((1, 1, size, size), 0.5)
        sigmas = [torch.tensor(0.4, requires_grad=True) for _ in range(2)]
        wanted = layer(normal, UP[None], albedo=albedo, roughness=sigmas[0])
        albedo = albedo.index_put((torch.tensor(0),) * 4, torch.tensor(torch.nan))
        found = compiled(normal, UP[None], albedo=albedo, roughness=sigmas[1])
        wanted.sum().backward()
        found.sum().backward()
        assert torch.allclose(found, wanted, atol=1e-6)
        assert sigmas[0].grad is not None
        assert sigmas[1].grad is not None
        assert torch.allclose(sigmas[1].grad, sigmas[0].grad, rtol=1e-4)


@pytest.mark.parametrize("model", ["qualitative", "vcavity", "eon"])
@pytest.mark.slow
def test_compiled_gradients_of_every_argument_at_any_batch_and_size(model: str) -> None:
    def shade(*a: Tensor) -> Tensor:
        return oren_nayar(*a[:5], irradiance=a[5], model=model)

    compiled = torch.compile(shade, fullgraph=True, backend="aot_eager", dynamic=True)
    for batch, height, width in ((2, 4, 5), (3, 7, 4), (1, 1, 6)):
        generator = torch.Generator().manual_seed(batch)
        scene = [unit(batch, 3, height, width, seed=1), unit(batch, 3, 1, 1, seed=2), unit(1, 3, height, width, seed=3)]
        scene += [torch.rand(batch, n, height, width, generator=generator).double() for n in (3, 1)]
        scene += [torch.rand(batch, 3, 1, 1, generator=generator).double()]
        leaves = [t.requires_grad_() for t in scene]
        wanted, found = shade(*leaves), compiled(*leaves)
        assert torch.allclose(found, wanted, rtol=1e-10, atol=1e-12)
        slopes = (torch.autograd.grad(value, leaves, torch.ones_like(value)) for value in (found, wanted))
        for a, b in zip(*slopes, strict=True):
            assert torch.allclose(a, b, rtol=1e-9, atol=1e-10)


@pytest.mark.slow
def test_torch_export() -> None:
    normal, light = unit(2, 3, 4, 5).float(), unit(2, 3).float()
    program = torch.export.export(OrenNayar("vcavity"), (normal, light), {"roughness": torch.tensor(0.4)})
    found = program.module()(normal, light, roughness=torch.tensor(0.4))
    assert torch.allclose(found, OrenNayar("vcavity")(normal, light, roughness=0.4), atol=1e-6)


def test_torch_export_with_dynamic_batch_and_size() -> None:
    batch, height, width = (torch.export.Dim(name, min=2) for name in ("batch", "height", "width"))
    image = {0: batch, 2: height, 3: width}
    shapes = {"normal": image, "light": {0: batch}, "albedo": image, "roughness": None}
    example = {
        "normal": unit(3, 3, 4, 5).float(),
        "light": unit(3, 3).float(),
        "albedo": torch.rand(3, 3, 4, 5),
        "roughness": torch.tensor(0.4),
    }
    program = torch.export.export(OrenNayar("vcavity"), (), example, dynamic_shapes=shapes)
    other = example | {
        "normal": unit(2, 3, 7, 6).float(),
        "light": unit(2, 3).float(),
        "albedo": torch.rand(2, 3, 7, 6),
    }
    assert torch.allclose(program.module()(**other), OrenNayar("vcavity")(**other), atol=1e-6)


def test_strides_do_not_matter() -> None:
    normal, light, view, albedo, roughness = random_scene()
    plain = oren_nayar(normal, light, view, albedo, roughness)
    assert torch.equal(
        oren_nayar(normal.contiguous(memory_format=torch.channels_last), light, view, albedo, roughness), plain
    )
    assert torch.equal(oren_nayar(normal, light.expand(2, 3, 4, 5), view.expand(2, 3, 4, 5), albedo, roughness), plain)


@pytest.mark.parametrize("shape", [(0, 3, 4, 5), (1, 3, 1, 5), (1, 3, 5, 1), (1, 3, 1, 1), (2, 3, 0, 4)])
def test_thin_and_empty_pictures_have_gradients(shape: tuple[int, ...]) -> None:
    normal = F.normalize(torch.rand(shape, generator=torch.Generator().manual_seed(0)), dim=1).requires_grad_()
    sigma, light = torch.tensor(0.4, requires_grad=True), UP.reshape(1, 3, 1, 1).clone().requires_grad_()
    value = oren_nayar(normal, light, UP.reshape(1, 3, 1, 1), 0.5, sigma, model="vcavity")
    assert value.shape == (shape[0], 1, *shape[2:])
    value.sum().backward()
    for leaf in (normal, light, sigma):
        assert leaf.grad is not None
        assert leaf.grad.shape == leaf.shape
        assert leaf.grad.isfinite().all()
    assert (sigma.grad != 0) == (value.numel() > 0)


def test_gradients_do_not_depend_on_strides() -> None:
    scene = random_scene()
    leaves = [t.clone().requires_grad_() for t in scene]
    wanted = torch.autograd.grad(oren_nayar(*leaves, model="vcavity").sum(), leaves)
    last = [t.contiguous(memory_format=torch.channels_last).requires_grad_() for t in scene]
    found = torch.autograd.grad(oren_nayar(*last, model="vcavity").sum(), last)
    for a, b in zip(found, wanted, strict=True):
        assert torch.allclose(a, b, rtol=1e-12, atol=1e-14)
    wide = [t.detach().expand(2, -1, 4, 5).requires_grad_() for t in scene]  # stride 0
    found = torch.autograd.grad(oren_nayar(*wide, model="vcavity").sum(), wide)
    for a, b in zip(found, wanted, strict=True):
        assert torch.allclose(a.sum_to_size(b.shape), b, rtol=1e-10, atol=1e-12)


def test_float16_gradients_saturate() -> None:
    """Both directions just above the horizon, where the true gradient exceeds the format."""
    grazing = torch.tensor([[1.0, 0, 6e-8]])
    for model in ALL:
        light, view = (grazing.half().requires_grad_() for _ in range(2))
        oren_nayar(UP[None].half(), light, view, 0.5, 0.5, model=model).float().sum().backward()
        for leaf in (light, view):
            assert leaf.grad is not None
            assert leaf.grad.isfinite().all()


def test_grazing_values_are_not_floored() -> None:
    """The guard of the cosines must lie far below any cosine that shows."""
    for cosine in (1e-3, 1e-5, 1e-7):
        low = torch.tensor([[math.sqrt(1 - cosine**2), 0, cosine]]).double()
        value = oren_nayar(UP[None].double(), low, low, 0.5, 0.5, model="qualitative").item()
        theta = math.acos(cosine)
        assert value == pytest.approx(oracles.angle_form("qualitative", theta, theta, 0, 0.5, 0.5) * cosine, rel=1e-6)


@pytest.mark.parametrize("model", CLOSED)
def test_directional_albedo_is_differentiable_up_to_the_frontal_view(model: str) -> None:
    cosine = torch.tensor([0.2, 0.7, 1.0], requires_grad=True)
    sigma = torch.tensor(0.4, requires_grad=True)
    directional_albedo(cosine, 0.8, sigma, model=model).sum().backward()
    for leaf in (cosine, sigma):
        assert leaf.grad is not None
        assert leaf.grad.isfinite().all()


def test_empty_batch() -> None:
    assert OrenNayar()(torch.zeros(0, 3, 4, 5), torch.zeros(0, 3), albedo=torch.zeros(0, 3)).shape == (0, 3, 4, 5)


def test_point_light_follows_the_inverse_square() -> None:
    points = torch.randn(1, 3, 4, 4, generator=torch.Generator().manual_seed(0)).double()
    position = torch.tensor([0.5, 0.4, 3.0]).double().reshape(1, 3, 1, 1)
    light, irradiance = point_light(points, position, 2.0)
    offset = position - points
    distance = offset.norm(dim=1, keepdim=True)
    assert torch.allclose(light, offset / distance)
    assert torch.allclose(irradiance, 2 / distance**2)


def test_point_light_at_the_surface_is_dark_with_finite_gradients() -> None:
    points = torch.zeros(1, 3, 1, 2, dtype=torch.float64)
    points[..., 1] = 1
    points.requires_grad_()
    light, irradiance = point_light(points, torch.zeros(1, 3, 1, 1).double(), 1.0)
    (light.sum() + irradiance.sum()).backward()
    assert light[..., 0].abs().sum() == 0
    assert irradiance[..., 0].item() == 0
    assert points.grad is not None
    assert points.grad.isfinite().all()


def test_point_light_beside_background_and_in_half_precision() -> None:
    """Points from a depth map that is infinite outside the mask."""
    points = torch.tensor([0.1, 0.2, -2.0]).reshape(1, 3, 1, 1).repeat(1, 1, 1, 2)
    points[..., 1] = torch.inf
    position = torch.tensor([0.5, 0.4, 1.0]).reshape(1, 3, 1, 1).requires_grad_()
    normal = UP.reshape(1, 3, 1, 1).repeat(1, 1, 1, 2) * torch.tensor([1.0, 0.0])
    light, irradiance = point_light(points, position, 4.0)
    value = oren_nayar(normal, light, UP.reshape(1, 3, 1, 1), 0.8, 0.4, irradiance=irradiance)
    value.sum().backward()
    assert value.flatten()[0] > 0
    assert value.flatten()[1] == 0
    assert position.grad is not None
    assert position.grad.isfinite().all()
    far = torch.tensor([0.0, 0, 300]).half().reshape(1, 3, 1, 1)
    light, irradiance = point_light(torch.zeros(1, 3, 1, 1).half(), far, 6e4)
    assert light.flatten().tolist() == [0, 0, 1]
    assert irradiance.item() == pytest.approx(6e4 / 9e4, rel=1e-3)


def test_point_light_gradients() -> None:
    points = unit(1, 3, 2, 2).requires_grad_()
    position = torch.tensor([0.5, 0.4, 3.0]).double().reshape(1, 3, 1, 1).requires_grad_()
    intensity = torch.tensor(1.5).double().requires_grad_()
    assert gradcheck(point_light, (points, position, intensity))


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"roughness": -0.1}, RangeError, "roughness"),
        ({"roughness": torch.tensor([[[[-0.1]]]])}, RangeError, "roughness"),
        ({"roughness": 30.0}, RangeError, "radians"),
        ({"roughness": float("nan")}, RangeError, "NaN"),
        ({"roughness": torch.full((1, 1, 2, 2), torch.nan)}, RangeError, "NaN"),
        ({"roughness": torch.zeros(1, 3, 1, 1)}, ShapeError, "roughness"),
        ({"albedo": -0.5}, RangeError, "albedo"),
        ({"albedo": float("inf")}, RangeError, "finite"),
        ({"irradiance": float("inf")}, RangeError, "infinite"),
        ({"irradiance": torch.ones(1, 2, 1, 1), "albedo": torch.ones(1, 3, 1, 1)}, ShapeError, "channel"),
        ({"normal": torch.tensor([0, 0, 1]).reshape(1, 3, 1, 1)}, ShapeError, "floating"),
        ({"normal": 2 * UP.reshape(1, 3, 1, 1)}, RangeError, "unit"),
        ({"view": [0, 0, 1]}, ShapeError, "floating"),
        ({"albedo": torch.rand(3)}, ShapeError, "albedo"),
        ({"albedo": torch.rand(1, 3, 5, 5)}, ShapeError, "albedo"),
        ({"light": torch.tensor([1.0, 1, 1]).reshape(1, 3, 1, 1)}, RangeError, "unit"),
        ({"light": torch.zeros(1, 2, 1, 1)}, ShapeError, "light"),
        ({"light": torch.zeros(3)}, ShapeError, "light"),
        ({"normal": torch.zeros(1, 4, 2, 2)}, ShapeError, "normal"),
        ({"model": "orennayar"}, ModelError, "qualitative"),
        ({"irradiance": -1.0}, RangeError, "irradiance"),
        ({"irradiance": torch.ones(1, 1, 3, 3)}, ShapeError, "irradiance"),
        ({"dim": 7}, ShapeError, "dim"),
        ({"dim": None}, ShapeError, "dim"),
        ({"albedo": [0.5, 0.6, 0.7]}, ShapeError, "albedo"),
        ({"roughness": "rough"}, ShapeError, "roughness"),
        ({"albedo": torch.ones(1, 1, 1, 1, dtype=torch.complex64)}, ShapeError, "albedo"),
        ({"albedo": torch.zeros(1, 0, 1, 1)}, ShapeError, "channel"),
        ({"model": ["vcavity"]}, ModelError, "vcavity"),
        ({"normal": np.zeros((1, 3, 2, 2))}, ShapeError, "as_tensor"),
        ({"normal": torch.zeros(1, 3, 2, 2, dtype=torch.uint8)}, ShapeError, "255.*decode_normals"),
        ({"normal": torch.full((1, 3, 2, 2), 0.5)}, RangeError, "decode_normals"),
        ({"albedo": torch.zeros(1, 3, 2, 2, dtype=torch.uint8)}, ShapeError, "255.*srgb_to_linear"),
        ({"light": torch.zeros(1, 3, 1, 1)}, RangeError, "light"),
        ({"view": torch.full((1, 3, 1, 1), torch.nan)}, RangeError, "view"),
    ],
)
def test_bad_input_names_argument_and_mend(change: dict[str, object], error: type[Exception], words: str) -> None:
    up = UP.reshape(1, 3, 1, 1)
    arguments: dict[str, object] = {
        "normal": up.expand(1, 3, 2, 2),
        "light": up,
        "view": up,
        "albedo": 0.5,
        "roughness": 0.3,
    }
    with pytest.raises(error, match=words):
        oren_nayar(**(arguments | change))  # type: ignore[arg-type]


@pytest.mark.parametrize("argument", ["normal", "light", "view"])
def test_large_maps_of_no_unit_vectors_are_refused_and_gaps_are_not(argument: str) -> None:
    maps = {name: unit(1, 3, 200, 300, seed=k).float() for k, name in enumerate(("normal", "light", "view"))}
    maps[argument][..., :150, :] = 0  # background

    def shade(dtype: torch.dtype = torch.float32) -> Tensor:
        return oren_nayar(maps["normal"].to(dtype), maps["light"].to(dtype), maps["view"].to(dtype), 0.5, 0.3)

    shade()
    shade(torch.bfloat16)
    maps[argument] = maps[argument] * 0.9  # as averaging leaves them
    with pytest.raises(RangeError, match=f"{argument}.*unit"):
        shade()


@pytest.mark.parametrize(
    "arguments",
    [
        {"albedo": torch.rand(4, 5)},
        {"albedo": torch.rand(2)},
        {"albedo": torch.rand(3, 3)},
        {"irradiance": torch.rand(7)},
        {"irradiance": torch.rand(2, 7)},
        {"irradiance": torch.rand(2, 6, 1)},
        {"irradiance": torch.rand(2, 4, 4, 5), "albedo": torch.rand(2, 3)},
        {"roughness": torch.rand(2)},
        {"roughness": torch.rand(2, 3)},
        {"light": unit(4, 5, 3, dim=2).float()},
        {"view": unit(3, 3).float()},
    ],
)
def test_layer_does_not_misread_plausible_calls(arguments: dict[str, Tensor]) -> None:
    scene: dict[str, Tensor] = {"normal": unit(2, 3, 4, 5).float(), "light": unit(2, 7, 3, dim=2).float()}
    with pytest.raises(ShapeError):
        OrenNayar()(**(scene | arguments))


@pytest.mark.parametrize("size", [(90, 90), (256, 256), (480, 640), (1080, 1920)])
def test_what_repeats_every_second_pixel_does_not_hide(size: tuple[int, int]) -> None:
    for wrong in (slice(0, None, 2), slice(1, None, 2)):
        normal = UP.reshape(1, 3, 1, 1).repeat(1, 1, *size)
        normal[..., wrong] *= 0.5
        with pytest.raises(RangeError, match="normal"):
            oren_nayar(normal, *(UP.reshape(1, 3, 1, 1),) * 2, 0.5, 0.3)


@pytest.mark.parametrize("normalise", [False, True])
def test_layer_refuses_lights_that_point_nowhere(normalise: bool) -> None:
    normal = unit(2, 3, 4, 5).float()
    for light in (torch.zeros(2, 3), torch.full((3,), torch.nan), torch.tensor([[[0.0, 0, 1]], [[0.0, 0, 0]]])):
        with pytest.raises(RangeError, match="light"):
            OrenNayar(normalise=normalise)(normal, light)


def test_layer_normalises_any_length() -> None:
    normal, light = unit(2, 3, 4, 5).float(), unit(2, 3).float()
    wanted = OrenNayar("vcavity")(normal, light, roughness=0.4)
    found = OrenNayar("vcavity", normalise=True)(normal * 1e-25, light * 1e25, roughness=0.4)
    assert torch.allclose(found, wanted, atol=1e-6)


def test_layer_refuses_layouts_it_does_not_know() -> None:
    normal = unit(2, 3, 4, 5).float()
    with pytest.raises(ShapeError, match="dim"):
        OrenNayar()(normal.movedim(1, -1), UP[None])
    with pytest.raises(ShapeError, match="albedo"):
        OrenNayar()(normal, UP[None], albedo=torch.rand(2, 4, 5))
    with pytest.raises(ModelError, match="vcavity"):
        OrenNayar("lambertian")


def test_the_mends_of_wrong_layouts_mend_them() -> None:
    """What a beginner tries first: no batch axis, several lights as (K, 3), lists, arguments in another order."""
    normal, lights = UP.reshape(3, 1, 1).expand(3, 4, 5), unit(6, 3).float()
    layer = OrenNayar("vcavity")
    with pytest.raises(ShapeError, match=r"normal\[None\]"):
        layer(normal, UP)
    assert layer(normal[None], UP).shape == (1, 1, 4, 5)
    with pytest.raises(ShapeError, match=r"light\[None\]"):
        layer(normal[None], lights)
    assert layer(normal[None], lights[None]).shape == (1, 6, 1, 4, 5)
    for wrong in ([0.0, 0.0, 1.0], np.zeros(3)):
        with pytest.raises(ShapeError, match=r"light.*as_tensor"):
            layer(normal[None], wrong)  # type: ignore[arg-type]
    with pytest.raises(ShapeError, match="view"):
        layer(normal[None], UP, 0.5, 0.3)  # type: ignore[arg-type]
