from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch
import trimesh
from hypothesis import example, given
from hypothesis import strategies as st
from torch import Tensor
from torch.autograd import gradcheck, gradgradcheck

from tests.support import oracles
from torch_orennayar import Camera, OrenNayar, RangeError, ShapeError, angular_error, load_mesh, render_normals
from torch_orennayar.geometry.mesh import normalise_mesh
from torch_orennayar.render import interpolate, raster
from torch_orennayar.render.spans import Spans

coordinate = st.floats(-1.5, 1.5, width=32)
corner = st.tuples(coordinate, coordinate, st.floats(-3, 3, width=32))
triangles = st.lists(st.tuples(corner, corner, corner), min_size=1, max_size=5)
STEEP = [  # two faces cut at the near plane, so steep that the grid of corners decides which is nearer in a pixel
    ((0.0, 0.0, 1.09375), (1.078125, 0.4586842656135559, 0.0), (0.0078125, 0.0, 0.0)),
    ((0.0, 0.0, 1.078125), (1.0145164728164673, 0.4586842656135559, 0.005859375), (0.0078125, -0.3046875, 0.0)),
]


def sphere(subdivisions: int) -> tuple[Tensor, Tensor]:
    ball = trimesh.creation.icosphere(subdivisions)
    return torch.tensor(ball.vertices, dtype=torch.float32), torch.tensor(ball.faces)


