"""Speed of the synthetic data source, a picture of it, and the traffic of training on it.

    python -m scripts.benchmarks.measure_synthetic [--output .github/images] [--device cpu] [--seconds 5]

`speed`: samples per second of `SyntheticCaptures`, both kinds, and seconds of a rendered scene. `switches`: what each
ingredient of pictures costs. `waiting`: how long a training step waits for its samples. `training`: what one
step of `examples/train_photometric_stereo.py` sends on 1 to 64 processes, calculated from the size of the network.
Recorded in results/measure_synthetic.json. Draws captures.png, a contact sheet of pictures with their truth.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Protocol, TypeAlias, cast

import torch
from torch import Tensor
from torch.utils.data import DataLoader

from scripts.benchmarks.record import ROOT, record
from tests.support.example_code import load
from torch_orennayar import Ingredients, SyntheticCaptures, SyntheticImages, SyntheticPixels, collate_captures
from torch_orennayar.io.figures import save_sheet, show_light, show_normals
from torch_orennayar.stereo.set_network import load_network
from torch_orennayar.synthetic.draw import Draw
from torch_orennayar.synthetic.scenes import SCENE_LIGHTS, draw_scene

LINK = 12.5e9
"""Bytes a second of a link of 100 Gb/s."""
ROUGH = Ingredients.plain(rough=1.0)
"""The mix that costs least."""
SWITCHES: dict[str, object] = {
    "glazed": 1.0, "retro": 1.0, "falloff": 1.0, "glossy": 1.0, "sheen": 1.0, "shadows": 1, "bounce": True,
    "ambient": 0.03, "light_error": 0.006, "intensity_error": 0.03, "noise": (0.02, 0.012), "clipped": 1.0,
    "bits": (6.5, 14.0),
}  # fmt: skip
"""Ingredients of pictures, and values that turn them on."""
STEP = 0.03
"""Seconds of the training step that waits for samples."""

Captures: TypeAlias = "SyntheticCaptures[SyntheticPixels] | SyntheticCaptures[SyntheticImages]"


class Training(Protocol):
    """What is measured of the example's trainer."""

    def run_step(self, samples: Iterator[object], world: int) -> object:
        """One step of training."""


def observations(sample: SyntheticPixels | SyntheticImages) -> int:
    """Pixels times lights of one sample."""
    tensors = cast("Mapping[str, Tensor]", sample)
    return tensors["observed"].numel() if "observed" in tensors else int(tensors["mask"].sum()) * len(tensors["lights"])


def speed(captures: Captures, seconds: float) -> dict[str, float]:
    """Samples and millions of observations per second."""
    captures.sample(0)
    begun, count, seen = time.perf_counter(), 0, 0
    while time.perf_counter() - begun < seconds:
        seen += observations(captures.sample(count))
        count += 1
    spent = time.perf_counter() - begun
    return {"samples per second": count / spent, "million observations per second": seen / spent / 1e6}


def switch_costs(device: str, repeats: int = 7, samples: int = 10) -> dict[str, object]:
    """Milliseconds of a plain sample, and how many more each ingredient takes: medians of interleaved runs."""
    mixes = {"": ROUGH} | {name: replace(ROUGH, **{name: value}) for name, value in SWITCHES.items()}  # type: ignore[arg-type]
    sources = {n: SyntheticCaptures("images", mix=m, lights=(4, 4), device=device) for n, m in mixes.items()}
    taken: dict[str, list[float]] = {name: [] for name in sources}
    for _ in range(repeats):
        for name, captures in sources.items():
            begun = time.perf_counter()
            for index in range(samples):
                captures.sample(index)
            taken[name].append(1e3 * (time.perf_counter() - begun) / samples)
    plain = median(taken.pop(""))
    return {"plain": plain, "more": {name: median(times) - plain for name, times in taken.items()}}


def waiting(workers: int = 2, steps: int = 40) -> dict[str, float]:
    """Share of the time that a step of `STEP` seconds, which leaves the processor free, waits for 8 samples."""
    shares = {}
    for name, mix in {"everything": Ingredients(), "rough surfaces alone": ROUGH}.items():
        captures = SyntheticCaptures("images", mix=mix, lights=(4, 4))
        batches = iter(DataLoader(captures, 8, num_workers=workers, collate_fn=collate_captures))
        next(batches)
        waited, begun = 0.0, time.perf_counter()
        for _ in range(steps):
            asked = time.perf_counter()
            next(batches)
            waited += time.perf_counter() - asked
            time.sleep(STEP)
        shares[name] = waited / (time.perf_counter() - begun)
    return shares


