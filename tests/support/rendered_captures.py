"""Rendered captures with true normals: objects x materials x cast shadows, to compare solvers without photographs.

Objects come with the package and trimesh. Materials are fitted to measurements (`python -m
tests.support.rendered_captures measured_brdf.npz` prints them): a diffuse part, which is Lambert's, a V-cavity's or
Lambert's under a glaze whose interface reflects light, and two GGX highlights. Except for Lambert without highlights
and the V-cavity, none of these is a model that the solvers fit.
"""

from __future__ import annotations

import functools
import itertools
import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torch_orennayar import (
    MODELS,
    Camera,
    NormalMap,
    OrenNayar,
    cast_shadows,
    load_mesh,
    microfacet,
    point_light,
    render_normals,
)  # fmt: skip
from torch_orennayar.geometry.mesh import normalise_mesh
from torch_orennayar.geometry.primitives import bumpy_ball, spiral_lights
from torch_orennayar.render.radiosity import SeenSurface, light_between
from torch_orennayar.synthetic.materials import transmitted

NOISE = 0.01
"""Standard deviation of the noise as a share of the brightest pixels."""
BOUNCE = 0.06
"""Light in shadows as a share of the mean of the lit surface, in place of interreflection; set by hand."""
LEAST_FACING = 0.05
"""Cosine to the view below which pixels are left out of the mask: they lie within a pixel of the silhouette."""


@dataclass(frozen=True)
class Surface:
    """Parameters of one measured material.

    Attributes:
        matt: ``lambert``, ``glazed`` or ``vcavity``.
        roughness: degrees, for ``vcavity``.
        albedo: of the matt part.
        highlights: (GGX width, strength) each.
    """

    matt: str
    roughness: float
    albedo: float
    highlights: tuple[tuple[float, float], ...] = ()


MATERIALS: dict[str, Surface] = {
    "alumina-oxide": Surface(matt="glazed", roughness=0.0, albedo=0.3001, highlights=((0.05, 0.0062), (0.7, 0.0512))),
    "aventurnine": Surface(matt="glazed", roughness=0.0, albedo=0.0465, highlights=((0.05, 0.0039), (0.7, 0.0321))),
    "blue-rubber": Surface(matt="vcavity", roughness=10.0, albedo=0.0618, highlights=((0.3, 0.017), (0.7, 0.0508))),
    "delrin": Surface(matt="lambert", roughness=0.0, albedo=0.1994, highlights=((0.15, 0.0137), (0.7, 0.1476))),
    "gold-metallic-paint": Surface(
        matt="vcavity", roughness=50.0, albedo=0.0, highlights=((0.2, 0.1396), (0.3, 0.0054))
    ),
    "white-diffuse-bball": Surface(
        matt="glazed", roughness=0.0, albedo=0.2594, highlights=((0.15, 0.0125), (0.7, 0.0705))
    ),
    "alum-bronze": Surface(matt="glazed", roughness=0.0, albedo=0.0092, highlights=((0.05, 0.0255), (0.3, 0.0678))),
    "laika_ceiling_paint_18_gray": Surface(matt="vcavity", roughness=50.0, albedo=0.1295, highlights=((0.7, 0.1925),)),
    "spectralon": Surface(matt="glazed", roughness=0.0, albedo=0.7806, highlights=((0.7, 0.5074),)),
    "satin_white": Surface(matt="glazed", roughness=0.0, albedo=0.2166, highlights=((0.15, 0.2971), (0.7, 0.4161))),
    "pink-plastic": Surface(matt="vcavity", roughness=10.0, albedo=0.1142, highlights=((0.7, 0.1463),)),
    "cardboard": Surface(matt="glazed", roughness=0.0, albedo=0.0566, highlights=((0.45, 0.2011), (0.7, 0.0656))),
}


def glazed(ci: Tensor, co: Tensor) -> Tensor:
    """Lambert's surface under a smooth interface of index 1.5 (Wolff 1994, without internal reflections)."""
    return transmitted(ci, 1.5) * transmitted(co, 1.5)


def matt_part(surface: Surface, ci: Tensor, co: Tensor, lv: Tensor) -> Tensor:
    """``pi f_r`` of the matt part, albedo included."""
    if surface.matt == "glazed":
        return surface.albedo * glazed(ci, co)
    rho, sigma = ci.new_tensor(surface.albedo), ci.new_tensor(math.radians(surface.roughness))
    return MODELS[surface.matt].function(ci, co, lv, rho, sigma)


