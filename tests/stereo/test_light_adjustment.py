"""Bundle adjustment against dense normal equations, and on photographs whose lights are known."""

from __future__ import annotations

import math

import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from torch_orennayar.geometry.primitives import Ball, spiral_lights
from torch_orennayar.stereo.gauss_newton import LOBE_RIDGE
from torch_orennayar.stereo.light_adjustment import (
    DAMPING,
    INDEPENDENT,
    LEAST_KNOWN,
    NUMBER_KNOWN,
    LightGuess,
    Observed,
    _Equations,
    adjust,
    standard_errors,
    tangents,
)
from torch_orennayar.stereo.linear_systems import tangent_vectors
from torch_orennayar.stereo.material import LightDirections, Material, respond
from torch_orennayar.stereo.material_refinement import number_of, with_number
from torch_orennayar.stereo.robust_stats import (
    ERROR_CAP,
    geman_mcclure,
    mean_brightness,
    median_rank,
    noise_level,
    select,
)

GLOSSY = Material(minnaert_exponent=1.1, exponents=(8, 64))
ROUGH = Material("vcavity", math.radians(30))


def photographs(material: Material, count: int, pixels: int) -> tuple[Tensor, Tensor, Tensor]:
    """Grey (P, K) of a ball with albedo .5, its normals (P, 3) and lights (K, 3)."""
    normal, mask = Ball(31.5, 31.5, 30.0).normals((64, 64))
    generator = torch.Generator().manual_seed(0)
    some = normal[:, mask[0]].T.double()
    some = some[some[:, 2] > 0.2]
    some = some[torch.randperm(len(some), generator=generator)[:pixels]]
    lights = spiral_lights(count).double()
    one = torch.ones(len(some), 1, dtype=torch.float64)
    lobes = 0.1 * one.expand(-1, len(material.exponents))
    response = respond(material, some, 0.5 * one, lobes, LightDirections.of(lights), one)
    noise = 0.003 * torch.randn(response.value.shape, generator=generator, dtype=torch.float64)
    return (response.value + noise).clamp_min(0), some, lights


@pytest.mark.parametrize("material", [GLOSSY, ROUGH], ids=["glossy", "rough"])
def test_equations_are_those_of_all_unknowns_together(material: Material) -> None:
    """The dense matrix by central differences, with the pixels eliminated."""
    grey, _, lights = photographs(material, 12, 7)
    brightness = torch.linspace(0.9, 1.1, 12, dtype=torch.float64)
    observed = Observed(grey, 0.2)
    guess = LightGuess(lights, brightness, material, observed.fit(lights, brightness, material, None, 3))
    pixels, mean = guess.pixels, mean_brightness(grey)
    sides, skew = tangents(lights), tangent_vectors(pixels.normal)
    size, count = 3 + len(material.exponents), len(lights)

    def shown(unknowns: Tensor) -> Tensor:
        own = unknowns[: 7 * size].view(7, size)
        common = unknowns[7 * size : -1].view(count, 3)
        normal = F.normalize(pixels.normal + skew[0] * own[:, :1] + skew[1] * own[:, 1:2], dim=1)
        light = F.normalize(lights + sides[0] * common[:, :1] + sides[1] * common[:, 1:2], dim=1)
        albedo, strength = pixels.albedo / mean + own[:, 2:3], pixels.lobes / mean + own[:, 3:]
        changed = with_number(material, number_of(material) + float(unknowns[-1]))
        response = respond(changed, normal, albedo, strength, LightDirections.of(light), mean)
        return response.value * brightness * common[:, 2].exp()

    start = torch.zeros(7 * size + 3 * count + 1, dtype=torch.float64)
    steps = 1e-5 * torch.eye(len(start), dtype=torch.float64)
    jacobian = torch.stack([(shown(step) - shown(-step)).flatten() / 2e-5 for step in steps], 1)
    residual = grey / mean - shown(start)
    selected = select(grey, "lit")
    noise = noise_level(residual, selected, median_rank(selected))
    weight = (INDEPENDENT * geman_mcclure(selected, residual, noise) / noise**2).flatten()
    matrix = jacobian.T @ (weight[:, None] * jacobian)
    right = jacobian.T @ (weight * residual.flatten())
    own = 7 * size
    matrix[:own, :own].diagonal().mul_(1 + DAMPING).add_(LEAST_KNOWN)
    ridge = INDEPENDENT * LOBE_RIDGE / ERROR_CAP**2 * torch.ones(7, len(material.exponents), dtype=torch.float64)
    matrix[:own, :own] += F.pad(ridge, (3, 0)).flatten().diag()
    right[:own] -= F.pad(ridge * pixels.lobes / mean, (3, 0)).flatten()
    reduced = matrix[own:, own:] - matrix[own:, :own] @ torch.linalg.solve(matrix[:own, :own], matrix[:own, own:])
    reduced[2:-1:3, 2:-1:3] += torch.eye(count) / 0.2**2
    reduced[-1, -1] += NUMBER_KNOWN
    target = right[own:] - matrix[own:, :own] @ torch.linalg.solve(matrix[:own, :own], right[:own])
    target[2:-1:3] -= (brightness.log() - brightness.log().mean()) / 0.2**2
    equations = _Equations.of(observed, guess)
    scale = float(matrix[own:, own:].abs().max())
    assert torch.allclose(equations.matrix, reduced, atol=1e-6 * scale)
    assert torch.allclose(equations.right, target, atol=1e-6 * float(right.abs().max() + 1))


