"""What several tests share: a small rough object with its truth, and ONNX graphs run."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Protocol

import numpy as np
import onnxruntime
import torch
from torch import Tensor

from torch_orennayar import Camera, Finding, OrenNayar, Reconstruction, angular_error, render_normals
from torch_orennayar.geometry.primitives import bumpy_ball, spiral_lights


class Scene:
    """A small rough object with the truth."""

    def __init__(self, *, size: int, lights: int, model: str, sigma_degrees: float, noise: float) -> None:
        vertices, faces = bumpy_ball()
        surface = render_normals(vertices, faces, Camera.orthographic(1.05), (size, size))
        self.normal, self.mask = surface.normal[0], surface.mask[0]
        self.lights = spiral_lights(lights)
        self.albedo = torch.tensor((0.7, 0.5, 0.3)).reshape(3, 1, 1) * self.mask
        images = OrenNayar(model)(
            surface.normal, self.lights[None], albedo=self.albedo[None], roughness=math.radians(sigma_degrees)
        )[0]
        generator = torch.Generator().manual_seed(1)
        images = images + noise * torch.randn(images.shape, generator=generator)
        self.images: Tensor = images.clamp_min(0) * self.mask


class Truth(Protocol):
    """True normals of an object."""

    @property
    def normal(self) -> Tensor: ...

    @property
    def mask(self) -> Tensor: ...


def mean_error(found: Reconstruction, truth: Truth) -> float:
    """Mean angle between normals found and true ones, degrees."""
    return angular_error(found.normal, truth.normal, truth.mask).summary()["mean"]


def degrees_apart(one: Tensor, other: Tensor) -> Tensor:
    """Angles between unit vectors (N, 3)."""
    return torch.rad2deg((one.double() * other.double()).sum(1).clamp(-1, 1).acos())


def opened_graph(path: Path, threads: int = 0) -> onnxruntime.InferenceSession:
    """A graph, ready to run on so many threads of the CPU; on as many as the runtime likes where none are named."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


def run_graph(path: Path, threads: int = 0, **feeds: Tensor) -> dict[str, Tensor]:
    """What ONNX Runtime computes, by name, in `opened_graph`."""
    session = opened_graph(path, threads)
    answers = session.run(None, {name: value.numpy() for name, value in feeds.items()})
    return {o.name: torch.from_numpy(np.asarray(a)) for o, a in zip(session.get_outputs(), answers, strict=True)}


def findings(found: Reconstruction, code: str) -> list[Finding]:
    return [finding for finding in found.report if finding.code == code]
