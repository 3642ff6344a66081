"""Whether photographs that are solved as under distant lights were taken under near ones, which bend the surface.

A near light shines on every pixel from another direction and from another distance. What that changes is not all what
another normal would change, so that it shows in the misfit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..core.findings import Finding
from ..core.warn import warn
from . import robust_fit
from .capture_checks import find_dark_pixels
from .material import LightDirections, Material
from .material_refinement import capped_error
from .pixel_sample import PixelSample, draw_places
from .robust_fit import PixelFit
from .robust_stats import in_light, mean_brightness

MIN_LIGHTS = 8
"""Photographs; with fewer little is left over from normal and albedo. Set by hand."""
PIXELS, STEPS = 250, 6
"""Pixels that are compared, and steps of their fits; set by hand, for some tenths of a second."""
MATERIALS = (Material(), *(Material("vcavity", math.radians(degrees)) for degrees in (20, 35)))
"""Materials under which distances are compared: a rough surface differs from a matt one by more than near lights from
distant ones. Set by hand."""
DISTANCES = (4.0, 2.0)
"""Distances of the lights that are tried, in sizes of the object; set by hand."""
BETTER = 0.8
"""Share of the error under distant lights that near ones must reach. Set by hand: .44 to .63 on tables under lamps at
1.8 and 2.3 times their size, .60 to .77 on rough objects at 2.3 to 2.6, and from .79 on, mostly above 1, on 128
captures under distant lights, photographed, rendered and made up."""


@dataclass(frozen=True)
class NearScene:
    """Pixels of an object, flat and facing the camera unless heights are given, and directions to lights near it.

    Lengths are in sizes of the object, the longer side of the box around it; x right, y up, z toward the camera.

    Attributes:
        sample: pixels under distant lights; their directions are those from ``origin``.
        places: (P, 3) of the pixels from the object's middle, at its mean height.
        origin: (3,) from the middle, whence the directions to the lights were measured.
        size: pixels.
        middle: column and row.
    """

    sample: PixelSample
    places: Tensor
    origin: Tensor
    size: float
    middle: tuple[float, float]

    def __getitem__(self, part: slice) -> NearScene:
        return replace(self, sample=self.sample[part], places=self.places[part])

    @staticmethod
    def of(sample: PixelSample, inside: Tensor, origin: tuple[float, float] | None = None) -> NearScene:
        """The scene of pixels of the object ``inside``, (H, W) bool.

        ``origin``: column and row of the pixel from which the directions were measured; by default the middle.
        """
        low, high = (bound.double() for bound in inside.nonzero().aminmax(dim=0))
        size = float((high - low).max() + 1)
        y, x = ((low + high) / 2).tolist()
        row, column = sample.rows_and_columns().to(sample.grey).unbind(1)
        places = torch.stack((column - x, y - row, torch.zeros_like(row)), 1) / size
        across, down = (0.0, 0.0) if origin is None else (origin[0] - x, origin[1] - y)
        return NearScene(sample, places, places.new_tensor((across, -down, 0.0)) / size, size, (x, y))

    def lamps(self, lights: Tensor, distance: float) -> Tensor:
        """Positions (K, 3) of lights of these directions (K, 3), all equally far from the object's middle."""
        along = lights @ self.origin
        reach = (distance**2 - self.origin @ self.origin + along**2).clamp_min(0).sqrt() - along
        return self.origin + reach[:, None] * lights

    def under_near_lights(self, distance: float) -> PixelSample:
        """The pixels as lit by lights at so many sizes of the object, their brightness made that at its middle."""
        toward = self.lamps(self.sample.directions.light, distance) - self.places[:, None]
        length = toward.norm(dim=2)
        near = LightDirections.of(toward / length[:, :, None])
        return replace(self.sample, grey=self.sample.grey * (length / distance) ** 2, directions=near)

    def at_heights(self, heights: Tensor) -> NearScene:
        """The scene of a surface whose pixels have these heights (P,)."""
        return replace(self, places=torch.cat((self.places[:, :2], heights[:, None].to(self.places)), 1))

    def fit(self, distance: float, material: Material) -> tuple[PixelFit, float]:
        """The pixels of a material under lights at that distance, and the share of their means left unexplained."""
        sample = self.sample if math.isinf(distance) else self.under_near_lights(distance)
        fitted = robust_fit.fit(sample, material, steps=STEPS)
        shown = robust_fit.predict(fitted, sample.directions, material)
        return fitted, capped_error(sample.grey, shown, mean_brightness(sample.grey), in_light(sample.grey))

    def least_error(self, distance: float = math.inf) -> float:
        """What the best of `MATERIALS` leaves unexplained."""
        return min(self.fit(distance, material)[1] for material in MATERIALS)


def check_distant_lights(sample: PixelSample, inside: Tensor) -> list[Finding]:
    """A finding, and a warning, where lights at a few sizes of the object explain the photographs much better.

    Args:
        sample: pixels under distant lights.
        inside: (H, W) bool, the object.
    """
    if len(sample.directions) < MIN_LIGHTS:
        return []
    distant, errors = _compare(NearScene.of(sample[:PIXELS], inside))
    best = min(errors, key=errors.__getitem__)
    if errors[best] >= BETTER * distant:
        return []
    text = (
        f"lights at about {best:g} times the object's size explain the photographs better than distant ones (error "
        f"{errors[best]:.3f} against {distant:.3f}): the surface found is bent; let their distance be found (--near, "
        "find_light_positions), or give their positions (--positions, near_light_stereo)."
    )
    warn(text)
    return [Finding(text, "lights-near", best)]


def shows_near_lights(
    images: Tensor, lights: Tensor, mask: Tensor, origin: tuple[float, float] | None = None, *, seed: int = 0
) -> bool:
    """Whether lights at a few sizes of the object explain photographs much better than distant ones.

    Args:
        images: (K, C, H, W), valid everywhere.
        lights: (K, 3) unit directions.
        mask: (1, H, W) bool.
        origin: column and row of the pixel from which the directions were measured; None: the object's middle.
        seed: of the pixels that are looked at.
    """
    if len(images) < MIN_LIGHTS:
        return False
    places = draw_places(mask[0] & ~find_dark_pixels(images, mask[0]), PIXELS, seed)
    distant, errors = _compare(NearScene.of(PixelSample.gather(images, lights, places), mask[0], origin))
    return min(errors.values()) < BETTER * distant


def _compare(scene: NearScene) -> tuple[float, dict[float, float]]:
    """The error under distant lights, and those under lights at `DISTANCES`."""
    return scene.least_error(), {distance: scene.least_error(distance) for distance in DISTANCES}
