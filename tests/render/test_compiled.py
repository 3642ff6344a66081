"""The renderer compiled by numba against that of torch: the same keys to the last bit, values to rounding."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from torch_orennayar import Camera, cast_shadows, render_normals
from torch_orennayar.core.optional import available
from torch_orennayar.geometry.primitives import bumpy_ball, spiral_lights
from torch_orennayar.render import interpolate, raster

pytestmark = pytest.mark.skipif(not available("numba"), reason="numba is not installed")


def both(draw: Callable[[], Any]) -> tuple[Any, Any]:
    """What ``draw`` returns with numba and without."""
    compiled = draw()
    with pytest.MonkeyPatch.context() as patch:
        for module in (raster, interpolate):
            patch.setattr(module, "is_compiled", lambda _: False)
        return compiled, draw()


@pytest.fixture(params=[1, 3])
def threads(request: pytest.FixtureRequest) -> Iterator[int]:
    """So many threads of torch."""
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


def record_keys(patch: pytest.MonkeyPatch) -> list[Tensor]:
    """The keys of every picture that is drawn from now on, in order."""
    seen: list[Tensor] = []
    nearest = raster._nearest

    def recorded(*arguments: Any) -> Tensor:
        seen.append(nearest(*arguments))
        return seen[-1]

    patch.setattr(raster, "_nearest", recorded)
    return seen


@given(
    seed=st.integers(0, 2**31),
    faces=st.integers(1, 60),
    spread=st.sampled_from([0.01, 0.3, 3.0, 300.0]),
    size=st.tuples(st.integers(1, 70), st.integers(1, 70)),
    cull=st.sampled_from([None, "back", "front"]),
    perspective=st.booleans(),
    whole=st.booleans(),
)
def test_random_faces_have_the_same_keys(
    seed: int, faces: int, spread: float, size: tuple[int, int], cull: str | None, perspective: bool, whole: bool
) -> None:
    """Small faces and such as reach far out of the picture and behind the camera; corners on centres of pixels."""
    generator = torch.Generator().manual_seed(seed)
    vertices = spread * torch.randn(2, faces + 2, 3, generator=generator, dtype=torch.float64)
    if whole:
        vertices = (vertices * 8).round() / 8
    triangles = torch.randint(faces + 2, (faces, 3), generator=generator)
    camera = Camera.perspective(math.radians(50), eye=(0.1, 0.2, 2.0)) if perspective else Camera.orthographic(1.3)
    with pytest.MonkeyPatch.context() as patch:
        found = record_keys(patch)
        both(lambda: render_normals(vertices, triangles, camera, size, cull=cull, smooth=False))
    assert torch.equal(found[0], found[1])


@pytest.mark.usefixtures("threads")
def test_a_fine_mesh_in_several_views(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = record_keys(monkeypatch)
    vertices, faces = bumpy_ball()
    eyes = torch.nn.functional.normalize(torch.randn(5, 3, generator=torch.Generator().manual_seed(0)), dim=1)
    compiled, plain = both(lambda: render_normals(vertices, faces, Camera.orthographic(1.2, eye=eyes), (200, 300)))
    assert torch.equal(keys[0], keys[1])
    assert torch.equal(compiled.face, plain.face)
    for name in ("normal", "depth", "barycentric"):
        torch.testing.assert_close(getattr(compiled, name), getattr(plain, name), rtol=1e-5, atol=1e-5)


def test_shadows_are_the_same() -> None:
    vertices, faces = bumpy_ball()
    seen = render_normals(vertices, faces, Camera.orthographic(1.2), (64, 64))
    lights = spiral_lights(6, math.radians(70))
    compiled, plain = both(lambda: cast_shadows(vertices, faces, seen, lights, resolution=256))
    assert torch.equal(compiled, plain)
    assert (compiled < 0.5).any()


@given(
    seed=st.integers(0, 2**31),
    faces=st.integers(1, 20),
    smooth=st.booleans(),
    perspective=st.booleans(),
    views=st.integers(1, 3),
)
def test_values_and_gradients_are_the_same(seed: int, faces: int, smooth: bool, perspective: bool, views: int) -> None:
    """In float64, where nothing but the order of operations differs; corner normals that cancel among them."""
    generator = torch.Generator().manual_seed(seed)
    vertices = torch.randn(views, faces + 2, 3, generator=generator, dtype=torch.float64)
    triangles = torch.randint(faces + 2, (faces, 3), generator=generator)
    camera = Camera.perspective(math.radians(50), eye=(0.1, 0.2, 4.0)) if perspective else Camera.orthographic(1.3)
    normals = torch.randn(faces + 2, 3, generator=generator, dtype=torch.float64).sign() if smooth else None
    toward = [torch.randn(views, n, 12, 15, generator=generator, dtype=torch.float64) for n in (3, 1, 3)]

    def draw() -> list[Tensor]:
        moved = vertices.clone().requires_grad_()
        seen = render_normals(moved, triangles, camera, (12, 15), smooth=smooth, vertex_normals=normals)
        shown = [seen.normal, torch.where(seen.mask, seen.depth, 0), seen.barycentric]
        torch.stack([(a * b).sum() for a, b in zip(shown, toward, strict=True)]).sum().backward()
        assert moved.grad is not None
        return [*(t.detach() for t in shown), moved.grad]

    for compiled, plain in zip(*both(draw), strict=True):
        torch.testing.assert_close(compiled, plain, rtol=1e-8, atol=1e-8 * max(1.0, float(plain.abs().max())))


@pytest.mark.usefixtures("threads")
def test_gradients_of_a_fine_mesh_are_the_same() -> None:
    vertices, faces = bumpy_ball()

    def gradient() -> Tensor:
        moved = vertices.clone().requires_grad_()
        render_normals(moved, faces, Camera.perspective(0.8), (48, 48)).normal[:, 0].sum().backward()
        assert moved.grad is not None
        return moved.grad

    compiled, plain = both(gradient)
    assert (compiled - plain).abs().max() < 5e-5 * plain.abs().max()
