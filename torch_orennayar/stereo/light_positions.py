"""Positions of near lights of which only the directions are known: their common distance, from the photographs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from ..core.checks import check_floating, check_unit
from ..core.defaults import independent_of_defaults
from ..core.errors import CaptureError
from ..core.findings import Finding
from ..core.threads import small_operations
from ..geometry.integrate import integrate_normals
from .broken_frames import judge_frames
from .calibrate import find_brightness, unequal_brightness
from .capture_checks import check_directions, check_shapes, find_dark_pixels, find_valid, leave_out
from .material import LightDirections, Material
from .near_evidence import MATERIALS, MIN_LIGHTS, NearScene
from .pixel_sample import PixelSample, gather_reduced, reduction

PIXELS = 2000
"""Pixels, about, of the reduced photographs in which the distance is sought; set by hand, for a second or two."""
BRIGHTNESS_ROUNDS = 10
"""Alternations by which brightness that was found is mended after each of the others; set by hand."""
ROUNDS = 2
"""Alternations between the distance and the surface under it; set by hand: a third changes nothing."""
NEAREST, FARTHEST, GROWTH = 0.7, 16.0, 1.25
"""Distances between which one is sought, in sizes of the object, and the ratio of neighbouring ones that are tried; set
by hand. Beyond, lights are distant: their direction differs by less than 4 degrees between the object's edges."""
FINE = 1.1
"""Ratio of the distances that are tried last; set by hand."""
TELLS = 0.9
"""Share of the error under distant lights that near ones must reach. Set by hand: .44 to .63 on tables under lamps at
1.8 and 2.3 times their size; under lamps at 5 times an object's size, and distant ones, none is below .98."""
FAR = 8.0
"""Distance, in sizes of the object, beyond which lights are distant; set by hand."""
PARTS = 4
"""Parts of the pixels: all materials and distances are tried on one of them, and the distances that they tell on their
own differ by the uncertainty. Set by hand."""


class LightPositions(NamedTuple):
    """Where near lights are.

    Attributes:
        positions: (K, 3) in pixels from the middle of the picture: x right, y up, z toward the camera from the object.
        distance: of the lights, in sizes of the object (the longer side of the box around it).
        uncertainty: standard error of the distance, in sizes of the object.
        intensities: (K, 1) brightness of the lights; 1 where the photographs do not say that it differs.
        findings: what was found.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> lights = torch.nn.functional.normalize(torch.tensor([[0.0, 0, 1], [3, 0, 4], [0, 3, 4]]), dim=1)
        >>> found = ton.LightPositions(500 * lights, 2.5, 0.1, torch.ones(3, 1), ())
        >>> found.positions[1].tolist()  # as near_light_stereo takes them
        [300.0, 0.0, 400.0]
    """

    positions: Tensor
    distance: float
    uncertainty: float
    intensities: Tensor
    findings: tuple[Finding, ...]


@torch.no_grad()
@independent_of_defaults
def find_light_positions(
    images: Tensor,
    lights: Tensor,
    mask: Tensor | None = None,
    *,
    origin: tuple[float, float] | None = None,
    valid: Tensor | None = None,
) -> LightPositions:
    """Find how far away near lights are whose directions are known, for `near_light_stereo`.

    All lights are taken to be equally far from the object's middle. Of a near light each pixel sees another direction
    and brightness: the distance is taken under which a matt or rough surface explains the images best, first on a plane
    that faces the camera, then on the surface of the normals found. Photographs that contradict the others do not
    count. Lights farther than some five sizes of the object can hardly be told from distant ones. Not differentiable.

    Args:
        images: (K, C, H, W) linear light.
        lights: (K, 3) unit directions to the lights.
        mask: (1, H, W) bool; default all pixels.
        origin: column and row of the pixel from which the directions were measured, such as the centre of a mirror
            ball; default the middle of the object.
        valid: as for `photometric_stereo`.

    Returns:
        The `LightPositions`.

    Raises:
        ShapeError: shapes do not fit together.
        RangeError: directions that are not unit vectors.
        CaptureError: fewer than 8 lights, or images that do not tell the distance.

    Source:
        Specific to this package; light and brightness as in `point_light`.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> from torch_orennayar.geometry.primitives import spiral_lights
        >>> lights, camera = spiral_lights(12), ton.Camera.orthographic(8.0)
        >>> table = camera.points(torch.zeros(1, 1, 16, 16))
        >>> seen, irradiance = ton.point_light(table, 32 * lights.reshape(12, 3, 1, 1), 1.0)
        >>> found = ton.find_light_positions(irradiance * seen[:, 2:], lights)
        >>> round(found.distance, 1)
        2.0
    """
    check_floating(images=images, lights=lights)
    inside = check_shapes(images, lights, mask)
    if len(images) < MIN_LIGHTS or lights.ndim != 2:
        raise CaptureError(
            "lights", expected=f"directions (K, 3) of at least {MIN_LIGHTS}", got=str(tuple(lights.shape)),
            mend="photograph under more lights, or measure their positions",
        )  # fmt: skip
    check_unit("lights", lights, 1, gaps=False)
    images, _ = leave_out(images, find_valid(images, inside, valid), inside)
    inside = inside & ~find_dark_pixels(images, inside)
    scene, small = _reduced(images, lights, inside, origin)
    check_directions(scene.sample.directions)
    with small_operations():
        found = _search(scene, small)
    text = (
        f"lights found near, at {found.distance:.1f} +- {found.uncertainty:.1f} times the object's size: they leave an "
        f"error of {found.error:.3f}, distant ones {found.distant:.3f}."
    )
    findings = [Finding(text, "light-distance-found", found.distance)]
    divisor = found.intensities.to(images)
    if bool((divisor != 1).any()):
        text = f"brightness of the lights found from the photographs, {divisor.min():.2f} to {divisor.max():.2f}."
        findings.append(Finding(text, "intensities-from-capture"))
    factor = reduction(inside, PIXELS)
    x, y = (factor * (v + 0.5) - 0.5 for v in scene.middle)
    middle = torch.tensor((x - (images.shape[3] - 1) / 2, (images.shape[2] - 1) / 2 - y, 0.0))
    positions = factor * scene.size * scene.lamps(scene.sample.directions.light, found.distance) + middle
    return LightPositions(positions.to(lights), found.distance, found.uncertainty, divisor, tuple(findings))


