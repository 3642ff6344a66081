"""Gradients by hand against autograd of the plain formulas and against differences; kinks as they are documented."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest
import torch
import torch.nn.functional as F
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from torch_orennayar import MODELS, ModelError, OrenNayar, directional_albedo, oren_nayar, register_model
from torch_orennayar.reflectance.gradients import Partials
from torch_orennayar.reflectance.models import ModelFunction, unregister_model
from torch_orennayar.reflectance.theory import gauss_legendre, legendre_coefficients
from torch_orennayar.shading import tiled
from torch_orennayar.shading.evaluate import shade_whole
from torch_orennayar.shading.inputs import ShadingInputs

UP = torch.tensor([0.0, 0.0, 1.0]).reshape(1, 3, 1, 1)
BY_HAND = [name for name, model in MODELS.items() if model.derivatives is not None]
angle = st.floats(0.0, math.pi / 2 - 1e-3)


Arguments = tuple[Tensor, Tensor, Tensor, Tensor, Tensor]


def cosines(ti: float, to: float, dphi: float, rho: float, sigma: float) -> Arguments:
    ci, co = math.cos(ti), math.cos(to)
    lv = ci * co + math.sin(ti) * math.sin(to) * math.cos(dphi)
    ci_, co_, lv_, rho_, sigma_ = (torch.tensor(v, dtype=torch.float64) for v in (ci, co, lv, rho, sigma))
    return ci_, co_, lv_, rho_, sigma_


def test_the_models_of_the_bars_have_gradients_by_hand() -> None:
    assert {"lambert", "qualitative", "qualitative-0.57", "fujii", "vcavity"} <= set(BY_HAND)


@pytest.mark.parametrize("name", BY_HAND)
@given(
    ti=angle,
    to=angle,
    dphi=st.floats(0.0, math.pi),
    rho=st.floats(0.0, 1.4),
    sigma=st.floats(0.0, 1.57),
    weight=st.floats(-2, 2),
)
def test_by_hand_is_autograd_of_the_formula(
    name: str, ti: float, to: float, dphi: float, rho: float, sigma: float, weight: float
) -> None:
    model, arguments = MODELS[name], cosines(ti, to, dphi, rho, sigma)
    leaves = [t.clone().requires_grad_() for t in arguments]
    value = model.function(*leaves)
    wanted = torch.autograd.grad(
        value, leaves, torch.tensor(weight, dtype=torch.float64), allow_unused=True, materialize_grads=True
    )
    assert model.derivatives is not None
    found_value, found = model.derivatives(*arguments, torch.tensor(weight, dtype=torch.float64))
    assert found_value.item() == pytest.approx(value.item(), rel=1e-12, abs=1e-14)
    for a, b in zip(found, wanted, strict=True):
        assert (0 if a is None else a.item()) == pytest.approx(b.item(), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("name", BY_HAND)
def test_by_hand_is_the_difference_quotient(name: str) -> None:
    """Central differences of the formula in float64, away from kinks."""
    model, step = MODELS[name], 1e-6
    for arguments in (cosines(0.4, 0.9, 0.7, 0.6, 0.5), cosines(1.2, 0.3, 2.5, 0.9, 1.1)):
        assert model.derivatives is not None
        _, found = model.derivatives(*arguments, torch.ones((), dtype=torch.float64))
        for k in range(5):
            moved = [[t + (step * sign if j == k else 0) for j, t in enumerate(arguments)] for sign in (1, -1)]
            quotient = (model.function(*moved[0]) - model.function(*moved[1])) / (2 * step)
            part = found[k]
            assert (0 if part is None else part.item()) == pytest.approx(quotient.item(), rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("name", ["qualitative", "qualitative-0.57", "fujii"])
def test_kink_at_equal_angles_takes_the_mean_of_both_sides(name: str) -> None:
    function, gradient = MODELS[name].function, MODELS[name].derivatives
    at = cosines(0.8, 0.8, 0.5, 0.7, 0.6)
    sides = []
    for sign in (1, -1):
        leaf = (at[0] + sign * 1e-9).requires_grad_()
        sides.append(torch.autograd.grad(function(leaf, *at[1:]), leaf)[0].item())
    assert abs(sides[0] - sides[1]) > 0.01  # it is a kink
    assert gradient is not None
    found = gradient(*at, torch.ones((), dtype=torch.float64))[1][0]
    assert found is not None
    assert found.item() == pytest.approx(sum(sides) / 2, rel=1e-6)
    leaf = at[0].requires_grad_()
    assert torch.autograd.grad(function(leaf, *at[1:]), leaf)[0].item() == pytest.approx(found.item(), rel=1e-12)


@pytest.mark.parametrize("name", ["qualitative", "qualitative-0.57"])
def test_kink_at_right_angles_takes_the_side_without_the_term(name: str) -> None:
    one = torch.ones((), dtype=torch.float64)
    at = one * 0.8, one * 0.5, one * 0.4, one * 0.7, one * 0.6  # s = 0 exactly
    model = MODELS[name]
    assert model.derivatives is not None
    found = model.derivatives(*at, one)[1]
    leaves = [t.clone().requires_grad_() for t in at]
    by_autograd = torch.autograd.grad(model.function(*leaves), leaves)
    for k in range(3):
        part = found[k]
        assert part is not None
        assert part.item() == 0
        assert by_autograd[k].item() == 0


DIRECTIONS = ("normal", "light", "view")
ARGUMENTS = (*DIRECTIONS, "albedo", "roughness", "irradiance")
LAYOUTS = {
    "maps": ((2, 3, 6, 5), (2, 3, 6, 5), (1, 3, 6, 5), (2, 3, 6, 5), (2, 1, 6, 5), (2, 3, 1, 1)),
    "one light": ((2, 3, 6, 5), (1, 3, 1, 1), (1, 3, 1, 1), (1, 1, 6, 5), (1, 1, 1, 1), (2, 1, 1, 5)),
    "one normal": ((1, 3, 1, 1), (2, 3, 6, 5), (1, 3, 1, 1), (2, 3, 1, 1), (1, 1, 6, 1), (1, 1, 6, 5)),
}


def random_scene(layout: str) -> list[Tensor]:
    """Float64 leaves: most pixels face light and view."""
    draw = torch.Generator().manual_seed(7)
    scene = []
    for name, shape in zip(ARGUMENTS, LAYOUTS[layout], strict=True):
        t = torch.randn(*shape, generator=draw, dtype=torch.float64)
        if name in DIRECTIONS:
            t = F.normalize(t + torch.tensor([0, 0, 1.5]).reshape(1, 3, 1, 1), dim=1)
        else:
            t = t.abs().clamp(max=1.2)
        scene.append(t.requires_grad_())
    return scene


@pytest.mark.parametrize("name", sorted(set(MODELS) - {"theory"}))
@pytest.mark.parametrize("layout", LAYOUTS)
def test_tiles_are_the_whole(name: str, layout: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Many small tiles, with sums over them, against plain operations on whole tensors: values and all gradients."""
    leaves = random_scene(layout)
    whole = shade_whole(MODELS[name], ShadingInputs(*leaves), -3, torch.float64)
    arriving = torch.randn(whole.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    wanted = torch.autograd.grad(whole, leaves, arriving)
    monkeypatch.setattr(tiled, "TILE", 7)
    value = oren_nayar(*leaves[:5], irradiance=leaves[5], model=name)
    found = torch.autograd.grad(value, leaves, arriving)
    assert torch.allclose(value, whole, rtol=1e-12, atol=1e-14)
    for a, b in zip(found, wanted, strict=True):
        assert a.shape == b.shape
        assert torch.allclose(a, b, rtol=1e-9, atol=1e-11)


@given(
    shape=st.lists(st.integers(0, 9), min_size=1, max_size=4),
    limit=st.integers(1, 50),
    data=st.data(),
)
def test_tiles_cover_every_element_once(shape: list[int], limit: int, data: st.DataObject) -> None:
    axis = data.draw(st.integers(-len(shape), -1))
    old, tiled.TILE = tiled.TILE, limit
    try:
        seen = torch.zeros(shape)
        for index in tiled.tile_indices(tuple(shape), axis, torch.device("cpu")):
            seen[index] += 1
            rest = math.prod(n for d, n in enumerate(seen[index].shape) if d - len(shape) != axis)
            assert rest * max(shape[axis], 1) <= max(limit, shape[axis])
    finally:
        tiled.TILE = old
    assert (seen == 1).all()


@pytest.mark.parametrize("model", ["qualitative", "vcavity", "full"])
def test_the_backward_pass_keeps_inputs_alone(model: str) -> None:
    scene = random_scene("one light")[:5]
    kept: list[Tensor] = []

    def keep(t: Tensor) -> Tensor:
        kept.append(t)
        return t

    with torch.autograd.graph.saved_tensors_hooks(keep, lambda t: t):
        oren_nayar(*scene, model=model)
    own = {t.untyped_storage().data_ptr() for t in scene}
    assert len(kept) == 5
    assert {t.untyped_storage().data_ptr() for t in kept} == own


def test_a_nan_that_arrives_at_the_background_stays_there() -> None:
    normal = torch.tensor([0.0, 0.0, 1.0]).reshape(1, 3, 1, 1).repeat(1, 1, 1, 3)
    normal[..., 0] = 0
    leaves = [normal.requires_grad_(), torch.tensor(0.5, requires_grad=True), torch.tensor(0.4, requires_grad=True)]
    value = OrenNayar("vcavity")(leaves[0], torch.tensor([[0.0, 0.6, 0.8]]), albedo=leaves[1], roughness=leaves[2])
    arriving = torch.ones_like(value)
    arriving[..., 0] = torch.nan
    found = torch.autograd.grad(value, leaves, arriving)
    assert all(g.isfinite().all() for g in found)
    assert (found[0][..., 0] == 0).all()
    assert found[2].abs() > 0


def test_a_registered_model_may_bring_its_gradient() -> None:
    def slopes(
        ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor, weight: Tensor
    ) -> tuple[Tensor, Partials]:
        return rho * ci, (weight * rho, None, None, weight * ci, None)

    try:
        register_model("squared", lambda ci, co, lv, rho, sigma: rho * ci, derivatives=slopes)
        scene = random_scene("one light")[:5]
        assert torch.autograd.gradcheck(lambda *a: oren_nayar(*a, model="squared"), scene)
    finally:
        unregister_model("squared")


@pytest.fixture
def odd_models() -> Iterator[None]:
    """Registered models that leave arguments out, so that values are smaller than the scene or constant."""
    formulas: dict[str, ModelFunction] = {
        "albedo alone": lambda ci, co, lv, rho, sigma: rho * 1.0,
        "no albedo": lambda ci, co, lv, rho, sigma: ci * co,
        "constant": lambda ci, co, lv, rho, sigma: torch.full_like(ci + rho, 0.5),
    }
    for name, formula in formulas.items():
        register_model(name, formula)
    yield
    for name in formulas:
        unregister_model(name)


@pytest.mark.usefixtures("odd_models")
@pytest.mark.parametrize("name", ["albedo alone", "no albedo", "constant"])
@pytest.mark.slow
def test_models_may_leave_arguments_out(name: str) -> None:
    scene = random_scene("one light")[:5]
    wide = [*scene[:3], torch.full((1, 3, 1, 1), 0.5, dtype=torch.float64, requires_grad=True), scene[4]]

    def shade(*a: Tensor) -> Tensor:
        return oren_nayar(*a, model=name)

    compiled = torch.compile(shade, fullgraph=True, backend="aot_eager")
    assert shade(*wide).shape == compiled(*wide).shape == (2, 3, 6, 5)
    whole = shade_whole(MODELS[name], ShadingInputs(*wide), -3, torch.float64)
    wanted = torch.autograd.grad(whole.sum(), wide, allow_unused=True, materialize_grads=True)
    for create_graph in (False, True):
        found = torch.autograd.grad(shade(*wide).sum(), wide, create_graph=create_graph)
        for a, b in zip(found, wanted, strict=True):
            assert torch.allclose(a, b, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("model", ["vcavity", "full"])
def test_anomaly_mode_sees_nothing_where_the_background_is_nan(model: str) -> None:
    normal = torch.tensor([0.0, 0.0, 1.0]).reshape(1, 3, 1, 1).repeat(1, 1, 1, 3)
    normal[..., 0] = torch.nan
    normal.requires_grad_()
    with torch.autograd.set_detect_anomaly(True):
        oren_nayar(normal, UP, UP, 0.5, 0.4, model=model).sum().backward()
    assert normal.grad is not None
    assert normal.grad.isfinite().all()


@pytest.mark.parametrize("model", ["vcavity", "full"])
@pytest.mark.slow
def test_nan_irradiance_of_the_background_reaches_no_gradient_where_checks_do_not_look(model: str) -> None:
    normal = UP.repeat(1, 1, 1, 3)
    normal[..., 0] = 0
    irradiance = torch.tensor([torch.nan, 1.0, 2.0]).reshape(1, 1, 1, 3).requires_grad_()
    leaves = [normal.requires_grad_(), torch.tensor(0.4, requires_grad=True), irradiance]

    def shade(n: Tensor, sigma: Tensor, e: Tensor) -> Tensor:
        return oren_nayar(n, UP, UP, 0.5, sigma, model=model, irradiance=e)

    value = torch.compile(shade, fullgraph=True, backend="aot_eager")(*leaves)
    assert value[..., 0] == 0
    assert all(g.isfinite().all() for g in torch.autograd.grad(value.sum(), leaves))


@pytest.mark.parametrize("model", ["lambert", "qualitative", "vcavity", "eon"])
@pytest.mark.slow
def test_an_infinite_direction_is_dark_however_it_is_computed(model: str) -> None:
    normal, light = torch.tensor([[0.6, 0.0, 0.8]]), torch.tensor([[-0.6, 0.0, 0.8]])
    view = torch.tensor([[torch.inf, 0.6, 0.8], [0.0, 0.0, 1.0]])  # a map of which one is bad
    compiled = torch.compile(oren_nayar, fullgraph=True, backend="aot_eager")
    for shade in (oren_nayar, compiled):
        value = shade(normal, light, view, 0.5, 0.4, model=model)
        assert value[0].item() == 0
        assert value[1].item() > 0


def wrong(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor, weight: Tensor) -> tuple[Tensor, Partials]:
    return rho * ci, (7 * weight, None, None, 0 * weight, None)


@pytest.mark.parametrize(
    ("derivatives", "words"),
    [
        (wrong, "ci, albedo"),
        (5, "TypeError"),
        (lambda *a: (a[3] * a[0], (a[5] * a[3], None, None)), "ValueError"),
        (lambda *a: (a[3] * a[0] + 1, (a[5] * a[3], None, None, a[5] * a[0], None)), "the value"),
    ],
)
def test_wrong_derivatives_are_refused_when_they_are_registered(derivatives: object, words: str) -> None:
    with pytest.raises(ModelError, match=words):
        register_model("wrong", lambda ci, co, lv, rho, sigma: rho * ci, derivatives=derivatives)  # type: ignore[arg-type]
    assert "wrong" not in MODELS


def test_inference_mode_leaves_nothing_behind() -> None:
    cosine, sigma = torch.tensor(0.51, dtype=torch.float64), torch.tensor(0.3, dtype=torch.float64, requires_grad=True)
    for cached in (gauss_legendre, legendre_coefficients):
        cached.cache_clear()
    with torch.inference_mode():
        directional_albedo(cosine, 0.8, 0.3)
        oren_nayar(UP.double(), UP.double(), UP.double(), 0.5, 0.3, model="theory")
    directional_albedo(cosine, 0.8, sigma).backward()
    oren_nayar(UP.double(), UP.double(), UP.double(), 0.5, sigma, model="theory").sum().backward()
    assert sigma.grad is not None


def test_a_number_in_a_tensor_may_lie_on_the_processor_beside_maps_elsewhere() -> None:
    normal, light = torch.empty(1, 3, 4, 4, device="meta"), torch.empty(1, 3, 1, 1, device="meta")
    assert oren_nayar(normal, light, light, 0.5, torch.tensor(0.4)).shape == (1, 1, 4, 4)
