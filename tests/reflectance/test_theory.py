from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.autograd import gradcheck

from tests.support import oracles
from torch_orennayar import directional_albedo, oren_nayar
from torch_orennayar.reflectance.theory import reflectance_by_bounces, theory


def exact(*values: float) -> list[Tensor]:
    return [torch.tensor([v], dtype=torch.float64) for v in values]


def cosines(ti: float, to: float, dphi: float) -> tuple[float, float, float]:
    ci, co = math.cos(ti), math.cos(to)
    return ci, co, ci * co + math.sin(ti) * math.sin(to) * math.cos(dphi)


def cases(count: int, seed: int) -> list[tuple[float, ...]]:
    """ti, to, dphi, rho, sigma."""
    draw = np.random.default_rng(seed)
    thetas = np.arccos(np.sqrt(draw.uniform(0.005, 1, (2, count))))
    ranges = ((0.0, math.pi), (0.0, 1.0), (0.05, 1.2))
    return list(zip(*thetas, *(draw.uniform(low, high, count) for low, high in ranges), strict=True))


@pytest.mark.parametrize("case", cases(6, 1))
def test_two_bounces_are_the_papers_integrals(case: tuple[float, ...]) -> None:
    ti, to, dphi, rho, sigma = case
    first, second = oracles.vcavity_two_bounces(ti, to, dphi, sigma, nodes=240)
    ci, co, lv, spread, albedo = exact(*cosines(ti, to, dphi), sigma, rho)
    found = reflectance_by_bounces(ci, co, lv, spread, albedo[:, None])[0, 0]
    assert found[0].item() * math.cos(ti) == pytest.approx(first * math.cos(ti), abs=1e-3)
    assert found[1].item() * math.cos(ti) == pytest.approx(rho * second * math.cos(ti), abs=1e-3)


@pytest.mark.parametrize(("case", "seed"), [(c, i) for i, c in enumerate(cases(10, 2))])
@pytest.mark.slow
def test_all_bounces_are_the_ray_tracers(case: tuple[float, ...], seed: int) -> None:
    ti, to, dphi, rho, sigma = case
    traced, noise = oracles.vcavity_traced(ti, to, dphi, rho, sigma, count=100_000, seed=seed)
    found = theory(*exact(*cosines(ti, to, dphi), rho, sigma)).item() / rho * math.cos(ti)
    assert abs(found - traced) <= 4 * noise + 5e-4


@pytest.mark.slow
def test_white_grooves_lose_no_light() -> None:
    cosine = torch.tensor([0.15, 0.5, 1.0], dtype=torch.float64)
    albedo = directional_albedo(cosine, 1.0, torch.tensor(0.9, dtype=torch.float64), model="theory")
    assert torch.allclose(albedo, torch.ones(3, dtype=torch.float64), atol=2e-3)


def test_gradients_are_those_of_the_quadrature() -> None:
    arguments = exact(*cosines(0.9, 0.5, 1.1), 0.6, 0.5)
    assert gradcheck(theory, [a.requires_grad_() for a in arguments], eps=1e-7, atol=1e-4)


@pytest.mark.parametrize("geometry", ["all aligned", "light at the normal", "mirror", "retro", "horizon"])
def test_gradients_are_finite_where_azimuths_are_not_defined(geometry: str) -> None:
    up = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
    aside = torch.tensor([[0.6, 0.0, 0.8]], dtype=torch.float64)
    low = torch.tensor([[1.0, 0.0, 1e-9]], dtype=torch.float64)
    light, view = {
        "all aligned": (up, up),
        "light at the normal": (up, aside),
        "mirror": (aside * torch.tensor([-1.0, 1, 1]), aside),
        "retro": (aside, aside),
        "horizon": (low, low),
    }[geometry]
    sigma = torch.tensor([[0.4]], dtype=torch.float64)
    leaves = [t.clone().requires_grad_() for t in (up, light, view, torch.tensor([[0.8]]).double(), sigma)]
    value = oren_nayar(*leaves, model="theory")
    value.sum().backward()
    assert value.isfinite().all()
    for leaf in leaves:
        assert leaf.grad is not None
        assert leaf.grad.isfinite().all()


def test_half_precision_and_empty_batches_work() -> None:
    normal = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float16)
    assert oren_nayar(normal, normal, normal, 0.5, 0.4, model="theory").dtype == torch.float16
    assert oren_nayar(normal[:0], normal, normal, 0.5, 0.4, model="theory").shape == (0, 1)


@pytest.mark.slow
def test_reference_by_quadrature_and_by_ray_tracing(data: Path) -> None:
    table = {k: torch.from_numpy(v).double() for k, v in np.load(data / "theory" / "vcavity_reference.npz").items()}
    rows = torch.randperm(len(table["sigma"]), generator=torch.Generator().manual_seed(0))[:3000]
    t = {k: v[rows] for k, v in table.items()}
    ci, co = t["theta_i"].cos(), t["theta_o"].cos()
    lv = ci * co + t["theta_i"].sin() * t["theta_o"].sin() * t["phi"].cos()
    found = reflectance_by_bounces(ci, co, lv, t["sigma"], t["rho"][:, None])[:, 0] * ci[:, None]
    for value, name in ((found[:, 0], "radiance_direct"), (found[:, :2].sum(1), "radiance_2bounce")):
        assert (value - t[name]).square().mean().sqrt().item() <= 5e-5
        assert (value - t[name]).abs().max().item() <= 1e-3
    score = (found.sum(1) - t["mc_allbounce"]) / t["mc_stderr_allbounce"].clamp_min(1e-4)
    assert score.mean().abs().item() <= 0.08
    assert 0.7 <= score.std().item() <= 1.1
