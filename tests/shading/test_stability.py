"""Every row of the stability map for shading: this package's models are right, or refuse; the copied ones fail."""

from __future__ import annotations

import pytest
import torch
import torch.nn.functional as F
from hypothesis import given
from hypothesis import strategies as st

from scripts.benchmarks import baselines, shading_edge_cases
from torch_orennayar import MODELS, OrenNayar, oren_nayar
from torch_orennayar.shading.precision import working_dtype

CASES = {case.name: case for case in shading_edge_cases.edge_cases()}
HALVES = (torch.bfloat16, torch.float16)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.slow
def test_models_are_right_or_refuse(name: str) -> None:
    case = CASES[name]
    for model in MODELS:
        shade = shading_edge_cases.member(model)
        for dtype in shading_edge_cases.FORMATS:
            for verdict in shading_edge_cases.judge(shade, shade, case, dtype):
                assert verdict.kind == ("refused" if case.mistake else "right"), (model, dtype, verdict)


@pytest.mark.parametrize("name", [n for n, case in CASES.items() if not case.mistake])
@pytest.mark.slow
def test_compiled_graphs_are_as_stable(name: str) -> None:
    """Where checks do not look: values and gradients of the compiled layer, bad data included."""
    for model in ("qualitative", "vcavity", "full"):
        compiled = torch.compile(shading_edge_cases.member(model), fullgraph=True, backend="aot_eager")
        for verdict in shading_edge_cases.judge(compiled, shading_edge_cases.member(model), CASES[name], torch.float32):
            assert verdict.kind == "right", (model, verdict)


@pytest.mark.parametrize("copied", ["angles", "normalised", "textbook"])
def test_copied_implementations_are_right_where_usual_and_fail_at_the_normal(copied: str) -> None:
    shade = getattr(baselines, copied)
    truth = shading_edge_cases.member("full" if copied == "textbook" else "qualitative")
    usual = shading_edge_cases.judge(shade, truth, CASES["usual directions"], torch.float64)
    assert [v.kind for v in usual] == ["right", "right"]
    at_normal = shading_edge_cases.judge(shade, truth, CASES["light = view = normal"], torch.float32)
    assert at_normal[1].kind == "not finite"


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.slow
def test_half_precision_is_within_two_units_in_the_last_place(model: str) -> None:
    draw = torch.Generator().manual_seed(4)
    count = 300 if model == "theory" else 20_000
    normal, light, view = (F.normalize(torch.randn(count, 3, generator=draw), dim=1) for _ in range(3))
    albedo, roughness = torch.rand(count, 1, generator=draw), torch.rand(count, 1, generator=draw)
    for dtype in HALVES:
        scene = [t.to(dtype) for t in (normal, light, view, albedo, roughness)]
        exact = oren_nayar(*(t.double() for t in scene), model=model)
        found = oren_nayar(*scene, model=model)
        assert found.dtype == dtype
        info = torch.finfo(dtype)
        unit = torch.exp2(exact.abs().clamp_min(info.tiny).log2().floor()) * info.eps
        assert ((found.double() - exact).abs() / unit).max() <= 2


@given(
    seed=st.integers(0, 2**31),
    shape=st.lists(st.integers(1, 5), min_size=1, max_size=3),
    model=st.sampled_from(sorted(set(MODELS) - {"theory"})),
    dtype=st.sampled_from(shading_edge_cases.FORMATS),
    data=st.data(),
)
def test_any_directions_shapes_strides_and_formats(
    seed: int, shape: list[int], model: str, dtype: torch.dtype, data: st.DataObject
) -> None:
    """Random scenes, some axes broadcast, some tensors transposed or expanded: finite, and right against float64."""
    draw = torch.Generator().manual_seed(seed)

    def tensor(size: int, name: str) -> torch.Tensor:
        axes = [1 if data.draw(st.booleans(), label=f"{name} broadcasts") else n for n in shape]
        whole = torch.randn(*axes, size, generator=draw, dtype=torch.float64)
        whole = F.normalize(whole, dim=-1) if size == 3 else whole.abs().clamp(max=1.5)
        whole = whole.to(dtype)
        layout = data.draw(st.sampled_from(("plain", "transposed", "expanded")), label=f"{name} layout")
        if layout == "transposed":
            return whole.transpose(0, -1).contiguous().transpose(0, -1)
        return whole.expand(*shape, size) if layout == "expanded" else whole

    scene = [tensor(3, "normal"), tensor(3, "light"), tensor(3, "view"), tensor(1, "albedo"), tensor(1, "roughness")]
    leaves = [t.detach().requires_grad_() for t in scene]
    value = oren_nayar(*leaves, model=model, dim=-1)
    exact = [t.detach().double().requires_grad_() for t in scene]
    wanted = oren_nayar(*exact, model=model, dim=-1)
    allowed = shading_edge_cases.ALLOWED[dtype]
    assert torch.allclose(value.double(), wanted, rtol=allowed, atol=allowed)
    gradients = torch.autograd.grad(value.sum(dtype=working_dtype(dtype)), leaves)
    for found, leaf in zip(gradients, leaves, strict=True):
        assert found.shape == leaf.shape
        assert found.dtype == dtype
        assert found.isfinite().all()


def test_layer_under_autocast_gives_what_it_gives_without() -> None:
    normal = F.normalize(torch.randn(1, 3, 8, 8, generator=torch.Generator().manual_seed(0)), dim=1)
    light = torch.tensor([[0.0, 0.6, 0.8]])
    sigma = torch.tensor(0.4, requires_grad=True)
    plain = OrenNayar("vcavity")(normal, light, roughness=sigma)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        under = OrenNayar("vcavity")(normal, light, roughness=sigma)
        under.sum().backward()
    assert torch.equal(plain, under)
    assert sigma.grad is not None
    assert sigma.grad.isfinite()
