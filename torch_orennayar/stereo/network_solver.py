"""Photometric stereo by the network that ships with the package: its normals, smoothed, and Lambert's albedo."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..core.progress import track
from ..core.threads import side_by_side, worker_count
from ..reconstruction import confidence_from_error
from .closed_form import Clean, Prepare
from .interreflected_light import InterreflectedLight
from .pixel_grid import Grid
from .pixel_sample import PixelSample, gather_directions
from .robust_stats import soft_middle
from .set_network import SetNetwork, load_network
from .solved_maps import SolvedMaps

NETWORK = "network"
"""The name of this solver among the models of `photometric_stereo`."""
TRAINED_LIGHTS = 12
"""Least number of lights of a pixel in the training of ``examples/train_photometric_stereo.py``."""
LEAST_ERROR = 1e-3
"""Radians, the least error of a normal in the weights of the smoothing. Set by hand."""
REACH, SPREAD = 2, 1.3
"""Pixels up to which normals are smoothed, and the standard deviation of the weights over them. Compared by mean error
on rendered captures (3.85 to 3.53 degrees); the script is not kept."""
EDGE, ERROR_POWER = 3.0, 0.7
"""Standard errors by which neighbours may differ, and the power of the error that divides their weight. They would be 1
and 2 if the network's errors were exact; chosen on 220 rendered captures, on which it errs by more than it expects; the
script is not kept."""
LEAST_LEFT = 0.01
"""Share of an observation that is left at least when light between parts of the surface is removed, so that no pixel
turns black. Set by hand."""
CHUNK, CHUNK_ACCELERATOR = 1 << 13, 1 << 20
"""Observations that the network reads together: what fits in a processor's cache, and what keeps an accelerator busy.
Set by hand."""


class Paint(nn.Module):
    """Lambert's albedo under given normals."""

    def forward(self, seen: Tensor, lights: Tensor, normal: Tensor) -> tuple[Tensor, Tensor]:
        """Weighted least squares on the observations of middle rank.

        Args:
            seen: (P, C, K).
            lights: (K, 3) or (P, K, 3).
            normal: (P, 3).

        Returns:
            Albedo (P, C), and the mean absolute residual of grey (P, 1).
        """
        shown = (normal[:, None] * lights).sum(2).clamp_min(0.0)
        grey = seen.mean(1)
        weighted = soft_middle(grey) * shown
        level = (weighted * shown).sum(1, keepdim=True).clamp_min(1e-9)
        albedo = (weighted[:, None] * seen).sum(2) / level
        residual = (grey - albedo.mean(1, keepdim=True) * shown).abs().mean(1, keepdim=True)
        return albedo.clamp_min(0.0), residual


