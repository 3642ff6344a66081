from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from tests.support import oracles
from torch_orennayar import (
    MODELS,
    ModelError,
    OrenNayar,
    directional_albedo,
    export_onnx,
    register_model,
    roughness_from_slope,
    slope_from_roughness,
)
from torch_orennayar.reflectance import formulas
from torch_orennayar.reflectance.models import unregister_model

ALL = sorted(MODELS)
angle = st.floats(1e-3, math.pi / 2 - 1e-3)
azimuth = st.floats(-math.pi, math.pi)
roughness = st.floats(0, math.pi / 2)
albedo = st.floats(0, 1)


def exact(value: object) -> torch.Tensor:
    return torch.tensor(value, dtype=torch.float64)


def evaluate(model: str, ti: float, to: float, dphi: float, rho: float, sigma: float) -> float:
    l, v = (oracles.directions(*exact(a)) for a in ((ti, 0.3), (to, 0.3 + dphi)))  # noqa: E741
    arguments = (
        l[2],
        v[2],
        (l * v).sum(),
        exact(rho),
        exact(sigma),
    )
    return MODELS[model].function(*arguments).item()


def test_models_of_the_contract_in_order() -> None:
    assert list(MODELS)[:7] == ["lambert", "qualitative", "qualitative-0.57", "fujii", "full", "vcavity", "eon"]
    assert "theory" in MODELS
    with pytest.raises(TypeError):
        MODELS["mine"] = MODELS["lambert"]  # type: ignore[index]


@pytest.mark.parametrize("model", ["lambert", "qualitative", "qualitative-0.57", "fujii", "full"])
@given(ti=angle, to=angle, dphi=azimuth, rho=albedo, sigma=roughness)
def test_dot_form_is_the_textbook_angle_form(
    model: str, ti: float, to: float, dphi: float, rho: float, sigma: float
) -> None:
    wanted = oracles.angle_form(model, ti, to, dphi, rho, sigma)
    # What a pixel sees is pi f_r cos: the reflectance itself grows like 1 / cos at the horizon.
    difference = evaluate(model, ti, to, dphi, rho, sigma) - wanted
    assert abs(difference) * math.cos(ti) <= 1e-12


@given(ti=angle, to=angle, dphi=azimuth, rho=albedo, r=st.floats(0.01, 1))
def test_eon_is_the_published_formula(ti: float, to: float, dphi: float, rho: float, r: float) -> None:
    l, v = (oracles.directions(*exact(a)) for a in ((ti, 0.3), (to, 0.3 + dphi)))  # noqa: E741
    value = formulas.eon_from_r(l[2], v[2], (l * v).sum(), exact(rho), exact(r))
    assert abs(value.item() - oracles.eon_published(ti, to, dphi, rho, r)) * math.cos(ti) <= 1e-12


@pytest.mark.parametrize("degrees", [10, 20, 30, 45, 60])
@pytest.mark.slow
def test_vcavity_follows_the_theory(degrees: int) -> None:
    """A dark surface, where two bounces are the whole theory: 30 directions against the integral."""
    rho, sigma = 0.05, math.radians(degrees)
    generator = torch.Generator().manual_seed(degrees)
    squares, worst = [], 0.0
    for _ in range(30):
        ti, to = (math.acos(math.sqrt(u)) for u in torch.rand(2, generator=generator).clamp(0.01, 0.999).tolist())
        dphi = math.pi * torch.rand(1, generator=generator).item()
        r1, r2 = oracles.vcavity_two_bounces(ti, to, dphi, sigma)
        difference = (evaluate("vcavity", ti, to, dphi, rho, sigma) / rho - (r1 + rho * r2)) * math.cos(ti)
        squares.append(difference**2)
        worst = max(worst, abs(difference))
    # The fit's own RMS is at most .006 in any (sigma, rho); the full 1994 model has .015.
    assert math.sqrt(sum(squares) / len(squares)) <= 0.006
    assert worst <= 0.03


