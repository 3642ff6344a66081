"""Move and scale a shape until its silhouette is a given mask: gradients at occlusion edges through `antialias`.

python examples/fit_silhouette.py picture.png
"""

import sys

import torch

import torch_orennayar as ton
from torch_orennayar.geometry.primitives import bumpy_ball
from torch_orennayar.io.figures import save_sheet

SIZE = (96, 96)
CAMERA = ton.Camera.perspective(0.8, eye=(0.0, 0.0, 3.2))


def main(picture: str) -> tuple[list[float], float, list[float]]:
    """Draw start, target and end; returns place, size (truth 0.3, -0.2, 1.5) and losses."""
    vertices, faces = bumpy_ball()
    vertices = vertices * 0.5
    neighbours = ton.face_neighbours(faces)  # once: the faces stay the same

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
    shown = {"start": start, "target": target, "found": silhouette(place, size).detach()}
    save_sheet(picture, [{name: 1 - mask[0].expand(3, -1, -1) for name, mask in shown.items()}])
    return place.tolist(), size.item(), losses


if __name__ == "__main__":
    found = main(*sys.argv[1:])
    print(f"place {found[0]}, size {found[1]:.3f}, loss {found[2][0]:.4f} to {found[2][-1]:.6f}")
