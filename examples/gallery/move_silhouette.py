"""
Move a silhouette
=================

A rasterised mask changes in steps, so it has no gradient where the surface ends. `~torch_orennayar.antialias` blends
pixels across silhouettes; then a shape can be moved and scaled until its mask is the one that is wanted.
"""

import matplotlib.pyplot as plt
import torch
import trimesh

import torch_orennayar as ton

ball = trimesh.creation.icosphere(subdivisions=4)
vertices = torch.tensor(ball.vertices, dtype=torch.float32) * torch.tensor([0.5, 0.35, 0.4])
faces = torch.tensor(ball.faces)
neighbours = ton.face_neighbours(faces)  # once: the faces stay the same
camera = ton.Camera.perspective(0.8, eye=(0.0, 0.0, 3.2))


def silhouette(place: torch.Tensor, size: torch.Tensor) -> torch.Tensor:
    """The mask (1, 1, 96, 96) of the moved and scaled shape, with gradients."""
    moved = vertices * size + torch.cat((place, place.new_zeros(1)))
    seen = ton.render_normals(moved, faces, camera, (96, 96))
    return ton.antialias(seen.mask.float(), seen, moved, faces, neighbours=neighbours)


target = silhouette(torch.tensor([0.3, -0.2]), torch.tensor(1.5))
place, size = torch.tensor([-0.3, 0.3], requires_grad=True), torch.tensor(1.0, requires_grad=True)

# %%
# Plain gradient descent on the difference of two masks.
optimiser = torch.optim.Adam([place, size], lr=0.02)
losses, kept = [], {}
for step in range(121):
    mask = silhouette(place, size)
    loss = (mask - target).square().mean()
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()
    losses.append(loss.item())
    if step in (0, 15, 40, 120):
        kept[step] = mask.detach()[0, 0]
print(f"place {place.tolist()}, size {size.item():.3f}; true (0.3, -0.2) and 1.5")

# %%
# Brown where only the shape is, violet where only the target is.
figure, axes = plt.subplots(1, 5, figsize=(11, 2.4), layout="constrained", width_ratios=[1, 1, 1, 1, 1.5])
for axis, (step, mask) in zip(axes, kept.items(), strict=False):
    axis.imshow(mask - target[0, 0], cmap="PuOr_r", vmin=-1, vmax=1)
    axis.set_title(f"step {step}")
    axis.axis("off")
axes[4].semilogy(losses)
axes[4].set_title("loss")
plt.show()
