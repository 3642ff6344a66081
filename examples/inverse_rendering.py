"""Fit albedo, roughness, highlights and the lights themselves to photographs, by gradient descent through the layer.

python examples/inverse_rendering.py CAPTURE FOLDER

Normals come from photometric stereo with the given lights, here rotated by a few degrees; then everything but the
normals is learnable. Draws the loss curve, and the object under a light that no photograph used for the fit had.
"""

import math
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import torch
import torch.nn.functional as F

import torch_orennayar as ton

STEPS = 120  # of Adam
PIXELS = 1500  # drawn at random from the mask
PERTURBATION = math.radians(3)  # of the lights
SHININESS = 24.0  # exponent of the highlight


def main(source: str, folder: str) -> dict[str, float]:
    """Print and return the error of the lights before and after, the roughness, and the losses."""
    torch.manual_seed(0)
    capture = ton.load_capture(source)
    noise = PERTURBATION / math.sqrt(2) * torch.randn(capture.lights.shape)
    lights = F.normalize(capture.lights + noise, dim=1)
    start = ton.photometric_stereo(capture.images, lights, capture.mask)
    fitted, roughness, losses = fit(capture, start, lights[1:])  # the first photograph is held out

    def error(directions: torch.Tensor) -> float:
        return ton.angular_error(directions, capture.lights[1:], dim=1).summary()["mean"]

    result = {
        "lights off before": error(lights[1:]),
        "lights off after": error(fitted),
        "roughness, degrees": math.degrees(roughness),
        "first loss": losses[0],
        "last loss": losses[-1],
    }
    for name, value in result.items():
        print(f"{name}: {value:.4g}")
    draw(capture, ton.photometric_stereo(capture.images[1:], fitted, capture.mask), losses, Path(folder))
    return result


def fit(
    capture: ton.Capture, start: ton.Reconstruction, lights: torch.Tensor
) -> tuple[torch.Tensor, float, list[float]]:
    """Fit all photographs but the first; returns their lights (K, 3), roughness in radians, and the losses."""
    pixels = capture.mask[0].flatten().nonzero().flatten()
    pixels = pixels[torch.randperm(len(pixels))[:PIXELS]]
    normal = start.normal.flatten(1)[:, pixels][:, :, None]  # (3, P, 1), an image of P x 1 pixels
    seen = capture.images.flatten(2)[1:, :, pixels][..., None]  # (K, C, P, 1)
    scale = seen.mean()

    direction = lights.clone().requires_grad_()
    albedo = start.albedo.flatten(1)[:, pixels][..., None].div(scale).clamp_min(0.01).log().requires_grad_()
    roughness = start.roughness.max().clamp_min(0.1).clone().requires_grad_()
    shine = torch.tensor(-4.0, requires_grad=True)  # logarithm of the strength of the highlight
    layer = ton.OrenNayar("vcavity")
    groups = (([direction], 1e-3), ([albedo], 1e-2), ([roughness], 1e-2), ([shine], 2e-2))
    optimiser = torch.optim.Adam([{"params": p, "lr": rate} for p, rate in groups])
    losses = []
    for _ in range(STEPS):
        light = F.normalize(direction, dim=1)
        sigma = roughness.clamp(0, 1.2).reshape(1, 1, 1, 1)
        image = layer(normal[None], light[None], albedo=albedo.exp()[None] * scale, roughness=sigma)[0]
        ci = torch.einsum("cpx,kc->kpx", normal, light).clamp_min(0)[:, None]
        lobe = ton.blinn_phong(ci, normal[2:], light[:, 2].reshape(-1, 1, 1, 1), SHININESS) * ci
        loss = F.huber_loss((image + shine.exp() * scale * lobe) / scale, seen / scale, delta=0.05)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    return F.normalize(direction.detach(), dim=1), roughness.item(), losses


def draw(capture: ton.Capture, final: ton.Reconstruction, losses: list[float], folder: Path) -> None:
    """Write the loss curve, and the first photograph beside the object shaded under its light."""
    folder.mkdir(parents=True, exist_ok=True)
    figure, axes = plt.subplots()
    axes.semilogy(losses)
    axes.set(xlabel="step", ylabel="loss")
    figure.savefig(folder / "loss.png")
    photograph, relit = capture.images[0], final.shade(capture.lights[:1])[0]
    figure, row = plt.subplots(1, 2)
    for axes, title, image in zip(row, ("photograph, held out", "relit"), (photograph, relit), strict=True):
        colours = ton.linear_to_srgb(image / photograph.amax()).expand(3, -1, -1)
        axes.imshow(torch.where(capture.mask, colours, 1.0).permute(1, 2, 0).numpy())
        axes.set(title=title, xticks=(), yticks=())
    figure.savefig(folder / "relit.png")
    plt.close("all")


if __name__ == "__main__":
    main(*sys.argv[1:])
