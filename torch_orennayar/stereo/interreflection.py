"""Light that parts of a surface send to each other, found from photographs and taken out of them.

What every part sends is what its photograph shows; where it goes follows from a first, simple surface. How white the
surface is in truth, photographs of unknown exposure do not tell: that one number is chosen by how well what is left
is explained.

Source: the idea of taking shapes and light between them in turns: Nayar, Ikeuchi & Kanade 1991, "Shape from
interreflections".
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.optional import require
from ..geometry.integrate import integrate_normals
from ..render.radiosity import arriving, form_factors
from . import robust_fit
from .material import LightDirections, Material
from .material_selection import SAMPLE_PIXELS, error
from .robust_fit import PixelFit
from .roughness_map import at_levels
from .row_bands import gather, gather_directions, solve_bands

MOST_PIXELS = 15_000
"""Of the picture on which light is followed; larger ones are halved until they fit."""
STEEPEST = 0.15
"""Least cosine to the view with which a pixel's surface is reckoned."""
STRENGTHS = (0.2, 0.4, 0.6, 0.8, 1.0)
"""Albedos that are tried for the brightest twentieth of the surface."""
PATCHES = 1000
"""Of the surface, whose light is followed."""
CHUNK = 4096
"""Pixels at once."""
LOOKED_AT = 10_000
"""Pixels among which hollows are sought."""
NOTABLE = 0.03
"""Share of a pixel's light that must come from others, were they white, for it to lie in a hollow."""
FEWEST = 100
"""Hollow pixels that can decide."""
DARKEST = 0.01
"""Share of the object's mean below which a pixel's own light is noise."""
MOST_SHARE = 2.0
"""Of a pixel's own light: more than all of it comes from others only if they are less white than reckoned."""
GAIN = 0.005
"""Share of the misfit in hollows that must go."""


