from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor
from torch.autograd import gradcheck

from torch_orennayar import RangeError, blinn_phong, microfacet, phong

LOBES = {
    "phong": lambda ci, co, lv: phong(ci, co, lv, 20.0),
    "blinn_phong": lambda ci, co, lv: blinn_phong(ci, co, lv, 60.0),
    "microfacet": lambda ci, co, lv: microfacet(ci, co, lv, 0.3, 1.0),
}
unit = st.floats(-1, 1)


def vectors(z: float, phi: float) -> Tensor:
    r = math.sqrt(1 - z * z)
    return torch.tensor([r * math.cos(phi), r * math.sin(phi), z], dtype=torch.float64)


@given(zi=unit, zo=unit, phi=st.floats(0, math.pi))
def test_lobes_are_the_textbook_vector_formulas(zi: float, zo: float, phi: float) -> None:
    l, v = vectors(zi, 0.0), vectors(zo, phi)  # noqa: E741
    ci, co, lv = l[2], v[2], l @ v
    lit = 1.0 if zi > 0 and zo > 0 else 0.0
    mirror = torch.tensor([0.0, 0.0, 2.0], dtype=torch.float64) * zi - l
    assert phong(ci, co, lv, 20.0).item() == pytest.approx(lit * 11 * max(0.0, float(mirror @ v)) ** 20, abs=1e-9)
    if (l + v).norm() < 1e-2:
        return
    half = (l + v) / (l + v).norm()
    assert blinn_phong(ci, co, lv, 60.0).item() == pytest.approx(
        lit * 8.5 * max(0.0, half[2].item()) ** 60, rel=1e-6, abs=1e-9
    )
    if lit and min(zi, zo) > 1e-3:
        alpha, f0 = 0.3, 0.1
        nh, lh = half[2].item(), float(l @ half)
        d = alpha**2 / (math.pi * (nh**2 * (alpha**2 - 1) + 1) ** 2)
        smith = [(math.sqrt(1 + alpha**2 * (1 - z * z) / (z * z)) - 1) / 2 for z in (zi, zo)]
        fresnel = f0 + (1 - f0) * (1 - lh) ** 5
        wanted = math.pi * d * fresnel / (1 + sum(smith)) / (4 * zi * zo)
        assert microfacet(ci, co, lv, alpha, f0).item() == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize("name", LOBES)
@pytest.mark.parametrize("co", [0.05, 0.4, 0.9, 1.0])
def test_lobes_do_not_make_energy(name: str, co: float) -> None:
    draw = torch.Generator().manual_seed(0)
    ci, phi = (torch.rand(400_000, generator=draw, dtype=torch.float64) for _ in range(2))
    ci = ci.sqrt()  # cosine-weighted: the mean of pi f_r is the directional albedo
    view = torch.tensor(co, dtype=torch.float64)
    lv = ci * co + ((1 - ci * ci) * (1 - co * co)).sqrt() * (2 * math.pi * phi).cos()
    # Blinn's usual factor is a fit that exceeds the exact one slightly.
    assert LOBES[name](ci, view, lv).mean().item() <= 1.03


@pytest.mark.parametrize("name", LOBES)
def test_lobes_are_reciprocal_and_differentiable(name: str) -> None:
    ci, co, lv = (torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (0.8, 0.55, 0.3))
    assert LOBES[name](ci, co, lv).item() == pytest.approx(LOBES[name](co, ci, lv).item(), rel=1e-12)
    assert gradcheck(LOBES[name], (ci, co, lv))


@pytest.mark.parametrize("name", LOBES)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("scene", [(1, 1, 1), (0, 0, -1), (0, 0, 1), (1e-6, 1e-6, -1), (0.5, 0.5, -0.5), (-1, 1, -1)])
def test_values_and_gradients_are_finite_everywhere(
    name: str, dtype: torch.dtype, scene: tuple[float, float, float]
) -> None:
    leaves = [torch.tensor(float(s), dtype=dtype, requires_grad=True) for s in scene]
    value = LOBES[name](*leaves)
    value.backward()
    assert value.isfinite()
    assert value.item() >= 0
    for leaf in leaves:
        assert leaf.grad is not None
        assert leaf.grad.isfinite()


def test_parameters_are_checked() -> None:
    one = torch.tensor(1.0)
    with pytest.raises(RangeError, match="exponent"):
        phong(one, one, one, 0.0)
    with pytest.raises(RangeError, match="exponent"):
        blinn_phong(one, one, one, -1.0)
    with pytest.raises(RangeError, match="width"):
        microfacet(one, one, one, 0.0)
    with pytest.raises(RangeError, match="reflectance"):
        microfacet(one, one, one, 0.5, 2.0)
