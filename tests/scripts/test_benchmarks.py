"""What the benchmarks measure with: copied formulas, the frontier, the fit of materials, random directions."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from scripts.benchmarks import baselines, charts, materials
from scripts.fit import theory_reference
from tests.support import oracles
from torch_orennayar import microfacet, oren_nayar


def scene(ti: float, to: float, dphi: float) -> list[torch.Tensor]:
    light, view = (
        oracles.directions(*(torch.tensor(a, dtype=torch.float64) for a in pair))[None]
        for pair in ((ti, 0.3), (to, 0.3 + dphi))
    )
    return [torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64), light, view]


@given(ti=st.floats(0.01, 1.55), to=st.floats(0.01, 1.55), dphi=st.floats(-3.1, 3.1), sigma=st.floats(0.01, 1.5))
def test_copied_formulas_are_the_classic_one_where_they_are_right(
    ti: float, to: float, dphi: float, sigma: float
) -> None:
    rest = [torch.tensor([[v]], dtype=torch.float64) for v in (0.7, sigma)]
    wanted = oracles.angle_form("qualitative", ti, to, dphi, 0.7, sigma) * math.cos(ti)
    for shade in (baselines.angles, baselines.normalised):
        assert shade(*scene(ti, to, dphi), *rest).item() == pytest.approx(wanted, abs=1e-8)
    # Each of the wrong formulas differs from the classic form by more than rounding somewhere.
    for shade in (baselines.sine_sine, baselines.rising, baselines.doubled):
        off = scene(1.2, 1.1, 0.1)
        right = oren_nayar(*off, *rest)
        assert abs(shade(*off, *rest) - right).item() > 1e-6


def test_copied_formulas_lose_their_gradients_at_the_normal_and_this_package_does_not() -> None:
    up = torch.tensor([[0.0, 0.0, 1.0]])
    for shade, finite in ((baselines.angles, False), (baselines.normalised, False), (oren_nayar, True)):
        normal = up.clone().requires_grad_()
        shade(normal, up, up, torch.tensor([[0.5]]), torch.tensor([[0.4]])).sum().backward()
        assert normal.grad is not None
        assert bool(normal.grad.isfinite().all()) is finite


def test_frontier_holds_what_nothing_beats_in_both() -> None:
    points = {
        "fast": (1.0, 0.5),
        "beaten": (2.0, 0.6),
        "between": (2.0, 0.2),
        "exact": (9.0, 0.01),
        "slow": (10.0, 0.01),
    }
    assert charts.frontier(points) == ["fast", "between", "exact"]


def test_materials_are_fitted_by_the_best_non_negative_mix() -> None:
    pairs = theory_reference.cosine_weighted(500, 0)
    lobe = microfacet(pairs.ci, pairs.co, pairs.lv, 0.3) * pairs.ci
    made = (0.4 * pairs.ci + 0.2 * lobe)[None, :, None]
    diffuse = pairs.ci.expand(1, -1)
    assert materials.remaining_error(made, diffuse, lobe).item() == pytest.approx(0, abs=1e-6)
    # A highlight cannot be taken away: the best mix without it is the diffuse part alone.
    less = (0.4 * pairs.ci - 0.2 * lobe)[None, :, None]
    alone = (1 - (less[0, :, 0] @ pairs.ci) ** 2 / (less.square().sum() * pairs.ci.square().sum())).sqrt()
    assert materials.remaining_error(less, diffuse, lobe).item() == pytest.approx(alone.item(), rel=1e-9)


def test_directions_are_cosine_weighted_within_their_angle() -> None:
    wide, narrow = (
        theory_reference.cosine_weighted(200_000, 0),
        theory_reference.cosine_weighted(1000, 0, math.radians(30)),
    )
    assert wide.ci.mean().item() == pytest.approx(2 / 3, abs=2e-3)
    assert wide.co.mean().item() == pytest.approx(2 / 3, abs=2e-3)
    assert min(narrow.ci.min().item(), narrow.co.min().item()) >= math.cos(math.radians(30)) - 1e-9