@dataclass(frozen=True)
class InterreflectedLight:
    """Light from other parts of the surface.

    Attributes:
        share: (K, C, h, w) of a pixel's mean over lights, for a surface whose brightest parts are white.
        factor: how many times smaller than the photographs it is.
        strength: albedo of those parts.
    """

    share: Tensor
    factor: int
    strength: float = 1.0

    def removed_from(self, images: Tensor, first: int) -> Tensor:
        """Rows ``first`` on of the photographs, (K, C, R, W), without that light."""
        rows, columns = (torch.arange(n, device=images.device) for n in images.shape[2:])
        places = self._places(rows[:, None] + first, columns)
        mean = images.mean(0, dtype=self.share.dtype).clamp_min(0)
        left = torch.empty_like(images)
        for k, image in enumerate(images):
            left[k] = image - (self.strength * _sampled(self.share[k : k + 1], places)[0] * mean).to(images)
        return left

    def at(self, seen: Tensor, picked: Tensor, width: int) -> Tensor:
        """That light at P pixels of a picture so wide that show ``seen`` (P, C, K)."""
        places = self._places(picked // width, picked % width)
        mean = seen.to(self.share).mean(2, keepdim=True).clamp_min(0)
        return self.strength * _sampled(self.share, places[None])[:, :, 0].permute(2, 1, 0) * mean

    def _places(self, rows: Tensor, columns: Tensor) -> Tensor:
        """Pixels in grid_sample's units, (..., 2)."""
        height, width = (self.factor * n for n in self.share.shape[2:])
        x, y = torch.broadcast_tensors((columns + 0.5) / width * 2 - 1, (rows + 0.5) / height * 2 - 1)
        return torch.stack((x, y), -1).to(self.share)


def _sampled(maps: Tensor, places: Tensor) -> Tensor:
    """Maps (N, C, h, w) at (R, S, 2)."""
    return F.grid_sample(maps, places.expand(len(maps), -1, -1, -1), padding_mode="border", align_corners=False)


def choose_interreflected_light(
    images: Tensor, lights: Tensor, inside: Tensor, material: Material, seed: int
) -> tuple[InterreflectedLight | None, str]:
    """The light to take out of photographs, if that explains hollows better, and a sentence on it."""
    alone = None, "parts of the surface hardly light each other."
    place = inside.flatten().nonzero().flatten()
    if len(place) < FEWEST:
        return alone
    interreflected = find_interreflected_light(images, lights, inside)
    generator = torch.Generator().manual_seed(seed)
    picked = place[torch.randperm(len(place), generator=generator)[:LOOKED_AT].to(place.device)]
    received = interreflected.at(images.flatten(2)[:, :, picked].permute(2, 1, 0), picked, images.shape[3]).mean(1)
    grey = gather(images, picked)
    share = received.mean(1) / robust_fit.mean_of(grey)[:, 0]
    hollow = (share > NOTABLE).nonzero().flatten()[:SAMPLE_PIXELS]
    if len(hollow) < FEWEST:
        return alone
    received, grey = received[hollow], grey[hollow]
    rays = LightDirections.of(gather_directions(lights, picked[hollow]).to(grey))
    unit, weight = robust_fit.mean_of(grey), robust_fit.in_light(grey) * share[hollow, None]

    def explain(strength: float, material: Material, start: PixelFit, steps: int) -> tuple[float, PixelFit]:
        left = grey - strength * received
        fitted = robust_fit.fit(left, rays, material, start=start, steps=steps)
        return error(left, robust_fit.predict(fitted, rays, material), unit, weight), fitted

    start = robust_fit.fit(grey, rays, Material(), used="middle", steps=8)
    levels = at_levels(material) if material.varied else [material]
    tried = [(*explain(0.0, level, start, 12), level) for level in levels]
    least, fitted, material = min(tried, key=lambda found: found[0])
    costs = {0.0: least}
    for strength in STRENGTHS:
        costs[strength], fitted = explain(strength, material, fitted, 6)
    best = min(costs, key=costs.__getitem__)
    listed = ", ".join(f"{strength:g} {cost:.4f}" for strength, cost in costs.items())
    if costs[best] > (1 - GAIN) * least:
        return None, f"light between parts of the surface explains hollows no better (misfit by albedo: {listed})."
    return replace(interreflected, strength=best), (
        f"light that parts of the surface send each other is taken away, as of a surface whose brightest parts have "
        f"albedo {best:g} (misfit by albedo: {listed})."
    )


def find_interreflected_light(images: Tensor, lights: Tensor, inside: Tensor) -> InterreflectedLight:
    """What every pixel of photographs (K, C, H, W) receives from the others, if the brightest are white."""
    factor, pixels = 1, int(inside.sum())
    while pixels > MOST_PIXELS * factor * factor:
        factor *= 2
    small, mask = _pooled(images, inside, factor)
    if lights.ndim == 4:
        lights = F.normalize(F.avg_pool2d(torch.where(inside, lights, 0), factor, ceil_mode=True), dim=1)
    found = solve_bands(small, lights, mask, Material(), "middle")
    points, part = _points(found["normal"], mask), _parts(inside, factor)[mask]
    normal, seen, albedo = (m[..., mask].movedim(-1, 0) for m in (found["normal"], small, found["albedo"]))
    order = torch.randperm(len(points), generator=torch.Generator().manual_seed(0))[:PATCHES].to(points.device)
    area = len(points) / len(order) / normal[order, 2:].clamp_min(STEEPEST)
    white = albedo.amax(1).quantile(0.95).clamp_min(1e-12)
    mean = seen.abs().mean(1)  # (P, C)
    own = albedo / white / torch.maximum(mean, DARKEST * mean.mean())
    received = []
    for rows in torch.arange(len(points), device=points.device).split(CHUNK):
        factors = form_factors(points[rows], normal[rows], points[order], normal[order], area)
        factors = factors * (part[rows, None] == part[order])
        received.append(arriving(factors, seen[order].clamp_min(0)) * own[rows, None])
    share = torch.zeros_like(small)
    share[..., mask] = torch.cat(received).clamp_max(MOST_SHARE).movedim(0, -1)
    return InterreflectedLight(share, factor)


def _pooled(images: Tensor, inside: Tensor, factor: int) -> tuple[Tensor, Tensor]:
    """Photographs (K, C, h, w) and mask (h, w), so many times smaller: means of what is inside, in float32."""
    weight = F.avg_pool2d(inside[None].float(), factor, ceil_mode=True, count_include_pad=False)
    small = [
        F.avg_pool2d(torch.where(inside, image, 0).to(weight), factor, ceil_mode=True, count_include_pad=False)
        / weight.clamp_min(1e-6)
        for image in images
    ]
    return torch.stack(small), weight[0] > 0


def _points(normal: Tensor, mask: Tensor) -> Tensor:
    """Where the pixels lie, (P, 3), in pixels."""
    height = integrate_normals(normal, mask[None])[0, mask].to(normal)
    row, column = mask.nonzero().unbind(1)
    return torch.stack((column.to(height), -row.to(height), height), 1)


def _parts(inside: Tensor, factor: int) -> Tensor:
    """Number of the connected part that every pixel of a smaller picture belongs to, (h, w)."""
    require("scipy")
    from scipy.ndimage import label

    parts = torch.from_numpy(label(inside.cpu().numpy())[0]).to(inside.device)
    return F.max_pool2d(parts[None].float(), factor, ceil_mode=True)[0]
