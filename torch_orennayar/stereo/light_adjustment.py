"""Bundle adjustment of photometric stereo: pixels, distant lights and the material's number, all at once.

Every pixel has a normal, an albedo and strengths of highlights, every light a direction and a brightness, and the
object one roughness or exponent of falloff. Gauss-Newton steps of all of them are solved together: the pixels, which
only share lights, are eliminated (Schur complement). What pixels and lights could trade against each other is so solved
for, instead of being approached in many alternations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from . import robust_fit
from .gauss_newton import LOBE_RIDGE, fill_jacobian, tilted
from .linear_systems import camera_facing, tangent_vectors
from .material import LightDirections, Material, Response, respond
from .material_refinement import capped_error, number_of, number_range, with_number
from .pixel_sample import PixelSample
from .robust_fit import PixelFit
from .robust_stats import (
    ERROR_CAP,
    geman_mcclure,
    in_light,
    mean_brightness,
    median_rank,
    noise_level,
    select,
)

INDEPENDENT = 0.02
"""Share of the observations that count as independent, 1 in 50: a material that does not fit errs the same way under
about ten lights and in about five pixels. Set by hand; the errors of lights found on rendered and real objects are then
mostly within their standard error (``scripts/benchmarks/evaluate_unknown_lights.py``)."""
OWN_STEPS = 3
"""Gauss-Newton steps of the pixels alone after each step of all; set by hand."""
MAX_TURN = 0.1
"""Radians by which a light may turn in a step; set by hand."""
MAX_CHANGE = 0.15
"""By which the roughness in radians, or the exponent, may change in a step; set by hand."""
MAX_DIMMING = 0.3
"""By which the logarithm of a brightness may change in a step; set by hand."""
DAMPING = 1e-6
"""Of the pixels' unknowns, as a share of the diagonal. It must be far below the share that the weakest common unknowns
have in the misfit, or those move as slowly as in an alternation. Set by hand."""
LEAST_KNOWN = 1e-6
"""What is known beforehand of the unknowns of pixels that no light reaches: nearly nothing. Set by hand."""
DIFFERENCE = 1e-4
"""Radians, or units of the material's number, over which derivatives are taken; set by hand."""
NUMBER_KNOWN = 1.0
"""What is known of the material's number beforehand, 1 / radians**2 or 1: nearly nothing. Set by hand."""
SETTLED = 3e-4
"""Radians by which no light turns in a round after which the search ends; set by hand."""
FROZEN = 1e6
"""Stiffness, 1 / radians**2, with which lights keep their common rotation; set by hand."""


@dataclass(frozen=True)
class LightGuess:
    """Lights, and the pixels that go with them.

    Attributes:
        directions: (K, 3) unit, float64.
        brightness: (K,), of geometric mean 1.
        material: what the pixels share.
        pixels: normal, albedo and highlights of every pixel.
    """

    directions: Tensor
    brightness: Tensor
    material: Material
    pixels: PixelFit

    def turned(self, rotation: Tensor) -> LightGuess:
        """With lights and normals turned by a rotation (3, 3), applied from the right; the view stays in front."""
        pixels = replace(self.pixels, normal=camera_facing(self.pixels.normal @ rotation))
        return replace(self, directions=self.directions @ rotation, pixels=pixels)


@dataclass(frozen=True)
class Observed:
    """What was photographed.

    Attributes:
        grey: (P, K) float64.
        spread: standard deviation of the logarithm of the lights' brightness that is expected.
    """

    grey: Tensor
    spread: float

    def fit(
        self, directions: Tensor, brightness: Tensor, material: Material, start: PixelFit | None, steps: int
    ) -> PixelFit:
        """The pixels under given lights."""
        places = torch.arange(len(self.grey))
        sample = PixelSample(self.grey / brightness, LightDirections.of(directions), places, len(places))
        return robust_fit.fit(sample, material, used="lit", start=start or "middle", steps=steps)

    def error(self, guess: LightGuess) -> float:
        """Mean absolute misfit over the pixels' means, each cut at `ERROR_CAP`."""
        grey = self.grey / guess.brightness
        shown = robust_fit.predict(guess.pixels, LightDirections.of(guess.directions), guess.material)
        return capped_error(grey, shown, mean_brightness(grey), in_light(grey))