def rays_of(camera: Camera, size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Origin and direction (z = -1) of every pixel's line of sight, camera frame."""
    base = camera.rays(size)[0].flatten(1).T.double()
    if camera.is_perspective:
        return torch.zeros_like(base), base
    return base, torch.tensor([0.0, 0, -1]).double().expand_as(base)


def centres(size: tuple[int, int]) -> Tensor:
    """Image points (H * W, 2) of pixel centres."""
    row, column = torch.meshgrid(*(torch.arange(n) + 0.5 for n in size), indexing="ij")
    return torch.stack((column, row), -1).reshape(-1, 2).double()


def lines_of(camera: Camera, size: tuple[int, int], points: Tensor) -> tuple[Tensor, Tensor]:
    """Origin and direction (z = -1) of the line of sight of image points (N, 2), camera frame."""
    focal, centre, half = camera.focal[0].double(), camera.centre[0].double(), size[0] / 2
    x = ((points[:, 0] - size[1] / 2) / half - centre[0]) / focal[0]
    y = (-(points[:, 1] - size[0] / 2) / half - centre[1]) / focal[1]
    zero, one = torch.zeros_like(x), torch.ones_like(x)
    if camera.is_perspective:
        return torch.stack((zero, zero, zero), 1), torch.stack((x, y, -one), 1)
    return torch.stack((x, y, zero), 1), torch.stack((zero, zero, -one), 1)


@pytest.mark.parametrize("perspective", [False, True])
@example(soup=STEEP)
@given(soup=triangles)
def test_any_triangles_against_ray_casting(perspective: bool, soup: list[object]) -> None:
    """Crossing, behind the camera, edge-on, tiny, huge: every pixel shows the face that a ray meets first."""
    vertices = torch.tensor(soup, dtype=torch.float32).reshape(-1, 3)
    faces = torch.arange(len(vertices)).reshape(-1, 3)
    size = (9, 12)
    camera = Camera.perspective(1.5, (0.05, 0.03, 1.0)) if perspective else Camera.orthographic(1.0)
    seen = render_normals(vertices, faces, camera, size)
    moved = camera.to_camera_frame(vertices.double())[0]
    near = camera.near if perspective else -math.inf
    face, depth, unsure = oracles.cast_rays(
        lambda points: lines_of(camera, size, points), centres(size), moved, faces, near
    )
    sure = ~unsure
    assert torch.equal(seen.face.flatten()[sure], face[sure])
    hit = sure & (face >= 0)
    assert torch.allclose(seen.depth.flatten()[hit].double(), depth[hit], rtol=1e-3, atol=1e-3)
    assert torch.equal(seen.mask.flatten(), seen.face.flatten() >= 0)
    assert seen.depth.flatten()[seen.face.flatten() < 0].isinf().all()
    assert not seen.depth.isnan().any()
    assert seen.normal.isfinite().all()
    assert seen.barycentric.isfinite().all()


grid_point = st.tuples(st.integers(-20, 100), st.integers(-20, 100), st.integers(-8, 8))


@pytest.mark.parametrize("scale", [1 / 16, 1 / 4, 40.0], ids=["small", "on the grid", "huge"])
@given(soup=st.lists(st.tuples(grid_point, grid_point, grid_point), min_size=1, max_size=6))
@pytest.mark.slow
def test_any_triangles_against_whole_numbers(scale: float, soup: list[object]) -> None:
    """Edges through pixel centres, slivers, level edges, ties of corners: to the last pixel."""
    size = (7, 10)
    image = torch.tensor(soup, dtype=torch.float64).reshape(-1, 3) * torch.tensor([scale, scale, 0.125])
    wanted, tied = oracles.rasterise_exactly(image.reshape(-1, 3, 3).tolist(), size)
    half = size[0] / 2
    vertices = torch.stack((image[:, 0] / half - size[1] / size[0], 1 - image[:, 1] / half, -image[:, 2]), 1)
    faces = torch.arange(len(vertices)).reshape(-1, 3)
    seen = render_normals(vertices, faces, Camera.orthographic(), size).face.flatten()
    sure = ~torch.tensor(tied)
    assert torch.equal(seen[sure], torch.tensor(wanted)[sure])
    assert torch.equal(seen >= 0, torch.tensor(wanted) >= 0)


@pytest.mark.parametrize("seed", range(5))
def test_shared_edges_belong_to_exactly_one_face(seed: int) -> None:
    """A sheet whose vertices and edges lie on pixel centres, split in two: no pixel twice, none missing."""
    generator = torch.Generator().manual_seed(seed)
    count, size = 9, 16
    grid = torch.stack(torch.meshgrid(*[torch.arange(count) * 2.0] * 2, indexing="xy"), -1)
    inner = grid[1:-1, 1:-1]
    inner += torch.randint(-1, 2, inner.shape, generator=generator) * 0.5
    place = (grid.reshape(-1, 2) + 0.5 - size / 2) / (size / 2)
    vertices = torch.cat((place, torch.zeros(count * count, 1)), 1)
    index = torch.arange(count * count).reshape(count, count)
    a, b, c, d = (i.flatten() for i in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    faces = torch.cat((torch.stack((a, b, c), 1), torch.stack((a, d, c), 1)))  # both windings
    part = torch.rand(len(faces), generator=generator) < 0.5
    camera = Camera.orthographic()
    whole, one, other = (
        render_normals(vertices, f, camera, (size, size), smooth=False).mask for f in (faces, faces[part], faces[~part])
    )
    # The sheet's left edge runs through the centres of column 0 (inside), its bottom through row 15 (outside).
    assert whole[..., :-1, :].all()
    assert not whole[..., -1, :].any()
    assert not (one & other).any()
    assert torch.equal(one | other, whole)


@pytest.mark.parametrize("mesh", [trimesh.creation.icosphere(3), trimesh.creation.torus(0.7, 0.3)])
@pytest.mark.parametrize("perspective", [False, True])
def test_closed_surfaces_have_no_cracks(mesh: trimesh.Trimesh, perspective: bool) -> None:
    """Every pixel sees as many front faces as back faces; the nearest one is a front face."""
    vertices, faces = torch.tensor(mesh.vertices).double(), torch.tensor(mesh.faces)
    camera = Camera.perspective(0.8, (0.3, 1.0, 2.9)) if perspective else Camera.orthographic(1.1, (0.2, 0.7, 2))
    seen = render_normals(vertices, faces, camera, (150, 200), smooth=False)
    p = camera.to_camera_frame(vertices)[0][faces]
    flat = torch.linalg.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    front = ((-flat * p[:, 0]).sum(1) if perspective else flat[:, 2]) > 0
    shown = seen.face[seen.mask]
    assert front[shown].all()
    back = render_normals(vertices, faces[~front], camera, (150, 200))
    assert torch.equal(back.mask, seen.mask)


@pytest.mark.parametrize(
    "camera", [Camera.orthographic(1.1), Camera.perspective(math.radians(90), (0.3, 0.2, 1.4))], ids=["ortho", "persp"]
)
def test_sphere_normals_are_exact(camera: Camera) -> None:
    vertices, faces = sphere(5)
    seen = render_normals(vertices, faces, camera, (256, 256))
    points = camera.points(torch.where(seen.mask, seen.depth, 1.0))
    centre = camera.to_camera_frame(torch.zeros(1, 3)).reshape(1, 3, 1, 1)
    error = angular_error(seen.normal, points - centre, seen.mask).summary()
    assert error["mean"] <= 0.015
    flat = render_normals(vertices, faces, camera, (256, 256), smooth=False)
    assert angular_error(flat.normal, points - centre, seen.mask).summary()["mean"] > 0.3


def test_given_vertex_normals_are_used() -> None:
    vertices, faces = sphere(2)
    tilted = torch.tensor([0.6, 0.0, 0.8]).expand_as(vertices)
    seen = render_normals(vertices, faces, Camera.orthographic(), (32, 32), vertex_normals=tilted)
    wanted = torch.tensor([0.6, 0.0, 0.8])[:, None].expand(3, int(seen.mask.sum()))
    assert torch.allclose(seen.normal[0][:, seen.mask[0, 0]], wanted, atol=1e-6)


def test_given_vertex_normals_may_differ_from_view_to_view() -> None:
    vertices, faces = sphere(2)
    camera = Camera.perspective(0.9, torch.tensor([[0.0, 0, 3], [2, 1, 2]]))
    given_normals = torch.nn.functional.normalize(torch.randn(2, *vertices.shape), dim=2)
    both = render_normals(vertices, faces, camera, (16, 16), vertex_normals=given_normals)
    one = render_normals(
        vertices, faces, Camera.perspective(0.9, camera.eye[1]), (16, 16), vertex_normals=given_normals[1]
    )
    assert torch.allclose(both.normal[1], one.normal[0], atol=1e-6)


def test_given_normals_stay_where_the_winding_is_inverted() -> None:
    vertices, faces = sphere(3)
    one, other = (
        render_normals(vertices, f, Camera.orthographic(), (32, 32), vertex_normals=vertices)
        for f in (faces, faces.flip(1))
    )
    assert torch.allclose(one.normal, other.normal, atol=1e-6)


def test_computed_normals_face_the_viewer_whatever_the_winding() -> None:
    vertices, faces = sphere(3)
    one, other = (render_normals(vertices, f, Camera.orthographic(), (32, 32)) for f in (faces, faces.flip(1)))
    assert torch.allclose(one.normal, other.normal, atol=1e-6)


def test_cancelling_normals_fall_back_to_the_face() -> None:
    vertices = torch.tensor([[-1.0, -1, 0], [3, -1, 0], [-1, 3, 0]])
    faces = torch.tensor([[0, 1, 2], [2, 1, 0]])
    seen = render_normals(vertices, faces, Camera.orthographic(), (4, 4))
    assert (seen.normal[:, 2] == 1).all()


def test_behind_the_eye_of_an_orthographic_camera_nearer_is_still_nearer() -> None:
    """Depths from -3 to 1: the key of the depth buffer must keep the order of negative numbers."""
    sheet = torch.tensor([[-1.0, -1], [3, -1], [-1, 3]])
    heights = (3.0, 5.0, 1.0, 4.5)
    vertices = torch.cat([torch.cat((sheet, torch.full((3, 1), h)), 1) for h in heights])
    seen = render_normals(vertices, torch.arange(12).reshape(4, 3), Camera.orthographic(), (4, 4))
    assert (seen.face == 1).all()
    assert (seen.depth == -3).all()


def test_near_plane_cuts() -> None:
    vertices = torch.tensor([[-9.0, -9, -1], [9, -9, -1], [0, 9, -1], [-9.0, -9, -3], [9, -9, -3], [0, 9, -3]])
    faces = torch.tensor([[0, 1, 2], [3, 4, 5]])
    for near, face in ((0.5, 0), (2.0, 1)):
        seen = render_normals(vertices, faces, Camera.perspective(1.0, (0, 0, 0.0), (0, 0, -1.0), near=near), (8, 8))
        assert (seen.face == face).all()


def test_coincident_vertices_give_finite_gradients() -> None:
    ball = trimesh.creation.icosphere(1)
    vertices = torch.cat((torch.tensor(ball.vertices), torch.tensor(ball.vertices[5:6]))).requires_grad_()
    faces = torch.cat((torch.tensor(ball.faces), torch.tensor([[5, len(vertices) - 1, 7]])))
    render_normals(vertices, faces, Camera.orthographic(1.2), (16, 16)).normal.sum().backward()
    assert vertices.grad is not None
    assert vertices.grad.isfinite().all()


def test_large_triangles_are_searched_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    vertices, faces = sphere(2)
    whole = render_normals(vertices * 3, faces, Camera.perspective(1.4, (0, 0, 3.5)), (40, 40))
    monkeypatch.setattr("torch_orennayar.render.raster.is_compiled", lambda _: False)
    monkeypatch.setattr("torch_orennayar.render.spans.FRAGMENTS", 37)
    monkeypatch.setattr("torch_orennayar.render.raster.CHUNK", 29)
    monkeypatch.setattr("torch_orennayar.render.interpolate.TILE", 100)
    parts = render_normals(vertices * 3, faces, Camera.perspective(1.4, (0, 0, 3.5)), (40, 40))
    assert torch.equal(whole.face, parts.face)
    assert torch.equal(whole.normal, parts.normal)
    eyes = torch.tensor([[0.0, 0, 3.5], [2, 1, 2.5], [0, 3, 2]])
    views = render_normals(vertices * 2, faces, Camera.perspective(1.4, eyes), (40, 40))
    monkeypatch.undo()
    whole = render_normals(vertices * 2, faces, Camera.perspective(1.4, eyes), (40, 40))
    assert torch.equal(views.face, whole.face)


def test_barycentric_weights_rebuild_the_surface_point() -> None:
    vertices, faces = sphere(2)
    camera = Camera.perspective(0.9, (0.5, 0.4, 2.5))
    seen = render_normals(vertices, faces, camera, (40, 40))
    hit = seen.mask[0, 0]
    corners = camera.to_camera_frame(vertices)[0][faces[seen.face[0, 0][hit]]]
    built = (corners * seen.barycentric[0][:, hit].T[:, :, None]).sum(1)
    assert torch.allclose(built, camera.points(torch.where(seen.mask, seen.depth, 1.0))[0][:, hit].T, atol=1e-5)
    assert torch.allclose(seen.barycentric[0][:, hit].sum(0), torch.ones(1), atol=1e-6)


def test_batches_of_meshes_and_cameras() -> None:
    vertices, faces = sphere(2)
    eyes = torch.tensor([[0.0, 0, 3], [2, 1, 2]])
    both = render_normals(vertices, faces, Camera.perspective(0.9, eyes), (24, 24))
    for b in range(2):
        one = render_normals(vertices, faces, Camera.perspective(0.9, eyes[b]), (24, 24))
        assert torch.equal(both.face[b], one.face[0])
        assert torch.allclose(both.normal[b], one.normal[0])
    grown = render_normals(torch.stack((vertices, vertices * 0.5)), faces, Camera.orthographic(), (24, 24))
    assert grown.mask[0].sum() > 3 * grown.mask[1].sum()


def test_coincident_faces_show_the_first() -> None:
    vertices = torch.tensor([[-1.0, -1, 0], [3, -1, 0], [-1, 3, 0]])
    faces = torch.tensor([[0, 1, 2], [2, 1, 0], [0, 1, 2]])
    assert (render_normals(vertices, faces, Camera.orthographic(), (8, 8)).face == 0).all()


def test_a_face_seen_from_behind_turns_its_normal() -> None:
    vertices = torch.tensor([[-1.0, -1, 0], [-1, 3, 0], [3, -1, 0]])
    seen = render_normals(vertices, torch.tensor([[0, 1, 2]]), Camera.orthographic(), (4, 4))
    assert (seen.normal[:, 2] == 1).all()


def test_standing_inside_a_sphere_fills_the_picture() -> None:
    vertices, faces = sphere(3)
    seen = render_normals(vertices, faces, Camera.perspective(2.0, (0.1, 0.2, 0.3), (0.0, 0.5, 1)), (64, 64))
    assert seen.mask.all()
    assert seen.depth.max() < 1.4


def test_nothing_to_see() -> None:
    nothing = torch.zeros(0, 3, dtype=torch.int64)
    for faces, camera in (
        (nothing, Camera.orthographic()),
        (torch.tensor([[0, 1, 2]]), Camera.perspective(1.0, (0, 0, -3), (0, 0, -4))),
        (torch.tensor([[0, 0, 1]]), Camera.orthographic()),
    ):
        seen = render_normals(torch.eye(3), faces, camera, (4, 5))
        assert not seen.mask.any()
        assert (seen.face == -1).all()
        assert seen.depth.isinf().all()
        assert (seen.normal == 0).all()


@pytest.mark.parametrize("perspective", [False, True])
@pytest.mark.slow
def test_gradients_reach_vertices_and_camera(perspective: bool) -> None:
    ball = trimesh.creation.icosphere(1)
    vertices = torch.tensor(ball.vertices).double().requires_grad_()
    faces = torch.tensor(ball.faces)
    eye = torch.tensor([0.31, 0.22, 2.6]).double().requires_grad_()

    def maps(v: Tensor, e: Tensor) -> tuple[Tensor, ...]:
        camera = Camera.perspective(0.9, e) if perspective else Camera.orthographic(1.2, e)
        seen = render_normals(v, faces, camera, (5, 5))
        return seen.normal, seen.barycentric, torch.where(seen.mask, seen.depth, 0.0)

    assert gradcheck(maps, (vertices, eye), eps=1e-7, atol=1e-5)


@pytest.mark.slow
def test_gradients_reach_vertex_normals() -> None:
    vertices, faces = sphere(1)
    given_normals = vertices.double().clone().requires_grad_()

    def normals(n: Tensor) -> Tensor:
        return render_normals(vertices.double(), faces, Camera.orthographic(), (5, 5), vertex_normals=n).normal

    assert gradcheck(normals, (given_normals,))


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"vertices": torch.full((3, 3), torch.nan)}, RangeError, "clean"),
        ({"vertices": torch.zeros(3)}, ShapeError, "vertices"),
        ({"vertices": torch.eye(3).long()}, ShapeError, "floating"),
        ({"vertices": torch.zeros(0, 3, 3)}, ShapeError, "empty"),
        ({"vertex_normals": torch.full((3, 3), torch.nan)}, RangeError, "vertex_normals"),
        ({"vertex_normals": torch.zeros(2, 3, 3)}, ShapeError, "vertex_normals"),
        ({"faces": torch.tensor([[0, 1, 3]])}, RangeError, "0 to 2"),
        ({"faces": torch.tensor([[0, -1, 2]])}, RangeError, "faces"),
        ({"faces": torch.tensor([[0, 1, 2]]).int()}, ShapeError, "int64"),
        ({"size": (0, 4)}, ShapeError, "size"),
        ({"size": (1, 80_000)}, ShapeError, "size"),
        ({"size": (4.5, 4)}, ShapeError, "size"),
        ({"size": 4}, ShapeError, "size"),
        ({"faces": [[0, 1, 2]]}, ShapeError, "tensor"),
        ({"cull": "both"}, RangeError, "cull"),
        ({"vertex_normals": torch.zeros(4, 3)}, ShapeError, "vertex_normals"),
        (
            {"vertices": torch.zeros(3, 3, 3), "camera": Camera.perspective(1.0, torch.ones(2, 3))},
            ShapeError,
            "batch",
        ),
    ],
)
def test_bad_input(change: dict[str, object], error: type[Exception], words: str) -> None:
    arguments = {
        "vertices": torch.eye(3),
        "faces": torch.tensor([[0, 1, 2]]),
        "camera": Camera.orthographic(),
        "size": (4, 4),
    }
    with pytest.raises(error, match=words):
        render_normals(**(arguments | change))  # type: ignore[arg-type]


