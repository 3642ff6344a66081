from __future__ import annotations

import copy
import json
import math
import pickle

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torch_orennayar import MODELS, ModelError, OrenNayar, RangeError, oren_nayar, register_model, simplest_model
from torch_orennayar.reflectance.model_choice import TABLE
from torch_orennayar.reflectance.models import unregister_model


def test_table_holds_every_model_of_the_package() -> None:
    table = json.loads(TABLE.read_text(encoding="utf-8"))
    assert {"lambert", "qualitative", "qualitative-0.57", "fujii", "full", "vcavity", "eon", "theory"} <= set(
        table["rms"]
    )
    sizes = tuple(len(table[k]) for k in ("roughness_degrees", "albedo", "angle_degrees"))
    assert all(tuple(torch.tensor(t).shape) == sizes for t in table["rms"].values())


def test_smooth_surfaces_need_lambert_and_rough_ones_more() -> None:
    assert simplest_model(roughness=0.0, tolerance=1e-6) == "lambert"
    assert simplest_model(roughness=math.radians(2), tolerance=0.02) == "lambert"
    assert simplest_model(tolerance=0.01) == "vcavity"
    assert simplest_model(roughness=0.5, tolerance=1e-4) == "theory"


@given(
    low=st.floats(0, 0.8),
    more=st.floats(0, 0.7),
    rho=st.floats(0, 1),
    angle=st.floats(0.1, 1.57),
    t=st.floats(1e-3, 0.5),
)
def test_choice_is_the_cheapest_within_tolerance(low: float, more: float, rho: float, angle: float, t: float) -> None:
    choice = simplest_model(roughness=(low, low + more), albedo=rho, angles=angle, tolerance=t)
    assert choice.error <= t
    assert choice.error == choice.candidates[choice]
    assert all(error > t for name, error in choice.candidates.items() if (MODELS[name].cost or 0) < choice.cost)
    # A wider range never errs less, so it never gets by with a cheaper model.
    wider = simplest_model(roughness=(low / 2, low + more), albedo=(rho / 2, rho), angles=angle, tolerance=t)
    assert wider.error >= choice.error or wider != choice
    assert wider.cost >= choice.cost


def test_error_over_a_range_is_measured_error() -> None:
    """Directions of our own, theory by our own call: the table's figure for one cell."""
    draw = torch.Generator().manual_seed(3)
    ci, co = torch.rand(2, 400, generator=draw, dtype=torch.float64).sqrt().clamp_min(1e-3)
    lv = ci * co + ((1 - ci**2) * (1 - co**2)).sqrt() * (math.pi * torch.rand(400, generator=draw)).cos()
    rho, sigma = torch.tensor(0.5).double(), torch.tensor(40.0).double().deg2rad()
    truth = MODELS["theory"].function(ci, co, lv, rho, sigma)
    for name in ("lambert", "qualitative", "fujii", "full", "eon"):
        error = ((MODELS[name].function(ci, co, lv, rho, sigma) - truth) / rho * ci).square().mean().sqrt().item()
        choice = simplest_model(roughness=sigma.item(), albedo=0.5, tolerance=1.0)
        assert choice.candidates[name] == pytest.approx(error, rel=0.15)


def test_choice_says_why_and_what_the_next_one_buys() -> None:
    choice = simplest_model(roughness=(0.0, 0.5), albedo=(0.2, 0.9), tolerance=0.1)
    assert choice in {"qualitative", "qualitative-0.57", "fujii"}
    assert "lambert (" in choice.reason
    assert "next one up" in choice.reason
    assert "0 to 29 degrees" in choice.reason


def test_choice_is_a_string_that_keeps_its_reason() -> None:
    choice = simplest_model(roughness=0.3, tolerance=0.05)
    for again in (pickle.loads(pickle.dumps(choice)), copy.deepcopy(choice)):
        assert again == choice
        assert again.reason == choice.reason
        assert again.candidates == choice.candidates
    up = torch.tensor([[0.0, 0.0, 1.0]])
    assert oren_nayar(up, up, up, 0.5, 0.3, model=choice).shape == (1, 1)
    assert choice.name == choice
    assert type(choice.name) is str


def test_tensors_give_their_range() -> None:
    maps = torch.tensor([[0.1, 0.6], [0.3, 0.2]])
    assert simplest_model(roughness=maps).candidates == simplest_model(roughness=(0.1, maps.max().item())).candidates


def test_layer_chooses_at_construction() -> None:
    layer = OrenNayar("auto", tolerance=0.01)
    assert layer.model == "vcavity"
    assert layer.choice is not None
    assert "vcavity errs by" in layer.choice.reason
    assert OrenNayar("fujii").choice is None
    narrow = OrenNayar(simplest_model(roughness=0.0))
    assert narrow.model == "lambert"


def test_layer_with_a_choice_compiles() -> None:
    layer = OrenNayar(simplest_model(roughness=0.3, tolerance=0.02))
    normal, light = torch.tensor([0.0, 0.6, 0.8]).reshape(1, 3, 1, 1), torch.tensor([[0.0, 0.0, 1.0]])
    compiled = torch.compile(layer, fullgraph=True, backend="aot_eager")
    assert torch.allclose(compiled(normal, light, roughness=0.3), layer(normal, light, roughness=0.3))


def test_registered_models_take_part_if_they_are_measured() -> None:
    register_model("free", lambda ci, co, lv, rho, sigma: rho + 0 * ci, cost=0.1, error=0.004)
    register_model("unknown", lambda ci, co, lv, rho, sigma: rho + 0 * ci)
    try:
        choice = simplest_model(roughness=0.5, tolerance=0.01)
        assert choice == "free"
        assert "unknown" not in choice.candidates
    finally:
        unregister_model("free")
        unregister_model("unknown")


def test_mistakes_are_named() -> None:
    with pytest.raises(RangeError, match="roughness"):
        simplest_model(roughness=3.0)
    with pytest.raises(RangeError, match="low <= high"):
        simplest_model(roughness=(0.5, 0.1))
    with pytest.raises(RangeError, match="pair"):
        simplest_model(albedo=(0.1, 0.2, 0.3))  # type: ignore[arg-type]
    with pytest.raises(RangeError, match="angles"):
        simplest_model(angles=90.0)
    with pytest.raises(RangeError, match="tolerance"):
        simplest_model(tolerance=0.0)
    with pytest.raises(ModelError, match="tolerance: expected at least"):
        simplest_model(roughness=0.5, tolerance=1e-7)
