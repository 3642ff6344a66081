"""Random figures, heaps, vessels and reliefs, modelled by signed distances and meshed by marching cubes.

A shape is a function from points (..., 3) to distances (...), negative inside. Parts are joined with or without a
fillet, cut, and displaced by waves: bumps, folds and engraved rings.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from ..core.optional import require
from .draw import Draw

Distance = Callable[[Tensor], Tensor]

GRID = 64
"""Points along each side of the grid that distances are evaluated on. Set by hand, for a tenth of a second a figure."""
REACH = 1.6
"""Half the side of the grid; parts lie within 1.5 of the origin."""


def draw_figure(draw: Draw) -> tuple[Tensor, Tensor]:
    """A random closed surface: float32 vertices (V, 3) and faces (F, 3), on the generator's device."""
    require("skimage")
    from skimage.measure import marching_cubes

    line = torch.linspace(-REACH, REACH, GRID, device=draw.device)
    points = torch.stack(torch.meshgrid(line, line, line, indexing="ij"), -1)
    volume = torch.ones_like(line)
    while not bool((volume < 0).any()):  # nearly always the first shape crosses the grid
        volume = _displaced(draw, _cut(draw, _draw_body(draw)))(points)
        volume = torch.maximum(volume, points.abs().amax(-1) - REACH + 2 * (line[1] - line[0]))  # closed at the grid
    vertices, faces, *_ = marching_cubes(volume.cpu().numpy(), 0.0, spacing=(float(line[1] - line[0]),) * 3)
    return (
        torch.from_numpy(vertices.copy()).float().to(draw.device) - REACH,
        torch.from_numpy(faces.astype("int64")).to(draw.device),
    )


def _draw_body(draw: Draw) -> Distance:
    """A figure with limbs (40 %), a heap (25 %), a vessel (15 %), a relief (15 %) or a single part (5 %)."""
    kind = draw.uniform(1).item()
    if kind < 0.4:
        return _figure(draw)
    if kind < 0.65:
        return _heap(draw)
    if kind < 0.8:
        return _vessel(draw)
    return _relief(draw) if kind < 0.95 else _part(draw, torch.zeros(3))


def _figure(draw: Draw) -> Distance:
    """A trunk, a head with small parts on it, and limbs of two members each, joined with fillets."""
    size = float(draw.uniform(1, low=0.25, high=0.5))
    hip, neck = torch.tensor([0.0, -0.4, 0.0]), torch.tensor([0.0, 0.4, 0.0]) + 0.15 * draw.normal(3).cpu()
    parts = [_limb(hip, neck, size * float(draw.uniform(1, low=0.7, high=1.3)), size)]
    head = neck + 0.45 * _direction(draw, up=0.8)
    radius = float(draw.uniform(1, low=0.22, high=0.42))
    parts.append(_ellipsoid(head, radius * draw.uniform(3, low=0.8, high=1.25).cpu()))
    for _ in range(int(draw.uniform(1, low=1, high=6))):  # nose, ears, eyes
        place = head + radius * _direction(draw)
        parts.append(_ellipsoid(place, radius * draw.uniform(3, low=0.15, high=0.5).cpu()))
    for _ in range(int(draw.uniform(1, low=0, high=6))):
        root = hip + float(draw.uniform(1)) * (neck - hip)
        elbow = root + float(draw.uniform(1, low=0.25, high=0.55)) * _direction(draw)
        thick = size * float(draw.uniform(1, low=0.3, high=0.8))
        end = elbow + float(draw.uniform(1, low=0.2, high=0.6)) * _direction(draw)
        parts += [_limb(root, elbow, thick, 0.8 * thick), _limb(elbow, end, 0.8 * thick, 0.5 * thick)]
    return _joined(parts, float(draw.log_uniform(1, low=0.01, high=0.2)))


def _heap(draw: Draw) -> Distance:
    """Ellipsoids, boxes, rings and members at random places, with narrow fillets or none."""
    count = int(draw.uniform(1, low=2, high=13))
    parts = [_part(draw, 0.35 * draw.normal(3).cpu().clamp(-2.5, 2.5)) for _ in range(count)]
    return _joined(parts, float(draw.log_uniform(1, low=0.002, high=0.1)))