@pytest.mark.slow
def test_vcavity_is_near_all_bounces_and_returns_all_light() -> None:
    """Directions of the test's own; every roughness and albedo beats the full 1994 model."""
    draw = torch.Generator().manual_seed(11)
    ci, co = torch.rand(2, 150, 1, generator=draw, dtype=torch.float64).sqrt().clamp_min(1e-3)
    lv = ci * co + ((1 - ci**2) * (1 - co**2)).sqrt() * (math.pi * torch.rand(150, 1, generator=draw)).cos()
    rho = torch.tensor([0.2, 0.5, 0.9], dtype=torch.float64)
    squares = []
    for degrees in (5, 15, 30, 45, 60):
        sigma = exact(math.radians(degrees))
        truth = MODELS["theory"].function(ci, co, lv, rho, sigma)
        error, other = (
            ((f(ci, co, lv, rho, sigma) - truth) / rho * ci).square().mean(0) for f in (formulas.vcavity, formulas.full)
        )
        assert (error < other).all()
        squares.append(error)
    assert torch.stack(squares).mean().sqrt().item() <= 0.0032
    white = directional_albedo(
        exact([0.05, 0.1, 0.3, 0.7, 1.0])[:, None], 1.0, exact([10, 20, 40, 60]).deg2rad(), model="vcavity"
    )
    assert (white - 1).abs().max().item() <= 0.01


@given(
    depth=st.tuples(st.floats(1e-9, 0.3), st.floats(1e-9, 0.3)),
    dphi=azimuth,
    rho=albedo,
    sigma=st.floats(0, math.pi / 2),
)
def test_vcavity_is_sane_at_the_horizon(depth: tuple[float, float], dphi: float, rho: float, sigma: float) -> None:
    ti, to = (math.acos(d) for d in depth)
    value = evaluate("vcavity", ti, to, dphi, rho, sigma)
    assert 0 <= value * max(depth) <= 1.2 * rho


@pytest.mark.parametrize("model", ALL)
@given(ti=st.floats(0, math.pi / 2 - 1e-3), to=st.floats(0, math.pi / 2 - 1e-3), dphi=azimuth, rho=albedo)
def test_smooth_is_lambert_exactly(model: str, ti: float, to: float, dphi: float, rho: float) -> None:
    assert evaluate(model, ti, to, dphi, rho, 0.0) == pytest.approx(rho, rel=4e-16, abs=0)