def shade(surface: Surface, normal: Tensor, lights: Tensor) -> Tensor:
    """Images (K, 1, H, W) of one surface seen along z, shading alone."""
    ci = torch.einsum("chw,kc->khw", normal, lights).clamp_min(0)[:, None]
    co = normal[2].clamp_min(1e-3).expand_as(ci)
    lv = lights[:, 2].reshape(-1, 1, 1, 1).expand_as(ci)
    facing = (ci > 0) & (normal[2] > 0)
    ci = ci.clamp_min(1e-4)
    value = matt_part(surface, ci, co, lv)
    for width, strength in surface.highlights:
        value = value + strength * microfacet(ci, co, lv, width, 1.0)
    return torch.where(facing, value * ci, 0.0)


@dataclass(frozen=True)
class Rendered:
    """Images (K, 1, H, W), lights (K, 3), mask (1, H, W) and true normals (3, H, W)."""

    images: Tensor
    lights: Tensor
    mask: Tensor
    normal: Tensor


def objects(folder: Path | None = None) -> dict[str, tuple[Tensor, Tensor]]:
    """Meshes in the unit sphere; those of ``folder`` too."""
    import trimesh

    knot = trimesh.creation.torus(0.62, 0.28, major_sections=200, minor_sections=100)
    knot.apply_transform(trimesh.transformations.rotation_matrix(0.9, (1, 0.4, 0)))
    steps = trimesh.util.concatenate(
        [
            trimesh.creation.icosphere(subdivisions=5, radius=r).apply_translation(p)
            for r, p in ((0.55, (-0.25, -0.25, 0)), (0.38, (0.45, 0.25, 0.2)), (0.3, (-0.3, 0.6, 0.1)))
        ]
    )
    found = {"bumps": bumpy_ball()}
    for name, mesh in (("ring", knot), ("balls", steps)):
        found[name] = torch.tensor(mesh.vertices, dtype=torch.float32), torch.tensor(mesh.faces)
    for file in sorted(folder.glob("*.obj")) if folder else ():
        found[file.stem] = load_mesh(file, crease=math.pi)
    return {name: (normalise_mesh(vertices), faces) for name, (vertices, faces) in found.items()}


@functools.lru_cache(maxsize=8)
def lit_view(vertices: Tensor, faces: Tensor, lights: int, size: int) -> tuple[NormalMap, Tensor, Tensor]:
    """A view of a mesh, directions to its lights, and how much of each reaches each pixel (K, 1, H, W).

    Kept, because captures of one object in several materials share it and it takes longer than to shade them.
    """
    seen = render_normals(vertices, faces, Camera.orthographic(1.02), (size, size))
    directions = spiral_lights(lights, math.radians(50))
    return seen, directions, cast_shadows(vertices, faces, seen, directions)


def capture(
    mesh: tuple[Tensor, Tensor], surface: Surface, *, lights: int = 48, size: int = 128, seed: int = 0
) -> Rendered:
    """Pictures of ``mesh`` with shading, cast shadows, a little light in the shadows, and noise."""
    seen, directions, reached = lit_view(*mesh, lights, size)
    normal, mask = seen.normal[0], seen.mask[0]
    images = shade(surface, normal, directions)
    mean = images[:, :, mask[0]].mean()
    images = images * reached + BOUNCE * mean * (1 - reached * (images > 0))
    noise = torch.randn(images.shape, generator=torch.Generator().manual_seed(seed))
    bright = images[:, :, mask[0]].quantile(0.95) if mask.sum() * lights < 1_000_000 else images.max()
    images = images + NOISE * noise * bright
    return Rendered(images.clamp_min(0) * mask, directions, mask & (normal[2:] > LEAST_FACING), normal)


def hollow_capture(mesh: tuple[Tensor, Tensor], albedo: float, *, lights: int = 32, size: int = 128) -> Rendered:
    """Pictures of unknown exposure of a Lambertian ``mesh`` with interreflection, cast shadows and noise."""
    seen, directions, reached = lit_view(*mesh, lights, size)
    inside = seen.mask[0, 0]
    surface = SeenSurface.of(seen)
    irradiance = (surface.normal @ directions.T).clamp_min(0)
    irradiance = irradiance * reached[:, 0, inside].T
    generator = torch.Generator().manual_seed(0)
    paint = torch.full((len(irradiance), 1), albedo)
    found = light_between(surface, paint, irradiance, generator)[:, 0]
    shown = 0.4 * albedo * (irradiance + found)
    shown = shown + NOISE * shown.amax() * torch.randn(shown.shape, generator=generator)
    images = torch.zeros(lights, 1, size, size)
    images[:, 0, inside] = shown.clamp_min(0).T
    return Rendered(images, directions, seen.mask[0] & (seen.normal[0, 2:] > LEAST_FACING), seen.normal[0])


