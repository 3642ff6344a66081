"""Train the network that `shape_from_shading` starts from: normals and their expected error from one picture.

    python -m scripts.fit.train_picture_network draw FOLDER [--captures 7600]
    python -m scripts.fit.train_picture_network train FOLDER -o network.pt [--minutes 64] [--start other.pt]
    python -m scripts.fit.train_picture_network train FOLDER -o network.pt --minutes 4 --start other.pt --only-error

`draw` renders captures of random figures, heaps, vessels and reliefs (`SyntheticCaptures(meshes="figures")`) in files
of a hundred; killed, it goes on where it stopped. `train` reads them at random: another light, place, part and mirror
image every time, ambient light in two fifths. The loss is the error of the normals, that of what the network expects of
itself, and that of the picture which the layer renders from the normals, with true albedo, shadows and the rest. The
learning rate falls with the time that is given, so that another machine makes other weights; captures of the first two
files are never trained on and judge. ``--only-error`` trains what the network expects of itself, and keeps its normals.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.utils.data import DataLoader, IterableDataset

import torch_orennayar as ton
from torch_orennayar.core.files import atomic_path
from torch_orennayar.core.progress import track
from torch_orennayar.shape.picture_network import (
    SIDE,
    Frame,
    PictureNetwork,
    load_picture_network,
    make_input,
    save_picture_network,
)

# All numbers below were set by hand.
MIX = ton.Ingredients(rough=0.4, glossy=0.6, metal=0.05, noise=(0.02, 0.01), clipped=0.1, outliers=0.0)
"""More matt surfaces than the captures of photometric stereo have: one picture says little of a mirror."""
LIGHTS = 3
"""Pictures of a capture, each with a light of its own."""
PER_FILE, HELD_OUT = 100, 2
"""Captures of a file, and files that judge."""
LEAST_PIXELS, LEAST_SEEN = 500, 300
"""Pixels of an object that is kept, and of what a sample shows of it."""
BATCH, RATE, DECAY, WARM_UP = 16, 2e-3, 1e-2, 100
"""Pictures of a step, largest learning rate, weight decay, steps in which the rate rises."""
AVERAGE = 0.998
"""Decay per step of the moving average of the weights, which is what is written."""
ZOOMED, AMBIENT, MOST_AMBIENT = 0.25, 0.4, 0.3
"""Shares of samples that show a part, and that have ambient light, and its largest share of the light."""
OUTLOOK, RERENDER = 0.05, 0.3
"""Weights in the loss of the expected error and of the rendered picture."""
REPORT = 250
"""Steps between reports."""


def draw(folder: Path, captures: int) -> None:
    """Render captures into files of `PER_FILE`; those that exist are left."""
    folder.mkdir(parents=True, exist_ok=True)
    dataset = ton.SyntheticCaptures("images", meshes="figures", size=(SIDE, SIDE), lights=(LIGHTS, LIGHTS), mix=MIX)
    for number in track(range(captures // PER_FILE), "captures", captures // PER_FILE):
        file = folder / f"{number:05d}.pt"
        if file.exists():
            continue
        samples = [dataset.sample(number * PER_FILE + k) for k in range(PER_FILE)]
        with atomic_path(file) as temporary:
            torch.save([_pack(sample) for sample in samples if sample["mask"].sum() >= LEAST_PIXELS], temporary)


def _pack(sample: ton.SyntheticImages) -> dict[str, Tensor]:
    """What training needs of a capture, grey and in half precision."""
    albedo = sample["exposure"][0] * sample["albedo"].mean(0, keepdim=True)
    rest = (sample["between"] + sample["remainder"]).mean(1)
    half = {"image": sample["images"].mean(1), "normal": sample["normal"], "albedo": albedo, "rest": rest}
    return {name: value.half() for name, value in (half | {"roughness": sample["roughness"]}).items()} | {
        "mask": sample["mask"],
        "reached": (255 * sample["reached"]).round().byte(),
        "lights": sample["true_lights"],
        "view": sample["view"][:, :: SIDE - 1, :: SIDE - 1].clone(),  # linear in row and column between the corners
    }


class Sample(NamedTuple):
    """One picture in its frame, or a batch of them; brightness is over the picture's peak."""

    maps: Tensor
    normal: Tensor
    inside: Tensor
    albedo: Tensor
    roughness: Tensor
    reached: Tensor
    rest: Tensor
    view: Tensor
    light: Tensor
    image: Tensor


