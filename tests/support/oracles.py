"""Slow, plain float64 answers to hold the package against; written from the papers, in angles and loops."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor


def directions(theta: Tensor, phi: Tensor) -> Tensor:
    """Unit vectors (..., 3) about +z."""
    return torch.stack((theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()), -1)


def angle_form(model: str, ti: float, to: float, dphi: float, rho: float, sigma: float) -> float:
    """``pi f_r`` by the textbook formulas in angles."""
    x = sigma * sigma
    alpha, beta = max(ti, to), min(ti, to)
    cos_phi = math.cos(dphi)
    a33, b = 1 - 0.5 * x / (x + 0.33), 0.45 * x / (x + 0.09)
    if model == "lambert":
        return rho
    if model in ("qualitative", "qualitative-0.57"):
        a = a33 if model == "qualitative" else 1 - 0.5 * x / (x + 0.57)
        return rho * (a + b * max(0.0, cos_phi) * math.sin(alpha) * math.tan(beta))
    if model == "fujii":
        s = math.sin(ti) * math.sin(to) * cos_phi
        t = max(math.cos(ti), math.cos(to)) if s > 0 else 1.0
        return rho * (a33 + 0.17 * rho * x / (x + 0.13) + b * s / t)
    if model == "full":
        c2 = b * (math.sin(alpha) - (0.0 if cos_phi >= 0 else (2 * beta / math.pi) ** 3))
        c3 = 0.125 * x / (x + 0.09) * (4 * alpha * beta / math.pi**2) ** 2
        first = a33 + cos_phi * c2 * math.tan(beta) + (1 - abs(cos_phi)) * c3 * math.tan((alpha + beta) / 2)
        second = 0.17 * rho * x / (x + 0.13) * (1 - cos_phi * (2 * beta / math.pi) ** 2)
        return rho * (first + second)
    raise ValueError(model)


def eon_published(ti: float, to: float, dphi: float, rho: float, r: float) -> float:
    """EON as its paper writes it, with 1 - E as differences and the polynomial for G."""

    def g_over_pi(theta: float) -> float:
        m = 1 - math.cos(theta)
        return m * (0.0571085289 + m * (0.491881867 + m * (-0.332181442 + m * 0.0714429953)))

    a = 1 / (1 + (0.5 - 2 / (3 * math.pi)) * r)
    b = r * a
    s = math.sin(ti) * math.sin(to) * math.cos(dphi)
    st = s / max(math.cos(ti), math.cos(to)) if s > 0 else s
    e_i, e_o = (a + b * g_over_pi(t) for t in (ti, to))
    mean = a + (2 / 3 - 28 / (15 * math.pi)) * b
    rho_ms = rho * rho * mean / (1 - rho * (1 - mean))
    return rho * (a + b * st) + rho_ms * max(0.0, 1 - e_i) * max(0.0, 1 - e_o) / (1 - mean)


def vcavity_two_bounces(ti: float, to: float, dphi: float, sigma: float, nodes: int = 120) -> tuple[float, float]:
    """R1 and R2 of the V-cavity integral (Oren & Nayar 1994) by a midpoint rule over facet directions."""
    l = np.array((math.sin(ti), 0.0, math.cos(ti)))  # noqa: E741
    v = np.array((math.sin(to) * math.cos(dphi), math.sin(to) * math.sin(dphi), math.cos(to)))
    ta = (np.arange(nodes) + 0.5) / nodes * (math.pi / 2)
    pa = (np.arange(4 * nodes) + 0.5) / (4 * nodes) * (2 * math.pi)
    theta, phi = np.meshgrid(ta, pa, indexing="ij")
    density = np.exp(-(theta**2) / (2 * sigma**2)) * np.sin(theta)
    density /= density.sum()
    facet = np.stack((np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), -1)
    opposite = facet * np.array((-1.0, -1.0, 1.0))
    an = np.cos(theta)
    la, va, lo = (np.clip(d @ w, 0, None) for d, w in ((facet, l), (facet, v), (opposite, l)))
    ci, co = l[2], v[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        masking = np.nan_to_num(2 * co * an / va, nan=np.inf, posinf=np.inf)
        shadow = np.nan_to_num(2 * ci * an / la, nan=np.inf, posinf=np.inf)
        shadow_opposite = np.nan_to_num(2 * ci * an / lo, nan=np.inf, posinf=np.inf)
    r1 = (density * la * va / (an * ci * co) * np.minimum(1, np.minimum(masking, shadow))).sum()
    mv, ms = 1 - np.minimum(1, masking), 1 - np.minimum(1, shadow_opposite)
    cos2 = np.cos(2 * theta)

    def d(x: npt.NDArray[np.float64], y: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        half: npt.NDArray[np.float64] = 0.5 * np.sqrt(x**2 + y**2 + 2 * x * y * cos2)
        return half

    one = np.ones_like(mv)
    exchange = d(one, mv) + d(one, ms) - d(ms, mv) - d(one, one)
    r2 = (density * lo * va / (an * ci * co) * exchange).sum()
    return float(r1), float(r2)


def directional_albedo_monte_carlo(
    function: object, cos_view: float, rho: float, sigma: float, count: int = 200_000
) -> float:
    """Hemispherical integral of f_r cos by cosine-weighted sampling: the mean of pi f_r."""
    generator = torch.Generator().manual_seed(0)
    ci = torch.rand(count, generator=generator, dtype=torch.float64).sqrt().clamp_min(1e-9)
    phi = 2 * math.pi * torch.rand(count, generator=generator, dtype=torch.float64)
    co = torch.full_like(ci, cos_view)
    lv = ci * co + ((1 - ci**2) * (1 - co**2)).sqrt() * phi.cos()
    tensor = torch.tensor
    value = function(ci, co, lv, tensor(rho, dtype=torch.float64), tensor(sigma, dtype=torch.float64))  # type: ignore[operator]
    return float(value.mean())


def cast_rays(
    lines: Callable[[Tensor], tuple[Tensor, Tensor]], pixels: Tensor, vertices: Tensor, faces: Tensor, near: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Nearest face per pixel by Moeller & Trumbore, one face after the other.

    ``lines`` gives origins and rays (z = -1, so the distance along a ray is depth) of image points (N, 2). Returns the
    face (-1 for none), its depth, and whether the pixel is within 1/100 of an edge or of the near plane's cut, or two
    depths are too close to call: within 1e-5, or so steep that 1/100 pixel could change their order.
    """
    best = torch.full((len(pixels),), math.inf, dtype=torch.float64)
    nearest, farthest = best, best  # what the best face's depth is within 1/100 pixel
    face = torch.full((len(pixels),), -1)
    unsure = torch.zeros(len(pixels), dtype=torch.bool)
    shifts = torch.tensor([[0.0, 0], [1, 0], [0, 1], [-1, 0], [0, -1]], dtype=torch.float64) / 100
    for index, corners in enumerate(vertices[faces].double()):
        found = [_meet(*lines(pixels + shift), corners) for shift in shifts]
        edges, depth, inside = (torch.stack(values) for values in zip(*found, strict=True))
        # Edge functions are linear in the image: their value over their slope is the distance to the edge's line.
        slope = torch.stack((edges[1] - edges[3], edges[2] - edges[4])).norm(dim=0) * 50
        unsure |= ((edges[0].abs() <= slope / 100) & (slope > 0)).any(0)
        hit = inside & (depth >= near)
        unsure |= hit.any(0) != hit.all(0)
        low, high = depth.amin(0), depth.amax(0)
        unsure |= hit[0] & (((depth[0] - best).abs() < 1e-5) | ((low < farthest) & (nearest < high)))
        seen = hit[0] & (depth[0] < best)
        best, face = torch.where(seen, depth[0], best), torch.where(seen, index, face)
        nearest, farthest = torch.where(seen, low, nearest), torch.where(seen, high, farthest)
    return face, best, unsure


