from __future__ import annotations

from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from tests.support.objects import run_graph
from torch_orennayar import Camera, ExportError, OrenNayar, export_onnx, oren_nayar
from torch_orennayar.export.describe import describe_onnx


class Relighter(nn.Module):
    """A small network that predicts normals, and the layer behind it."""

    def __init__(self) -> None:
        super().__init__()
        self.net = nn.Sequential(nn.Conv2d(3, 8, 3, padding=1), nn.ReLU(), nn.Dropout(0.5), nn.Conv2d(8, 3, 1))
        self.layer = OrenNayar("vcavity")

    def forward(self, picture: Tensor, light: Tensor) -> tuple[Tensor, Tensor]:
        up = picture.new_tensor([0.0, 0.0, 1.0]).reshape(1, 3, 1, 1)
        normal = F.normalize(0.3 * self.net(picture) + up, dim=1)
        return self.layer(normal, light, albedo=0.7, roughness=0.4), normal


@pytest.mark.slow
def test_a_module_with_the_layer_inside(tmp_path: Path) -> None:
    torch.manual_seed(0)
    module = Relighter().train()
    example = (torch.rand(2, 3, 8, 9), F.normalize(torch.randn(2, 3), dim=1))
    path = export_onnx(
        module, tmp_path / "net.onnx", example_inputs=example, input_names=("picture", "light"),
        output_names=("shading", "normal"),
    )  # fmt: skip
    assert module.training
    assert all(p.grad is None for p in module.parameters())
    described = describe_onnx(path)
    assert described["inputs"]["picture"] == ["picture_axis0", "3", "picture_axis2", "picture_axis3"]
    assert described["inputs"]["light"] == ["picture_axis0", "3"]
    assert described["metadata"]["graph"] == "Relighter"
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    picture, light = torch.rand(5, 3, 20, 13), F.normalize(torch.randn(5, 3), dim=1)
    answers = session.run(None, {"picture": picture.numpy(), "light": light.numpy()})
    with torch.no_grad():
        wanted = module.eval()(picture, light)
    for answer, value in zip(answers, wanted, strict=True):
        assert np.abs(answer - value.numpy()).max() <= 1e-5


class Branch(nn.Module):
    def forward(self, x: Tensor) -> Tensor:
        return x + 1 if x.sum() > 0 else x - 1


class Named(nn.Module):
    def forward(self, x: Tensor) -> dict[str, Tensor]:
        return {"x": x}


class Noisy(nn.Module):
    def forward(self, x: Tensor) -> Tensor:
        return x + torch.rand_like(x)


@pytest.mark.parametrize(
    ("module", "example", "message"),
    [
        (Branch(), (torch.rand(3, 4),), "branches"),
        (Named(), (torch.rand(3, 4),), "returns tensors"),
        (Relighter(), (torch.rand(3, 4),), "Relighter takes"),
        (Noisy(), (torch.rand(3, 4),), "torch's"),
        (nn.ReLU(), None, "example_inputs"),
        (nn.ReLU(), (1.0,), "example_inputs"),
    ],
)
@pytest.mark.slow
def test_modules_that_do_not_export_say_why(
    tmp_path: Path, module: nn.Module, example: tuple[Tensor, ...] | None, message: str
) -> None:
    with pytest.raises(ExportError, match=message):
        export_onnx(module, tmp_path / "net.onnx", example_inputs=example)
    assert list(tmp_path.iterdir()) == []