MESHES = ["stanford-bunny", "spot", "suzanne", "teapot", "nefertiti"]


def pairs(
    monkeypatch: pytest.MonkeyPatch, vertices: Tensor, faces: Tensor, camera: Camera, size: tuple[int, int]
) -> np.ndarray:
    """All (face, pixel) pairs that the rasteriser enters, sorted."""
    entered = []

    def spy(best: Tensor, spans: Spans, start: Tensor, face: Tensor, width: int) -> None:
        number = spans.number.flatten().long()
        row = torch.arange(len(spans.begin))[:, None] * width
        first = (start + row + spans.begin.long()).flatten()
        which = torch.repeat_interleave(number)
        step = torch.arange(len(which)) - (number.cumsum(0) - number)[which]
        entered.append(torch.stack((face.expand(len(spans.begin), -1).flatten()[which], first[which] + step), 1))

    monkeypatch.setattr(raster, "is_compiled", lambda _: False)  # whose keys are the same: test_compiled.py
    monkeypatch.setattr(raster, "enter", spy)
    render_normals(vertices, faces, camera, size, smooth=False)
    monkeypatch.undo()
    found = torch.cat(entered).numpy()
    return found[np.lexsort((found[:, 1], found[:, 0]))]


def check_cover(monkeypatch: pytest.MonkeyPatch, vertices: Tensor, faces: Tensor, camera: Camera) -> np.ndarray:
    size = (90, 128)
    image = camera.to_image(camera.to_camera_frame(vertices.double()), size)[0]
    flat = (image[:, :2] / image[:, 2:])[faces].numpy()
    found = pairs(monkeypatch, vertices, faces, camera, size)
    assert np.array_equal(found, oracles.cover_by_edges(flat, size))
    return found


