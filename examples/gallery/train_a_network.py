"""
Train a network in half a minute
================================

A small network that sees three pictures under known lights and returns normals.
`~torch_orennayar.SyntheticCaptures` makes the shapes and `~torch_orennayar.RandomRelight` new pictures of them in every
step, so that nothing has to be stored.
"""

import matplotlib.pyplot as plt
import torch
from torch import nn

import torch_orennayar as ton

torch.manual_seed(0)
captures = ton.SyntheticCaptures("images", seed=5, mix=ton.Ingredients.plain(), size=(32, 32), lights=(3, 3))
shapes = ton.collate_captures([captures.sample(k) for k in range(72)])
relight = ton.RandomRelight(lights=3, roughness=(0.2, 0.9))


class Network(nn.Module):
    """From pictures, lights and mask to unit normals."""

    def __init__(self) -> None:
        super().__init__()
        wide = [part for width in (13, 48, 48) for part in (nn.Conv2d(width, 48, 3, padding=1), nn.SiLU())]
        self.body = nn.Sequential(*wide, nn.Conv2d(48, 3, 1))

    def forward(self, images: torch.Tensor, lights: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
        """Normals (B, 3, H, W) from grey images (B, 3, H, W) and lights (B, 3, 3)."""
        maps = lights.flatten(1)[:, :, None, None].expand(-1, -1, *images.shape[2:])
        return nn.functional.normalize(self.body(torch.cat((images, maps, mask.float()), 1)), dim=1)


# %%
# Shapes 60 to 71 are kept for the test. Below: pictures, the normals found, the true ones.
network, errors = Network(), list[float]()
optimiser = torch.optim.Adam(network.parameters(), lr=3e-3)
for _ in range(400):
    picked = torch.randint(60, (12,))
    batch = relight({name: shapes[name][picked] for name in ("normal", "albedo", "mask")})
    found = network(batch["images"].mean(2), batch["lights"], batch["mask"])
    loss = ((found - batch["normal"]).square().sum(1, keepdim=True) * batch["mask"]).sum() / batch["mask"].sum()
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()
    errors.append(ton.angular_error(found.detach(), batch["normal"], batch["mask"]).summary()["mean"])

test = relight({name: shapes[name][60:] for name in ("normal", "albedo", "mask")})
found = network(test["images"].mean(2), test["lights"], test["mask"]).detach()
error = ton.angular_error(found, test["normal"], test["mask"])
print(f"{errors[0]:.0f} degrees at first, {error.summary()['mean']:.1f} on shapes that it has not seen")
rows = test["images"][:, 0], ton.encode_normals(found * test["mask"]), ton.encode_normals(test["normal"])
figure, axes = plt.subplots(3, 6, figsize=(9, 4.6), layout="constrained")
for row, maps in zip(axes, rows, strict=True):
    for axis, picture in zip(row, maps, strict=False):
        axis.imshow(picture.permute(1, 2, 0).clamp(0, 1))
        axis.axis("off")
plt.show()
