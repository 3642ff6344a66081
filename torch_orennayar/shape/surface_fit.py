"""Fit a height field to one shaded picture: from coarse to fine, through the shading layer.

Heights live at the corners of pixels, in pixels toward the viewer; in perspective they are -log(depth) over the angle
of a pixel. So every pixel has a normal of its own from its four corners, and the surface is integrable.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.optional import require
from ..core.progress import track
from ..reflectance.models import get_model
from ..shading import tiled as evaluation

COARSEST = 24
"""Levels are halved while the shorter side stays at least as long as this."""
STEPS = 100
"""Of L-BFGS per level."""
SCALES, SCALE_GAIN = 6, 1.4
"""The step is sought at several scales at once, the coarser the larger: what would take L-BFGS thousands of steps."""
HISTORY = 10
SMALL = 50_000
"""Pixels below which a second thread gains a tenth, and costs a factor of 30 on a busy machine."""
TWIST = 0.02
"""Weight against the checkerboard of corners, which normals do not see."""
CONTOUR, CONTOUR_COSINE = 4.0, 0.95
"""Weight of the occluding contour, and the cosine to the outward direction from which a border pixel is free."""
LEVEL = 0.02
"""Weight against a slant of the whole surface where no contour tells it."""
UNLIT = 1.0
"""Weight that turns pixels which are bright in the picture into the light: shading itself has no slope there."""
OUTLIER = 0.15
"""Residuals above this share of the picture's brightest light count less and less: cast shadows, highlights."""
MISUNDERSTOOD = 0.03
"""Share of the bright end that a picture must be off by, beyond its noise, for half the weight of the silhouette's
normals: where reflectance explains the picture, they are not asked."""
NEGLIGIBLE = 0.003
"""A weight of them below which nothing is solved again."""
ROUGHEST, WHITEST, STRONGEST_AMBIENT = 1.1, 4.0, 0.3
"""Where an unknown roughness ends, radians, an unknown albedo, times the picture's bright end, and unknown ambient
light, times the irradiance of the light."""
LIT = 0.05
"""Share of the bright end, above ambient light, from which a pixel is taken to face the light."""
KNOWN = 0.05
"""Weight of a known height per squared pixel."""


@dataclass(frozen=True)
class Scene:
    """One picture and what is known of it, at one size.

    Attributes:
        image: (C, H, W); 0 outside the mask.
        unit: the picture's bright end.
        mask: (1, H, W) float.
        light: (3, 1, 1) or (3, H, W) unit directions.
        view: (3, 1, 1) or (3, H, W).
        rays: (3, H + 1, W + 1) lines of sight through corners at depth 1, or None for parallel ones.
        albedo: (1 or C, 1, 1) or maps.
        roughness: (1, 1, 1) or (1, H, W).
        ambient: (1, 1, 1) or (1, H, W), times the light's irradiance.
        known: (1, H, W) heights, NaN where unknown.
        pixel: angle of a pixel, or 1.
        likely: (3, H, W) normals of the inflated silhouette, or None where no contour tells them.
        noise: variance of the picture's noise in units of ``unit``.
    """

    image: Tensor
    unit: float
    mask: Tensor
    light: Tensor
    view: Tensor
    rays: Tensor | None
    albedo: Tensor
    roughness: Tensor
    ambient: Tensor
    known: Tensor
    pixel: float
    likely: Tensor | None
    noise: float

    def cropped(self, rows: slice, columns: slice) -> Scene:
        """The part in a window."""

        def cut(values: Tensor, corners: int = 0) -> Tensor:
            if values.shape[1:] == (1, 1):
                return values
            return values[:, rows.start : rows.stop + corners, columns.start : columns.stop + corners]

        return replace(
            self,
            image=cut(self.image),
            mask=cut(self.mask),
            light=cut(self.light),
            view=cut(self.view),
            rays=None if self.rays is None else cut(self.rays, 1),
            albedo=cut(self.albedo),
            roughness=cut(self.roughness),
            ambient=cut(self.ambient),
            known=cut(self.known),
        )

    def halved(self) -> Scene:
        """Every four pixels as one; heights are halved with the pixels."""
        share = _halve(self.mask)

        def inside(values: Tensor) -> Tensor:
            return values if values.shape[-1] == 1 else _halve(values * self.mask) / share.clamp_min(1e-6)

        sure = self.known.isfinite()
        count = _halve(sure.to(self.image))
        known = torch.where(count > 0, _halve(self.known.nan_to_num(0)) / count.clamp_min(1e-6) / 2, torch.nan)
        rays = None if self.rays is None else _resize(self.rays, (share.shape[1] + 1, share.shape[2] + 1))
        return replace(
            self,
            image=inside(self.image),
            mask=(share >= 0.5).to(self.image),
            light=F.normalize(inside(self.light), dim=0),
            view=F.normalize(inside(self.view), dim=0),
            rays=rays,
            albedo=inside(self.albedo),
            roughness=inside(self.roughness),
            ambient=inside(self.ambient),
            known=known,
            pixel=self.pixel * (1 if self.rays is None else 2),
            likely=None if self.likely is None else F.normalize(inside(self.likely), dim=0),
            noise=self.noise / 4,
        )