@pytest.mark.parametrize(
    "camera", [Camera.orthographic(1.02), Camera.perspective(0.8, (0.4, 0.9, 2.6))], ids=["o", "p"]
)
@pytest.mark.parametrize("closed", [trimesh.creation.icosphere(4), trimesh.creation.torus(0.7, 0.3)])
def test_a_closed_surface_covers_every_pixel_as_often_from_behind(
    monkeypatch: pytest.MonkeyPatch, camera: Camera, closed: trimesh.Trimesh
) -> None:
    """No crack and no pixel twice: the winding number of the whole is 0 at every centre."""
    vertices, faces = torch.tensor(closed.vertices).float(), torch.tensor(closed.faces)
    found = check_cover(monkeypatch, vertices, faces, camera)
    image = camera.to_image(camera.to_camera_frame(vertices.double()), (90, 128))[0]
    corner = ((image[:, :2] / image[:, 2:]) * 256).round()[faces]
    edge, other = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    turn = (edge[:, 0] * other[:, 1] - edge[:, 1] * other[:, 0]).sign().numpy()
    winding = np.bincount(found[:, 1], turn[found[:, 0]], minlength=90 * 128)
    assert (winding == 0).all()


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize(
    "camera", [Camera.orthographic(1.02), Camera.perspective(0.8, (0.4, 0.9, 2.6))], ids=["o", "p"]
)
@pytest.mark.slow
def test_real_meshes_cover_what_whole_numbers_say(
    data: object, monkeypatch: pytest.MonkeyPatch, name: str, camera: Camera
) -> None:
    vertices, faces = load_mesh(f"{data}/meshes/{name}.obj")
    check_cover(monkeypatch, normalise_mesh(vertices), faces, camera)


