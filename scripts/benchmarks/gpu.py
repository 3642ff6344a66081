"""What an accelerator does with this package: agreement with the processor, and speed, in at most six minutes.

    python -m scripts.benchmarks.gpu [--device cuda] [--sections NAME...] [--quick]

`parity`: largest differences of layer, gradients, renderer, shadows and solvers from the processor's. `shading`: bytes
per second of the layer, eager and compiled, over those of a copy on the device. `renderer`: milliseconds per view.
`stereo`: seconds for a capture of 96 photographs of 512 x 512 pixels. `data`: samples per second made on the device,
and the share of the time that a training step waits for them. Medians, with the smallest and largest of ratios.
Recorded in results/gpu.json; ``--device cpu`` tries the script where there is no accelerator.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from statistics import median

import torch
import torch.nn.functional as F
from torch import Tensor, nn

import torch_orennayar as ton
from scripts.benchmarks.benchmark_shading import CLOSED, model, scene
from scripts.benchmarks.record import record
from scripts.benchmarks.timing import Call, allow_recompilations, both, forward, interleave, ratio
from torch_orennayar.geometry.primitives import bumpy_ball, spiral_lights

SIZE, LIGHTS = 512, 96
"""Height and width of the photographs of `stereo`, and how many there are."""
VIEWS = {
    "512 x 512, 20 thousand": (5, 512, 1),
    "1024 x 1024, 328 thousand": (7, 1024, 1),
    "64 of 128 x 128": (5, 128, 64),
}
"""Subdivisions of an icosphere, height and width, views at once."""
BATCH = (8, 64, 4)
"""Samples, height and width, and lights of a training step."""
Results = Iterator[tuple[str, object]]
"""What was measured, one after the other."""


def capture(size: int, lights: int, device: str) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Images, lights, mask and normals of a rough bumpy ball with noise, the same on every device."""
    vertices, faces = bumpy_ball()
    seen = ton.render_normals(vertices, faces, ton.Camera.orthographic(1.05), (size, size))
    toward = spiral_lights(lights)
    images = ton.OrenNayar("vcavity")(seen.normal, toward[None], albedo=0.6, roughness=math.radians(30))[0]
    images = (images + 0.01 * torch.randn(images.shape, generator=torch.Generator().manual_seed(0))).clamp_min(0)
    return images.to(device), toward.to(device), seen.mask[0].to(device), seen.normal[0].to(device)


def measure_parity(device: str, runs: int) -> Results:
    """Largest absolute differences from the processor; of normals that are solved, the median angle in degrees."""
    del runs
    for name in CLOSED:
        here, there = ([p.requires_grad_() for p in scene(256, device=d)] for d in ("cpu", device))
        values = [model(name)(*parts) for parts in (here, there)]
        gradients = [
            torch.autograd.grad(v.sum(), p, allow_unused=True) for v, p in zip(values, (here, there), strict=True)
        ]
        pairs = [(a, b) for a, b in zip(*gradients, strict=True) if a is not None]
        yield f"{name}, values", (values[0] - values[1].cpu()).abs().max().item()
        apart = (((a - b.cpu()).abs().max() / a.abs().max().clamp_min(1e-12)).item() for a, b in pairs)
        yield f"{name}, gradients over their largest", max(apart)
    vertices, faces = bumpy_ball()
    camera, lights = ton.Camera.perspective(0.8, eye=(0.5, 0.6, 2.6)), spiral_lights(4)
    seen = [ton.render_normals(vertices.to(d), faces.to(d), camera, (384, 512)) for d in ("cpu", device)]
    yield "renderer, pixels with another face", int((seen[0].face != seen[1].face.cpu()).sum())
    yield "renderer, normals", (seen[0].normal - seen[1].normal.cpu()).abs().max().item()
    shadow = [
        ton.cast_shadows(vertices.to(s.face.device), faces.to(s.face.device), s, lights.to(s.face.device)) for s in seen
    ]
    yield "cast shadows, share of pixels that differ", (shadow[0] != shadow[1].cpu()).double().mean().item()
    here_all, there_all = (capture(96, 24, d) for d in ("cpu", device))
    for name in ("lambert", "vcavity", "auto", "network"):
        one, other = (ton.photometric_stereo(*c[:3], model=name).normal.cpu() for c in (here_all, there_all))
        yield f"stereo {name}, median degrees", ton.angular_error(one, other, here_all[2]).summary()["median"]


def measure_shading(device: str, runs: int) -> Results:
    """Bytes per second over a copy's of as many bytes, on a picture of 4096 x 4096."""
    allow_recompilations()
    size = 4096 if runs > 5 else 1024
    parts = scene(size, device=device)
    block = torch.empty(3, size, size, device=device)  # read and written: as many bytes as five maps in and one out
    copies: list[float] = []
    for kind, wrap in (("eager", _as_it_is), ("compiled", _compiled)):
        for what, make in (("forward", forward), ("forward and backward", both)):
            calls: dict[str, Call] = {name: make(wrap(model(name)), parts) for name in CLOSED}
            times = interleave(calls | {"copy": block.clone}, runs, warm=5)
            copies += times["copy"]
            speeds = {name: ratio(times, "copy", name)._asdict() for name in CLOSED}
            yield f"{what}, {kind}, speed over the copy's", speeds
    copied = 2 * block.numel() * block.element_size() / median(copies) * 1e3
    yield "height and width", size
    yield "copy, GB per second", copied / 1e9


