from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import rendered
import torch
from hypothesis import settings
from torch import Tensor

from torch_orennayar import Camera, OrenNayar, render_normals
from torch_orennayar.capture import save_capture
from torch_orennayar.demo import make_object, spiral_lights

settings.register_profile("project", deadline=None, derandomize=True, max_examples=40)
settings.load_profile("project")


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real captures, where there is one."""
    place = os.environ.get("TORCH_ORENNAYAR_DATA")
    if not place:
        pytest.skip("TORCH_ORENNAYAR_DATA is not set")
    return Path(place)


@pytest.fixture(scope="session")
def meshes() -> dict[str, tuple[Tensor, Tensor]]:
    """The objects that captures are rendered of."""
    return rendered.objects()


class Scene:
    """A small rough object with the truth."""

    def __init__(self, *, size: int, lights: int, model: str, sigma_degrees: float, noise: float) -> None:
        vertices, faces = make_object()
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


def run_graph(path: Path, threads: int = 0, **feeds: Tensor) -> dict[str, Tensor]:
    """What ONNX Runtime computes, by name; as many threads as it likes where none are named."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    answers = session.run(None, {name: value.numpy() for name, value in feeds.items()})
    return {o.name: torch.from_numpy(np.asarray(a)) for o, a in zip(session.get_outputs(), answers, strict=True)}


@pytest.fixture(scope="session")
def rough() -> Scene:
    return Scene(size=64, lights=24, model="vcavity", sigma_degrees=30, noise=0.01)


@pytest.fixture(scope="session")
def smooth() -> Scene:
    return Scene(size=64, lights=24, model="lambert", sigma_degrees=0, noise=0.01)


@pytest.fixture
def capture_folder(tmp_path: Path, rough: Scene) -> Path:
    """A capture of the rough object, cut to 32 x 32 and 12 lights, written to disk."""
    folder = tmp_path / "capture"
    part = (slice(None), slice(4, 36), slice(4, 36))
    save_capture(
        folder,
        rough.images[::2, :, 4:36, 4:36],
        rough.lights[::2],
        rough.mask[part],
        rough.normal[part],
    )
    return folder
