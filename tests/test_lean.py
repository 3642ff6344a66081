"""With torch and numpy alone the core works, and whatever else is missing is named with its ``pip`` command."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import PackageNotFoundError, packages_distributions, requires

import pytest

from torch_orennayar.core.optional import PACKAGES

BLOCKER = """
import importlib.abc, sys

ALLOWED = {allowed!r} | {{"torch_orennayar"}} | sys.stdlib_module_names


class Blocker(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] not in ALLOWED:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)


sys.meta_path.insert(0, Blocker())
"""

CORE = """
import torch, torch_orennayar as ton

normal = torch.nn.functional.normalize(torch.tensor([0.2, 0.1, 1.0]), dim=0).reshape(1, 3, 1, 1).expand(1, 3, 6, 7)
lights = torch.nn.functional.normalize(torch.tensor([[0.0, 0, 1], [1, 0, 1], [0, 1, 1], [-1, 0, 1]]), dim=1)
assert ton.OrenNayar("vcavity")(normal, lights[:1], roughness=0.4).shape == (1, 1, 6, 7)
vertices = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]])
seen = ton.render_normals(vertices, torch.tensor([[0, 1, 2]]), ton.Camera.orthographic(1.05), (16, 16))
assert bool(seen.mask.any())
images = ton.OrenNayar("lambert")(normal, lights[None], albedo=0.5)[0]
found = ton.photometric_stereo(images, lights, model="lambert")
assert torch.allclose(found.normal, normal[0], atol=1e-3)
assert next(iter(ton.SyntheticCaptures("pixels", seed=0)))["normal"].shape[1] == 3

calls = {
    "integrate_normals": lambda: ton.integrate_normals(normal[0]),
    "shape_from_shading": lambda: ton.shape_from_shading(images[0], lights[0]),
    "load_mesh": lambda: ton.load_mesh("absent.ply"),
    "save_mesh": lambda: ton.save_mesh("absent.ply", vertices, torch.tensor([[0, 1, 2]])),
    "srgb_to_linear": lambda: ton.srgb_to_linear(images),
    "linear_to_srgb": lambda: ton.linear_to_srgb(images),
    "to_kornia": lambda: ton.Camera.perspective(1.0, (0.0, 0.0, 3.0)).to_kornia((4, 4)),
    "export_onnx": lambda: ton.export_onnx("shading", "absent.onnx"),
    "SyntheticCaptures": lambda: next(iter(ton.SyntheticCaptures("images", seed=0))),
}
for name, call in calls.items():
    try:
        call()
    except ton.TorchOrenNayarError as error:
        assert isinstance(error, ImportError)
        print(f"{name}: {error}")

sys.stderr.isatty = lambda: True
from torch_orennayar.core.progress import track

assert list(track([1, 2], "counting")) == [1, 2]
sys.argv = ["orennayar", "--help"]
from torch_orennayar.cli import main

main()
"""

INSTALLS = {
    "integrate_normals": "pip install pyamg scipy",
    "shape_from_shading": "pip install pyamg scipy",
    "load_mesh": "pip install scipy",
    "save_mesh": "pip install trimesh",
    "srgb_to_linear": "pip install kornia",
    "linear_to_srgb": "pip install kornia",
    "to_kornia": "pip install kornia",
    "export_onnx": 'pip install onnx onnxscript onnxruntime, or "torch_orennayar[export]"',
    "SyntheticCaptures": "pip install trimesh",
}


def needed_by(*packages: str) -> set[str]:
    """What can be imported where only ``packages`` and all that they require are installed."""
    wanted, found = list(packages), set[str]()
    while wanted:
        name = _canonical(wanted.pop())
        if name in found:
            continue
        try:
            lines = requires(name) or []
        except PackageNotFoundError:  # for another system or version of Python
            continue
        found.add(name)
        wanted += [_name(line) for line in lines if "extra ==" not in line]
    return {module for module, owners in packages_distributions().items() if found & {_canonical(o) for o in owners}}


def _canonical(package: str) -> str:
    return package.lower().replace("_", "-").replace(".", "-")


def _name(requirement: str) -> str:
    end = next((k for k, letter in enumerate(requirement) if not (letter.isalnum() or letter in "-_.")), None)
    return requirement[:end]


@pytest.fixture(scope="module")
def lean() -> subprocess.CompletedProcess[str]:
    allowed = needed_by("torch", "numpy")
    assert not allowed & (set(PACKAGES) - {"jinja2"})
    code = BLOCKER.format(allowed=allowed) + CORE
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_the_core_works_with_torch_and_numpy_alone(lean: subprocess.CompletedProcess[str]) -> None:
    assert "Traceback" not in lean.stderr, lean.stderr


@pytest.mark.parametrize("name", INSTALLS)
def test_what_is_missing_is_named_with_its_command(lean: subprocess.CompletedProcess[str], name: str) -> None:
    said = dict(line.split(": ", 1) for line in lean.stdout.splitlines())
    assert INSTALLS[name] in said[name]


def test_the_command_names_what_it_needs(lean: subprocess.CompletedProcess[str]) -> None:
    last = lean.stderr.splitlines()[-1]
    assert last.startswith("error: typer, rich: ")
    assert 'pip install typer rich, or "torch_orennayar[cli]"' in last
    assert lean.returncode == 1