class Smooth(nn.Module):
    """Bilateral mean of normals.

    Neighbours that are near and have a small expected error weigh more; those that differ by far more than both errors
    explain, as across an edge, weigh less.
    """

    def forward(self, normal_map: Tensor, error_map: Tensor) -> Tensor:
        """Of normals (3, H, W), 0 outside the mask, and errors (1, H, W), radians: normals (3, H, W)."""
        both, side = torch.cat((normal_map, error_map))[None], 2 * REACH + 1
        variance = error_map.clamp_min(LEAST_ERROR).square()
        total = torch.zeros_like(normal_map)
        for place, shift in enumerate(torch.eye(side * side).reshape(-1, 1, 1, side, side)):
            there = F.conv2d(both, shift.to(both).expand(4, 1, side, side), padding=REACH, groups=4)[0]
            normal, error = there[:3], there[3:].clamp_min(LEAST_ERROR)
            difference = (normal - normal_map).square().sum(0, keepdim=True) / (variance + error.square())
            distance = ((place // side - REACH) ** 2 + (place % side - REACH) ** 2) / SPREAD**2
            total = total + normal * (torch.exp(-0.5 * (difference / EDGE**2 + distance)) / error**ERROR_POWER)
        return F.normalize(total, dim=0)


class LearnedNormals(NamedTuple):
    """What the network says of P pixels.

    Attributes:
        normal: (P, 3) unit.
        error: (P, 1) radians that it expects to err by.
    """

    normal: Tensor
    error: Tensor


@torch.no_grad()
def read_normals(sample: PixelSample, grid: Grid | None = None) -> LearnedNormals:
    """Normals of grey pixels, in their dtype, smoothed where a grid of all of them is given."""
    grey, network = sample.grey, load_network().to(sample.grey.device)
    size = _chunk(grey.shape[1], grey.device)
    parts = [sample[i : i + size] for i in range(0, len(sample), size)]

    def read(part: PixelSample) -> tuple[Tensor, Tensor]:
        seen = Prepare()(part.grey[:, None].float().clamp_min(0))[0]
        found: tuple[Tensor, Tensor] = network(seen, part.directions.light.float())
        return found

    read_parts = side_by_side(read, parts, workers=worker_count() if grey.device.type == "cpu" else 1)
    normal, error = (torch.cat(values) for values in zip(*read_parts, strict=True))
    error = error.clamp_max(math.pi / 2)
    if grid is not None:
        normal = Smooth()(grid.draw(normal), grid.draw(error))[:, grid.mask].T
    return LearnedNormals(normal.to(grey), error.to(grey))


def solve_network(
    images: Tensor, lights: Tensor, inside: Tensor, network: SetNetwork | None = None
) -> dict[str, Tensor]:
    """What the graph computes, in torch, by the names of its outputs.

    Args:
        images: (K, C, H, W).
        lights: (K, 3) unit, camera frame.
        inside: (H, W) bool.
        network: default the one that ships.

    Returns:
        ``normal`` (3, H, W), ``albedo`` (C, H, W), ``roughness`` (1, H, W), which is 0, and ``error`` (1, H, W), the
        expected error of the normal in radians; 0 outside the mask.
    """
    seen, lights = Clean()(images, lights)
    maps, error = solve_by_network(seen, lights, inside, network)
    return {"normal": maps.normal, "albedo": maps.albedo, "roughness": maps.roughness, "error": error}


@torch.no_grad()
def solve_by_network(
    images: Tensor,
    lights: Tensor,
    inside: Tensor,
    network: SetNetwork | None = None,
    interreflected: InterreflectedLight | None = None,
) -> tuple[SolvedMaps, Tensor]:
    """Maps as of `solve_bands`, and the expected error of the normal (1, H, W), radians.

    Args:
        images: (K, C, H, W).
        lights: (K, 3) or (K, 3, H, W).
        inside: (H, W) bool.
        network: default the one that ships.
        interreflected: light to subtract from the observations first.
    """
    network = (network or load_network()).to(images.device)
    dtype = next(network.parameters()).dtype
    grid, places, flat = Grid(inside), inside.flatten().nonzero().flatten(), images.flatten(2)
    chunks = places.split(_chunk(len(images), images.device))

    def observe(chunk: Tensor) -> tuple[Tensor, Tensor]:
        seen = flat[:, :, chunk].permute(2, 1, 0).to(dtype)
        if interreflected:
            left = seen - interreflected.at(seen, chunk, images.shape[3]).to(dtype)
            seen = torch.maximum(left, LEAST_LEFT * seen)
        return seen, gather_directions(lights, chunk).to(dtype)

    found = []
    for chunk in track(chunks, "network"):
        seen, directions = observe(chunk)
        found.append(network(Prepare()(seen)[0], directions))
    normal, error = (torch.cat(values) for values in zip(*found, strict=True))
    error = error.clamp_max(math.pi / 2)
    normal = Smooth()(grid.draw(normal), grid.draw(error)).flatten(1)[:, places].T
    parts = zip(chunks, normal.split(chunks[0].shape[0]), strict=True)
    albedo, residual = (torch.cat(v) for v in zip(*(Paint()(*observe(c), n) for c, n in parts), strict=True))
    maps = SolvedMaps(
        normal=grid.draw(normal),
        albedo=grid.draw(albedo),
        albedo_grey=grid.draw(albedo.mean(1, keepdim=True)),
        residual=grid.draw(residual),
        confidence=grid.draw(confidence_from_error(error)),
        roughness=grid.draw(torch.zeros_like(error)),
    )
    return maps, grid.draw(error)


def _chunk(lights: int, device: torch.device) -> int:
    """Pixels under so many lights that the network reads together."""
    return max(1, (CHUNK if device.type == "cpu" else CHUNK_ACCELERATOR) // lights)