def scene_seconds(device: str, scenes: int = 5) -> float:
    """Seconds to render one scene."""
    begun = time.perf_counter()
    for seed in range(scenes):
        draw_scene(Draw(seed, device), SCENE_LIGHTS, None)
    return (time.perf_counter() - begun) / scenes


def contact_sheet(path: Path) -> None:
    """Eight captures: three photographs, normals, albedo, roughness."""
    rows = []
    captures = SyntheticCaptures("images", size=(96, 96), lights=(3, 3))
    for index in range(8):
        sample = captures.sample(index)
        mask = sample["mask"]
        top = sample["images"].flatten().quantile(0.995).clamp_min(1e-3)
        row = {f"light {k}": show_light(image / top, mask) for k, image in enumerate(sample["images"])}
        rough = sample["roughness"].expand(3, -1, -1)
        rows.append(row | {"normal": show_normals(sample["normal"], mask), "albedo": show_light(sample["albedo"], mask),
                           "roughness, white is 57 degrees": torch.where(mask, rough, 1.0)})  # fmt: skip
    save_sheet(path, rows)


def training_step(training: Training, count: int) -> float:
    """Seconds of a step of training on this machine."""
    samples: Iterator[object] = iter(SyntheticCaptures("pixels", observations=count))
    training.run_step(samples, 1)
    begun = time.perf_counter()
    for _ in range(5):
        training.run_step(samples, 1)
    return (time.perf_counter() - begun) / 5


def scaling() -> dict[str, object]:
    """What every process of the trainer computes and sends in a step of ring all-reduce."""
    trainer = load("train_photometric_stereo")
    options = trainer.parse(["--device", "cpu"])
    size = 4 * sum(p.numel() for p in load_network().parameters())
    rows = {}
    for processes in (1, 2, 8, 64):
        groups = max(options.groups, processes)
        sent = 2 * (processes - 1) / processes * size
        rows[str(processes)] = {
            "groups each": groups // processes,
            "observations per step": groups * options.observations,
            "MB sent by each per step": sent / 1e6,
            "ms per step at 100 Gb/s": 1e3 * sent / LINK,
            "GB sent in all": sent * processes * options.steps / 1e9,
        }
    return {
        "gradient kB": size / 1e3,
        "groups": options.groups,
        "observations": options.observations,
        "seconds per step": training_step(trainer.Training(options), options.observations),
        "processes": rows,
    }


def main() -> None:
    """Measure, draw, print and record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=ROOT / ".github" / "images")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--seconds", type=float, default=5.0)
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    device = options.device
    sources: dict[str, Captures] = {
        "pixels": SyntheticCaptures("pixels", device=device),
        "images, 64 x 64": SyntheticCaptures("images", device=device),
        "images, 64 x 64, 4 lights": SyntheticCaptures("images", device=device, lights=(4, 4)),
        "images, 64 x 64, 4 lights, rough surfaces alone": SyntheticCaptures(
            "images", mix=ROUGH, device=device, lights=(4, 4)
        ),
        "images, 256 x 256, 8 lights": SyntheticCaptures("images", device=device, lights=(8, 8), size=(256, 256)),
        "images, 128 x 128, 12 lights": SyntheticCaptures("images", device=device, lights=(12, 12), size=(128, 128)),
    }
    rows = {name: speed(captures, options.seconds) for name, captures in sources.items()}
    scene = {"lights": SCENE_LIGHTS, "seconds": scene_seconds(device)}
    sections = {
        "speed": {"sources": rows, "scene": scene, "device": device},
        "switches": switch_costs(device),
        "waiting": {"step": STEP, "workers": 2, "shares": waiting()},
        "training": scaling(),
    }
    for title, found in sections.items():
        print(title, *found.items(), sep="\n  ")
    contact_sheet(options.output / "captures.png")
    record("measure_synthetic", sections, device=device)


if __name__ == "__main__":
    main()
