from __future__ import annotations

from pathlib import Path

import onnx
import pytest
import torch
import torch.nn.functional as F
import trimesh

from tests.support.objects import opened_graph, run_graph
from torch_orennayar import (
    MODELS,
    Camera,
    ExportError,
    ModelError,
    OrenNayar,
    ShapeError,
    export_onnx,
    load_mesh,
    oren_nayar,
    register_model,
    render_normals,
)
from torch_orennayar.export import shading_graph, verify
from torch_orennayar.export.describe import describe_onnx
from torch_orennayar.geometry.mesh import normalise_mesh
from torch_orennayar.reflectance.models import ModelFunction, unregister_model

CAMERA, SIZE = Camera.orthographic(1.05), (512, 512)
"""At this size the camera's maps would not fit into the file."""


def run(path: Path, **feeds: torch.Tensor) -> torch.Tensor:
    """The only answer of a graph."""
    (answer,) = run_graph(path, 0, **feeds).values()
    return answer


@pytest.mark.parametrize("rows_per_band", [1, 7, 1000])
@pytest.mark.slow
def test_bands_of_rows_are_the_whole_whatever_broadcasts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows_per_band: int
) -> None:
    """Several bands with a rest; maps of one row or one column beside full ones; runs repeat to the bit."""
    generator = torch.Generator().manual_seed(3)
    monkeypatch.setattr(shading_graph, "ROW_BAND_ELEMENTS", 2 * 11 * rows_per_band)
    path = export_onnx("shading", tmp_path / "graph.onnx", model="vcavity")
    up = torch.tensor([0.0, 0, 1]).reshape(1, 3, 1, 1)
    for normal, light, albedo, roughness in (
        ((2, 3, 17, 11), (2, 3, 1, 1), (2, 3, 17, 11), (1, 1, 17, 11)),
        ((1, 3, 17, 11), (2, 3, 1, 1), (1, 1, 1, 11), (1, 1, 17, 1)),
        ((2, 3, 1, 1), (1, 3, 1, 1), (1, 2, 17, 11), (1, 1, 1, 1)),
    ):
        inputs = {
            "normal": F.normalize(torch.randn(normal, generator=generator), dim=1),
            "light": F.normalize(torch.randn(light, generator=generator), dim=1),
            "view": up,
            "albedo": torch.rand(albedo, generator=generator),
            "roughness": torch.rand(roughness, generator=generator),
        }
        wanted = oren_nayar(*inputs.values(), model="vcavity")
        answers = [run(path, **inputs) for _ in range(3)]
        assert answers[0].shape == wanted.shape
        assert (answers[0] - wanted).abs().max() <= 1e-5
        assert all(torch.equal(a, answers[0]) for a in answers)


@pytest.mark.slow
def test_maps_that_do_not_fit_fail_and_empty_pictures_do_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(shading_graph, "ROW_BAND_ELEMENTS", 10 * 4)
    path = export_onnx("shading", tmp_path / "graph.onnx", model="vcavity")
    per_pixel = export_onnx("shading", tmp_path / "maps.onnx", model="vcavity", per_pixel_directions=True)
    assert capfd.readouterr().err == ""  # the runtime has nothing to warn of
    one = torch.tensor([0.0, 0, 1]).reshape(1, 3, 1, 1)
    normal = one.repeat(1, 1, 41, 4)
    for height in (4, 10, 11, 20, 21, 40, 42):
        albedo = torch.rand(1, 1, height, 4)
        for file in (path, per_pixel):
            with pytest.raises(Exception, match="ONNXRuntimeError"):
                run(file, normal=normal, light=one, view=one, albedo=albedo, roughness=one[:, :1])
    for shape in ((0, 3, 41, 4), (1, 3, 0, 4), (1, 3, 41, 0)):
        for file in (path, per_pixel) if shape[0] else (per_pixel,):  # no product of matrices has an empty batch
            empty = run(file, normal=torch.zeros(shape), light=one, view=one, albedo=one[:, :1], roughness=one[:, :1])
            assert empty.shape == (shape[0], 1, *shape[2:])