class Pictures(IterableDataset[Sample]):
    """Endless samples of files of captures."""

    def __init__(self, files: list[Path], seed: int) -> None:
        self.files, self.seed = files, seed

    def __iter__(self) -> Iterator[Sample]:
        torch.set_num_threads(1)
        generator = torch.Generator().manual_seed(self.seed)
        while True:
            captures = torch.load(self.files[int(torch.randint(len(self.files), (), generator=generator))])
            for place in torch.randperm(len(captures), generator=generator).tolist():
                sample = _prepare(captures[place], generator)
                if sample is not None:
                    yield sample


def _prepare(capture: dict[str, Tensor], generator: torch.Generator) -> Sample | None:
    """One picture of a capture, moved, cut and mirrored at random; None where little is left to see."""

    def uniform(low: float = 0.0, high: float = 1.0) -> float:
        return low + (high - low) * float(torch.rand((), generator=generator))

    which = int(torch.randint(len(capture["image"]), (), generator=generator))
    light, mask, albedo = capture["lights"][which], capture["mask"].float(), capture["albedo"].float()
    ambient = albedo * (uniform(0, MOST_AMBIENT) if uniform() < AMBIENT else 0.0)
    whole = {
        "image": capture["image"][which][None].float() + ambient,
        "mask": mask,
        "normal": capture["normal"].float(),
        "albedo": albedo,
        "roughness": capture["roughness"].float(),
        "reached": capture["reached"][which].float() / 255,
        "rest": capture["rest"][which][None].float() + ambient,
        "view": F.interpolate(capture["view"][None], size=mask.shape[1:], mode="bilinear", align_corners=True)[0],
    }
    frame = _draw_frame(capture["mask"], light, uniform, generator)
    mirror = torch.tensor([1.0, -1.0 if uniform() < 0.5 else 1.0, 1.0]).reshape(3, 1, 1)
    taken = frame.take(torch.cat(list(whole.values())))
    taken = taken.flip(1) if mirror[1] < 0 else taken
    part = dict(zip(whole, taken.split([len(value) for value in whole.values()]), strict=True))
    inside = part["mask"] > 0.5
    if inside.sum() < LEAST_SEEN:
        return None
    image = part["image"] / part["mask"].clamp_min(0.5)
    peak = image[inside].quantile(0.99).clamp_min(1e-4)
    turned = {name: mirror * frame.take_vectors(part[name]) for name in ("normal", "view")}
    return Sample(
        maps=make_input(image / peak, part["mask"], math.acos(float(light[2].clamp(-1, 1)))),
        normal=F.normalize(turned["normal"], dim=0) * inside,
        inside=inside.float(),
        albedo=part["albedo"] / peak,
        roughness=part["roughness"],
        reached=part["reached"],
        rest=part["rest"] / peak,
        view=F.normalize(turned["view"], dim=0),
        light=mirror * frame.take_vectors(light.reshape(3, 1, 1)),
        image=image / peak,
    )


def _draw_frame(mask: Tensor, light: Tensor, uniform: object, generator: torch.Generator) -> Frame:
    """The frame of the object, a little off, or of a part of it."""
    assert callable(uniform)
    frame = Frame.around(mask, light)
    if uniform() < ZOOMED:
        pixels = mask[0].nonzero()
        row, column = pixels[int(torch.randint(len(pixels), (), generator=generator))].tolist()
        frame = Frame((row, column), frame.reach * uniform(0.4, 0.9), frame.azimuth)
    else:
        frame = Frame(frame.centre, frame.reach * uniform(0.97, 1.1), frame.azimuth)
    slip = 0.05 * float(torch.randn((), generator=generator)) if uniform() < 0.3 else 0.0
    return Frame(frame.centre, frame.reach, frame.azimuth + slip)