def adjust(observed: Observed, guess: LightGuess, rounds: int, stiffness: Tensor | None = None) -> LightGuess:
    """Improve a guess by Gauss-Newton steps of everything together.

    Args:
        observed: the photographs.
        guess: to begin with.
        rounds: most steps.
        stiffness: (3, 3) inverse covariance, 1 / radians**2, of the lights' common rotation about that of the guess;
            None: they keep it.
    """
    kept = FROZEN * torch.eye(3, dtype=guess.directions.dtype) if stiffness is None else stiffness
    anchor = guess.directions
    for _ in range(rounds):
        before, guess = guess, _step(observed, guess, anchor, kept)
        if float((guess.directions - before.directions).norm(dim=1).max()) < SETTLED:
            break
    return guess


def standard_errors(observed: Observed, guess: LightGuess, stiffness: Tensor) -> tuple[float, float]:
    """How well the lights are determined.

    Args:
        observed: the photographs.
        guess: the solution.
        stiffness: (3, 3) what else is known of their common rotation, 1 / radians**2.

    Returns:
        Standard errors of a direction, radians, and of the logarithm of a brightness, RMS over the lights.
    """
    matrix = _Equations.of(observed, guess).matrix.clone()
    count = 3 * len(guess.directions)
    turning = _rotation_of_lights(guess.directions)
    matrix[:count, :count] += turning.T @ stiffness @ turning
    matrix.diagonal().mul_(1 + 1e-9)
    variance = torch.linalg.pinv(matrix, hermitian=True).diagonal()[:count].view(-1, 3)
    sides, brightness = variance[:, :2].sum(1).mean(), variance[:, 2].mean()
    return float(sides.clamp_min(0).sqrt()), float(brightness.clamp_min(0).sqrt())


def tangents(directions: Tensor) -> tuple[Tensor, Tensor]:
    """Two unit vectors (K, 3) at right angles to each direction and each other."""
    axis = torch.where(
        directions[:, 2:].abs() < 0.9, directions.new_tensor((0.0, 0, 1)), directions.new_tensor((1.0, 0, 0))
    )
    first = F.normalize(torch.linalg.cross(directions, axis), dim=1)
    return first, torch.linalg.cross(directions, first)