@pytest.mark.slow
def test_models_of_users_export_with_the_rounding_that_they_have(tmp_path: Path) -> None:
    formulas: dict[str, ModelFunction] = {
        "by acos": lambda ci, co, lv, rho, sigma: rho * ci.acos(),
        "bright": lambda ci, co, lv, rho, sigma: 50 * rho * (ci * co) ** sigma,
        "no albedo": lambda ci, co, lv, rho, sigma: ci * co,
        "albedo alone": lambda ci, co, lv, rho, sigma: rho * 1.0,
    }
    for name, formula in formulas.items():
        try:
            register_model(name, formula)
            assert export_onnx("shading", tmp_path / f"{name}.onnx", model=name).exists()
        finally:
            unregister_model(name)


@pytest.mark.parametrize("model", list(MODELS)[:7])
@pytest.mark.slow
def test_graph_equals_torch_at_new_sizes(tmp_path: Path, model: str) -> None:
    path = export_onnx("shading", tmp_path / "graph.onnx", model=model)
    for seed, (batch, channels, height, width) in enumerate(((4, 3, 33, 17), (1, 1, 1, 64), (2, 5, 128, 96))):
        generator = torch.Generator().manual_seed(seed)
        inputs = {
            "normal": F.normalize(torch.randn(batch, 3, height, width, generator=generator), dim=1),
            "light": F.normalize(torch.randn(batch, 3, 1, 1, generator=generator), dim=1),
            "view": torch.tensor([0.0, 0, 1]).reshape(1, 3, 1, 1),
            "albedo": torch.rand(batch, channels, height, width, generator=generator),
            "roughness": torch.rand(1, 1, 1, 1, generator=generator),
        }
        wanted = oren_nayar(*inputs.values(), model=model)
        answer = run(path, **inputs)
        assert answer.shape == wanted.shape
        assert (answer - wanted).abs().max() <= 1e-5


@pytest.mark.slow
def test_per_pixel_directions(tmp_path: Path) -> None:
    path = export_onnx("shading", tmp_path / "graph.onnx", model="vcavity", per_pixel_directions=True)
    generator = torch.Generator().manual_seed(0)
    normal, light, view = (F.normalize(torch.randn(2, 3, 6, 7, generator=generator), dim=1) for _ in range(3))
    albedo, roughness = torch.rand(2, 3, 6, 7), torch.rand(2, 1, 6, 7)
    wanted = oren_nayar(normal, light, view, albedo, roughness, model="vcavity")
    answer = run(path, normal=normal, light=light, view=view, albedo=albedo, roughness=roughness)
    assert (answer - wanted).abs().max() <= 1e-5


def test_broken_pixels_are_zero_in_the_graph_too(tmp_path: Path) -> None:
    path = export_onnx("shading", tmp_path / "graph.onnx", model="vcavity")
    normal = torch.tensor([0.0, 0, 1]).reshape(1, 3, 1, 1).repeat(1, 1, 1, 3)
    normal[..., 0], normal[..., 1] = torch.nan, 0
    up = torch.tensor([0.0, 0, 1]).reshape(1, 3, 1, 1)
    answer = run(
        path, normal=normal, light=up, view=up, albedo=torch.ones(1, 1, 1, 1), roughness=torch.full((1, 1, 1, 1), 0.5)
    )
    assert answer.flatten()[:2].tolist() == [0, 0]
    assert answer.flatten()[2] > 0.5


