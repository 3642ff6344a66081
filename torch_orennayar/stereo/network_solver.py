"""Photometric stereo by the network that ships with the package, in torch and as an ONNX graph."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..core.progress import track
from .closed_form import Prepare, middle_ranks
from .interreflection import DARKEST
from .pixel_grid import Grid
from .row_bands import gather_directions
from .set_network import SetNetwork, load_network

if TYPE_CHECKING:
    from .interreflection import InterreflectedLight

NETWORK = "network"
"""The name that `photometric_stereo` takes."""
TRAINED_LIGHTS = 12
"""The fewest lights that it has seen."""
SUREST = 1e-3
"""Least error of a normal that is reckoned with, radians."""
REACH, SPREAD = 2, 1.3
"""How far normals are smoothed, in pixels, and the standard deviation of that."""
UNLIKE, TRUST = 3.0, 0.7
"""By how many of their errors neighbours may differ, and the power of the error that weighs them down; 1 and 2 if the
network knew its errors, but on rendered captures it errs by more than it expects."""
CHUNK, CHUNK_ACCELERATOR = 1 << 13, 1 << 20
"""Observations at once: what fits in cache, and what keeps an accelerator busy."""


class Paint(nn.Module):
    """Lambert's albedo under given normals."""

    def forward(self, seen: Tensor, lights: Tensor, normal: Tensor) -> tuple[Tensor, Tensor]:
        """Of pixels (P, C, K), lights (K, 3) or (P, K, 3) and normals (P, 3): albedo (P, C), grey's misfit (P, 1)."""
        shown = (normal[:, None] * lights).sum(2).clamp_min(0.0)
        grey = seen.mean(1)
        pull = middle_ranks(grey) * shown
        level = (pull * shown).sum(1, keepdim=True).clamp_min(1e-9)
        albedo = (pull[:, None] * seen).sum(2) / level
        missed = (grey - albedo.mean(1, keepdim=True) * shown).abs().mean(1, keepdim=True)
        return albedo.clamp_min(0.0), missed


class Smooth(nn.Module):
    """Mean normal of a picture's pixels and those about them.

    The near ones and those of small error count more; those that differ by far more than both errors explain, as across
    an edge, count less.
    """

    def forward(self, normal_map: Tensor, error_map: Tensor) -> Tensor:
        """Normals (3, H, W), 0 outside the mask, errors (1, H, W)."""
        both, side = torch.cat((normal_map, error_map))[None], 2 * REACH + 1
        variance = error_map.clamp_min(SUREST).square()
        total = torch.zeros_like(normal_map)
        for place, shift in enumerate(torch.eye(side * side).reshape(-1, 1, 1, side, side)):
            there = F.conv2d(both, shift.to(both).expand(4, 1, side, side), padding=REACH, groups=4)[0]
            normal, error = there[:3], there[3:].clamp_min(SUREST)
            apart = (normal - normal_map).square().sum(0, keepdim=True) / (variance + error.square())
            away = ((place // side - REACH) ** 2 + (place % side - REACH) ** 2) / SPREAD**2
            total = total + normal * (torch.exp(-0.5 * (apart / UNLIKE**2 + away)) / error**TRUST)
        return F.normalize(total, dim=0)


def solve_network(
    images: Tensor,
    lights: Tensor,
    inside: Tensor,
    network: SetNetwork | None = None,
    interreflected: InterreflectedLight | None = None,
) -> dict[str, Tensor]:
    """Maps (C, H, W) as of `solve_bands`: the network's normals, smoothed, and Lambert's albedo under them.

    ``interreflected``, light that parts of the surface send each other, is taken away first.
    """
    network = (network or load_network()).to(images.device)
    dtype = next(network.parameters()).dtype
    grid, place, flat = Grid(inside), inside.flatten().nonzero().flatten(), images.flatten(2)
    most = CHUNK if images.device.type == "cpu" else CHUNK_ACCELERATOR
    chunks = place.split(max(1, most // len(images)))

    def look(chunk: Tensor) -> tuple[Tensor, Tensor]:
        seen = flat[:, :, chunk].permute(2, 1, 0).to(dtype)
        if interreflected:  # a little stays, so that no pixel turns black
            seen = torch.maximum(seen - interreflected.at(seen, chunk, images.shape[3]).to(dtype), DARKEST * seen)
        return seen, gather_directions(lights, chunk).to(dtype)

    with torch.no_grad():
        found = []
        for chunk in track(chunks, "network"):
            seen, directions = look(chunk)
            found.append(network(Prepare()(seen)[0], directions))
        normal, error = (torch.cat(values) for values in zip(*found, strict=True))
        error = error.clamp_max(math.pi / 2)
        normal = Smooth()(grid.draw(normal), grid.draw(error)).flatten(1)[:, place].T
        painted = [
            Paint()(*look(chunk), part) for chunk, part in zip(chunks, normal.split(chunks[0].shape[0]), strict=True)
        ]
    albedo, residual = (torch.cat(values) for values in zip(*painted, strict=True))
    return {
        "normal": grid.draw(normal),
        "albedo": grid.draw(albedo),
        "albedo_grey": grid.draw(albedo.mean(1, keepdim=True)),
        "residual": grid.draw(residual),
        "confidence": grid.draw(1 / (1 + (error / math.radians(2)) ** 2)),
        "roughness": grid.draw(torch.zeros_like(error)),
        "error": grid.draw(error),
    }