@dataclass(frozen=True)
class _Equations:
    """Normal equations of lights and number after the pixels are eliminated, and what gives the pixels back.

    The unknowns are, light by light, two angles and the logarithm of the brightness, and last the material's number.

    Attributes:
        matrix: (3 K + 1, 3 K + 1).
        right: (3 K + 1,).
        root: (P, D, D) Cholesky factors of the pixels' own matrices.
        coupling: (P, D, 3 K + 1) between pixels and common unknowns, over ``root``.
        pull: (P, D) the pixels' right sides, over ``root``.
    """

    matrix: Tensor
    right: Tensor
    root: Tensor
    coupling: Tensor
    pull: Tensor

    @staticmethod
    def of(observed: Observed, guess: LightGuess) -> _Equations:
        """At a guess."""
        mean = mean_brightness(observed.grey)
        selected = select(observed.grey, "lit")
        response = _respond(guess, guess.directions, guess.material, mean)
        residual = observed.grey / mean - guess.brightness * response.value
        noise = noise_level(residual, selected, median_rank(selected))
        weight = INDEPENDENT * geman_mcclure(selected, residual, noise) / noise.square()
        own = _by_pixels(guess, response)
        common = _by_lights(guess, response, mean)
        number = _by_number(guess, mean)
        size, count = own.shape[1], len(guess.directions)
        matrix = torch.einsum("pak,pk,pbk->pab", own, weight, own)
        pull = torch.einsum("pak,pk->pa", own, weight * residual)
        ridge = INDEPENDENT * LOBE_RIDGE / ERROR_CAP**2
        matrix.diagonal(dim1=1, dim2=2).mul_(1 + DAMPING).add_(LEAST_KNOWN)
        matrix.diagonal(dim1=1, dim2=2)[:, 3:] += ridge
        pull[:, 3:] -= ridge * guess.pixels.lobes / mean
        across = torch.einsum("pak,pk,pbk->pakb", own, weight, common).reshape(-1, size, 3 * count)
        across = torch.cat((across, torch.einsum("pak,pk,pk->pa", own, weight, number)[:, :, None]), 2)
        root = torch.linalg.cholesky(matrix)
        coupling = torch.linalg.solve_triangular(root, across, upper=False)
        pull = torch.linalg.solve_triangular(root, pull[:, :, None], upper=False)[:, :, 0]
        flat = coupling.reshape(-1, 3 * count + 1)
        reduced = _common_matrix(common, number, weight) - flat.T @ flat
        right = torch.cat(
            (torch.einsum("pak,pk->ka", common, weight * residual).flatten(), (weight * residual * number).sum()[None])
        )
        right = right - flat.T @ pull.flatten()
        logarithm, places = guess.brightness.log(), slice(2, 3 * count, 3)
        reduced.diagonal()[places] += observed.spread**-2
        right[places] -= (logarithm - logarithm.mean()) / observed.spread**2
        reduced[-1, -1] += NUMBER_KNOWN
        return _Equations(reduced, right, root, coupling, pull)

    def pixels(self, step: Tensor) -> Tensor:
        """Steps of the pixels (P, D) that go with a step of the common unknowns."""
        left = (self.pull - self.coupling @ step)[:, :, None]
        steps: Tensor = torch.linalg.solve_triangular(self.root.mT, left, upper=True)[:, :, 0]
        return steps


def _step(observed: Observed, guess: LightGuess, anchor: Tensor, stiffness: Tensor) -> LightGuess:
    """One step of everything, and some of the pixels alone."""
    equations = _Equations.of(observed, guess)
    count = len(guess.directions)
    sides = tangents(guess.directions)
    turning = _rotation_of_lights(guess.directions)
    left = torch.stack([((anchor - guess.directions) * side).sum(1) for side in sides], 1)
    turned = turning @ F.pad(left, (0, 1)).flatten()
    matrix, right = equations.matrix.clone(), equations.right.clone()
    matrix[: 3 * count, : 3 * count] += turning.T @ stiffness @ turning
    right[: 3 * count] += turning.T @ (stiffness @ turned)
    matrix.diagonal().mul_(1 + 1e-9)
    value, (least, most) = number_of(guess.material), number_range(guess.material)
    step = _bounded_solution(matrix, right, least - value, most - value)
    lights = step[:-1].view(count, 3)
    scale = min(
        1.0,
        MAX_TURN / max(float(lights[:, :2].norm(dim=1).max()), 1e-12),
        MAX_CHANGE / max(abs(float(step[-1])), 1e-12),
    )
    step, lights = scale * step, scale * lights
    directions = F.normalize(guess.directions + sides[0] * lights[:, :1] + sides[1] * lights[:, 1:2], dim=1)
    logarithm = guess.brightness.log() + lights[:, 2].clamp(-MAX_DIMMING, MAX_DIMMING)
    brightness = (logarithm - logarithm.mean()).exp()
    material = with_number(guess.material, min(max(value + float(step[-1]), least), most))
    pixels = _moved(guess.pixels, equations.pixels(step), mean_brightness(observed.grey))
    return LightGuess(
        directions, brightness, material, observed.fit(directions, brightness, material, pixels, OWN_STEPS)
    )


