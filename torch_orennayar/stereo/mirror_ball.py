"""Find a mirror ball in photographs under several lights: first by its highlights, then by its outline.

Under each light the ball shows one small highlight where no other light makes it bright; all of these lie on one disc,
and nothing else does that. The outline around them is the circle at which brightness steps all around, in the mean,
the brightest or the median picture; of several, the outermost: what a ball reflects is inside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from torch import Tensor

from ..core.errors import CaptureError
from ..core.optional import require
from ..geometry.primitives import Ball

Floats = npt.NDArray[np.float32]
Doubles = npt.NDArray[np.float64]

# All of these were set by hand, on balls in the dark, on a table and of glass.
WORKING_SIDE = 900
"""Pixels of the longer side of the pictures that are searched."""
CANDIDATES = 8
"""Bright spots of each photograph that may be its highlight."""
FAINTEST = 0.1
"""Of the most conspicuous spot that another one must reach."""
SPOT = 6
"""Pixels within which two bright spots are one."""
NEIGHBOURHOOD = 41
"""Pixels of the square whose mean is subtracted: a highlight is smaller."""
SHARE = 0.9
"""Of the photographs must show their highlight on the disc: a light may fail."""
REST = 0.6
"""Brightness of a highlight's place under the next brightest light over that under its own, at most; matt: 0.9."""
ANGLES = 72
"""Directions in which the step of brightness at a circle is looked at."""
STEP = 0.4
"""Of the logarithm of brightness that counts as a full step at the outline."""
FLOOR = 1e-3
"""Of the picture's bright parts, added before the logarithm: what is darker is equally dark."""
GRADUAL = 11
"""Pixels of the radius over which a change of brightness is gradual and no outline."""
PEAK = 0.7
"""Share of the largest support down to which radii belong to one outline, which lies in their middle."""
NUDGES = np.arange(-2, 2.1, 0.5)
"""Pixels by which the centre is moved to find the middle of equally good ones."""
LEAST_SUPPORT = 0.5
"""Share of the outline that must show a step of brightness."""
REACH = 12.0
"""Largest radius over the distance of the highlights from their middle."""
SEARCH_RADIUS, FINE_RADIUS = 250, 150
"""Pixels of the largest radius when the outline is searched, and of its own radius when it is measured."""


def find_mirror_ball(images: Tensor) -> Ball:
    """A mirror ball somewhere in photographs under several lights, beside an object or alone.

    Args:
        images: (K, C, H, W) linear light, one light each, K >= 3.

    Returns:
        Its outline in pixels of the photographs.

    Raises:
        CaptureError: no ball: no bright spots that move with the light on one disc, or no outline around them.
        MissingPackageError: OpenCV is not installed.
    """
    mend = "mark it: --ball X,Y,RADIUS in pixels (column, row), or a mask of it, --ball-mask FILE"
    if len(images) < 3:
        raise CaptureError(
            "images", expected="at least 3 photographs to find a ball in", got=str(len(images)), mend=mend
        )
    grey, scale = _shrunk(images)
    places, rest = _highlights(grey)
    few = len(places) < SHARE * len(images)
    if few or np.median(rest) > REST:
        got = f"spots close together in {len(places)} of {len(images)}" if few else "spots that other lights reach too"
        raise CaptureError("images", expected="a mirror ball's highlight under each light", got=got, mend=mend)
    outline = _Outline.around(grey, places)
    circle = outline.search()
    if circle is None:
        spot = np.median(places, 0) * scale
        raise CaptureError(
            "images",
            expected="a ball whose outline shows",
            got=f"highlights near column {spot[0]:.0f}, row {spot[1]:.0f}, and no circle around them",
            mend=mend,
        )
    if scale == 1 and outline.zoom == 1:  # searched at the photographs' own size
        return Ball(circle.x, circle.y, circle.radius)
    places = _unshrink(places, scale)
    x, y = _unshrink(np.array((circle.x, circle.y)), scale)
    return _measured(images, Ball(float(x), float(y), circle.radius * scale), places)


