"""What to expect of a surface before its shading is looked at closely: the network's normals, or the outline's."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.findings import Finding
from .objective import Reflectance, shade
from .picture_network import learned_normals, load_picture_network
from .scene import PictureScene, Prior

OUTLINE_TRUSTED = 1.2
"""Factor by which albedo under the network's normals must vary more from pixel to pixel than under the inflated
silhouette's for these to be taken. Set by hand: it is .2 to .95 on 12 renders and 8 photographs, and 1.9 on a ball
painted in a chequer, which the network misreads."""
EXPLAINED = 0.1
"""Share of a picture's brightness by which the inflated silhouette may miss it to be taken for the surface. Set by
hand: .01 to .05 on three balls, .06 and more on 27 other objects, where the network's normals miss by less."""
GRAZING, DARKEST, REACH = 0.15, 0.03, 2
"""Least cosine to the light and share of the peak (or of the largest albedo) at which albedo is judged, and the
distance in pixels over which it is compared. Set by hand."""


def with_learned_prior(scene: PictureScene, model: str, *, albedo_unknown: bool) -> tuple[PictureScene, list[Finding]]:
    """The scene with the network's normals to expect, or with the inflated silhouette's where these fit better.

    Args:
        scene: whose prior is the inflated silhouette.
        model: the reflectance model.
        albedo_unknown: whether the scene's albedo is only a start.
    """
    assert scene.prior is not None
    read = _read(scene, albedo_unknown=albedo_unknown)
    if _paint_edges(scene, read.normal) >= OUTLINE_TRUSTED * _paint_edges(scene, scene.prior.normal):
        text = "starts from the inflated silhouette: under its normals the paint has fewer edges than the network's."
        return scene, [Finding(text, "outline-trusted")]
    assert read.error is not None
    outline, network = (_misfit(scene, n, model, albedo_unknown) for n in (scene.prior.normal, read.normal))
    if outline < min(network, EXPLAINED):
        text = "starts from the inflated silhouette, which explains the picture better than the network's normals."
        inflated = Prior(scene.prior.normal, read.error * (outline / network))
        return replace(scene, prior=inflated), [Finding(text, "outline-trusted")]
    degrees = math.degrees(float(read.error[scene.mask > 0].square().mean().sqrt()))
    text = f"starts from normals that a network reads in the picture, to {degrees:.0f} degrees as it expects."
    return replace(scene, prior=read), [Finding(text, "network-start", degrees)]


def _read(scene: PictureScene, *, albedo_unknown: bool) -> Prior:
    """What the network reads in each picture, averaged; of several pictures its error does not become smaller."""
    inside = scene.mask > 0
    even = scene.image if albedo_unknown else scene.image / scene.albedo.clamp_min(DARKEST * scene.albedo.max())
    network = load_picture_network()
    read = [learned_normals(image, light, inside, network) for image, light in zip(even, scene.light, strict=True)]
    weights = [inside / found.error.square().clamp_min(1e-6) for found in read]
    normal = torch.stack([found.normal * weight for found, weight in zip(read, weights, strict=True)]).sum(0)
    return Prior(F.normalize(normal, dim=0), torch.stack(weights).mean(0).clamp_min(1e-6).rsqrt())


def _misfit(scene: PictureScene, normal: Tensor, model: str, albedo_unknown: bool) -> float:
    """`misfit` of the shading of normals (3, H, W) in the bright pixels of all pictures."""
    shaded = shade(scene, Reflectance(scene.albedo, scene.roughness, scene.ambient), normal, model).mean(1)
    grey = scene.image.mean(1)
    bright = (scene.mask[0] > 0) & (grey > DARKEST * scene.peak)
    return misfit(grey[bright], shaded[bright], scaled=albedo_unknown)


def misfit(seen: Tensor, shaded: Tensor, *, scaled: bool) -> float:
    """Median difference of brightness (P,) and shading (P,) as a share of the mean brightness.

    Args:
        seen: of pixels that are not dark.
        shaded: the same pixels under a model.
        scaled: whether the albedo is unknown: then the one counts that makes the sum of all differences least.
    """
    if not len(seen):
        return math.inf
    if scaled:
        ratio, order = (seen / shaded.clamp_min(1e-9)).sort()
        passed = shaded[order].cumsum(0)
        shaded = shaded * ratio[int((passed < passed[-1] / 2).sum())]
    return float((seen - shaded).abs().median() / seen.mean())


def _paint_edges(scene: PictureScene, normal: Tensor) -> float:
    """How much the albedo would vary from pixel to pixel under normals (3, H, W), in the middle of all pixels.

    Paint has few edges: under the true normals most neighbours have one albedo. Median of the differences of the
    logarithms of picture over shading, over `REACH` pixels.
    """
    shading = (normal * scene.light).sum(1, keepdim=True)
    grey = scene.image.mean(1, keepdim=True)
    sure = (scene.mask > 0) & (shading > GRAZING) & (grey > DARKEST * scene.peak)
    albedo = torch.where(sure, grey.clamp_min(1e-9) / shading.clamp_min(GRAZING), 1.0).log()
    differences = [
        (albedo.narrow(axis, REACH, size) - albedo.narrow(axis, 0, size)).abs()[
            sure.narrow(axis, REACH, size) & sure.narrow(axis, 0, size)
        ]
        for axis, size in ((2, albedo.shape[2] - REACH), (3, albedo.shape[3] - REACH))
        if size > 0
    ]
    found = torch.cat(differences) if differences else albedo.new_zeros(0)
    return float(found.median()) if found.numel() else 0.0