def losses(network: PictureNetwork, batch: Sample) -> Tensor:
    """Loss, mean error of the network and of the inflated silhouette in degrees, loss of outlook and picture; (5,)."""
    with torch.autocast("cpu", torch.bfloat16):
        normal, error = network(batch.maps.to(memory_format=torch.channels_last))
    seen = batch.inside * (batch.normal[:, 2:] > 0.05)
    total = seen.sum().clamp_min(1)
    missed = (normal - batch.normal).norm(dim=1, keepdim=True)
    outlook = (missed.detach().square() / (2 * error * error) + 2 * error.log()) * seen
    layer = ton.OrenNayar("vcavity")
    shaded = batch.reached * layer(normal, batch.light, batch.view, batch.albedo, batch.roughness) + batch.rest
    picture = (shaded - batch.image).abs().clamp_max(0.5) * seen
    start = (F.normalize(batch.maps[:, :3] + 1e-3, dim=1) - batch.normal).norm(dim=1, keepdim=True)
    degrees = [(2 * (d.detach() / 2).clamp_max(1).asin().rad2deg() * seen).sum() / total for d in (missed, start)]
    parts = (outlook.sum() / total, picture.sum() / total)
    return torch.stack(((missed * seen).sum() / total + OUTLOOK * parts[0] + RERENDER * parts[1], *degrees, *parts))


def train(folder: Path, output: Path, minutes: float, start: Path | None, *, only_error: bool) -> None:
    """Train for so many minutes; the moving average of the weights is written at every report."""
    torch.manual_seed(0)
    files = sorted(folder.glob("*.pt"))
    network = PictureNetwork() if start is None else load_picture_network(start).train()
    network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    if only_error:
        network.requires_grad_(False)
        network.doubt.requires_grad_(True)
    average = PictureNetwork()
    average.load_state_dict(network.state_dict())
    held_out = iter(Pictures(files[:HELD_OUT], 7000))
    judges = [_stack([next(held_out) for _ in range(BATCH)]) for _ in range(8)]
    loader = DataLoader(Pictures(files[HELD_OUT:], 1000), BATCH, num_workers=1, collate_fn=_stack, prefetch_factor=8)
    optimiser = torch.optim.AdamW(network.parameters(), RATE, betas=(0.9, 0.98), weight_decay=DECAY)
    begun, step = time.monotonic(), 0
    for step, batch in enumerate(loader, 1):
        share = (time.monotonic() - begun) / (60 * minutes)
        if share >= 1:
            break
        rate = RATE * min(1, step / WARM_UP) * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * share)))
        for group in optimiser.param_groups:
            group["lr"] = rate
        optimiser.zero_grad()
        losses(network, batch)[0].backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        with torch.no_grad():
            for kept, value in zip(average.parameters(), network.parameters(), strict=True):
                kept.lerp_(value, max(1 - AVERAGE, 1 / (step + 10)))
        if step % REPORT == 0:
            _report(step, average, judges, output)
    _report(step, average, judges, output)


@torch.no_grad()
def _report(step: int, network: PictureNetwork, judges: list[Sample], output: Path) -> None:
    save_picture_network(output, network)
    mean = torch.stack([losses(network, batch) for batch in judges]).mean(0)
    print(f"step {step}: {mean[1]:.2f} degrees, inflated silhouette {mean[2]:.2f}", flush=True)


def _stack(samples: list[Sample]) -> Sample:
    return Sample(*(torch.stack(values) for values in zip(*samples, strict=True)))


def main() -> None:
    """Draw or train."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("draw", "train"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path("out/picture_network.pt"))
    parser.add_argument("--captures", type=int, default=7600)
    parser.add_argument("--minutes", type=float, default=64)
    parser.add_argument("--start", type=Path, help="weights to begin with")
    parser.add_argument("--only-error", action="store_true", help="keep the normals of --start")
    given = parser.parse_args()
    if given.what == "draw":
        draw(given.folder, given.captures)
    else:
        train(given.folder, given.output, given.minutes, given.start, only_error=given.only_error)


if __name__ == "__main__":
    main()