def _shrunk(images: Tensor) -> tuple[Floats, int]:
    """Grey photographs (K, h, w) of at most `WORKING_SIDE` pixels, and the factor to the whole ones."""
    require("cv2")
    import cv2

    factor = math.ceil(max(images.shape[2:]) / WORKING_SIDE)
    size = (images.shape[3] // factor, images.shape[2] // factor)
    pictures = (image.float().mean(0).cpu().numpy()[: size[1] * factor, : size[0] * factor] for image in images)
    if factor == 1:
        return np.stack(list(pictures)), 1
    return np.stack([cv2.resize(picture, size, interpolation=cv2.INTER_AREA) for picture in pictures]), factor


def _unshrink(places: Doubles, scale: int) -> Doubles:
    """Pixel centres of whole photographs from those of shrunk ones."""
    return places * scale + (scale - 1) / 2


def _highlights(grey: Floats) -> tuple[Doubles, Doubles]:
    """The tightest group of one bright spot (x, y) per photograph, and how bright its place is under the next light.

    A photograph whose spots are all far from the group's is left out.
    """
    require("cv2")
    import cv2

    smooth = np.stack([cv2.GaussianBlur(picture, (0, 0), 1.0) for picture in grey])
    second, largest = np.partition(smooth, -2, axis=0)[-2:]
    brightest, excess = smooth.argmax(0), largest - second
    excess *= (excess / largest.clip(1e-12)) ** 2  # matt surfaces are nearly as bright under the next light
    spots = [_spots(np.where(brightest == k, excess, 0)) for k in range(len(grey))]
    spots = [found for found in spots if len(found)]
    if len(spots) < SHARE * len(grey):
        return np.empty((0, 2)), np.empty(0)
    best, reach = np.empty((0, 2)), np.inf
    for seed in np.concatenate(spots):
        group = np.stack([found[np.square(found - seed).sum(1).argmin()] for found in spots])
        spread = float(np.quantile(np.hypot(*(group - seed).T), SHARE))
        if spread < reach:
            best, reach = group, spread
    middle = np.median(best, 0)
    near = best[np.hypot(*(best - middle).T) <= 3 * max(reach, SPOT)]
    column, row = near.astype(int).T
    return near, (second / largest.clip(1e-12))[row, column].astype(np.float64)


def _spots(excess: Floats) -> Doubles:
    """Places (x, y) of the highest compact maxima, at most `CANDIDATES`."""
    require("cv2")
    import cv2

    left = (excess - cv2.blur(excess, (NEIGHBOURHOOD, NEIGHBOURHOOD))).astype(np.float32)
    found, least = [], max(FAINTEST * float(left.max()), 1e-12)
    for _ in range(CANDIDATES):
        row, column = divmod(int(left.argmax()), left.shape[1])
        if left[row, column] < least:
            break
        found.append((column, row))
        cv2.circle(left, (column, row), SPOT, 0.0, -1)
    return np.array(found, dtype=np.float64).reshape(-1, 2)


class _Circle(NamedTuple):
    support: float
    x: float
    y: float
    radius: float


@dataclass
class _Outline:
    """Steps of brightness at circles around highlights, in pictures that are cut out and reduced.

    Attributes:
        pictures: logarithms of the mean, brightest and median picture.
        places: (K, 2) highlights, in their pixels.
        radius: the largest that is looked at, in their pixels.
        corner: of the cut in the photographs.
        zoom: pixels of the pictures per pixel of the photographs.
    """

    pictures: list[Floats]
    places: Doubles
    radius: int
    corner: tuple[int, int]
    zoom: float

    @staticmethod
    def around(grey: Floats, places: Doubles) -> _Outline:
        """To search: everything that may be the outline of a ball with these highlights."""
        middle = np.median(places, 0)
        spread = max(float(np.hypot(*(places - middle).T).max()), 3.0)
        reach = min(REACH * spread, max(grey.shape[1:]))
        return _Outline.cut(grey, places, middle, 2 * reach, reach, min(1.0, SEARCH_RADIUS / reach))

    @staticmethod
    def cut(grey: Floats, places: Doubles, middle: Doubles, half: float, radius: float, zoom: float) -> _Outline:
        """The square of ``half`` its side around ``middle``."""
        require("cv2")
        import cv2

        x0, y0 = (max(int(m - half), 0) for m in middle)
        part = grey[:, y0 : int(middle[1] + half) + 1, x0 : int(middle[0] + half) + 1]
        pictures = []
        for light in (part.mean(0), part.max(0), np.median(part, 0)):
            picture = np.log(light + 0.1 * np.median(light) + FLOOR * np.quantile(light, 0.9) + 1e-9).astype(np.float32)
            pictures.append(
                picture if zoom == 1 else cv2.resize(picture, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_AREA)
            )
        inside = (places - (x0, y0) + 0.5) * zoom - 0.5
        return _Outline(pictures, inside, int(radius * zoom), (x0, y0), zoom)

    def support(self, x: float, y: float) -> Doubles:
        """Share of the circle at which brightness steps, the same way all around, for every radius in whole pixels."""
        require("cv2")
        import cv2

        height, width = self.pictures[0].shape
        found = np.zeros(self.radius)
        flags = cv2.WARP_POLAR_LINEAR + cv2.WARP_FILL_OUTLIERS
        kernel, gradual = np.array([[-0.5, -0.5, 0, 0.5, 0.5]], np.float32), np.ones((1, GRADUAL), np.uint8)
        for picture in self.pictures:
            polar = cv2.warpPolar(picture, (self.radius, ANGLES), (x, y), self.radius, flags)
            step = cv2.filter2D(polar, -1, kernel, borderType=cv2.BORDER_REPLICATE)
            full = np.tanh(step / STEP)
            up, down = (cv2.morphologyEx(part.clip(0), cv2.MORPH_TOPHAT, gradual) for part in (full, -full))
            found = np.maximum(found, np.abs((up - down).mean(0)))
        found[max(int(min(x, y, width - 1 - x, height - 1 - y)), 0) :] = 0  # beyond the picture
        least = np.quantile(np.hypot(*(self.places - (x, y)).T), SHARE)  # highlights lie inside
        found[: math.ceil(max(float(least), 4.0))] = 0
        return found

    def search(self) -> _Circle | None:
        """The outermost circle with good support, in pixels of the photographs."""
        middle = np.median(self.places, 0)
        spread = max(float(np.hypot(*(self.places - middle).T).max()), 3 * self.zoom)
        offsets = np.arange(-3 * spread, 3 * spread + 0.1, max(spread / 5, 1.0))
        height, width = self.pictures[0].shape
        profile, centres = np.zeros(self.radius), np.zeros((self.radius, 2))
        for x in middle[0] + offsets:
            for y in middle[1] + offsets:
                if 2 < x < width - 2 and 2 < y < height - 2:
                    support = self.support(x, y)
                    better = support > profile
                    profile[better], centres[better] = support[better], (x, y)
        found = []
        while (radius := int(profile.argmax())) and profile[radius] > LEAST_SUPPORT / 2:
            profile[int(radius * 0.88) : int(radius * 1.13) + 1] = 0
            found.append(self.refine(float(centres[radius, 0]), float(centres[radius, 1]), radius, spread / 10))
        good = [circle for circle in found if circle.support >= LEAST_SUPPORT]
        return self._outside(max(good, key=lambda circle: circle.radius)) if good else None

    def refine(self, x: float, y: float, radius: float, step: float) -> _Circle:
        """The best circle near another one, in pixels of the pictures; the middle where several are equally good."""
        low, high = max(int(radius * 0.9), 1), math.ceil(radius * 1.12) + 1

        def at(x: float, y: float) -> _Circle:
            support = self.support(x, y)[low:high]
            if not support.size:
                return _Circle(0.0, x, y, radius)
            k = int(support.argmax())
            return _Circle(float(support[k]), x, y, low + k + _middle(support, k))

        best = at(x, y)
        while step > 0.1:
            around = [at(best.x + i * step, best.y + j * step) for i in (-1, 0, 1) for j in (-1, 0, 1)]
            better = max(around)
            if better.support <= best.support:
                step /= 2
            best = max(best, better)
        around = [at(best.x + dx, best.y + dy) for dx in NUDGES for dy in NUDGES]
        weight = np.array([max(circle.support - PEAK * best.support, 0.0) for circle in around]) ** 2 + 1e-12
        x, y, radius = np.average([(c.x, c.y, c.radius) for c in around], 0, weight)
        return _Circle(best.support, float(x), float(y), float(radius))

    def _outside(self, circle: _Circle) -> _Circle:
        x, y = ((v + 0.5) / self.zoom - 0.5 + c for v, c in zip((circle.x, circle.y), self.corner, strict=True))
        return _Circle(circle.support, x, y, circle.radius / self.zoom)

    def measure(self, ball: Ball) -> _Circle:
        """The circle near a ball that was found in coarser pictures."""
        x, y = ((v - c + 0.5) * self.zoom - 0.5 for v, c in zip((ball.x, ball.y), self.corner, strict=True))
        return self._outside(self.refine(x, y, ball.radius * self.zoom, 2.0))


def _middle(values: Doubles, k: int) -> float:
    """Middle of the peak around the largest value, whose top may be flat: in pixels from index ``k``."""
    least = PEAK * values[k]
    low = high = k
    while low > 0 and values[low - 1] >= least:
        low -= 1
    while high < len(values) - 1 and values[high + 1] >= least:
        high += 1
    weight = values[low : high + 1] - least + 1e-9
    return float((weight * np.arange(low - k, high + 1 - k)).sum() / weight.sum())


def _measured(images: Tensor, ball: Ball, places: Doubles) -> Ball:
    """The ball's outline in the whole photographs."""
    half = 1.4 * ball.radius
    x0, y0 = max(int(ball.x - half), 0), max(int(ball.y - half), 0)
    part = images[:, :, y0 : int(ball.y + half) + 1, x0 : int(ball.x + half) + 1].float().mean(1).cpu().numpy()
    inside, moved = places - (x0, y0), Ball(ball.x - x0, ball.y - y0, ball.radius)
    zoom = min(1.0, FINE_RADIUS / ball.radius)
    outline = _Outline.cut(part, inside, np.array((moved.x, moved.y)), 2 * half, half, zoom)
    circle = outline.measure(moved)
    return Ball(circle.x + x0, circle.y + y0, circle.radius)