@pytest.mark.parametrize("reach", [3.0, 1e3, 1e5, 1e7])
@pytest.mark.parametrize("perspective", [False, True])
def test_two_halves_of_a_huge_square_share_no_pixel_and_leave_none(reach: float, perspective: bool) -> None:
    """Far outside the image, and for a pinhole behind it too, where faces are cut."""
    tilt = 0.3 if perspective else 0.0
    square = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]).double() * reach
    square[:, 2] = square[:, 1] * tilt
    faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
    camera = Camera.perspective(1.0, (0.0, 0, 2)) if perspective else Camera.orthographic(1.0)
    one, other = (render_normals(square, f[None], camera, (32, 32)).mask for f in faces)
    assert not (one & other).any()
    whole = render_normals(square, faces, camera, (32, 32)).mask
    assert torch.equal(one | other, whole)
    if not perspective or reach <= 3:
        assert whole.all()


def test_faces_seen_from_behind_or_in_front_are_left_out() -> None:
    vertices, faces = sphere(3)
    camera, size = Camera.perspective(0.9, (0.3, 0.4, 2.5)), (60, 80)
    whole, no_back, no_front = (
        render_normals(vertices, faces, camera, size, cull=cull) for cull in (None, "back", "front")
    )
    assert torch.equal(whole.face, no_back.face)
    assert torch.equal(no_front.mask, whole.mask)
    assert (no_front.depth > no_back.depth)[whole.mask].all()
    turned = render_normals(vertices, faces.flip(1), camera, size, cull="front")
    assert torch.equal(turned.face, whole.face)
    big = torch.tensor([[-9.0, -9, 0], [9, -9, 0], [0, 9, 0]])
    for triangle, seen in (([0, 1, 2], True), ([0, 2, 1], False)):
        assert (
            bool(render_normals(big, torch.tensor([triangle]), Camera.orthographic(), size, cull="back").mask.any())
            == seen
        )


