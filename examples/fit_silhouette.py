"""Move and scale a shape until its silhouette is a given mask: gradients at occlusion edges through `antialias`.

python examples/fit_silhouette.py picture.png
"""

import sys

import torch
import trimesh
from PIL import Image

import torch_orennayar as ton

SIZE = (96, 96)
CAMERA = ton.Camera.perspective(0.8, eye=(0.0, 0.0, 3.2))


def main(picture: str) -> tuple[list[float], float, list[float]]:
    """Return place and size (the truth is 0.3, -0.2 and 1.5) and the losses; draw start, target and result."""
    ball = trimesh.creation.icosphere(subdivisions=5)
    vertices = torch.tensor(ball.vertices, dtype=torch.float32) * torch.tensor([0.5, 0.35, 0.4])  # an ellipsoid
    faces = torch.tensor(ball.faces)
    neighbours = ton.face_neighbours(faces)  # once, since the faces stay the same

    def silhouette(place: torch.Tensor, size: torch.Tensor) -> torch.Tensor:
        moved = vertices * size + torch.cat((place, place.new_zeros(1)))
        seen = ton.render_normals(moved, faces, CAMERA, SIZE)
        return ton.antialias(seen.mask.float(), seen, moved, faces, neighbours=neighbours)

    target = silhouette(torch.tensor([0.3, -0.2]), torch.tensor(1.5))
    place, size = torch.tensor([-0.3, 0.3]).requires_grad_(), torch.tensor(1.0).requires_grad_()
    start = silhouette(place, size).detach()
    optimiser = torch.optim.Adam([place, size], lr=0.02)
    losses = []
    for _ in range(150):
        loss = (silhouette(place, size) - target).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    shown = torch.cat((start, target, silhouette(place, size).detach()), dim=3)[0, 0]  # side by side
    Image.fromarray((255 * shown).round().byte().numpy()).convert("RGB").save(picture)
    return place.tolist(), size.item(), losses


if __name__ == "__main__":
    found = main(*sys.argv[1:])
    print(f"place {found[0]}, size {found[1]:.3f}, loss {found[2][0]:.4f} to {found[2][-1]:.6f}")