def _meet(origins: Tensor, rays: Tensor, corners: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Edge functions (3, N), depth, and whether rays meet a triangle."""
    a, b, c = corners
    e1, e2 = b - a, c - a
    p = torch.linalg.cross(rays, e2.expand_as(rays))
    det = (p * e1).sum(1)
    t = origins - a
    q = torch.linalg.cross(t, e1.expand_as(t))
    u, w = (t * p).sum(1), (rays * q).sum(1)
    edges = torch.stack((u, w, det - u - w))
    return edges, (e2 * q).sum(1) / det, (edges * det > 0).all(0) & (det.abs() > 1e-15)


def rasterise_exactly(
    image: list[list[tuple[float, float, float]]], size: tuple[int, int], *, grid: int = 256
) -> tuple[list[int], list[bool]]:
    """Face of every pixel (-1 for none), pixel by pixel in whole numbers, and whether two depths are equal there.

    ``image`` holds the corners (x, y, depth) of every face in pixels. They are rounded to ``grid``; centres on an edge
    belong to the face if it is a left edge, or a level one at the top; depth is linear on the rounded triangle.
    """
    best: list[tuple[Fraction, int] | None] = [None] * (size[0] * size[1])
    tied = [False] * len(best)
    for index, corners in enumerate(image):
        points = [(round(x * grid), round(y * grid)) for x, y, _ in corners]
        depths = [Fraction(z) for _, _, z in corners]
        (ax, ay), (bx, by), (cx, cy) = points
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0:
            continue
        if area < 0:  # corners run clockwise in rows and columns, so that inside is to the right
            points, depths, area = points[::-1], depths[::-1], -area
        for pixel in range(len(best)):
            px, py = (2 * (pixel % size[1]) + 1) * grid // 2, (2 * (pixel // size[1]) + 1) * grid // 2
            weights = []
            for k in range(3):
                (sx, sy), (ex, ey) = points[(k + 1) % 3], points[(k + 2) % 3]
                value = (ex - sx) * (py - sy) - (ey - sy) * (px - sx)
                owned = ey < sy or (ey == sy and ex > sx)
                weights.append(value if value > 0 or (value == 0 and owned) else None)
            inner = [w for w in weights if w is not None]
            if len(inner) < 3:
                continue
            depth = sum((Fraction(w, area) * z for w, z in zip(inner, depths, strict=True)), Fraction(0))
            known = best[pixel]
            tied[pixel] |= known is not None and abs(known[0] - depth) < Fraction(1, 10**7)
            if known is None or depth < known[0]:
                best[pixel] = depth, index
    return [-1 if b is None else b[1] for b in best], tied


def cover_by_edges(image: np.ndarray, size: tuple[int, int], *, grid: int = 256) -> np.ndarray:
    """All (face, pixel) pairs of triangles (F, 3, 2) in pixels, sorted: edge functions in whole numbers, box by box."""
    points = np.rint(image * grid).astype(np.int64)
    a, b, c = points[:, 0], points[:, 1], points[:, 2]
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    points = np.where((area < 0)[:, None, None], points[:, ::-1], points)
    low = np.maximum(points.min(1) // grid, 0)
    high = np.minimum(points.max(1) // grid + 1, [size[1], size[0]])
    span = np.maximum(high - low, 0) * (area != 0)[:, None]
    count = span[:, 0] * span[:, 1]
    face = np.repeat(np.arange(len(points)), count)
    offset = np.arange(len(face)) - np.repeat(count.cumsum() - count, count)
    column, row = low[face, 0] + offset % span[face, 0], low[face, 1] + offset // span[face, 0]
    inside = np.ones(len(face), bool)
    for k in range(3):
        start, end = points[face, (k + 1) % 3], points[face, (k + 2) % 3]
        edge = end - start
        value = edge[:, 0] * (row * grid + grid // 2 - start[:, 1]) - edge[:, 1] * (
            column * grid + grid // 2 - start[:, 0]
        )
        owned = (edge[:, 1] < 0) | ((edge[:, 1] == 0) & (edge[:, 0] > 0))
        inside &= (value > 0) | ((value == 0) & owned)
    return np.stack((face, row * size[1] + column), 1)[inside]


def vcavity_traced(
    ti: float,
    to: float,
    dphi: float,
    rho: float,
    sigma: float,
    *,
    count: int = 200_000,
    bounces: int = 60,
    seed: int = 0,
) -> tuple[float, float]:
    """``pi f_r cos(ti) / rho`` of V-grooves and its standard error, by tracing paths from the eye through all bounces.

    Nothing here knows the theory's integrals: walls are half-planes of unit length that meet in a valley, rays are
    tested against the facing wall by geometry, and every bounce is a random cosine-weighted direction.
    """
    draw = np.random.default_rng(seed)
    l = np.array((math.sin(ti), 0.0, math.cos(ti)))  # noqa: E741
    v = np.array((math.sin(to) * math.cos(dphi), math.sin(to) * math.sin(dphi), math.cos(to)))
    # A wall's slope has density exp(-t^2 / 2 sigma^2) sin(t), its azimuth is uniform.
    grid = np.linspace(0, math.pi / 2, 20_001)
    density = np.exp(-(grid**2) / (2 * sigma**2)) * np.sin(grid)
    heap = np.concatenate(([0.0], np.cumsum((density[1:] + density[:-1]) / 2)))
    slope = np.interp(draw.random(count), heap / heap[-1], grid)
    azimuth = draw.random(count) * 2 * math.pi
    # Coordinates of a groove: x across it, y along it, z up; walls rise from the valley at x = 0. The wall that is
    # seen lies at x < 0, so that its normal points to +x, the azimuth that was drawn.
    turn = np.stack((np.cos(azimuth), np.sin(azimuth)), -1)

    def local(d: np.ndarray) -> np.ndarray:
        across, along = turn @ d[:2], turn[:, 0] * d[1] - turn[:, 1] * d[0]
        return np.stack((across, along, np.full(count, d[2])), -1)

    light, view = local(l), local(v)
    cosine, sine = np.cos(slope), np.sin(slope)
    side = np.full(count, -1.0)  # the wall at x < 0
    place = draw.random(count)  # along the wall from the valley

    def normal(side: np.ndarray) -> np.ndarray:
        return np.stack((-side * sine, np.zeros(count), cosine), -1)

    def meets(side: np.ndarray, place: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Whether a ray from ``place`` hits the facing wall between valley and ridge, and where."""
        x, z = side * place * cosine, place * sine
        # Points of the facing wall are u (-side cos, sin): solve x + t dx = -side u cos, z + t dz = u sin.
        det = d[:, 0] * sine + side * cosine * d[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = -(x * sine + side * cosine * z) / det
            u = (z + t * d[:, 2]) / sine
        hit = (t > 1e-12) & (u > 0) & (u < 1) & (sine > 0)
        return hit, np.where(hit, u, 0)

    facing = (view * normal(side)).sum(1)
    weight = np.where((facing > 0) & ~meets(side, place, view)[0], facing / (cosine * math.cos(to)), 0)
    total = np.zeros(count)
    for _ in range(bounces):
        n = normal(side)
        received = np.clip((light * n).sum(1), 0, None) * ~meets(side, place, light)[0]
        total += weight * received
        radius, angle = np.sqrt(draw.random(count)), draw.random(count) * 2 * math.pi
        tangent = np.stack((cosine, np.zeros(count), side * sine), -1)
        up = np.sqrt(1 - radius**2)
        out = (radius * np.cos(angle))[:, None] * tangent + up[:, None] * n
        out[:, 1] += radius * np.sin(angle)
        hit, place = meets(side, place, out)
        weight = np.where(hit, weight * rho, 0)
        side = -side
        if not weight.any():
            break
    return float(total.mean()), float(total.std() / math.sqrt(count))