def test_shading_takes_the_view_of_the_camera() -> None:
    vertices, faces = sphere(3)
    camera = Camera.perspective(1.2, (0.3, 0.4, 1.9))
    seen = render_normals(vertices, faces, camera, (24, 32))
    lights = torch.nn.functional.normalize(torch.rand(1, 5, 3), dim=2)
    layer = OrenNayar("vcavity")
    wanted = layer(seen.normal, lights, camera.view_directions((24, 32)), albedo=0.7, roughness=0.5)
    assert torch.equal(seen.shade(layer, lights, albedo=0.7, roughness=0.5), wanted)
    flat = render_normals(vertices, faces, Camera.orthographic(), (24, 32))
    assert torch.equal(flat.shade(layer, lights), layer(flat.normal, lights))


@pytest.mark.slow
def test_gradients_reach_focal_length_and_second_derivatives_exist() -> None:
    ball = trimesh.creation.icosphere(1)
    ball.apply_transform(trimesh.transformations.random_rotation_matrix(np.array([0.1, 0.2, 0.3])))
    faces = torch.tensor(ball.faces)
    camera = Camera.perspective(0.9, (0.1, 0.2, 2.6))

    def maps(vertices: Tensor, focal: Tensor) -> tuple[Tensor, ...]:
        seen = render_normals(vertices, faces, dataclasses.replace(camera, focal=focal), (4, 4))
        return seen.normal, torch.where(seen.mask, seen.depth, 0.0)

    inputs = torch.tensor(ball.vertices).double().requires_grad_(), camera.focal.double().requires_grad_()
    assert gradcheck(maps, inputs, eps=1e-7, atol=1e-5)
    assert gradgradcheck(maps, inputs, eps=1e-7, atol=1e-4)


