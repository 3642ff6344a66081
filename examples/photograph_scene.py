"""Photograph a made-up scene as a hobby rig would: JPEG files to try `orennayar stereo` on, with the truth beside them.

python examples/photograph_scene.py photographs truth --ball
python examples/photograph_scene.py photographs truth --ball --table --near
"""

import argparse
import csv
import math
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
import trimesh
from PIL import Image
from torch import Tensor

import torch_orennayar as ton

SIZE = (180, 240)  # height, width of a photograph in pixels
HALF_HEIGHT = 48.0  # of the table, mm, that a photograph shows from its middle to its upper edge
OBJECT, BALL, TABLE, NOTHING = 0, 1, 2, 3
ALBEDO = torch.tensor([[0.62, 0.5, 0.4], [0.0, 0.0, 0.0], [0.2, 0.2, 0.21], [0.0, 0.0, 0.0]])
ROUGHNESS = torch.tensor([0.5, 0.0, 0.3, 0.0])  # radians


def scene(*, with_object: bool, ball: bool, table: bool) -> tuple[Tensor, Tensor, Tensor]:
    """Vertices (V, 3) in mm (the table is z = 0, the camera looks down), faces (F, 3), the part of each face."""
    unit = trimesh.creation.icosphere(subdivisions=5)
    sphere, faces = torch.tensor(unit.vertices, dtype=torch.float32), torch.tensor(unit.faces)
    x, y, z = (5 * sphere).T
    bumps = 1 + 0.08 * (x + 1).sin() * y.cos() + 0.06 * (z + x).sin()
    parts = [(OBJECT, 28 * sphere * bumps[:, None] + torch.tensor([-14.0, 0, 31]), faces)] if with_object else []
    if ball:
        parts.append((BALL, 12 * sphere + torch.tensor([42.0, -26, 12]), faces))
    if table:
        corners = torch.tensor([[-200.0, -200, 0], [200, -200, 0], [200, 200, 0], [-200, 200, 0]])
        parts.append((TABLE, corners, torch.tensor([[0, 1, 2], [0, 2, 3]])))
    starts = np.cumsum([0, *(len(v) for _, v, _ in parts)])
    return (
        torch.cat([v for _, v, _ in parts]),
        torch.cat([f + int(start) for (_, _, f), start in zip(parts, starts, strict=False)]),
        torch.cat([torch.full((len(f),), kind) for kind, _, f in parts]),
    )


def photograph(
    folder: Path, truth: Path, *, lamps: int, near: bool, with_object: bool, ball: bool, table: bool, seed: int
) -> None:
    """Write a photograph per lamp and one with all lamps off into ``folder``; lights and normals into ``truth``."""
    distance = 450.0 if near else 3000.0  # of the camera and of the lamps from the table, mm
    vertices, faces, parts = scene(with_object=with_object, ball=ball, table=table)
    camera = ton.Camera.perspective(2 * math.atan(HALF_HEIGHT / distance), eye=(0.0, 0.0, distance))
    fine = ton.render_normals(vertices, faces, camera, (2 * SIZE[0], 2 * SIZE[1]))  # averaged to half, as a sensor does
    part = torch.where(fine.mask, parts[fine.face.clamp_min(0)], NOTHING)
    albedo, roughness = ALBEDO[part[:, 0]].permute(0, 3, 1, 2), ROUGHNESS[part]
    points = camera.points(torch.where(fine.mask, fine.depth, distance))
    view = F.normalize(-points, dim=1)

    turn = 2 * math.pi * torch.arange(lamps) / lamps + 0.2
    tilt = torch.tensor([0.45, 0.75])[torch.arange(lamps) % 2] if not near else torch.full((lamps,), 0.6)
    toward = torch.stack([turn.cos() * tilt.sin(), turn.sin() * tilt.sin(), tilt.cos()], dim=1)
    positions = (300.0 if near else distance) * toward
    layer, noise = ton.OrenNayar("vcavity"), torch.Generator().manual_seed(seed)
    mirrored = 2 * (fine.normal * view).sum(1, keepdim=True) * fine.normal - view
    ambient = torch.where(part == BALL, 0.04, 0.02 * albedo)
    pictures = []
    for position in positions:
        lamp = (position - torch.tensor([0.0, 0, distance])).reshape(1, 3, 1, 1)
        light, irradiance = ton.point_light(points, lamp, float(position.square().sum()))
        reached = ton.cast_shadows(vertices, faces, fine, F.normalize(position, dim=0)[None], resolution=1024)[0]
        lit = 0.8 * reached * layer(fine.normal, light, view, albedo=albedo, roughness=roughness, irradiance=irradiance)
        spot = ((mirrored * light).sum(1, keepdim=True) > math.cos(0.06)) * (part == BALL)  # lamps of 7 degrees
        pictures.append(F.avg_pool2d(lit + ambient + 1.5 * spot, 2)[0])
    pictures.append(F.avg_pool2d(ambient, 2)[0])

    folder.mkdir(parents=True, exist_ok=True)
    truth.mkdir(parents=True, exist_ok=True)
    names = [*(f"IMG_{2001 + k}.JPG" for k in range(lamps)), "ambient.JPG"]
    for name, picture in zip(names, pictures, strict=True):
        noisy = picture + 0.003 * torch.randn(picture.shape, generator=noise)
        pixels = (255 * ton.linear_to_srgb(noisy.clamp(0, 1))).round().byte()
        Image.fromarray(pixels.permute(1, 2, 0).numpy()).save(folder / name, quality=95)
    with (truth / "lamps.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("x_mm", "y_mm", "z_mm"), *(map("{:.1f}".format, p) for p in positions.tolist())])
    np.savetxt(truth / "light_directions.txt", toward.numpy(), fmt="%.6f")
    np.save(truth / "normal.npy", fine.normal[0, :, ::2, ::2].numpy())
    np.save(truth / "part.npy", part[0, 0, ::2, ::2].numpy())


def main(arguments: list[str] | None = None) -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="for the photographs")
    parser.add_argument("truth", type=Path, help="for lights, positions of lamps, normals and parts")
    parser.add_argument("--ball", action="store_true", help="put a mirror ball beside the object")
    parser.add_argument("--no-object", action="store_true", help="leave the object out: a ball by itself")
    parser.add_argument("--table", action="store_true", help="let a grey table be seen; else all around is black")
    parser.add_argument("--near", action="store_true", help="lamps on a ring 300 mm away, a camera at 450 mm")
    parser.add_argument("--lamps", type=int, default=12)
    parser.add_argument("--seed", type=int, default=0, help="of the noise")
    given = parser.parse_args(arguments)
    photograph(
        given.folder, given.truth, lamps=given.lamps, near=given.near, with_object=not given.no_object,
        ball=given.ball, table=given.table, seed=given.seed,
    )  # fmt: skip


if __name__ == "__main__":
    main()