def test_directions_of_any_length_and_roughness_in_degrees(tmp_path: Path) -> None:
    """Directions count, not lengths; roughness is clamped; ``valid`` says where an input was out of its range."""
    path = export_onnx("shading", tmp_path / "graph.onnx", model="vcavity", checked=True)
    generator = torch.Generator().manual_seed(2)
    normal = F.normalize(torch.randn(1, 3, 4, 5, generator=generator), dim=1)
    light = F.normalize(torch.tensor([0.3, 0.2, 0.9]), dim=0).reshape(1, 3, 1, 1)
    view = torch.tensor([0.0, 0, 1]).reshape(1, 3, 1, 1)
    albedo, roughness = torch.full((1, 2, 1, 1), 0.7), torch.full((1, 1, 4, 5), 0.5)
    right = run_graph(path, normal=normal, light=light, view=view, albedo=albedo, roughness=roughness)
    assert bool(right["valid"].all())
    assert torch.allclose(
        right["shading"], oren_nayar(normal, light, view, albedo, roughness, model="vcavity"), atol=1e-6
    )

    longer = run_graph(path, normal=normal * 1.7, light=light, view=view, albedo=albedo, roughness=roughness)
    assert torch.allclose(longer["shading"], right["shading"], atol=1e-6)
    assert not bool(longer["valid"].any())
    assert right["valid"].shape == (1, 1, 4, 5)

    mixed = roughness.clone()
    mixed[..., 0], mixed[..., 1], mixed[..., 2] = 30.0, -0.1, torch.nan
    degrees = run_graph(path, normal=normal, light=light, view=view, albedo=albedo, roughness=mixed)
    assert degrees["valid"][0, 0].tolist() == [[False, False, False, True, True]] * 4
    roughest = oren_nayar(normal, light, view, albedo, torch.pi / 2, model="vcavity")
    assert torch.allclose(degrees["shading"][..., 0], roughest[..., 0], atol=1e-5)
    negative = run_graph(path, normal=normal, light=light, view=view, albedo=-albedo, roughness=roughness)
    assert not bool(negative["valid"].any())


def test_description_names_inputs_axes_and_units(tmp_path: Path) -> None:
    described = describe_onnx(export_onnx("shading", tmp_path / "graph.onnx", model="qualitative"))
    assert list(described["inputs"]) == ["normal", "light", "view", "albedo", "roughness"]
    assert described["inputs"]["light"] == ["light_batch", "3", "1", "1"]
    assert described["outputs"] == {"shading": ["shading_batch", "shading_channels", "shading_height", "shading_width"]}
    assert described["opset"] == 18
    assert described["operators"]["Loop"] == 1
    assert described["operators"]["MatMul"] == 2
    assert described["operators"]["Relu"] == 1  # inside the loop
    assert described["metadata"]["model"] == "qualitative"
    assert "radians" in described["metadata"]["roughness"]
    assert described["bytes"] < 300_000
    assert described["types"]["light"] == "float32"
    assert described["meanings"]["roughness"].startswith("standard deviation of the facet slope angle, radians")


def test_no_names_of_this_machine_in_the_file(tmp_path: Path) -> None:
    data = export_onnx("shading", tmp_path / "graph.onnx").read_bytes()
    assert b"site-packages" not in data
    assert str(Path(shading_graph.__file__).parent).encode() not in data


def test_a_graph_that_differs_is_not_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verify, "TOLERANCE", -1.0)
    with pytest.raises(ExportError, match="difference"):
        export_onnx("shading", tmp_path / "graph.onnx", model="lambert")
    assert list(tmp_path.iterdir()) == []


RendererGraph = tuple[str, Path, Camera, tuple[int, int]]
"""What the graph is, its file, its camera and the size of its pictures."""