def test_half_precision_ends(tmp_path: Path) -> None:
    """Inputs and outputs are float16, the graph between computes in float32, as the layer does."""
    path = export_onnx("shading", tmp_path / "half.onnx", model="vcavity", dtype=torch.float16)
    assert describe_onnx(path)["metadata"]["precision"] == "float16"
    generator = torch.Generator().manual_seed(0)
    scene = {
        "normal": F.normalize(torch.randn(1, 3, 40, 50, generator=generator), dim=1),
        "light": torch.tensor([0.6, 0.0, 0.8]).reshape(1, 3, 1, 1),
        "view": torch.tensor([0.0, 0.0, 1.0]).reshape(1, 3, 1, 1),
        "albedo": torch.rand(1, 3, 40, 50, generator=generator),
        "roughness": torch.rand(1, 1, 40, 50, generator=generator),
    }
    scene = {name: value.half() for name, value in scene.items()}
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    (answer,) = session.run(None, {name: value.numpy() for name, value in scene.items()})
    wanted = oren_nayar(*scene.values(), model="vcavity")
    assert answer.dtype == np.float16
    assert np.abs(answer.astype(np.float32) - wanted.float().numpy()).max() <= 2**-10


@pytest.mark.slow
def test_weights_that_half_precision_holds_take_half_the_space(tmp_path: Path) -> None:
    """The network's are stored in half precision, so that nothing is lost; rounding of inputs and outputs remains."""
    images, lights = torch.rand(12, 1, 8, 9), F.normalize(torch.rand(12, 3) + torch.tensor([0, 0, 1.0]), dim=1)
    mask, answers, sizes = torch.ones(1, 8, 9, dtype=torch.bool), [], []
    for dtype in (torch.float32, torch.float16):
        path = export_onnx("stereo", tmp_path / f"{dtype}.onnx", model="network", dtype=dtype)
        sizes.append(path.stat().st_size)
        feeds = {"images": images.half().to(dtype), "lights": lights.half().to(dtype), "mask": mask}
        answers.append(run_graph(path, 0, **feeds)["normal"].float())
    assert sizes[1] < 0.6 * sizes[0]
    assert (answers[0] - answers[1]).abs().max() <= 2**-11


@pytest.mark.slow
def test_half_precision_of_the_others(tmp_path: Path) -> None:
    path = export_onnx("stereo", tmp_path / "stereo.onnx", model="lambert", dtype=torch.float16)
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    assert [i.type for i in session.get_inputs()] == ["tensor(float16)", "tensor(float16)", "tensor(bool)"]
    camera = Camera.orthographic(1.05)
    path = export_onnx("renderer", tmp_path / "renderer.onnx", camera=camera, size=(64, 48), dtype=torch.float16)
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    types = [o.type for o in session.get_outputs()]
    assert types == ["tensor(float16)", "tensor(bool)", "tensor(float16)", "tensor(int64)"]
    with pytest.raises(ExportError, match="float16"):
        export_onnx("shading", tmp_path / "wide.onnx", dtype=torch.float64)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ({"input_names": ("a",)}, "2 names, one per input"),
        ({"input_names": ("a", "a")}, "different words"),
        ({"input_names": ("a", "")}, "different words"),
        ({"output_names": ("b",)}, "2 names, one per output"),
        ({"input_names": ("a", "b"), "output_names": ("a", "c")}, "other names than the inputs'"),
    ],
)
def test_names_that_do_not_fit(tmp_path: Path, names: dict[str, tuple[str, ...]], words: str) -> None:
    example = (torch.rand(1, 3, 4, 5), F.normalize(torch.randn(1, 3), dim=1))
    with pytest.raises(ExportError, match=words):
        export_onnx(Relighter(), tmp_path / "net.onnx", example_inputs=example, **names)  # type: ignore[arg-type]


def test_examples_in_other_memory_layouts(tmp_path: Path) -> None:
    class Double(nn.Module):
        def forward(self, x: Tensor) -> Tensor:
            return 2 * x

    example = torch.rand(3, 2, requires_grad=True).T.expand(4, 2, 3)
    path = export_onnx(Double(), tmp_path / "net.onnx", example_inputs=(example,))
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    data = np.random.default_rng(0).random((4, 2, 3), np.float32)
    assert np.array_equal(session.run(None, {"input_0": data})[0], 2 * data)
