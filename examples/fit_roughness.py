"""The layer inside a training loop: albedo and roughness learned from images by gradient descent.

python examples/fit_roughness.py
"""

import math

import torch
import torch.nn.functional as F

import torch_orennayar as ton


def main(steps: int = 150) -> tuple[torch.Tensor, float]:
    """Return the learned albedo (3,) and roughness in degrees; the truth is (0.8, 0.5, 0.2) and 35."""
    # Normals (1, 3, 64, 64) of a sphere, 0 in the background, and eight lights (1, 8, 3) around the viewer.
    y, x = torch.meshgrid(torch.linspace(1.05, -1.05, 64), torch.linspace(-1.05, 1.05, 64), indexing="ij")
    normal = torch.stack((x, y, (1 - x * x - y * y).clamp_min(0).sqrt()))[None] * (x * x + y * y < 1)
    azimuth = torch.arange(8) * (2 * math.pi / 8)
    lights = F.normalize(torch.stack((azimuth.cos(), azimuth.sin(), torch.ones(8)), 1), dim=1)[None]
    layer = ton.OrenNayar("vcavity")
    target = layer(normal, lights, albedo=torch.tensor([[0.8, 0.5, 0.2]]), roughness=math.radians(35))

    # Sigmoids keep both parameters in their ranges, whatever the optimiser does.
    albedo_logit = torch.zeros(1, 3, requires_grad=True)
    roughness_logit = torch.zeros((), requires_grad=True)

    def parameters() -> tuple[torch.Tensor, torch.Tensor]:
        return albedo_logit.sigmoid(), roughness_logit.sigmoid() * (math.pi / 2)

    optimiser = torch.optim.Adam((albedo_logit, roughness_logit), lr=0.1)
    for step in range(steps):
        albedo, roughness = parameters()
        loss = (layer(normal, lights, albedo=albedo, roughness=roughness) - target).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        if step % 25 == 0:
            print(f"step {step:3d}: loss {loss.item():.2e}, roughness {math.degrees(roughness.item()):.1f} degrees")
    albedo, roughness = parameters()
    return albedo.detach()[0], math.degrees(roughness.item())


if __name__ == "__main__":
    print(main())
