"""Light that parts of a surface send to each other, found from photographs.

What every part sends is what its photograph shows; where it goes follows from a first, Lambertian surface. Photographs
of unknown exposure do not determine how white the surface is: that one number is chosen by how well the remaining light
is explained.

Source: the idea of alternating between shape and interreflection: Nayar, Ikeuchi & Kanade 1991, "Shape from
interreflections".
"""

from __future__ import annotations

from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.findings import Finding
from ..core.optional import require
from ..geometry.integrate import integrate_normals
from ..render.radiosity import arriving, form_factors
from . import robust_fit
from .interreflected_light import InterreflectedLight
from .material import Material
from .material_refinement import capped_error
from .pixel_sample import SAMPLE_PIXELS, PixelSample, draw_places
from .robust_fit import PixelFit
from .robust_stats import in_light, mean_brightness
from .roughness_map import at_levels
from .row_bands import solve_bands

MOST_PIXELS = 15_000
"""Pixels of the picture on which light is followed; larger pictures are halved until they have fewer. Set by hand."""
STEEPEST = 0.15
"""Least cosine to the view in the area of a pixel's surface. Set by hand."""
STRENGTHS = (0.2, 0.4, 0.6, 0.8, 1.0)
"""Albedos that are tried for the brightest twentieth of the surface. Set by hand."""
PATCHES = 1000
"""Pixels that stand for the surface as senders of light. Set by hand."""
CHUNK = 4096
"""Receiving pixels that are evaluated together, which bounds the memory. Set by hand."""
CANDIDATES = 10_000
"""Pixels among which hollows are sought. Set by hand."""
NOTABLE = 0.03
"""Share of a pixel's light that must come from other parts, were they white, for it to lie in a hollow. Set by hand."""
FEWEST = 100
"""Number of hollow pixels that can decide. Set by hand."""
DARKEST = 0.01
"""Share of the object's mean below which a pixel's own light is noise. Set by hand."""
MOST_SHARE = 2.0
"""Greatest share of a pixel's own light that may come from other parts: above 1 only if they are less white than
assumed. Set by hand."""
GAIN, GAIN_MIXED = 0.005, 0.02
"""Share of the misfit in hollows that must vanish for the light to be removed: from surfaces of one material, and of
several, on which the misfit of the one is larger. Set by hand."""


def choose_interreflected_light(
    images: Tensor, lights: Tensor, inside: Tensor, material: Material, seed: int, *, mixed: bool = False
) -> tuple[InterreflectedLight | None, Finding]:
    """The light to remove from photographs, if that explains hollows better, and a finding on it.

    Args:
        images: (K, C, H, W).
        lights: (K, 3) or (K, 3, H, W).
        inside: (H, W) bool.
        material: of the surface.
        seed: picks the pixels among which hollows are sought.
        mixed: whether it is one of several materials.
    """
    no_hollows = Finding("parts of the surface hardly light each other.", "interreflection-kept")
    if int(inside.sum()) < FEWEST:
        return None, no_hollows
    interreflected = find_interreflected_light(images, lights, inside)
    hollows, received, share = _sample_hollows(images, lights, inside, interreflected, seed)
    if len(hollows) < FEWEST:
        return None, no_hollows
    costs = _misfit_by_strength(hollows, received, share, material)
    best = min(costs, key=costs.__getitem__)
    listed = ", ".join(f"{strength:g} {cost:.4f}" for strength, cost in costs.items())
    if costs[best] > (1 - (GAIN_MIXED if mixed else GAIN)) * costs[0.0]:
        text = f"removing light between parts of the surface explains hollows no better (misfit by albedo: {listed})."
        return None, Finding(text, "interreflection-kept")
    text = (
        f"light between parts of the surface is removed, as of a surface whose brightest parts have albedo {best:g} "
        f"(misfit by albedo: {listed})."
    )
    return replace(interreflected, strength=best), Finding(text, "interreflection-removed", best)


def _sample_hollows(
    images: Tensor, lights: Tensor, inside: Tensor, interreflected: InterreflectedLight, seed: int
) -> tuple[PixelSample, Tensor, Tensor]:
    """Pixels in hollows, the light (P, K) that they receive from other parts, and that as a share of theirs, (P,)."""
    places = draw_places(inside, CANDIDATES, seed)
    seen = images.flatten(2)[:, :, places].permute(2, 1, 0)
    received = interreflected.at(seen, places, images.shape[3]).mean(1)
    candidates = PixelSample.gather(images, lights, places)
    share = received.mean(1) / mean_brightness(candidates.grey)[:, 0]
    hollow = (share > NOTABLE).nonzero().flatten()[:SAMPLE_PIXELS]
    return candidates[hollow], received[hollow], share[hollow]


def _misfit_by_strength(
    hollows: PixelSample, received: Tensor, share: Tensor, material: Material
) -> dict[float, float]:
    """Error of the fit to hollows without the light that they receive, by the albedo of the surface; 0 removes none."""
    mean, weight = mean_brightness(hollows.grey), in_light(hollows.grey) * share[:, None]

    def misfit(strength: float, material: Material, start: PixelFit, steps: int) -> tuple[float, PixelFit]:
        left = replace(hollows, grey=hollows.grey - strength * received)
        fitted = robust_fit.fit(left, material, start=start, steps=steps)
        predicted = robust_fit.predict(fitted, left.directions, material)
        return capped_error(left.grey, predicted, mean, weight), fitted

    start = robust_fit.fit(hollows, Material(), used="middle", steps=8)
    levels = at_levels(material) if material.roughness_varies else [material]
    tried = [(*misfit(0.0, level, start, 12), level) for level in levels]
    least, fitted, material = min(tried, key=lambda found: found[0])
    costs = {0.0: least}
    for strength in STRENGTHS:
        costs[strength], fitted = misfit(strength, material, fitted, 6)
    return costs


def find_interreflected_light(images: Tensor, lights: Tensor, inside: Tensor) -> InterreflectedLight:
    """What every pixel of photographs (K, C, H, W) receives from the others, if the brightest parts are white.

    The photographs are made smaller first, and solved for a Lambertian surface.
    """
    factor, pixels = 1, int(inside.sum())
    while pixels > MOST_PIXELS * factor * factor:
        factor *= 2
    small, mask = _pooled(images, inside, factor)
    if lights.ndim == 4:
        lights = F.normalize(F.avg_pool2d(torch.where(inside, lights, 0), factor, ceil_mode=True), dim=1)
    surface = solve_bands(small, lights, mask, Material(), "middle")
    points, part = _points(surface.normal, mask), _parts(inside, factor)[mask]
    normal, seen, albedo = (m[..., mask].movedim(-1, 0) for m in (surface.normal, small, surface.albedo))
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
    """Positions of the pixels' surface, (P, 3), in pixels."""
    height = integrate_normals(normal, mask[None])[0, mask].to(normal)
    row, column = mask.nonzero().unbind(1)
    return torch.stack((column.to(height), -row.to(height), height), 1)


def _parts(inside: Tensor, factor: int) -> Tensor:
    """Number of the connected part that every pixel of a smaller picture belongs to, (h, w)."""
    require("scipy")
    from scipy.ndimage import label

    parts = torch.from_numpy(label(inside.cpu().numpy())[0]).to(inside.device)
    return F.max_pool2d(parts[None].float(), factor, ceil_mode=True)[0]