def _relief(draw: Draw) -> Distance:
    """Parts on a slab."""
    parts = [_box(torch.zeros(3), torch.tensor([1.3, 1.3, 0.15]), torch.eye(3), 0.05)]
    for _ in range(int(draw.uniform(1, low=3, high=12))):
        x, y = draw.uniform(2, low=-1.0, high=1.0).tolist()
        parts.append(_part(draw, torch.tensor([x, y, 0.15])))
    return _joined(parts, float(draw.log_uniform(1, low=0.005, high=0.1)))


def _vessel(draw: Draw) -> Distance:
    """A surface of revolution about y, hollow or not, with up to two handles."""
    height, wall = float(draw.uniform(1, low=0.7, high=1.3)), float(draw.uniform(1, low=0.05, high=0.12))
    mean, sizes = float(draw.uniform(1, low=0.45, high=0.8)), 0.3 * draw.uniform(4).cpu() / torch.arange(1.0, 5.0)
    phases = draw.uniform(4, high=2 * math.pi).tolist()

    def solid(points: Tensor) -> Tensor:
        y = points[..., 1]
        radius = torch.full_like(y, mean)
        for k, (size, phase) in enumerate(zip(sizes.tolist(), phases, strict=True), 1):
            radius = radius + size * torch.sin(k * math.pi / 2 * y / height + phase)
        return torch.maximum(0.6 * (points[..., ::2].norm(dim=-1) - radius), y.abs() - height)

    def hollow(points: Tensor) -> Tensor:
        distance = solid(points)
        return torch.maximum(distance, -torch.where(points[..., 1] > wall - height, distance + wall, 1.0))

    parts: list[Distance] = [hollow if draw.uniform(1).item() < 0.6 else solid]
    for side in (-1.0, 1.0)[: int(draw.uniform(1, high=3))]:
        centre = torch.tensor([side * (mean + 0.15), 0.2 * float(draw.normal(1)), 0.0])
        parts.append(_ring(centre, torch.eye(3), float(draw.uniform(1, low=0.2, high=0.4)), 0.08))
    return _joined(parts, 0.05)


def _part(draw: Draw, centre: Tensor) -> Distance:
    """One part of a random kind, turned at random."""
    kind, turn = int(draw.uniform(1, high=4)), torch.linalg.qr(draw.normal(3, 3).cpu())[0]
    if kind == 0:
        return _ellipsoid(centre, draw.uniform(3, low=0.15, high=0.6).cpu())
    if kind == 1:
        return _box(centre, draw.uniform(3, low=0.1, high=0.5).cpu(), turn, float(draw.uniform(1, low=0.01, high=0.15)))
    if kind == 2:
        return _ring(
            centre, turn, *draw.uniform(2).mul(torch.tensor([0.3, 0.15])).add(torch.tensor([0.2, 0.05])).tolist()
        )
    ends = centre + 0.5 * _direction(draw), centre - 0.5 * _direction(draw)
    return _limb(*ends, *draw.uniform(2, low=0.06, high=0.3).tolist())


def _cut(draw: Draw, shape: Distance) -> Distance:
    """The shape with up to two balls or boxes cut away."""
    if draw.uniform(1).item() < 0.6:
        return shape
    place = draw.uniform(1, low=0.5, high=1.1).item() * _direction(draw)
    turn = torch.linalg.qr(draw.normal(3, 3).cpu())[0]
    extent = draw.uniform(3, low=0.2, high=0.6).cpu()
    tool = _ellipsoid(place, extent) if draw.uniform(1).item() < 0.5 else _box(place, extent, turn, 0.02)
    return lambda points: torch.maximum(shape(points), -tool(points))