@pytest.fixture(scope="module", params=["orthographic", "perspective"])
def renderer(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> RendererGraph:
    """A renderer, and a renderer with shading behind it, from the side and of a picture that is not square."""
    path = tmp_path_factory.mktemp("graph") / f"{request.param}.onnx"
    if request.param == "orthographic":
        return "renderer", export_onnx("renderer", path, camera=CAMERA, size=SIZE), CAMERA, SIZE
    camera, size = Camera.perspective(1.6, (0.3, 0.4, 1.1)), (384, 512)
    return "shaded_mesh", export_onnx("shaded_mesh", path, camera=camera, size=size, model="vcavity"), camera, size


def render(path: Path, *inputs: torch.Tensor, threads: int = 0) -> dict[str, torch.Tensor]:
    session = opened_graph(path, threads)
    names = [i.name for i in session.get_inputs()]
    answers = session.run(None, {n: v.numpy() for n, v in zip(names, inputs, strict=True)})
    return dict(zip([o.name for o in session.get_outputs()], map(torch.from_numpy, answers), strict=True))


def check_render(renderer: RendererGraph, vertices: torch.Tensor, faces: torch.Tensor) -> None:
    what, path, camera, size = renderer
    light = F.normalize(torch.tensor([[0.0, 0, 1], [1, 1, 1], [-1, 0.5, 0.2]]), dim=1)
    albedo = torch.tensor([0.8, 0.4])
    inputs = (vertices, faces) if what == "renderer" else (vertices, faces, light, albedo, torch.tensor([0.6]))
    answers = [render(path, *inputs, threads=threads) for threads in (1, 2, 4, 4)]
    for other in answers[1:]:
        assert all(torch.equal(a, b) for a, b in zip(answers[0].values(), other.values(), strict=True))
    seen, found = render_normals(vertices, faces, camera, size), answers[0]
    assert torch.equal(found["face"], seen.face)
    assert torch.equal(found["mask"], seen.mask)
    assert torch.equal(found["depth"].isinf(), ~seen.mask)
    assert torch.allclose(found["depth"], seen.depth, rtol=1e-5, atol=1e-5)
    assert torch.allclose(found["normal"], seen.normal, atol=1e-5)
    if what == "shaded_mesh":
        wanted = seen.shade(OrenNayar("vcavity"), light[None], albedo=albedo.reshape(1, 2, 1, 1), roughness=0.6)[0]
        assert torch.allclose(found["shading"], wanted, atol=1e-5)


@pytest.mark.slow
def test_renderer_sees_the_faces_that_torch_sees(renderer: RendererGraph) -> None:
    ball = trimesh.creation.icosphere(4)
    check_render(renderer, torch.tensor(ball.vertices).float(), torch.tensor(ball.faces))
    generator = torch.Generator().manual_seed(5)
    for count, spread in ((1, 5.0), (60, 1.0), (5000, 0.05)):  # some cross the near plane
        corners = torch.randn(count, 1, 3, generator=generator) + torch.randn(count, 3, 3, generator=generator) * spread
        check_render(renderer, corners.reshape(-1, 3), torch.arange(3 * count).reshape(-1, 3))


@pytest.mark.parametrize("name", ["stanford-bunny", "spot", "suzanne", "teapot", "nefertiti"])
@pytest.mark.slow
def test_renderer_sees_the_same_faces_of_real_meshes(renderer: RendererGraph, data: Path, name: str) -> None:
    vertices, faces = load_mesh(data / "meshes" / f"{name}.obj")
    check_render(renderer, normalise_mesh(vertices), faces)


@pytest.mark.parametrize("what", ["renderer", "shaded_mesh"])
@pytest.mark.slow
def test_one_file_serves_every_view(tmp_path: Path, what: str) -> None:
    """Camera and size are inputs: an orbit of cameras, lenses and pictures of other sizes, as torch sees them."""
    perspective = what == "shaded_mesh"
    camera = Camera.perspective(1.6, (0.3, 0.4, 1.1)) if perspective else CAMERA
    path = export_onnx(what, tmp_path / "graph.onnx", camera=camera, size=(8, 8), view_inputs=True, model="vcavity")
    described = describe_onnx(path)
    assert list(described["inputs"])[:7] == ["vertices", "faces", "rotation", "eye", "focal", "centre", "size"]
    assert described["outputs"]["face"] == ["1", "1", "height", "width"]
    assert described["types"]["size"] == "int64"
    assert "half image heights" in described["meanings"]["focal"]
    ball = trimesh.creation.icosphere(3)
    vertices, faces = torch.tensor(ball.vertices).float() * torch.tensor([1.0, 0.6, 0.8]), torch.tensor(ball.faces)
    light, albedo = torch.tensor([[0.0, 0, 1], [0.6, 0, 0.8]]), torch.tensor([0.8])
    for eye, size, factor in (
        ((0.3, 0.4, 2.1), (96, 128), 1.0),
        ((1.9, -1.0, 0.2), (1, 33), 0.7),
        ((0, 1, -3), (200, 7), 2.0),
    ):
        seen_by = Camera.perspective(0.9 * factor, eye) if perspective else Camera.orthographic(1.1 * factor, eye)
        view = {n: getattr(seen_by, n)[0] for n in ("rotation", "eye", "focal", "centre")}
        feeds = {"vertices": vertices, "faces": faces, **view, "size": torch.tensor(size)}
        if perspective:
            feeds |= {"light": light, "albedo": albedo, "roughness": torch.tensor([0.6])}
        found, seen = run_graph(path, 0, **feeds), render_normals(vertices, faces, seen_by, size)
        assert torch.equal(found["face"], seen.face)
        assert torch.allclose(found["depth"], seen.depth, rtol=1e-5, atol=1e-5)
        assert torch.allclose(found["normal"], seen.normal, atol=1e-5)
        if perspective:
            wanted = seen.shade(OrenNayar("vcavity"), light[None], albedo=0.8, roughness=0.6)[0]
            assert torch.allclose(found["shading"], wanted, atol=1e-5)


@pytest.mark.slow
def test_renderer_is_a_small_file_without_races(renderer: RendererGraph) -> None:
    what, path, _, size = renderer
    described = describe_onnx(path)
    assert described["bytes"] <= 300_000
    assert described["opset"] == 18
    assert described["inputs"]["vertices"] == ["vertices", "3"]
    assert described["inputs"]["faces"] == ["faces", "3"]
    assert described["outputs"]["face"] == ["1", "1", *map(str, size)]
    assert not {"ScatterND", "Inverse"} & set(described["operators"])
    assert described["metadata"]["graph"] == what
    assert "perspective" in described["metadata"]["camera"] or what == "renderer"
    assert b"site-packages" not in path.read_bytes()


@pytest.mark.parametrize("missing", [{"camera": None}, {"size": None}, {"camera": Camera.orthographic(torch.ones(2))}])
def test_a_renderer_needs_one_camera_and_a_size(tmp_path: Path, missing: dict[str, object]) -> None:
    arguments = {"camera": Camera.orthographic(), "size": (4, 4)} | missing
    with pytest.raises(ExportError, match="camera"):
        export_onnx("renderer", tmp_path / "graph.onnx", **arguments)  # type: ignore[arg-type]


def test_a_renderer_has_the_limits_of_render_normals(tmp_path: Path) -> None:
    with pytest.raises(ShapeError, match="size"):
        export_onnx("renderer", tmp_path / "graph.onnx", camera=Camera.orthographic(), size=(1, 80_000))


def test_bad_input(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="shading"):
        export_onnx("shadow", tmp_path / "graph.onnx")
    with pytest.raises(ModelError, match="vcavity"):
        export_onnx("shading", tmp_path / "graph.onnx", model="phong")
    (tmp_path / "no.onnx").write_bytes(b"rubbish")
    for name in ("no.onnx", "absent.onnx"):
        with pytest.raises(ExportError, match=name):
            describe_onnx(tmp_path / name)


def test_types_that_are_no_tensors_are_described_as_unknown(tmp_path: Path) -> None:
    """And those that the installed onnx does not know."""
    tensor = onnx.helper.make_tensor_type_proto(onnx.TensorProto.FLOAT, None)
    values = [onnx.helper.make_value_info(n, onnx.helper.make_sequence_type_proto(tensor)) for n in "ab"]
    graph = onnx.helper.make_graph([onnx.helper.make_node("Identity", ["a"], ["b"])], "g", values[:1], values[1:])
    onnx.save(onnx.helper.make_model(graph), tmp_path / "sequence.onnx")
    assert describe_onnx(tmp_path / "sequence.onnx")["types"] == {"a": "unknown", "b": "unknown"}
