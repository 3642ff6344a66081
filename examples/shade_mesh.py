"""Mesh to shaded pictures: a normal map once, then many lights and roughnesses in one call.

python examples/shade_mesh.py mesh.obj picture.png
"""

import math
import sys

import torch

import torch_orennayar as ton
from torch_orennayar.geometry.mesh import normalise_mesh
from torch_orennayar.io.images import write_image


def main(mesh: str, picture: str) -> None:
    """Draw the mesh under three lights (columns) with roughness 0 and 40 degrees (rows)."""
    vertices, faces = ton.load_mesh(mesh)
    camera = ton.Camera.perspective(math.radians(30), eye=(1.5, 1.2, 3.6))
    seen = ton.render_normals(normalise_mesh(vertices), faces, camera, (256, 256))
    lights = torch.tensor([[-0.8, 0.0, 0.6], [0.0, 0.0, 1.0], [0.48, 0.64, 0.6]])  # unit, camera frame
    layer = ton.OrenNayar("vcavity")
    rows = []
    for degrees in (0, 40):
        images = seen.shade(layer, lights[None], albedo=0.8, roughness=math.radians(degrees))[0]
        rows.append(torch.cat(list(images), dim=-1))  # (1, 256, 768)
    write_image(picture, ton.linear_to_srgb(torch.cat(rows, dim=-2)))


if __name__ == "__main__":
    main(*sys.argv[1:])