def _displaced(draw: Draw, shape: Distance) -> Distance:
    """The shape with fractal bumps, folds within a ball, and engraved rings, each of which may be missing."""
    waves = draw.normal(12, 3).cpu() * (2.0 * 1.7 ** torch.arange(12.0) ** 0.7)[:, None]
    phases, heights = draw.uniform(12, high=2 * math.pi).cpu(), 0.5 * draw.uniform(12).cpu() / waves.norm(dim=1)
    bumpy = float(draw.bernoulli(0.6, 1)) * float(draw.uniform(1)) ** 2
    across, frequency = _direction(draw), float(draw.uniform(1, low=8, high=25))
    folded = float(draw.bernoulli(0.35, 1)) * float(draw.uniform(1, low=0.2, high=0.7)) / frequency
    middle, reach = 0.7 * draw.normal(3).cpu(), float(draw.uniform(1, low=0.5, high=1.2))
    engraved = float(draw.bernoulli(0.25, 1)) * float(draw.uniform(1, low=0.01, high=0.05))
    spacing, width = float(draw.uniform(1, low=0.15, high=0.5)), float(draw.uniform(1, low=0.03, high=0.08))

    def displaced(points: Tensor) -> Tensor:
        distance = shape(points)
        if bumpy:
            for wave, phase, size in zip(waves, phases, heights, strict=True):
                distance = distance + bumpy * size * torch.sin(points @ wave.to(points) + phase)
        away = (points - middle.to(points)).norm(dim=-1)
        if folded:
            bent = points @ across.to(points) + 0.1 * torch.sin(3 * points[..., 0] + 2 * points[..., 1])
            distance = distance + folded * torch.sin(frequency * bent) * torch.exp(-((away / reach) ** 2))
        if engraved:
            nearest = (away / spacing - (away / spacing).round()) * spacing
            distance = distance + engraved * torch.exp(-((nearest / width) ** 2))
        return distance

    return displaced


def _direction(draw: Draw, up: float = 0.0) -> Tensor:
    """A random unit vector, drawn towards +y."""
    vector = draw.normal(3).cpu() * (1 - up)
    vector[1] += up
    unit: Tensor = vector / vector.norm().clamp_min(1e-6)
    return unit


def _joined(parts: list[Distance], fillet: float) -> Distance:
    """The union; ``fillet`` is the distance over which parts blend. Source: Quilez, "Smooth minimum", quadratic."""

    def union(points: Tensor) -> Tensor:
        distance = parts[0](points)
        for part in parts[1:]:
            other = part(points)
            blend = (fillet - (distance - other).abs()).clamp_min(0) / fillet
            distance = torch.minimum(distance, other) - 0.25 * fillet * blend * blend
        return distance

    return union


def _limb(start: Tensor, end: Tensor, first: float, last: float) -> Distance:
    """A capsule whose radius changes linearly."""

    def limb(points: Tensor) -> Tensor:
        axis, away = (end - start).to(points), points - start.to(points)
        share = ((away @ axis) / axis.square().sum().clamp_min(1e-9)).clamp(0, 1)
        distance: Tensor = (away - share[..., None] * axis).norm(dim=-1) - (first + (last - first) * share)
        return distance

    return limb


def _ellipsoid(centre: Tensor, radii: Tensor) -> Distance:
    """Along the axes; the distance is approximate away from the surface."""

    def ellipsoid(points: Tensor) -> Tensor:
        scaled = (points - centre.to(points)) / radii.to(points)
        length = scaled.norm(dim=-1)
        distance: Tensor = length * (length - 1) / (scaled / radii.to(points)).norm(dim=-1).clamp_min(1e-6)
        return distance

    return ellipsoid


def _box(centre: Tensor, half: Tensor, turn: Tensor, rounding: float) -> Distance:
    def box(points: Tensor) -> Tensor:
        beyond = ((points - centre.to(points)) @ turn.to(points)).abs() - half.to(points) + rounding
        distance: Tensor = beyond.clamp_min(0).norm(dim=-1) + beyond.amax(-1).clamp_max(0) - rounding
        return distance

    return box


def _ring(centre: Tensor, turn: Tensor, radius: float, thickness: float) -> Distance:
    def ring(points: Tensor) -> Tensor:
        x, y, z = ((points - centre.to(points)) @ turn.to(points)).unbind(-1)
        distance: Tensor = torch.hypot(torch.hypot(x, y) - radius, z) - thickness
        return distance

    return ring