def _bounded_solution(matrix: Tensor, right: Tensor, least: float, most: float) -> Tensor:
    """The solution; where its last entry would leave its range it stops there and the rest is solved again."""
    step: Tensor = torch.linalg.solve(matrix, right)
    if least <= float(step[-1]) <= most:
        return step
    last = right.new_tensor([least if float(step[-1]) < least else most])
    return torch.cat((torch.linalg.solve(matrix[:-1, :-1], right[:-1] - matrix[:-1, -1] * last), last))


def _moved(pixels: PixelFit, step: Tensor, mean: Tensor) -> PixelFit:
    """Pixels after a step of two tangent angles, albedo and highlights, both over ``mean``."""
    return replace(
        pixels,
        normal=tilted(pixels.normal, tangent_vectors(pixels.normal), step[:, :2]),
        albedo=(pixels.albedo + step[:, 2:3] * mean).clamp_min(1e-6 * mean),
        lobes=(pixels.lobes + step[:, 3:] * mean).clamp_min(0),
    )


def _respond(guess: LightGuess, directions: Tensor, material: Material, mean: Tensor) -> Response:
    pixels = guess.pixels
    return respond(
        material, pixels.normal, pixels.albedo / mean, pixels.lobes / mean, LightDirections.of(directions), mean
    )


def _by_pixels(guess: LightGuess, response: Response) -> Tensor:
    """Derivatives (P, D, K) by the pixels' unknowns."""
    pixels = guess.pixels
    jacobian = pixels.normal.new_empty(len(pixels.normal), 3 + pixels.lobes.shape[1], len(guess.directions))
    fill_jacobian(jacobian, response, tangent_vectors(pixels.normal), LightDirections.of(guess.directions))
    return jacobian * guess.brightness


def _by_lights(guess: LightGuess, response: Response, mean: Tensor) -> Tensor:
    """Derivatives (P, 3, K) by two angles and the logarithm of the brightness of each light."""
    columns = []
    for side in tangents(guess.directions):
        ahead, behind = (
            _respond(guess, F.normalize(guess.directions + h * side, dim=1), guess.material, mean).value
            for h in (DIFFERENCE, -DIFFERENCE)
        )
        columns.append((ahead - behind) / (2 * DIFFERENCE))
    return torch.stack((*columns, response.value), 1) * guess.brightness


def _by_number(guess: LightGuess, mean: Tensor) -> Tensor:
    """Derivative (P, K) by the material's number."""
    value = number_of(guess.material)
    ahead, behind = (
        _respond(guess, guess.directions, with_number(guess.material, value + h), mean).value
        for h in (DIFFERENCE, -DIFFERENCE)
    )
    return guess.brightness * (ahead - behind) / (2 * DIFFERENCE)


def _common_matrix(common: Tensor, number: Tensor, weight: Tensor) -> Tensor:
    """Products of the derivatives by lights and number, (3 K + 1, 3 K + 1)."""
    blocks = torch.einsum("pak,pk,pbk->kab", common, weight, common)
    matrix = F.pad(torch.block_diag(*blocks), (0, 1, 0, 1))
    matrix[-1, :-1] = torch.einsum("pak,pk,pk->ka", common, weight, number).flatten()
    matrix[:-1, -1] = matrix[-1, :-1]
    matrix[-1, -1] = (weight * number.square()).sum()
    return matrix


def _rotation_of_lights(directions: Tensor) -> Tensor:
    """The common rotation (3,) in steps of lights (3 K,), by least squares: a matrix (3, 3 K)."""
    moved = torch.stack(
        [torch.linalg.cross(axis.expand_as(directions), directions) for axis in torch.eye(3).to(directions)]
    )
    columns = torch.stack([(moved * side).sum(2) for side in tangents(directions)], 2)
    turned = F.pad(columns, (0, 1)).flatten(1)
    solution: Tensor = torch.linalg.solve(turned @ turned.T, turned)
    return solution