@pytest.mark.parametrize("model", ALL)
@given(ti=angle, to=angle, dphi=azimuth, rho=albedo, sigma=roughness)
def test_reciprocity(model: str, ti: float, to: float, dphi: float, rho: float, sigma: float) -> None:
    there, back = (evaluate(model, a, b, d, rho, sigma) for a, b, d in ((ti, to, dphi), (to, ti, -dphi)))
    assert there == pytest.approx(back, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("model", sorted(set(ALL) - {"full"}))
@given(ti=angle, to=angle, dphi=azimuth, rho=albedo, sigma=roughness)
def test_never_negative(model: str, ti: float, to: float, dphi: float, rho: float, sigma: float) -> None:
    assert evaluate(model, ti, to, dphi, rho, sigma) >= 0


def test_full_goes_below_zero_as_little_as_documented() -> None:
    generator = torch.Generator().manual_seed(0)
    theta = torch.rand(2, 20000, generator=generator, dtype=torch.float64) * (math.pi / 2)
    phi = torch.rand(20000, generator=generator, dtype=torch.float64) * math.pi
    ci, co = theta.cos()
    lv = ci * co + theta.sin().prod(0) * phi.cos()
    value = formulas.full(ci, co, lv, torch.tensor(1e-6).double(), torch.tensor(math.radians(60)).double())
    assert -0.02 < (value / 1e-6 * ci).min().item() < -0.01


@pytest.mark.parametrize("model", ALL)
def test_albedo_above_one_scales(model: str) -> None:
    white, brighter = (evaluate(model, 0.7, 0.4, 1.0, rho, 0.6) for rho in (1.0, 3.0))
    assert brighter == pytest.approx(3 * white, rel=1e-12)


@pytest.fixture
def minnaert() -> object:
    register_model("minnaert", lambda ci, co, lv, rho, k: rho * (ci * co) ** k, source="Minnaert 1941")
    yield
    unregister_model("minnaert")


@pytest.mark.usefixtures("minnaert")
@pytest.mark.slow
def test_a_registered_model_works_in_layer_and_export(tmp_path: object) -> None:
    normal = torch.tensor([0.0, 0.6, 0.8]).reshape(1, 3, 1, 1)
    light = torch.tensor([[0.0, 0.0, 1.0]])
    value = OrenNayar("minnaert")(normal, light, albedo=0.5, roughness=0.5)
    assert value.item() == pytest.approx(0.5 * 0.8 * 0.8, rel=1e-6)
    assert export_onnx("shading", f"{tmp_path}/minnaert.onnx", model="minnaert").exists()


@pytest.mark.usefixtures("minnaert")
def test_registering_refuses_taken_names_and_broken_functions() -> None:
    with pytest.raises(ModelError, match="exists"):
        register_model("minnaert", formulas.lambert)
    with pytest.raises(ModelError, match="TypeError"):
        register_model("broken", lambda ci: ci)  # type: ignore[arg-type,misc]
    with pytest.raises(ModelError, match="shape"):
        register_model("broken", lambda ci, co, lv, rho, sigma: rho.sum())
    assert "broken" not in MODELS


@given(value=st.floats(0, 1.5))
def test_slope_and_roughness_are_inverse_and_agree_when_small(value: float) -> None:
    slope = slope_from_roughness(exact(value))
    assert roughness_from_slope(slope).item() == pytest.approx(value, rel=1e-12, abs=1e-15)
    # The difference is a third of the cube: 0.3 % at 0.1 radians.
    small = exact(value * 0.1)
    assert abs(slope_from_roughness(small) - small).item() <= 0.35 * small.item() ** 3 + 1e-15


def test_slope_and_roughness_agree_as_the_shading_of_small_slopes_does() -> None:
    """Facets normal in gradient with sd s shade like facets normal in angle with sd atan(s)."""
    draw = torch.Generator().manual_seed(0)
    for sd in (0.02, 0.05):
        angle = torch.randn(200_000, generator=draw, dtype=torch.float64) * roughness_from_slope(exact(sd))
        gradient = torch.randn(200_000, generator=draw, dtype=torch.float64) * sd
        assert angle.tan().std().item() == pytest.approx(gradient.std().item(), rel=0.01)


def test_reference_of_the_theory(data: object) -> None:
    """RMS over the shared reference, all bounces, sigma 5 to 60 degrees, without its grazing slice and its noise."""
    import numpy as np

    table = {k: torch.from_numpy(v).double() for k, v in np.load(f"{data}/theory/vcavity_reference.npz").items()}
    keep = (table["sigma"] > 0.08) & (table["grazing_slice"] == 0)
    ti, to, phi, rho, sigma, truth = (
        table[k][keep] for k in ("theta_i", "theta_o", "phi", "rho", "sigma", "mc_allbounce")
    )
    ci, co = ti.cos(), to.cos()
    lv = ci * co + ti.sin() * to.sin() * phi.cos()
    error = MODELS["vcavity"].function(ci, co, lv, rho, sigma) / rho * ci - truth
    noise = table["mc_stderr_allbounce"][keep].square().mean()
    assert (error.square().mean() - noise).sqrt().item() <= 0.0030
    assert error.abs().max().item() <= 0.035
    full = MODELS["full"].function(ci, co, lv, rho, sigma) / rho * ci - truth
    for cell in {(s, r) for s, r in zip(sigma.tolist(), rho.tolist(), strict=True)}:
        there = (sigma == cell[0]) & (rho == cell[1])
        assert error[there].square().mean() < full[there].square().mean()


def test_rms_against_two_bounces_is_the_published_one(data: object) -> None:
    """The design's table, within 2 %."""
    import numpy as np

    t = {k: torch.from_numpy(v).double() for k, v in np.load(f"{data}/theory/vcavity_reference.npz").items()}
    t = {k: v[(t["sigma"] > 0.08) & (t["grazing_slice"] == 0)] for k, v in t.items()}
    ci, co = t["theta_i"].cos(), t["theta_o"].cos()
    lv = ci * co + t["theta_i"].sin() * t["theta_o"].sin() * t["phi"].cos()
    for name, wanted in (("qualitative", 0.0456), ("fujii", 0.0157), ("full", 0.0150), ("lambert", 0.152)):
        error = MODELS[name].function(ci, co, lv, t["rho"], t["sigma"]) / t["rho"] * ci - t["radiance_2bounce"]
        assert error.square().mean().sqrt().item() == pytest.approx(wanted, rel=0.02)
