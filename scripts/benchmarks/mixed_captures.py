"""Rendered captures of several materials side by side on one shape, with true normals and a map of the materials.

Shapes are meshes and random reliefs; materials are rough (``vcavity``), plastic (Lambert's or glazed, with GGX
highlights), metal (GGX highlights alone), and fits to measured ones, none of which is the solvers' own lobe. Pixels get
cast shadows, a little light in them, noise and the quantisation of a 16-bit file or of a JPEG. Captures to tune on and
captures to judge by share no shape, no measured material and no seed.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from tests.support.rendered_captures import LEAST_FACING, Surface, fit_surfaces, lit_view, objects, shade
from torch_orennayar.core.optional import require
from torch_orennayar.io.srgb import linear_to_srgb, srgb_to_linear

NOISE = 0.004
"""Standard deviation of the noise as a share of full scale."""
BOUNCE = 0.05
"""Light in shadows as a share of the mean of the lit surface, in place of interreflection."""
BRIGHTEST = 0.995
"""Quantile of the samples that is exposed to full scale; what is brighter is clipped."""
DARKEST = 0.3
"""Mean brightness of the darkest material over the brightest: fits to measured metals are far darker than paints, and
would be lost in the noise."""
QUALITY = 92
"""Of JPEG files."""
SHAPES = {"tuning": ("bumps", "stanford-bunny", "suzanne"), "judging": ("balls", "spot", "teapot", "nefertiti")}
"""Meshes of each half; reliefs come in addition."""
SIZE, SIZE_MESH = 80, 120
"""Height and width in pixels of reliefs, which fill the picture, and of meshes, which fill a half of it."""


@dataclass(frozen=True)
class MixedCapture:
    """Images (K, 1, H, W), lights (K, 3), mask (1, H, W), true normals (3, H, W) and labels (1, H, W) of materials."""

    name: str
    images: Tensor
    lights: Tensor
    mask: Tensor
    normal: Tensor
    material: Tensor
    surfaces: tuple[tuple[str, Surface], ...]


def relief(seed: int, size: int = 160) -> tuple[Tensor, Tensor]:
    """A random relief as a mesh (V, 3), (F, 3) that fills the view: smooth hills, finer ones and a few steps."""
    require("scipy")
    from scipy.ndimage import gaussian_filter

    draw = np.random.default_rng(seed)
    height = np.zeros((size, size))
    for width, share in ((size / 8, 0.2), (size / 16, 0.06), (size / 40, 0.01)):
        hills = gaussian_filter(draw.standard_normal((size, size)), width, mode="wrap")
        height += share * hills / hills.std()
    blocks = gaussian_filter((gaussian_filter(draw.standard_normal((size, size)), size / 10) > 0).astype(float), 3)
    height += 0.15 * blocks
    y, x = np.meshgrid(np.linspace(1.05, -1.05, size), np.linspace(-1.05, 1.05, size), indexing="ij")
    vertices = torch.from_numpy(np.stack((x, y, height - height.max()), 2).reshape(-1, 3)).float()
    corner = torch.arange(size * size).reshape(size, size)
    a, b, c, d = (part.flatten() for part in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]))
    return vertices, torch.cat((torch.stack((a, c, b), 1), torch.stack((b, c, d), 1)))


def patches(count: int, mask: Tensor, generator: torch.Generator) -> Tensor:
    """Labels (1, H, W) of ``count`` materials: cells about random pixels of a mask (H, W), two for each material."""
    inside = mask.nonzero()
    points = inside[torch.randint(len(inside), (2 * count,), generator=generator)]
    apart = torch.cdist(torch.ones_like(mask).nonzero().float(), points.float())
    return (apart.argmin(1) % count).reshape(1, *mask.shape)


def mixed_capture(
    name: str,
    mesh: tuple[Tensor, Tensor],
    surfaces: Sequence[tuple[str, Surface]],
    *,
    lights: int = 48,
    size: int,
    jpeg: bool = False,
    seed: int = 0,
) -> MixedCapture:
    """Pictures of ``mesh`` in patches of all ``surfaces``."""
    generator = torch.Generator().manual_seed(seed)
    seen, directions, reached = lit_view(*mesh, lights, size)
    normal, mask = seen.normal[0], seen.mask[0]
    material = patches(len(surfaces), mask[0], generator)
    shaded = torch.stack([shade(surface, normal, directions) for _, surface in surfaces])  # (M, K, 1, H, W)
    exposed = DARKEST + (1 - DARKEST) * torch.rand(len(surfaces), 1, 1, 1, 1, generator=generator)
    shaded = shaded * (exposed / shaded[..., mask[0]].mean((1, 2, 3)).reshape(-1, 1, 1, 1, 1))
    images = shaded.gather(0, material.expand(1, lights, 1, -1, -1))[0]
    mean = images.mean(0, keepdim=True)
    images = images * reached + BOUNCE * mean * (1 - reached * (images > 0))
    images = images / images[:, :, mask[0]].flatten().quantile(BRIGHTEST)
    images = (images + NOISE * torch.randn(images.shape, generator=generator)).clamp(0, 1) * mask
    images = _as_jpeg(images) if jpeg else (images * 65535).round() / 65535
    inside = mask & (normal[2:] > LEAST_FACING)
    return MixedCapture(name, images, directions, inside, normal, material, tuple(surfaces))


def _as_jpeg(images: Tensor) -> Tensor:
    """Images (K, 1, H, W) in [0, 1] after a JPEG file of sRGB values."""
    require("PIL")
    from PIL import Image

    read = []
    for image in (linear_to_srgb(images)[:, 0] * 255).round().to(torch.uint8).numpy():
        file = io.BytesIO()
        Image.fromarray(image).save(file, "JPEG", quality=QUALITY)
        read.append(torch.from_numpy(np.asarray(Image.open(file)).copy()))
    return srgb_to_linear(torch.stack(read)[:, None].float() / 255)


def captures(half: str, data: Path, count: int) -> list[MixedCapture]:
    """``count`` captures of a half, ``"tuning"`` or ``"judging"``, of 2 to 8 materials each, under 30 to 60 lights.

    The half to judge by was drawn again, from 2000 on, after two rules were changed on seeing the draw from 1000 on.
    """
    first = 0 if half == "tuning" else 2000
    meshes = {name: mesh for name, mesh in objects(data / "meshes").items() if name in SHAPES[half]}
    measured = list(_measured(half, data).items())
    made = []
    for k in range(count):
        generator = torch.Generator().manual_seed(first + k)
        shapes = list(meshes)
        if k % 2:
            name, mesh = f"relief {first + k}", relief(first + k)
        else:
            name = shapes[k // 2 % len(shapes)]
            mesh = meshes[name]
        surfaces = [_draw_surface(measured, generator, i, k) for i in range(2 + k % 7)]
        lights = int(torch.randint(30, 61, (1,), generator=generator))
        kind = f"{name}, {len(surfaces)} materials, {lights} lights, {'JPEG' if k % 3 == 2 else '16 bits'}"
        size, jpeg = SIZE if k % 2 else SIZE_MESH, k % 3 == 2
        made.append(mixed_capture(kind, mesh, surfaces, lights=lights, size=size, jpeg=jpeg, seed=first + k))
    return made


def _measured(half: str, data: Path) -> dict[str, Surface]:
    """Fits to every so many of the measured materials; the halves take other ones."""
    fitted = fit_surfaces(data / "measured_brdf" / "measured_brdf.npz", slice(half == "judging", None, 3))
    return {name.split("/")[-1]: surface for name, surface in fitted.items()}


def _draw_surface(
    measured: Sequence[tuple[str, Surface]], generator: torch.Generator, place: int, capture: int
) -> tuple[str, Surface]:
    """One of four kinds in turn: rough, plastic, measured, metal."""

    def between(low: float, high: float) -> float:
        return low + (high - low) * float(torch.rand(1, generator=generator))

    kind = ("rough", "plastic", "measured", "metal")[(place + capture) % 4]
    if kind == "measured":
        return measured[int(torch.randint(len(measured), (1,), generator=generator))]
    if kind == "rough":
        return kind, Surface("vcavity", between(15, 50), between(0.2, 0.8))
    wide, narrow = between(0.3, 0.6), between(0.1, 0.3)
    if kind == "metal":
        return kind, Surface("lambert", 0.0, 0.0, ((wide, between(0.2, 0.5)), (narrow, between(0.0, 0.2))))
    matt = "glazed" if between(0, 1) < 0.5 else "lambert"
    return kind, Surface(matt, 0.0, between(0.1, 0.7), ((narrow, between(0.02, 0.08)),))
