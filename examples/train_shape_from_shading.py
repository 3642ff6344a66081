"""Teach a small network normals from one picture of a rough surface, without showing it a single normal.

    python examples/train_shape_from_shading.py [-o out/train_shape] [--steps 400] [--size 64]

Pictures are rendered from made-up meshes. The network bends the inflated silhouette; the loss is how far the shading of
its answer, by the layer, is from the picture it saw. Three versions are compared on captures that none has seen:
untrained (the inflated silhouette itself), with Lambert in the loss, with Oren-Nayar (`vcavity`) in the loss.
Writes a picture of the comparison and the loss curves; prints the errors.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
from kornia.filters import spatial_gradient
from torch import Tensor, nn

import torch_orennayar as ton
from torch_orennayar.core.progress import track
from torch_orennayar.io.figures import save_curves, save_sheet, show_light, show_normals
from torch_orennayar.shape.surface_fit import inflate, normals
from torch_orennayar.synthetic.pixels import Ingredients

MATT = Ingredients(
    rough=1.0, glazed=0.0, retro=0.0, falloff=0.0, glossy=0.0, metal=0.0, sheen=0.0, shadows=0, bounce=False,
    ambient=0.0, light_error=0.0, intensity_error=0.0, noise=(0.01, 0.005), clipped=0.0, outliers=0.0, bits=(8.0, 12.0),
)  # fmt: skip
BATCH, RATE, SMOOTH = 16, 2e-3, 0.02
STEEPEST = 8.0
"""Slopes of the inflated silhouette are cut here: at the rim they have no end."""


@dataclass
class Pictures:
    """N pictures with what is known of them, and true normals to judge by; all (N, C, H, W)."""

    shading: Tensor
    mask: Tensor
    light: Tensor
    roughness: Tensor
    slopes: Tensor
    normal: Tensor

    def __len__(self) -> int:
        return len(self.shading)

    def at(self, index: Tensor) -> Pictures:
        """Some of them."""
        return Pictures(**{name: value[index] for name, value in vars(self).items()})


def draw(count: int, first: int, size: int, lights: int = 4) -> Pictures:
    """Pictures of ``count`` captures under each of their lights; albedo is known and divided out."""
    source = ton.SyntheticCaptures("images", mix=MATT, lights=(lights, lights), size=(size, size))
    rows = []
    for index in track(range(first, first + count), "rendering", count):
        s = source.sample(index)
        mask = s["mask"].float()
        inflated = normals(inflate(mask), None, 1.0)
        slopes = (-inflated[:2] / inflated[2:].clamp_min(1e-3)).clamp(-STEEPEST, STEEPEST) * mask
        albedo = s["albedo"].mean(0, keepdim=True).clamp_min(0.05)
        for image, light in zip(s["images"], s["lights"], strict=True):
            shading = image.mean(0, keepdim=True) / albedo * mask
            shading = shading / shading[s["mask"]].quantile(0.95).clamp_min(1e-3)
            roughness = s["roughness"].amax().reshape(1, 1, 1)
            rows.append((shading, mask, light.reshape(3, 1, 1), roughness, slopes, s["normal"]))
    return Pictures(*(torch.stack(part) for part in zip(*rows, strict=True)))


class Bender(nn.Module):
    """A U-Net that adds a height to the inflated silhouette; at first none."""

    def __init__(self, width: int = 16) -> None:
        super().__init__()
        sizes = (width, 2 * width, 4 * width)
        self.down = nn.ModuleList(_two(a, b) for a, b in zip((11, *sizes[:2]), sizes, strict=True))
        self.up = nn.ModuleList((_two(sizes[2] + sizes[1], sizes[1]), _two(sizes[1] + sizes[0], sizes[0])))
        self.last = nn.Conv2d(width, 1, 3, padding=1)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)

    def forward(self, seen: Pictures) -> Tensor:
        """Normals (N, 3, H, W) of a surface: the slopes are those of a height."""
        area = seen.mask.shape[2:]
        inflated = _normals(seen.slopes, seen.mask)
        told = (seen.light.expand(-1, 3, *area), seen.roughness.expand(-1, 1, *area))
        column = torch.linspace(-1, 1, area[1]).expand(len(seen), 1, *area)
        row = torch.linspace(1, -1, area[0])[:, None].expand(len(seen), 1, *area)
        x = torch.cat((seen.shading, seen.mask, *told, inflated, column, row), 1)
        kept = []
        for block in self.down:
            x = block(F.max_pool2d(x, 2) if kept else x)
            kept.append(x)
        for block, before in zip(self.up, kept[-2::-1], strict=True):
            x = block(torch.cat((F.interpolate(x, size=before.shape[2:], mode="bilinear"), before), 1))
        height = self.last(x) * 10
        bend = spatial_gradient(height, mode="diff")[:, 0] * torch.tensor([1.0, -1.0]).reshape(2, 1, 1)
        return _normals(seen.slopes + bend, seen.mask)


def _two(inside: int, outside: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inside, outside, 3, padding=1), nn.GroupNorm(4, outside), nn.GELU(),
        nn.Conv2d(outside, outside, 3, padding=1), nn.GELU(),
    )  # fmt: skip


def _normals(slopes: Tensor, mask: Tensor) -> Tensor:
    """Unit normals from slopes to the right and up, 0 outside the mask."""
    return F.normalize(torch.cat((-slopes, torch.ones_like(mask)), 1), dim=1) * mask


def misfit(layer: ton.OrenNayar, normal: Tensor, seen: Pictures, rough: bool) -> Tensor:
    """How far the shading of the answer is from the picture, in an unknown exposure; and how bent it is."""
    roughness = seen.roughness if rough else torch.zeros_like(seen.roughness)
    shown = layer(normal, seen.light.flatten(1), albedo=1.0, roughness=roughness)
    shown = shown.reshape(seen.shading.shape)
    exposure = (shown * seen.shading).sum((1, 2, 3), keepdim=True) / shown.square().sum((1, 2, 3), keepdim=True).add(
        1e-6
    )
    missed = (F.huber_loss(exposure * shown, seen.shading, reduction="none", delta=0.1) * seen.mask).sum()
    bends = sum(
        ((normal.narrow(axis, 1, normal.shape[axis] - 1) - normal.narrow(axis, 0, normal.shape[axis] - 1)).square()
         * seen.mask.narrow(axis, 1, normal.shape[axis] - 1) * seen.mask.narrow(axis, 0, normal.shape[axis] - 1)).sum()
        for axis in (2, 3)
    )  # fmt: skip
    return (missed + SMOOTH * bends) / seen.mask.sum()


def train(pictures: Pictures, steps: int, model: str, seed: int) -> tuple[Bender, list[float]]:
    """A network and its losses."""
    torch.manual_seed(seed)
    network, layer = Bender(), ton.OrenNayar(model)
    optimiser = torch.optim.AdamW(network.parameters(), lr=RATE)
    rate = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=steps)
    losses = []
    for _ in track(range(steps), f"training with {model}", steps):
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
    """Mean and median error, degrees, and the normals."""
    found = torch.cat([network(pictures.at(part)) for part in torch.arange(len(pictures)).split(BATCH)])
    return ton.angular_error(found, pictures.normal, pictures.mask > 0).summary(), found


def main(output: Path, steps: int = 400, size: int = 64, captures: int = 150, seed: int = 0) -> dict[str, float]:
    """Median errors by version."""
    begun = time.perf_counter()
    seen, unseen = draw(captures, 0, size), draw(max(captures // 8, 4), 10**6, size)
    networks, curves = {"untrained": Bender().eval()}, {}
    for name, model in (("Lambert in the loss", "lambert"), ("Oren-Nayar in the loss", "vcavity")):
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
        rows.append({"picture": show_light(unseen.shading[k], mask), "truth": show_normals(unseen.normal[k], mask)}
                    | {name: show_normals(values[k], mask) for name, values in maps.items()})  # fmt: skip
    save_sheet(output / "normals.png", rows)
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