def patched_capture(left: float, right: float, *, lights: int = 36, size: int = 72) -> tuple[Rendered, Tensor]:
    """The bumpy object with one roughness in degrees on its left half and another on its right, and their map."""
    vertices, faces = objects()["bumps"]
    seen = render_normals(vertices, faces, Camera.orthographic(1.02), (size, size))
    directions, normal, mask = spiral_lights(lights, math.radians(50)), seen.normal[0], seen.mask[0]
    here = (torch.arange(size) < size // 2).expand(1, size, size)
    roughness = torch.where(here, math.radians(left), math.radians(right))
    images = OrenNayar("vcavity")(seen.normal, directions[None], albedo=0.7, roughness=roughness[None])[0]
    images = images + NOISE * torch.randn(images.shape, generator=torch.Generator().manual_seed(0))
    return Rendered(images.clamp_min(0) * mask, directions, mask & (normal[2:] > LEAST_FACING), normal), roughness


def halves_capture(left: Surface, right: Surface, *, lights: int = 36, size: int = 72) -> tuple[Rendered, Tensor]:
    """The bumpy object with one surface on its left half and another on its right, and which is where (1, H, W)."""
    seen = render_normals(*objects()["bumps"], Camera.orthographic(1.02), (size, size))
    directions, normal, mask = spiral_lights(lights, math.radians(50)), seen.normal[0], seen.mask[0]
    material = (torch.arange(size) >= size // 2).long().expand(1, size, size)
    images = torch.where(material == 0, shade(left, normal, directions), shade(right, normal, directions))
    images = images + 0.003 * torch.randn(images.shape, generator=torch.Generator().manual_seed(0))
    return Rendered(images.clamp_min(0) * mask, directions, mask & (normal[2:] > LEAST_FACING), normal), material


@dataclass(frozen=True)
class NearLit:
    """Images (K, 1, H, W) under near lights at (K, 3), the object's mean distance, camera, mask and true normals."""

    images: Tensor
    positions: Tensor
    distance: float
    camera: Camera
    mask: Tensor
    normal: Tensor


def near_capture(mesh: tuple[Tensor, Tensor], *, lights: int = 24, size: int = 96) -> NearLit:
    """Pictures of a rough ``mesh`` in perspective under point lights one and a half diameters away, with noise."""
    vertices, faces = mesh
    camera = Camera.perspective(math.radians(35), eye=(0.0, 0.0, 4.0))
    seen = render_normals(vertices, faces, camera, (size, size))
    positions = 3.0 * spiral_lights(lights, math.radians(50)) - torch.tensor([0.0, 0.0, 4.0])
    depth = torch.where(seen.mask, seen.depth, 4.0)
    light, irradiance = point_light(camera.points(depth), positions[:, :, None, None], 1.0)
    view = camera.view_directions((size, size))
    normal = seen.normal.expand(lights, -1, -1, -1)
    images = OrenNayar("vcavity")(normal, light, view, albedo=0.6, roughness=0.5, irradiance=irradiance)
    noise = torch.randn(images.shape, generator=torch.Generator().manual_seed(0))
    images = (images + NOISE * noise * images.amax()).clamp_min(0) * seen.mask
    distance = seen.depth[seen.mask].log().mean().exp().item()
    return NearLit(images, positions, distance, camera, seen.mask[0], seen.normal[0])


def fit_surfaces(file: Path, which: slice = slice(None)) -> dict[str, Surface]:
    """The parameters nearest to each measured material, or some of them, by relative error of grey values."""
    from scipy.optimize import nnls

    table = np.load(file)
    ti, to, phi = (torch.from_numpy(table[k]).double() for k in ("theta_i", "theta_o", "phi"))
    ci, co = ti.cos(), to.cos()
    lv = ci * co + ti.sin() * to.sin() * phi.cos()
    kinds = [("lambert", 0.0), ("glazed", 0.0), *(("vcavity", float(s)) for s in (10, 20, 30, 40, 50))]
    widths = (0.05, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7)
    lobes = {w: (microfacet(ci, co, lv, w, 1.0)).numpy() for w in widths}
    found = {}
    for name, values in zip(table["name"][which], table["f"][which], strict=True):
        target = values.mean(1) * math.pi
        albedo = float(min(1.0, np.median(target)))
        weight = 1 / (target + 0.2 * np.median(target))
        best: tuple[float, Surface] | None = None
        for (kind, sigma), pair in itertools.product(kinds, itertools.combinations(widths, 2)):
            matt = matt_part(Surface(kind, sigma, albedo), ci, co, lv).expand_as(ci).numpy() / albedo
            basis = np.stack([matt, *(lobes[w] for w in pair)], 1)
            parts, left = nnls(basis * weight[:, None], target * weight)
            if best is None or left < best[0]:
                lights = tuple((w, round(float(s), 4)) for w, s in zip(pair, parts[1:], strict=True) if s > 1e-4)
                best = left, Surface(kind, sigma, round(float(parts[0]), 4), lights)
        assert best is not None
        found[str(name)] = best[1]
    return found


if __name__ == "__main__":
    for name, surface in fit_surfaces(Path(sys.argv[1])).items():
        print(f'    "{name}": {surface!r},'.replace("'", '"'))
