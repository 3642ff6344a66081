"""What synthetic captures cost and look like, and what training on them sends between machines.

    python -m scripts.benchmarks.measure_synthetic [--output out/synthetic] [--device cpu]

Samples per second of `SyntheticCaptures`, both kinds; seconds of a scene; a contact sheet of pictures with their truth;
bytes and steps of `examples/train_photometric_stereo.py` on 1 to 64 processes, reckoned from the size of the network.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import torch

from tests.support.example_code import load
from torch_orennayar import SyntheticCaptures
from torch_orennayar.io.figures import save_sheet, show_light, show_normals
from torch_orennayar.stereo.set_network import load_network
from torch_orennayar.synthetic.pixels import Draw
from torch_orennayar.synthetic.scenes import SCENE_LIGHTS, draw_scene

LINK = 12.5e9
"""Bytes a second of a link of 100 Gb/s."""


def speed(captures: SyntheticCaptures, seconds: float) -> tuple[float, float]:
    """Samples and observations a second."""
    captures.sample(0)
    begun, count, seen = time.perf_counter(), 0, 0
    while time.perf_counter() - begun < seconds:
        sample = captures.sample(count)
        seen += (
            sample["observed"].numel()
            if captures.kind == "pixels"
            else int(sample["mask"].sum()) * len(sample["lights"])
        )
        count += 1
    spent = time.perf_counter() - begun
    return count / spent, seen / spent


def scene_seconds(device: str, scenes: int = 5) -> float:
    """Seconds that a scene takes to be rendered."""
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


def training_step(training: Any) -> float:
    """Seconds of a step of training on this machine."""
    samples = iter(SyntheticCaptures("pixels", observations=training.options.observations))
    training.run_step(samples, 1)
    begun = time.perf_counter()
    for _ in range(5):
        training.run_step(samples, 1)
    return (time.perf_counter() - begun) / 5


def scaling() -> None:
    """Print what every process of the trainer does and sends in a step, as ring all-reduce does it."""
    trainer = load("train_photometric_stereo")
    options = trainer.parse(["--device", "cpu"])
    step_seconds = training_step(trainer.Training(options))
    size = 4 * sum(p.numel() for p in load_network().parameters())
    print(f"gradient {size / 1e3:.0f} kB; {step_seconds:.2f} s a step of {options.groups} x {options.observations}")
    print(f"{'processes':>10}{'groups each':>13}{'observations a step':>21}{'sent by each, MB a step':>25}"
          f"{'ms at 100 Gb/s':>16}{'sent in all, GB':>17}")  # fmt: skip
    for processes in (1, 2, 8, 64):
        groups = max(options.groups, processes)
        sent = 2 * (processes - 1) / processes * size
        print(f"{processes:10}{groups // processes:13}{groups * options.observations:21,}{sent / 1e6:25.2f}"
              f"{1e3 * sent / LINK:16.2f}{sent * processes * options.steps / 1e9:17.1f}")  # fmt: skip


def main() -> None:
    """Measure, draw, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("out/synthetic"))
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--seconds", type=float, default=5.0)
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    print(f"{torch.get_num_threads()} threads, {options.device}")
    for name, captures in {
        "pixels": SyntheticCaptures("pixels", device=options.device),
        "images, 64 x 64": SyntheticCaptures("images", device=options.device),
        "images, 64 x 64, 4 lights": SyntheticCaptures("images", device=options.device, lights=(4, 4)),
        "images, 128 x 128, 12 lights": SyntheticCaptures("images", device=options.device, lights=(12, 12),
                                                          size=(128, 128)),
    }.items():  # fmt: skip
        samples, seen = speed(captures, options.seconds)
        print(f"{name:30}{samples:10.1f} samples/s{seen / 1e6:10.2f} million observations/s")
    print(f"a scene under {SCENE_LIGHTS} lights for pixels to stand in: {scene_seconds(options.device):.2f} s")
    contact_sheet(options.output / "captures.png")
    scaling()
    print(f"look at {options.output / 'captures.png'}")


if __name__ == "__main__":
    main()
