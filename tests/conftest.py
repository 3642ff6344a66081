from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from hypothesis import settings
from torch import Tensor

from tests.support import rendered_captures, traced_graphs
from tests.support.command_line import Result, Run
from tests.support.objects import Scene
from torch_orennayar.cli import main
from torch_orennayar.io.capture import save_capture

settings.register_profile("project", deadline=None, derandomize=True, max_examples=40)
settings.load_profile("project")


@pytest.fixture(params=["cpu", "cuda"])
def device(request: pytest.FixtureRequest) -> torch.device:
    """Where the test computes; CUDA is skipped without one."""
    name: str = request.param
    if name == "cuda" and not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    return torch.device(name)


@pytest.fixture(scope="session", autouse=True)
def graphs_are_traced_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """In a folder that the run's processes share."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "traced"
    folder.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        traced_graphs.share(patch, folder)
        yield


@pytest.fixture
def orennayar(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    """Run the command with the given words."""

    def run(*arguments: object) -> Result:
        monkeypatch.setattr(sys, "argv", ["orennayar", *(str(a) for a in arguments)])
        capfd.readouterr()
        try:
            main()
            status = 0
        except SystemExit as leave:
            status = int(leave.code or 0)
        captured = capfd.readouterr()
        return Result(status, captured.out, captured.err)

    return run


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
    return rendered_captures.objects()


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
