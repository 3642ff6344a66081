"""Train a small network to estimate normals from one picture of a rough surface, without true normals.

    python examples/train_shape_from_shading.py [-o out/train_shape] [--steps 400] [--size 64]

Pictures are rendered from random meshes. The network deforms the inflated silhouette; the loss is the difference
between the picture and the shading of the estimated normals by the layer. Three versions are compared on captures that
none has seen: untrained (the inflated silhouette itself), with Lambert in the loss, with Oren-Nayar (`vcavity`) in the
loss. Writes normals.png, loss.png and network.pt; prints the errors.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
from kornia.filters import spatial_gradient
from matplotlib.figure import Figure
from torch import Tensor, nn

import torch_orennayar as ton

MATT = ton.Ingredients.plain(rough=1.0, noise=(0.01, 0.005), bits=(8.0, 12.0))
"""Rough surfaces without highlights, shadows and interreflection."""
BATCH = 16
"""Pictures of a step. Set by hand, as all of these."""
RATE = 2e-3
"""Largest learning rate."""
SMOOTHNESS = 0.02
"""Weight in the loss of squared differences between neighbouring normals."""
MAX_SLOPE = 8.0
"""Slopes of the inflated silhouette are clamped to this: at the rim they are infinite."""
HEIGHT_SCALE = 10
"""Pixels of height that an output of 1 stands for."""


@dataclass
class Pictures:
    """N pictures, what is known about them, and their true normals for evaluation; all (N, C, H, W)."""

    shading: Tensor
    mask: Tensor
    light: Tensor
    roughness: Tensor
    slopes: Tensor
    normal: Tensor

    def __len__(self) -> int:
        return len(self.shading)

    def at(self, index: Tensor) -> Pictures:
        """The pictures at an index (M,)."""
        return Pictures(**{name: value[index] for name, value in vars(self).items()})


def draw(count: int, first: int, size: int, lights: int = 4) -> Pictures:
    """Pictures of ``count`` captures under each of their lights; the albedo is known and divided out."""
    source = ton.SyntheticCaptures("images", mix=MATT, lights=(lights, lights), size=(size, size))
    rows = []
    for index in range(first, first + count):
        sample = source.sample(index)
        mask = sample["mask"].float()
        inflated = ton.silhouette_normals(sample["mask"])
        slopes = (-inflated[:2] / inflated[2:].clamp_min(1e-3)).clamp(-MAX_SLOPE, MAX_SLOPE) * mask
        albedo = sample["albedo"].mean(0, keepdim=True).clamp_min(0.05)
        for image, light in zip(sample["images"], sample["lights"], strict=True):
            shading = image.mean(0, keepdim=True) / albedo * mask
            shading = shading / shading[sample["mask"]].quantile(0.95).clamp_min(1e-3)
            roughness = sample["roughness"].amax().reshape(1, 1, 1)
            rows.append((shading, mask, light.reshape(3, 1, 1), roughness, slopes, sample["normal"]))
    return Pictures(*(torch.stack(part) for part in zip(*rows, strict=True)))


class Bender(nn.Module):
    """A U-Net that adds a height to the inflated silhouette; untrained it adds 0."""

    def __init__(self, width: int = 16) -> None:
        super().__init__()
        sizes = (width, 2 * width, 4 * width)
        self.down = nn.ModuleList(_convolutions(a, b) for a, b in zip((11, *sizes[:2]), sizes, strict=True))
        self.up = nn.ModuleList(
            (_convolutions(sizes[2] + sizes[1], sizes[1]), _convolutions(sizes[1] + sizes[0], sizes[0]))
        )
        self.last = nn.Conv2d(width, 1, 3, padding=1)
        nn.init.zeros_(self.last.weight)
        assert self.last.bias is not None
        nn.init.zeros_(self.last.bias)

    def forward(self, seen: Pictures) -> Tensor:
        """Normals (N, 3, H, W), whose deviation from the inflated silhouette is the gradient of a height."""
        size = seen.mask.shape[2:]
        inflated = _normals(seen.slopes, seen.mask)
        light, roughness = seen.light.expand(-1, 3, *size), seen.roughness.expand(-1, 1, *size)
        column = torch.linspace(-1, 1, size[1]).expand(len(seen), 1, *size)
        row = torch.linspace(1, -1, size[0])[:, None].expand(len(seen), 1, *size)
        x = torch.cat((seen.shading, seen.mask, light, roughness, inflated, column, row), 1)
        skipped: list[Tensor] = []
        for block in self.down:
            x = block(F.max_pool2d(x, 2) if skipped else x)
            skipped.append(x)
        for block, skip in zip(self.up, skipped[-2::-1], strict=True):
            x = block(torch.cat((F.interpolate(x, size=skip.shape[2:], mode="bilinear"), skip), 1))
        height = self.last(x) * HEIGHT_SCALE
        slopes = spatial_gradient(height, mode="diff")[:, 0] * torch.tensor([1.0, -1.0]).reshape(2, 1, 1)
        return _normals(seen.slopes + slopes, seen.mask)


def _convolutions(channels_in: int, channels_out: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(channels_in, channels_out, 3, padding=1), nn.GroupNorm(4, channels_out), nn.GELU(),
        nn.Conv2d(channels_out, channels_out, 3, padding=1), nn.GELU(),
    )  # fmt: skip


def _normals(slopes: Tensor, mask: Tensor) -> Tensor:
    """Unit normals from slopes to the right and up, 0 outside the mask."""
    return F.normalize(torch.cat((-slopes, torch.ones_like(mask)), 1), dim=1) * mask


def misfit(layer: ton.OrenNayar, normal: Tensor, seen: Pictures, rough: bool) -> Tensor:
    """Difference of the normals' shading from the picture, of unknown exposure, plus a smoothness term."""
    roughness = seen.roughness if rough else torch.zeros_like(seen.roughness)
    shaded = layer(normal, seen.light.flatten(1), albedo=1.0, roughness=roughness)
    shaded = shaded.reshape(seen.shading.shape)
    image = (1, 2, 3)
    exposure = (shaded * seen.shading).sum(image, keepdim=True) / shaded.square().sum(image, keepdim=True).add(1e-6)
    residual = (F.huber_loss(exposure * shaded, seen.shading, reduction="none", delta=0.1) * seen.mask).sum()
    bending = sum(
        ((normal.narrow(axis, 1, normal.shape[axis] - 1) - normal.narrow(axis, 0, normal.shape[axis] - 1)).square()
         * seen.mask.narrow(axis, 1, normal.shape[axis] - 1) * seen.mask.narrow(axis, 0, normal.shape[axis] - 1)).sum()
        for axis in (2, 3)
    )  # fmt: skip
    return (residual + SMOOTHNESS * bending) / seen.mask.sum()