@dataclass
class Surface:
    """What is sought.

    Attributes:
        height: (1, H + 1, W + 1) of the corners.
        albedo: (1, 1, 1), the logit of its share of `WHITEST`, where it is free.
        roughness: (1, 1, 1), the logit of its share of `ROUGHEST`, where it is free.
        ambient: (1, 1, 1), the logit of its share of `STRONGEST_AMBIENT`, where it is free.
    """

    height: Tensor
    albedo: Tensor
    roughness: Tensor
    ambient: Tensor


@dataclass(frozen=True)
class FitSettings:
    """How to fit: the reflectance model, what is free, and the weights of the priors."""

    model: str
    contour: bool
    smoothness: float
    silhouette: float
    free_albedo: bool
    free_roughness: bool
    free_ambient: bool


def _halve(values: Tensor) -> Tensor:
    return F.avg_pool2d(values, 2, ceil_mode=True, count_include_pad=False)


def _resize(values: Tensor, size: tuple[int, int]) -> Tensor:
    return F.interpolate(values[None], size=size, mode="bilinear", align_corners=True)[0]


def normals(height: Tensor, rays: Tensor | None, pixel: float) -> Tensor:
    """Unit normals of the pixels (3, H, W) from the heights of their corners (1, H + 1, W + 1)."""
    if rays is None:
        z = height[0]
        right = (z[:-1, 1:] + z[1:, 1:] - z[:-1, :-1] - z[1:, :-1]) / 2
        up = (z[:-1, :-1] + z[:-1, 1:] - z[1:, :-1] - z[1:, 1:]) / 2
        facing = (1 + right * right + up * up).rsqrt()
        return torch.stack((-right * facing, -up * facing, facing))
    points = rays * torch.exp(-height * pixel) / pixel
    falling = points[:, 1:, 1:] - points[:, :-1, :-1]
    rising = points[:, :-1, 1:] - points[:, 1:, :-1]
    return F.normalize(torch.linalg.cross(falling, rising, dim=0), dim=0)


def inflate(mask: Tensor) -> Tensor:
    """A pillow on a mask (1, H, W), corners' heights (1, H + 1, W + 1): a half ellipsoid on an ellipse."""
    require("pyamg", "scipy")
    import pyamg
    import scipy.sparse.linalg

    padded = F.pad(mask, (1, 1, 1, 1))[0] > 0.5
    inside = padded.cpu().numpy()
    kept = inside.flatten().nonzero()[0]
    system = pyamg.gallery.poisson(inside.shape, format="csr")[kept][:, kept]
    wanted = torch.full((len(kept),), 4.0, dtype=torch.float64).numpy()
    if len(kept) > 5000:
        solution = pyamg.ruge_stuben_solver(system.tocsr(), max_coarse=50).solve(wanted, tol=1e-4, accel="cg")
    else:
        solution = scipy.sparse.linalg.spsolve(system.tocsc(), wanted)
    square = torch.zeros(inside.shape, dtype=torch.float64)
    square[padded.cpu()] = torch.as_tensor(solution).reshape(-1)
    height = square.clamp_min(0).sqrt().to(mask)
    return corners(height[None, 1:-1, 1:-1])


def coarse_to_fine(scene: Scene) -> list[Scene]:
    """The scene at every size, the smallest first."""
    scenes = [scene]
    while min(scenes[-1].mask.shape[1:]) >= 2 * COARSEST:
        scenes.append(scenes[-1].halved())
    return scenes[::-1]