@pytest.mark.parametrize("material", [GLOSSY, ROUGH], ids=["glossy", "rough"])
def test_wrong_lights_of_unknown_brightness_are_mended(material: Material) -> None:
    """From lights 6 degrees and brightness 20 % off: a reflectance that is not linear leaves nothing open."""
    grey, _, lights = photographs(material, 24, 500)
    generator = torch.Generator().manual_seed(1)
    stretched = F.normalize(lights * lights.new_tensor((1.15, 0.9, 1.0)), dim=1)
    wrong = F.normalize(stretched + 0.03 * torch.randn(24, 3, generator=generator).double(), dim=1)
    brightness = (0.2 * torch.randn(24, generator=generator).double()).exp()
    brightness = brightness / brightness.log().mean().exp()
    observed = Observed(grey * brightness, 2.0)
    start = with_number(material, number_of(material) + 0.1)
    one = torch.ones_like(brightness)
    guess = LightGuess(wrong, one, start, observed.fit(wrong, one, start, None, 8))
    before = float(torch.rad2deg((wrong * lights).sum(1).clamp(-1, 1).acos()).mean())
    found = adjust(observed, guess, 20, torch.eye(3, dtype=torch.float64))
    apart = float(torch.rad2deg((found.directions * lights).sum(1).clamp(-1, 1).acos()).mean())
    assert before > 3
    assert apart < 0.8
    assert float((found.brightness / brightness).log().std()) < 0.02
    assert number_of(found.material) == pytest.approx(number_of(material), abs=0.02)
    assert observed.error(found) < 0.02 < observed.error(guess)
    direction, dimmed = standard_errors(observed, found, 1e4 * torch.eye(3, dtype=torch.float64))
    assert 0 < math.degrees(direction) < 10
    assert 0 < dimmed < 0.5


def test_a_lambertian_surface_leaves_the_brightness_open() -> None:
    grey, _, lights = photographs(Material(), 24, 500)
    observed = Observed(grey, 2.0)
    one = torch.ones(24, dtype=torch.float64)
    guess = LightGuess(lights, one, Material(minnaert_exponent=1.01), observed.fit(lights, one, Material(), None, 8))
    stiff = 1e4 * torch.eye(3, dtype=torch.float64)
    open_error, _ = standard_errors(observed, guess, stiff)
    closed_error, _ = standard_errors(Observed(grey, 0.02), guess, stiff)
    assert math.degrees(closed_error) < 3
    assert open_error > 3 * closed_error