def train(pictures: Pictures, steps: int, model: str, seed: int) -> tuple[Bender, list[float]]:
    """Train a network; returns it and the loss of every step."""
    torch.manual_seed(seed)
    network, layer = Bender(), ton.OrenNayar(model)
    optimiser = torch.optim.AdamW(network.parameters(), lr=RATE)
    rate = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=steps)
    losses = []
    for _ in range(steps):
        batch = pictures.at(torch.randint(len(pictures), (BATCH,)))
        loss = misfit(layer, network(batch), batch, model != "lambert")
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        rate.step()
        losses.append(loss.item())
    return network.eval(), losses


@torch.no_grad()
def errors(network: Bender, pictures: Pictures) -> tuple[dict[str, float], Tensor]:
    """Summary of the angular error in degrees, and the normals."""
    found = torch.cat([network(pictures.at(part)) for part in torch.arange(len(pictures)).split(BATCH)])
    return ton.angular_error(found, pictures.normal, pictures.mask > 0).summary(), found


def save_pictures(path: Path, rows: Sequence[Mapping[str, Tensor]]) -> None:
    """Rows of pictures (3, H, W) in [0, 1] with their captions."""
    figure = Figure(figsize=(2.1 * len(rows[0]), 2.3 * len(rows)), layout="constrained")
    for axes, row in zip(figure.subplots(len(rows), len(rows[0]), squeeze=False), rows, strict=True):
        for axis, (caption, picture) in zip(axes, row.items(), strict=True):
            axis.imshow(picture.permute(1, 2, 0).numpy().clip(0, 1))
            axis.set_title(caption, fontsize=9)
            axis.axis("off")
    figure.savefig(path, dpi=130)


def save_curves(path: Path, curves: Mapping[str, Sequence[float]]) -> None:
    """Losses by step."""
    figure = Figure(figsize=(5, 3), layout="constrained")
    axis = figure.subplots()
    for name, losses in curves.items():
        axis.semilogy(losses, label=name, linewidth=1)
    axis.set(xlabel="step", ylabel="loss")
    axis.legend(fontsize=8)
    figure.savefig(path, dpi=130)


def main(output: Path, steps: int = 400, size: int = 64, captures: int = 150, seed: int = 0) -> dict[str, float]:
    """Train and compare all versions; returns the median error in degrees by version."""
    begun = time.perf_counter()
    print(f"rendering {captures} captures", flush=True)
    seen, unseen = draw(captures, 0, size), draw(max(captures // 8, 4), 10**6, size)
    networks, curves = {"untrained": Bender().eval()}, {}
    for name, model in (("Lambert in the loss", "lambert"), ("Oren-Nayar in the loss", "vcavity")):
        print(f"training with {name}", flush=True)
        networks[name], curves[name] = train(seen, steps, model, seed)
    found, maps = {}, {}
    for name, network in networks.items():
        summary, maps[name] = errors(network, unseen)
        found[name] = summary["median"]
        print(f"{name:24} median {summary['median']:6.2f}  mean {summary['mean']:6.2f} degrees")
    output.mkdir(parents=True, exist_ok=True)
    rows = []
    for k in range(0, len(unseen), max(1, len(unseen) // 5)):
        mask = unseen.mask[k] > 0
        picture = torch.where(mask, ton.linear_to_srgb(unseen.shading[k].expand(3, -1, -1)), 1.0)
        normals = {"truth": unseen.normal[k]} | {name: values[k] for name, values in maps.items()}
        colours = {name: torch.where(mask, ton.encode_normals(n, mask), 1.0) for name, n in normals.items()}
        rows.append({"picture": picture} | colours)
    save_pictures(output / "normals.png", rows)
    save_curves(output / "loss.png", curves)
    torch.save(networks["Oren-Nayar in the loss"].state_dict(), output / "network.pt")
    print(f"{time.perf_counter() - begun:.0f} s; look at {output / 'normals.png'}")
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/train_shape"))
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--captures", type=int, default=150)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    main(options.output, options.steps, options.size, options.captures, options.seed)
