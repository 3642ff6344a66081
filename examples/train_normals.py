"""Train a network that finds normals in four photographs; few captures have true normals, others are rendered again.

Of each batch one capture has true normals; for the others the layer renders the photographs from the network's normals,
which must be those seen. `--loss supervised` leaves that out, `--loss lambert` takes the surfaces for Lambertian. On a
GPU: `--device cuda --compile --workers 8`. Writes normals.png (found above, true below) and curve.csv.
"""

import argparse
from pathlib import Path

import kornia.augmentation as K
import torch
import torch.nn.functional as F
from PIL import Image
from torch import Tensor, nn
from torch.utils.data import DataLoader

import torch_orennayar as ton

MIX = ton.Ingredients.plain(rough=1.0, roughest=1.5, shadows=1, noise=(0.01, 0.005), bits=(8.0, 12.0))
BATCH, LABELLED, LIGHTS, RERENDER = 8, 1, (4, 4), 4.0  # the last weighs the photographs' error beside the normals'


def conv(channels_in: int, channels_out: int, stride: int = 1) -> nn.Sequential:
    """A convolution with its normalisation."""
    return nn.Sequential(nn.Conv2d(channels_in, channels_out, 3, stride, 1), nn.GroupNorm(8, channels_out), nn.SiLU())


class FewLights(nn.Module):
    """What to add to least-squares normals: one encoder for all photographs, the maximum over them, and a decoder."""

    def __init__(self, width: int = 32) -> None:
        super().__init__()
        self.encode = nn.Sequential(conv(10, width, 2), conv(width, width), conv(width, 2 * width))
        self.decode = nn.Sequential(conv(2 * width, width), conv(width, width), nn.Upsample(scale_factor=2))
        self.last = nn.Sequential(conv(width + 4, width), nn.Conv2d(width, 3, 3, padding=1))

    def forward(self, images: Tensor, lights: Tensor, mask: Tensor) -> Tensor:
        """Unit normals (B, 3, H, W) of images (B, K, 3, H, W), lights (B, K, 3) and mask (B, 1, H, W)."""
        inverse = (lights.mT @ lights + 0.05 * torch.eye(3, device=lights.device)).inverse()
        start = F.normalize(torch.einsum("bde,bke,bkhw->bdhw", inverse, lights, images.mean(2)) + 1e-6, dim=1)
        even = images / images.mean((1, 2), keepdim=True).clamp_min(0.02)  # of the albedo little is left
        light = (lights[..., None, None] * mask[:, None]).unbind(1)
        seen = [torch.cat((start, mask, one, image), 1) for one, image in zip(light, even.unbind(1), strict=True)]
        decoded = self.decode(torch.stack([self.encode(one) for one in seen]).amax(0))
        return F.normalize(start + 0.3 * self.last(torch.cat((decoded, start, mask), 1)).float(), dim=1)


def loss_of(normal: Tensor, batch: ton.SyntheticBatch, layer: nn.Module, weight: float) -> Tensor:
    """Error of the normals where they are known, and of the photographs that the layer renders from them."""
    mask = batch["mask"].float()
    labelled = ((normal - batch["normal"]).square() * mask)[:LABELLED].sum() / mask[:LABELLED].sum().clamp_min(1)
    shaded = layer(normal, batch["true_lights"], batch["view"], batch["albedo"], batch["roughness"])
    missed = (batch["exposure"] * batch["reached"] * shaded - batch["images"]).abs()
    photographs: Tensor = (missed * mask[:, None]).mean() / mask.mean()
    return labelled + weight * photographs


def main(arguments: list[str] | None = None) -> list[float]:
    """Train; returns the mean error in degrees on captures never seen, before, on the way and at the end."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/train_normals"))
    parser.add_argument("--loss", choices=("both", "supervised", "lambert"), default="both")
    for name, default in (("--steps", 300), ("--workers", 1), ("--device", "cpu")):
        parser.add_argument(name, type=type(default), default=default)
    parser.add_argument("--compile", action="store_true")
    given = parser.parse_args(arguments)
    torch.manual_seed(0)
    network = FewLights().to(given.device)
    run = torch.compile(network) if given.compile else network
    layer = ton.OrenNayar("lambert" if given.loss == "lambert" else "vcavity")
    augment = ton.AugmentCaptures(K.RandomHorizontalFlip(), K.RandomVerticalFlip())
    optimiser = torch.optim.AdamW(network.parameters(), 2e-3)
    rate = torch.optim.lr_scheduler.OneCycleLR(optimiser, 3e-3, given.steps)
    unseen = ton.collate_captures(list(ton.SyntheticCaptures("images", mix=MIX, lights=LIGHTS, seed=1, length=32)))
    captures = ton.SyntheticCaptures("images", mix=MIX, lights=LIGHTS, length=given.steps * BATCH)
    loader = DataLoader(captures, BATCH, num_workers=given.workers, collate_fn=ton.collate_captures)

    def find(batch: ton.SyntheticBatch) -> Tensor:
        with torch.autocast(given.device, torch.bfloat16, enabled=given.device != "cpu"):
            found: Tensor = run(*(batch[name].to(given.device).float() for name in ("images", "lights", "mask")))
        return found

    @torch.no_grad()
    def error() -> float:
        return ton.angular_error(find(unseen).cpu(), unseen["normal"], unseen["mask"]).summary()["mean"]

    curve = [(0, error())]
    for step, batch in enumerate(loader, 1):
        moved = augment({name: value.to(given.device) for name, value in batch.items()})
        loss = loss_of(find(moved), moved, layer, RERENDER * (given.loss != "supervised"))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        rate.step()
        if step % 50 == 0 or step == given.steps:
            curve.append((step, error()))
            print(f"step {step}: {curve[-1][1]:.2f} degrees on captures never seen", flush=True)
    given.output.mkdir(parents=True, exist_ok=True)
    (given.output / "curve.csv").write_text("".join(f"{step},{degrees:.3f}\n" for step, degrees in curve))
    both = [ton.encode_normals(n.cpu(), unseen["mask"]) for n in (find(unseen).detach(), unseen["normal"])]
    rows = torch.cat([torch.cat(list(maps[:6]), 2) for maps in both], 1)
    Image.fromarray((255 * rows).round().byte().permute(1, 2, 0).numpy()).save(given.output / "normals.png")
    return [degrees for _, degrees in curve]


if __name__ == "__main__":
    main()