def fit(
    levels: Sequence[Scene], start: Surface, wish: FitSettings, show: str = "", most: float = math.inf
) -> tuple[Surface, float]:
    """One size after the other, from a surface of any size; the surface at the last one and its cost per pixel.

    What costs ``most`` before the silhouette's normals are asked, is not solved again with them: they add to it.
    """
    surface = start
    cost, pull = math.nan, 0.0
    for k, level in enumerate(track(levels, show) if show else levels):
        grown = surface.height.shape[1] - 1
        height = _resize(surface.height, _corners(level)) * (level.mask.shape[1] / grown)
        surface = replace(surface, height=height)
        surface, cost, left = _fit_level(level, surface, wish, pull)
        if level.likely is not None and k == max(len(levels) - 2, 0):  # fine enough to tell whether it is understood
            pull = wish.silhouette * left**2 / (left**2 + MISUNDERSTOOD**4)
            if pull > NEGLIGIBLE and cost < most:
                surface, cost, _ = _fit_level(level, surface, wish, pull)
    return surface, cost


def _corners(scene: Scene) -> tuple[int, int]:
    return scene.mask.shape[1] + 1, scene.mask.shape[2] + 1


def unknowns(scene: Scene, surface: Surface, wish: FitSettings) -> tuple[Tensor, Tensor, Tensor]:
    """Albedo, roughness and ambient light, given or found."""
    albedo = WHITEST * scene.unit * surface.albedo.sigmoid() if wish.free_albedo else scene.albedo
    roughness = ROUGHEST * surface.roughness.sigmoid() if wish.free_roughness else scene.roughness
    ambient = STRONGEST_AMBIENT * surface.ambient.sigmoid() if wish.free_ambient else scene.ambient
    return albedo, roughness, ambient


def shade(scene: Scene, surface: Surface, normal: Tensor, wish: FitSettings) -> Tensor:
    """The picture of a surface, (C, H, W)."""
    albedo, roughness, ambient = unknowns(scene, surface, wish)
    parts = normal, scene.light, scene.view, albedo, roughness, None
    return evaluation.shade(get_model(wish.model), parts, -3, normal.dtype) + albedo * ambient


def lit(scene: Scene, surface: Surface, wish: FitSettings) -> Tensor:
    """Pixels to which the light itself adds something, (1, H, W) bool."""
    albedo, _, ambient = unknowns(scene, surface, wish)
    added = (scene.image - albedo * ambient).mean(0, keepdim=True)
    return (added >= LIT * scene.unit) & (scene.mask > 0)


