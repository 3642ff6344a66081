"""Fit albedo, roughness, highlights and the lights themselves to photographs, by gradient descent through the layer.

python examples/inverse_rendering.py CAPTURE FOLDER

Normals come from photometric stereo with the lights as given, here turned by a few degrees; then everything but the
normals is learnable. Draws the loss curve and the object under a light that no photograph had.
"""

import math
import sys
from pathlib import Path

import torch
import torch.nn.functional as F

import torch_orennayar as ton
from torch_orennayar.io.figures import save_curves, save_sheet, show_light

STEPS = 120
PIXELS = 1500
HELD_OUT = 0


def main(source: str, folder: str) -> dict[str, float]:
    """Print how far the lights were off before and after, and the roughness."""
    torch.manual_seed(0)
    capture = ton.load_capture(source)
    true_lights = capture.lights
    turned = F.normalize(true_lights + math.radians(3) / math.sqrt(2) * torch.randn(true_lights.shape), dim=1)
    start = ton.photometric_stereo(capture.images, turned, capture.mask)

    pixels = capture.mask[0].flatten().nonzero().flatten()
    pixels = pixels[torch.randperm(len(pixels))[:PIXELS]]
    normal = start.normal.flatten(1)[:, pixels][:, :, None]  # (3, P, 1), a picture of P x 1 pixels
    seen = capture.images.flatten(2)[1:, :, pixels][..., None]  # the first photograph is held out
    scale = seen.mean()

    direction = turned[1:].clone().requires_grad_()
    albedo = start.albedo.flatten(1)[:, pixels][..., None].div(scale).clamp_min(0.01).log().requires_grad_()
    roughness = start.roughness.max().clamp_min(0.1).clone().requires_grad_()
    shine = torch.tensor(-4.0, requires_grad=True)
    layer = ton.OrenNayar("vcavity")
    groups = (([direction], 1e-3), ([albedo], 1e-2), ([roughness], 1e-2), ([shine], 2e-2))
    optimiser = torch.optim.Adam([{"params": p, "lr": rate} for p, rate in groups])
    losses = []
    for _ in range(STEPS):
        lights = F.normalize(direction, dim=1)
        sigma = roughness.clamp(0, 1.2).reshape(1, 1, 1, 1)
        image = layer(normal[None], lights[None], albedo=albedo.exp()[None] * scale, roughness=sigma)[0]
        ci = torch.einsum("cpx,kc->kpx", normal, lights).clamp_min(0)[:, None]
        lobe = ton.blinn_phong(ci, normal[2:], lights[:, 2].reshape(-1, 1, 1, 1), 24.0) * ci
        loss = F.huber_loss((image + shine.exp() * scale * lobe) / scale, seen / scale, delta=0.05)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())

    def off(lights: torch.Tensor) -> float:
        return ton.angular_error(lights, true_lights[1:], dim=1).summary()["mean"]

    again = torch.cat((true_lights[:1], F.normalize(direction.detach(), dim=1)))
    final = ton.photometric_stereo(capture.images[1:], again[1:], capture.mask)
    result = {
        "lights off before": off(turned[1:]),
        "lights off after": off(again[1:]),
        "roughness, degrees": math.degrees(roughness.item()),
        "first loss": losses[0],
        "last loss": losses[-1],
    }
    for name, value in result.items():
        print(f"{name}: {value:.4g}")

    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    save_curves(target / "loss.png", {"all together": losses})
    top = capture.images[HELD_OUT].amax()
    relit = final.shade(true_lights[HELD_OUT : HELD_OUT + 1])[0]
    pictures = {"photograph, held out": capture.images[HELD_OUT] / top, "relit": relit / top}
    save_sheet(target / "relit.png", [{k: show_light(v, capture.mask) for k, v in pictures.items()}])
    return result


if __name__ == "__main__":
    main(*sys.argv[1:])