class _Search(NamedTuple):
    """What `_search` found: the distance in sizes of the object, (K, 1) brightness, errors near and distant."""

    distance: float
    uncertainty: float
    intensities: Tensor
    error: float
    distant: float


def _search(scene: NearScene, small: Tensor) -> _Search:
    """The distance of the lights of a scene whose pixels lie in ``small``, (h, w) bool."""
    material, distance = _on_a_plane(scene)
    unequal = unequal_brightness(scene.under_near_lights(distance))
    intensities = torch.ones_like(scene.sample.grey[:1].T) if unequal is None else unequal
    if unequal is not None:
        scene = _divided(scene, unequal)
        material, distance = _on_a_plane(scene)
    broken, _ = judge_frames(scene.under_near_lights(distance))
    if bool(broken.any()):
        scene = replace(scene, sample=scene.sample.under(~broken))
        material, distance = _on_a_plane(scene)
    for _ in range(ROUNDS):
        scene = _on_its_surface(scene, small, material, distance)
        distance = _refined(scene, material, distance)
        if unequal is not None:
            rest, _ = find_brightness(scene.under_near_lights(distance), BRIGHTNESS_ROUNDS)
            scene, intensities[~broken] = _divided(scene, rest), intensities[~broken] * rest
    near, distant = scene.fit(distance, material)[1], scene.least_error()
    if not near < TELLS * distant or distance > FAR:
        raise CaptureError(
            "images", expected="photographs that tell how far near lights are",
            got=f"distant ones explain them about as well (error {distant:.3f}, at {distance:.1f} sizes {near:.3f})",
            mend="solve as under distant lights, or measure the lights' positions",
        )  # fmt: skip
    return _Search(distance, _uncertainty(scene, material, distance), intensities, near, distant)


def _reduced(
    images: Tensor, lights: Tensor, inside: Tensor, origin: tuple[float, float] | None
) -> tuple[NearScene, Tensor]:
    """The pixels of the reduced photographs, and where they lie, (h, w) bool."""
    grey, small = gather_reduced(images, inside, PIXELS)
    directions = LightDirections.of(lights.detach().cpu().float())
    sample = PixelSample(grey.float(), directions, small.flatten().nonzero().flatten(), small.shape[1])
    factor = reduction(inside, PIXELS)
    start = None if origin is None else ((origin[0] + 0.5) / factor - 0.5, (origin[1] + 0.5) / factor - 0.5)
    return NearScene.of(sample, small, start), small


def _divided(scene: NearScene, intensities: Tensor) -> NearScene:
    return replace(scene, sample=replace(scene.sample, grey=scene.sample.grey / intensities.T))


def _on_a_plane(scene: NearScene) -> tuple[Material, float]:
    """The material and the distance under which a plane that faces the camera explains the photographs best."""
    count = 1 + math.ceil(math.log(FARTHEST / NEAREST) / math.log(GROWTH))
    part = scene[::PARTS]
    found = {}
    for material in MATERIALS:
        rough = min((NEAREST * GROWTH**i for i in range(count)), key=partial(_error, part, material))
        found[material] = _refined(part, material, rough)
    material = min(found, key=lambda one: _error(scene, one, found[one]))
    return material, _refined(scene, material, found[material])


def _on_its_surface(scene: NearScene, small: Tensor, material: Material, distance: float) -> NearScene:
    """The scene with the heights of its normals under lights at that distance."""
    normal = torch.zeros(3, small.numel())
    normal[:, small.flatten()] = scene.fit(distance, material)[0].normal.T.float()
    heights = integrate_normals(normal.view(3, *small.shape), small[None])[:, small][0]
    return scene.at_heights(heights / scene.size)


def _refined(scene: NearScene, material: Material, distance: float) -> float:
    """The best distance about one that is the best of a few."""
    for ratio in (GROWTH, FINE):
        distance = _lowest(partial(_error, scene, material), distance, ratio)
    return distance


def _error(scene: NearScene, material: Material, distance: float) -> float:
    return scene.fit(distance, material)[1]


def _lowest(error: Callable[[float], float], middle: float, ratio: float) -> float:
    """Where the parabola over the logarithm of three distances is lowest, within these."""
    before, here, behind = (error(middle * ratio**power) for power in (-1, 0, 1))
    bend = before - 2 * here + behind
    if not bend > 0:
        return middle * ratio if behind < before else middle / ratio
    return middle * math.exp(math.log(ratio) * max(-1.0, min(1.0, (before - behind) / (2 * bend))))


def _uncertainty(scene: NearScene, material: Material, distance: float) -> float:
    """Standard error of the distance, from how far those of parts of the pixels lie apart."""
    found = [_lowest(partial(_error, scene[i::PARTS], material), distance, GROWTH) for i in range(PARTS)]
    return distance * float(torch.tensor(found).log().std()) / math.sqrt(PARTS)