def test_tiles_give_the_gradient_of_one_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    vertices, faces = sphere(2)
    vertices = vertices.double().requires_grad_()
    gradients = []
    for tile in (interpolate.TILE, 60):
        monkeypatch.setattr(interpolate, "TILE", tile)
        seen = render_normals(vertices, faces, Camera.perspective(0.9), (20, 30))
        weight = torch.rand(3, 20, 30, generator=torch.Generator().manual_seed(0)).double()
        total = (seen.normal * weight).sum() + (seen.barycentric * weight).sum() + seen.depth[seen.mask].sum()
        gradients.append(torch.autograd.grad(total, vertices)[0])
    assert torch.allclose(gradients[0], gradients[1], atol=1e-12)


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.slow
def test_real_meshes_show_what_rays_meet(data: object, name: str) -> None:
    """A sample of pixels against trimesh's ray casting."""
    vertices, faces = load_mesh(f"{data}/meshes/{name}.obj")
    vertices = normalise_mesh(vertices)
    camera = Camera.orthographic(1.0)
    seen = render_normals(vertices, faces, camera, (48, 48), smooth=False)
    solid = trimesh.Trimesh(vertices.double().numpy(), faces.numpy(), process=False)
    base, _ = rays_of(camera, (48, 48))
    origins = base + torch.tensor([0.0, 0, 2])
    rays = (base * 0 + torch.tensor([0.0, 0, -1])).numpy()
    first = torch.from_numpy(solid.ray.intersects_first(origins.numpy(), rays))
    assert ((first >= 0) != seen.mask.flatten()).float().mean() < 0.002
    # Edges within 1/512 of a centre: many where faces are a seventh of a pixel.
    assert (first != seen.face.flatten()).float().mean() < (0.03 if len(faces) > 90_000 else 0.004)