def _fit_level(scene: Scene, start: Surface, wish: FitSettings, pull: float) -> tuple[Surface, float, float]:
    """One size: the surface, its cost per pixel, and the variance that it leaves beyond the picture's noise."""
    with torch.enable_grad():
        terms = _Terms.of(scene, start, wish)
        shapes = [tuple(start.height.shape[1:])]
        for _ in range(SCALES - 1):
            shapes.append(((shapes[-1][0] + 1) // 2, (shapes[-1][1] + 1) // 2))
        moves = [start.height.new_zeros(1, *shape).requires_grad_() for shape in shapes]
        albedo = start.albedo.clone().requires_grad_(wish.free_albedo)
        roughness = start.roughness.clone().requires_grad_(wish.free_roughness)
        ambient = start.ambient.clone().requires_grad_(wish.free_ambient)

        def now() -> Surface:
            height = start.height
            for k, move in enumerate(moves):
                height = height + SCALE_GAIN**k * (move if k == 0 else _resize(move, (shapes[0][0], shapes[0][1])))
            return Surface(height, albedo, roughness, ambient)

        free = [*moves, *(p for p in (albedo, roughness, ambient) if p.requires_grad)]
        optimiser = torch.optim.LBFGS(
            free,
            max_iter=STEPS,
            history_size=HISTORY,
            line_search_fn="strong_wolfe",
            tolerance_change=1e-7,
            tolerance_grad=1e-6,
        )

        def closure() -> Tensor:
            optimiser.zero_grad()
            cost = terms.cost(now(), pull)
            cost.backward()
            return cost

        with _one_thread(scene.mask.numel() < SMALL):
            optimiser.step(closure)
        with torch.no_grad():
            found = now()
            pixels = scene.mask.sum().clamp_min(1)
            cost = float(terms.cost(found, pull) / pixels)
            missed = terms.missed(found, normals(found.height, scene.rays, scene.pixel))
            beyond_noise = max(float(missed.sum() / pixels) - scene.noise, 0.0)
    found = Surface(*(values.detach() for values in (found.height, found.albedo, found.roughness, found.ambient)))
    return found, cost, beyond_noise


@contextmanager
def _one_thread(wanted: bool) -> Iterator[None]:
    """Work on one thread for a while, where more gain little: beside another busy process they wait for each other."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1 if wanted else threads)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@dataclass(frozen=True)
class _Terms:
    """The cost of a surface; ``lit`` is None where it changes with what is sought."""

    scene: Scene
    wish: FitSettings
    border: Tensor
    outward: Tensor
    across: Tensor
    along: Tensor
    lit: Tensor | None

    @staticmethod
    def of(scene: Scene, start: Surface, wish: FitSettings) -> _Terms:
        mask = scene.mask
        blurred = F.pad(mask, (6, 6, 6, 6))  # the blur and the difference reach beyond the picture
        for radius in (3, 2):
            blurred = F.avg_pool2d(blurred, 2 * radius + 1, 1)
        falling = torch.cat(
            (blurred[:, 1:-1, :-2] - blurred[:, 1:-1, 2:], blurred[:, 2:, 1:-1] - blurred[:, :-2, 1:-1])
        )
        outward = F.pad(F.normalize(falling, dim=0), (0, 0, 0, 0, 0, 1))
        outward = F.normalize(outward - (outward * scene.view).sum(0, keepdim=True) * scene.view, dim=0)
        inner = -F.max_pool2d(-F.pad(mask, (1, 1, 1, 1)), 3, 1)
        border = mask * (inner < 1)
        return _Terms(
            scene,
            wish,
            border * wish.contour,
            outward,
            mask[:, :, 1:] * mask[:, :, :-1],
            mask[:, 1:] * mask[:, :-1],
            None if wish.free_albedo or wish.free_ambient else lit(scene, start, wish),
        )

    def missed(self, surface: Surface, normal: Tensor) -> Tensor:
        """Squared brightness that is not explained, (1, H, W), in units of the bright end; outliers count less."""
        missed = (shade(self.scene, surface, normal, self.wish) - self.scene.image) / self.scene.unit
        missed = missed.square().mean(0, keepdim=True) * self.scene.mask
        return missed / (1 + missed / OUTLIER**2)

    def cost(self, surface: Surface, pull: float) -> Tensor:
        """Sum over pixels: brightness missed, likely normals, bends, contour, twist, pixels to be lit, known heights.

        ``pull`` weighs the normals of the inflated silhouette: as much as the reflectance leaves unexplained.
        """
        scene, mask = self.scene, self.scene.mask
        normal = normals(surface.height, scene.rays, scene.pixel)
        total = self.missed(surface, normal).sum()
        if scene.likely is not None and pull:
            total = total + pull * ((normal - scene.likely).square() * mask).sum()
        bends = ((normal[:, :, 1:] - normal[:, :, :-1]).square() * self.across).sum()
        bends = bends + ((normal[:, 1:] - normal[:, :-1]).square() * self.along).sum()
        total = total + self.wish.smoothness * bends
        z = surface.height
        twist = (z[:, :-1, :-1] + z[:, 1:, 1:] - z[:, 1:, :-1] - z[:, :-1, 1:]) * normal[2:] * mask
        total = total + TWIST * twist.square().sum()
        outward = (normal * self.outward).sum(0, keepdim=True)
        total = total + CONTOUR * ((CONTOUR_COSINE - outward).clamp_min(0).square() * self.border).sum()
        if not self.wish.contour:
            slant = (normal[:2] * mask).flatten(1).sum(1) / mask.sum().clamp_min(1)
            total = total + LEVEL * slant.square().sum() * mask.sum()
        away = -(normal * scene.light).sum(0, keepdim=True)
        bright = lit(scene, surface, self.wish) if self.lit is None else self.lit
        total = total + UNLIT * (away.clamp_min(0).square() * bright).sum()
        sure = scene.known.isfinite()
        if bool(sure.any()):
            total = total + KNOWN * (centres(z) - scene.known.nan_to_num(0)).square().mul(sure).sum()
        return total


def corners(values: Tensor) -> Tensor:
    """Means at the corners of pixels (1, H + 1, W + 1) of what pixels (1, H, W) have; 0 beyond the picture."""
    return F.avg_pool2d(F.pad(values, (1, 1, 1, 1)), 2, 1)


def centres(height: Tensor) -> Tensor:
    """Heights of pixels (1, H, W) from those of their corners."""
    return (height[:, :-1, :-1] + height[:, 1:, :-1] + height[:, :-1, 1:] + height[:, 1:, 1:]) / 4
