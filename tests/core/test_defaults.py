"""torch's default dtype and device belong to the caller: results do not depend on them, and they stay."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch
import trimesh
from torch import Tensor

import torch_orennayar as ton
from torch_orennayar.geometry.primitives import spiral_lights
from torch_orennayar.io.capture import save_capture

SIZE = 16


class Things:
    """Inputs, made before the defaults change."""

    def __init__(self, folder: Path) -> None:
        generator = torch.Generator().manual_seed(0)
        toward = torch.tensor([-0.5, -0.5, 1]).reshape(3, 1, 1)
        self.normal = torch.nn.functional.normalize(torch.rand(3, SIZE, SIZE, generator=generator) + toward, dim=0)
        self.lights, self.mask = spiral_lights(12), torch.ones(1, SIZE, SIZE, dtype=torch.bool)
        shaded = ton.OrenNayar("lambert")(self.normal[None], self.lights[None], albedo=0.7)[0]
        self.images = shaded.expand(-1, 3, -1, -1).contiguous()
        save_capture(folder, self.images, self.lights, self.mask, self.normal)
        ball = trimesh.creation.icosphere(2)
        ball.export(folder / "ball.ply")
        self.folder, self.vertices, self.faces = folder, torch.tensor(ball.vertices).float(), torch.tensor(ball.faces)
        self.intrinsics = torch.tensor([[9.0, 0, 4], [0, 9, 4], [0, 0, 1]])
        self.camera = ton.Camera.orthographic()
        self.positions = 3 * self.lights - torch.tensor([0.0, 0, 4])
        self.seen = ton.render_normals(self.vertices, self.faces, self.camera, (SIZE, SIZE))


def tensors(value: object) -> Iterator[Tensor]:
    """All tensors in a result."""
    if isinstance(value, Tensor):
        yield value
    elif isinstance(value, dict):
        yield from tensors(list(value.values()))
    elif isinstance(value, (tuple, list)):
        for part in value:
            yield from tensors(part)
    elif dataclasses.is_dataclass(value):
        yield from tensors([getattr(value, f.name) for f in dataclasses.fields(value)])


CALLS: dict[str, Callable[[Things], object]] = {
    "load_capture": lambda t: ton.load_capture(t.folder),
    "own intensities": lambda t: ton.load_capture(t.folder).with_own_intensities(),
    "stereo lambert": lambda t: ton.photometric_stereo(t.images, t.lights, t.mask, model="lambert"),
    "stereo auto": lambda t: ton.photometric_stereo(t.images, t.lights, t.mask),
    "stereo vcavity": lambda t: ton.photometric_stereo(t.images, t.lights, t.mask, model="vcavity"),
    "stereo network": lambda t: ton.photometric_stereo(t.images, t.lights, t.mask, model="network"),
    "near lights": lambda t: ton.near_light_stereo(
        t.images, t.positions, t.mask, camera=t.camera, distance=4.0, model="lambert"
    ),
    "integrate": lambda t: ton.integrate_normals(t.normal, t.mask),
    "shape": lambda t: ton.shape_from_shading(t.images[0], t.lights[0], t.mask, albedo=0.7, roughness=0.1),
    "load_mesh": lambda t: ton.load_mesh(t.folder / "ball.ply"),
    "camera": lambda _: ton.Camera.perspective(0.6, eye=(0, 0, 4)),
    "intrinsics": lambda t: ton.Camera.from_intrinsics(t.intrinsics, (9, 9)),
    "render": lambda t: ton.render_normals(t.vertices, t.faces, t.camera, (SIZE, SIZE)),
    "shadows": lambda t: ton.cast_shadows(t.vertices, t.faces, t.seen, t.lights),
    "depth_to_normals": lambda t: ton.depth_to_normals(t.images[:1, :1].contiguous()),
    "images": lambda _: ton.SyntheticCaptures("images", seed=1, size=(SIZE, SIZE), lights=(4, 4)).sample(0),
    "pixels": lambda _: ton.SyntheticCaptures("pixels", seed=1, observations=200).sample(0),
    "theory": lambda t: ton.OrenNayar("theory")(t.normal[None, :, :2], t.lights[None, :1], albedo=0.5, roughness=0.3),
    "collate": lambda _: ton.collate_captures([ton.SyntheticCaptures("images", size=(8, 8), lights=(3, 3)).sample(0)]),
}  # fmt: skip


@pytest.fixture(scope="module")
def things(tmp_path_factory: pytest.TempPathFactory) -> Things:
    return Things(tmp_path_factory.mktemp("things"))


@pytest.mark.filterwarnings("ignore:take the roughness as unknown")
@pytest.mark.parametrize("name", CALLS)
def test_results_do_not_depend_on_defaults(things: Things, name: str) -> None:
    """A tensor made on the device "meta" by mistake cannot be mixed with others."""
    wanted = list(tensors(CALLS[name](things)))
    torch.set_default_dtype(torch.float64)
    torch.set_default_device("meta")
    try:
        found = list(tensors(CALLS[name](things)))
        assert torch.get_default_dtype() == torch.float64
        assert torch.get_default_device().type == "meta"
    finally:
        torch.set_default_dtype(torch.float32)
        torch.set_default_device(None)
    assert len(found) == len(wanted) > 0
    for one, other in zip(found, wanted, strict=True):
        assert (one.dtype, one.device) == (other.dtype, other.device)
        assert torch.equal(one.nan_to_num(), other.nan_to_num())


@pytest.mark.slow
def test_a_graph_does_not_depend_on_defaults(tmp_path: Path) -> None:
    wanted = ton.export_onnx("shading", tmp_path / "a.onnx", model="fujii").read_bytes()
    torch.set_default_dtype(torch.float64)
    try:
        assert ton.export_onnx("shading", tmp_path / "b.onnx", model="fujii").read_bytes() == wanted
    finally:
        torch.set_default_dtype(torch.float32)


def test_an_error_leaves_the_defaults_as_they_were(tmp_path: Path) -> None:
    torch.set_default_dtype(torch.float64)
    try:
        with pytest.raises(ton.FileError):
            ton.load_capture(tmp_path / "absent")
        assert torch.get_default_dtype() == torch.float64
    finally:
        torch.set_default_dtype(torch.float32)
