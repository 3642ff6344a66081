"""From a mesh to shaded images: a normal map once, then several lights and roughnesses in one call each.

python examples/shade_mesh.py mesh.obj picture.png
"""

import math
import sys

import torch
from PIL import Image

import torch_orennayar as ton


def main(mesh: str, picture: str) -> None:
    """Draw the mesh under three lights (columns) with roughness 0 and 40 degrees (rows)."""
    vertices, faces = ton.load_mesh(mesh)
    camera = ton.Camera.perspective(math.radians(30), eye=(1.5, 1.2, 3.6))
    seen = ton.render_normals(ton.normalise_mesh(vertices), faces, camera, (256, 256))
    lights = torch.tensor([[-0.8, 0.0, 0.6], [0.0, 0.0, 1.0], [0.48, 0.64, 0.6]])  # unit, camera frame
    layer = ton.OrenNayar("vcavity")
    rows = []
    for degrees in (0, 40):
        images = seen.shade(layer, lights[None], albedo=0.8, roughness=math.radians(degrees))[0]  # (3, 1, 256, 256)
        rows.append(torch.cat(list(images), dim=-1))  # (1, 256, 768)
    pixels = 255 * ton.linear_to_srgb(torch.cat(rows, dim=-2))[0]
    Image.fromarray(pixels.round().byte().numpy()).save(picture)


if __name__ == "__main__":
    main(*sys.argv[1:])
