"""The layer inside a training loop: albedo and roughness learned from pictures by gradient descent.

python examples/fit_roughness.py
"""

import math

import torch

import torch_orennayar as ton
from torch_orennayar.geometry.primitives import bumpy_ball, spiral_lights


def main(steps: int = 150) -> tuple[torch.Tensor, float]:
    """Return the learned albedo (3,) and roughness in degrees; the truth is (0.8, 0.5, 0.2) and 35."""
    vertices, faces = bumpy_ball()
    normal = ton.render_normals(vertices, faces, ton.Camera.orthographic(1.05), (64, 64)).normal
    lights = spiral_lights(8)[None]
    layer = ton.OrenNayar("vcavity")
    target = layer(normal, lights, albedo=torch.tensor([[0.8, 0.5, 0.2]]), roughness=math.radians(35))

    # Sigmoids keep both parameters inside their ranges, whatever the optimiser does.
    albedo_raw = torch.zeros(1, 3, requires_grad=True)
    roughness_raw = torch.zeros((), requires_grad=True)
    optimiser = torch.optim.Adam((albedo_raw, roughness_raw), lr=0.1)
    for step in range(steps):
        albedo, roughness = albedo_raw.sigmoid(), roughness_raw.sigmoid() * (math.pi / 2)
        loss = (layer(normal, lights, albedo=albedo, roughness=roughness) - target).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        if step % 25 == 0:
            print(f"step {step:3d}: loss {loss.item():.2e}, roughness {math.degrees(roughness.item()):.1f} degrees")
    return albedo.detach()[0], math.degrees(roughness.item())


if __name__ == "__main__":
    print(main())