def _as_it_is(function: Callable[..., Tensor]) -> Callable[..., Tensor]:
    return function


def _compiled(function: Callable[..., Tensor]) -> Callable[..., Tensor]:
    return torch.compile(function, fullgraph=True)


def measure_renderer(device: str, runs: int) -> Results:
    """Milliseconds per call, forward, and with gradients of the vertices."""
    import trimesh

    for name, (subdivisions, size, views) in VIEWS.items():
        ball = trimesh.creation.icosphere(subdivisions)
        vertices, faces = torch.tensor(ball.vertices).float().to(device), torch.tensor(ball.faces).to(device)
        vertices = vertices.expand(views, -1, -1) if views > 1 else vertices

        def draw(points: Tensor, faces: Tensor = faces, size: int = size) -> Tensor:
            return ton.render_normals(points, faces, ton.Camera.orthographic(1.05), (size, size)).normal

        times = interleave({"forward": forward(draw, [vertices]), "both": both(draw, [vertices])}, max(runs // 2, 3))
        yield name, {"forward, ms": median(times["forward"]), "forward and backward, ms": median(times["both"])}


def measure_stereo(device: str, runs: int) -> Results:
    """Seconds, and mean angular error in degrees, by model."""
    size, lights = (SIZE, LIGHTS) if runs > 5 else (64, 16)
    images, toward, mask, normal = capture(size, lights, device)
    yield "pixels", int(mask.sum())
    yield "photographs", lights
    for name in ("lambert", "vcavity", "auto", "network"):
        ton.photometric_stereo(images[:, :, :64], toward, mask[:, :64], model=name)  # loads kernels
        begun = time.perf_counter()
        solved = ton.photometric_stereo(images, toward, mask, model=name)
        error = ton.angular_error(solved.normal, normal, mask).summary()["mean"]
        yield name, {"seconds": time.perf_counter() - begun, "mean error, degrees": error}


def measure_data(device: str, runs: int) -> Results:
    """Samples per second, and the share of the time that a step waits for the samples made in its own process."""
    count, size, lights = BATCH
    sources: Mapping[str, Callable[[int], object]] = {
        "pixels": ton.SyntheticCaptures("pixels", device=device).sample,
        f"images, {size} x {size}, {lights} lights": ton.SyntheticCaptures(
            "images", device=device, lights=(lights, lights), size=(size, size)
        ).sample,
    }
    wait_ms = 0.0
    for name, sample in sources.items():
        wait_ms = median(interleave({name: partial(_draw, sample, count)}, max(runs // 4, 2))[name])
        yield name, {"samples per second": 1e3 * count / wait_ms}
    channels = 3 * lights
    network = nn.Sequential(
        nn.Conv2d(channels, 64, 3, padding=1),
        nn.ReLU(),
        nn.Conv2d(64, 64, 3, padding=1),
        nn.ReLU(),
        nn.Conv2d(64, 3, 1),
    ).to(device)
    optimiser = torch.optim.AdamW(network.parameters())
    images = torch.rand(count, channels, size, size, device=device)

    def step() -> None:
        loss = (1 - F.cosine_similarity(network(images), images[:, :3])).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()

    step_ms = median(interleave({"step": step}, runs)["step"])
    yield "training step", {"ms": step_ms, "share that waits for samples": wait_ms / (wait_ms + step_ms)}


def _draw(sample: Callable[[int], object], count: int) -> list[object]:
    return [sample(k) for k in range(count)]


SECTIONS: dict[str, Callable[[str, int], Results]] = {
    "parity": measure_parity,
    "shading": measure_shading,
    "renderer": measure_renderer,
    "stereo": measure_stereo,
    "data": measure_data,
}
"""What each section measures, on a device, with a number of runs."""


def main() -> None:
    """Measure, print and record, section by section: what is done when a section is interrupted is kept."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--sections", nargs="+", choices=SECTIONS, default=list(SECTIONS))
    parser.add_argument("--quick", action="store_true", help="few runs on small inputs")
    options = parser.parse_args()
    for name in options.sections:
        _measure(name, options.device, quick=options.quick)


def _measure(name: str, device: str, *, quick: bool) -> None:
    begun, results = time.perf_counter(), dict[str, object]()
    try:
        for key, value in SECTIONS[name](device, 3 if quick else 21):
            results[key] = value
            print(f"{time.perf_counter() - begun:6.1f} s  {name}: {key}: {value}", flush=True)
    finally:
        if results:  # a section that failed at once leaves an earlier recording as it is
            record("gpu", {name: results}, quick=[name] if quick else [], device=device)


if __name__ == "__main__":
    main()
