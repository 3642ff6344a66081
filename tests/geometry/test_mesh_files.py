from __future__ import annotations

import itertools
import json
import math
import os
import re
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from hypothesis import given
from hypothesis import strategies as st

import torch_orennayar as ton
from torch_orennayar import Camera, FileError, RangeError, ShapeError, load_mesh, render_normals, save_mesh
from torch_orennayar.geometry.mesh_polygons import Polygons, triangulate
from torch_orennayar.geometry.mesh_repair import MERGE_DISTANCE

CUBE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
SIDES = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
OUTWARD = [(0, 0, -1), (0, 0, 1), (0, -1, 0), (1, 0, 0), (0, 1, 0), (-1, 0, 0)]
# A polygon that a fan would fill wrongly: an arrow whose notch lies at its second corner.
ARROW = [(0, 0), (2, 1), (4, 0), (2, 4)]
ARROW_AREA = 6.0


def obj(points: Sequence[Sequence[float]], faces: Sequence[Sequence[int]]) -> str:
    lines = [f"v {' '.join(map(str, p))}" for p in points] + [f"f {' '.join(str(i + 1) for i in f)}" for f in faces]
    return "\n".join(lines) + "\n"


def ply(points: Sequence[Sequence[float]], faces: Sequence[Sequence[int]], order: str) -> bytes:
    header = (
        f"ply\nformat {order} 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\n"
        f"property double z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\nproperty uchar flags\n"
        "end_header\n"
    ).encode()
    if order == "ascii":
        rows = [" ".join(map(str, p)) for p in points] + [" ".join(map(str, (len(f), *f, 7))) for f in faces]
        return header + "\n".join(rows).encode()
    sign = "<" if "little" in order else ">"
    body = [struct.pack(f"{sign}ffd", *p) for p in points]
    return header + b"".join(body + [struct.pack(f"{sign}B{len(f)}iB", len(f), *f, 7) for f in faces])


def off(points: Sequence[Sequence[float]], faces: Sequence[Sequence[int]], header: str = "OFF\n") -> str:
    rows = [" ".join(map(str, p)) for p in points] + [" ".join(map(str, (len(f), *f))) for f in faces]
    return f"{header}{len(points)} {len(faces)} 0\n" + "\n".join(rows) + "\n"


def area(vertices: torch.Tensor, faces: torch.Tensor) -> float:
    corner = vertices.double()[faces]
    return float(torch.linalg.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]).norm(dim=1).sum() / 2)


def volume(vertices: torch.Tensor, faces: torch.Tensor) -> float:
    """Positive where all faces of a closed surface are wound outward; between that and 0 where some are not."""
    a, b, c = vertices.double()[faces].unbind(1)
    return float((torch.linalg.cross(a, b) * c).sum() / 6)


def written(folder: Path, name: str, data: str | bytes) -> Path:
    (folder / name).write_bytes(data.encode() if isinstance(data, str) else data)
    return folder / name


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".glb", ".stl", ".off"])
def test_round_trip(tmp_path: Path, suffix: str) -> None:
    ball = trimesh.creation.icosphere(1)
    vertices, faces = torch.tensor(ball.vertices), torch.tensor(ball.faces)
    save_mesh(tmp_path / f"ball{suffix}", vertices, faces)
    found, triangles = load_mesh(tmp_path / f"ball{suffix}")
    assert found.dtype == torch.float32
    assert triangles.dtype == torch.int64
    assert len(found) == len(vertices)  # STL repeats vertices; loading joins them
    a, b = (v.double()[f].mean(1) for v, f in ((vertices, faces), (found, triangles)))
    assert torch.cdist(a, b).amin(1).max() < 1e-5


def test_quads_are_split_and_seams_are_joined(tmp_path: Path) -> None:
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 0\nv 2 1 0\nvt 0 0\nvt 1 1\n"
    (tmp_path / "q.obj").write_text(text + "f 1/1 2/1 3/1 4/1\nf 2/2 5/2 6/2 3/2\n")
    vertices, faces = load_mesh(tmp_path / "q.obj")
    assert vertices.shape == (6, 3)
    assert faces.shape == (4, 3)


def test_comments_in_other_encodings(tmp_path: Path) -> None:
    (tmp_path / "latin.obj").write_bytes(b"# cr\xe9\xe9\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert load_mesh(tmp_path / "latin.obj")[0].shape == (3, 3)


def test_colours_are_written(tmp_path: Path) -> None:
    save_mesh(tmp_path / "c.ply", torch.eye(3), torch.tensor([[0, 1, 2]]), torch.tensor([[1.0, 0, 0]]).expand(3, 3))
    assert trimesh.load_mesh(tmp_path / "c.ply").visual.vertex_colors[0].tolist() == [255, 0, 0, 255]


@pytest.mark.parametrize(
    ("name", "content", "error"),
    [
        ("a.obj", b"", FileError),
        ("a.obj", b"v 0 0 0\n", FileError),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", RangeError),
        ("a.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 9\n", FileError),
        ("a.stl", b"\x00" * 80 + b"\xff\xff\xff\x7f", FileError),
        ("a.glb", b"glTF rubbish", FileError),
        ("a.xyz1", b"", FileError),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", FileError),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", FileError),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nf -1 -2 -3\nv 0 1 0\n", FileError),
        ("a.obj", b"v 0 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", FileError),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1//1 2//1 3//1\n", FileError),
        ("a.off", b"OFF BINARY\n", FileError),
        ("a.off", b"OFF\n3 1 0\n0 0 0\n", FileError),
        ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n4 0 1 2\n", FileError),
        ("a.off", b"NO\n", FileError),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1000000000\nproperty float x\nend_header\n1\n", FileError),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty word x\nend_header\n1\n", FileError),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 999999999999999999999\n", FileError),
        ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 999999999999999999999\n", FileError),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float x\nend_header\n1 1\n",
            FileError,
        ),
        ("a.gltf", b"{}", FileError),
        ("a.gltf", b"[]", FileError),
        ("a.glb", struct.pack("<4sIII4s2s", b"glTF", 1, 22, 2, b"JSON", b"{}"), FileError),
    ],
)
def test_damaged_files(tmp_path: Path, name: str, content: bytes, error: type[Exception]) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(error, match=name):
        load_mesh(tmp_path / name)


def test_saving_what_cannot_be_saved(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="ply"):
        save_mesh(tmp_path / "a.xyz1", torch.eye(3), torch.tensor([[0, 1, 2]]))
    with pytest.raises(ShapeError):
        save_mesh(tmp_path / "a.ply", torch.eye(4), torch.tensor([[0, 1, 2]]))
    assert list(tmp_path.iterdir()) == []


def test_a_mesh_whose_name_is_not_utf8(tmp_path: Path) -> None:
    (tmp_path / os.fsdecode(b"m\xe9.obj")).write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    vertices, faces = load_mesh(tmp_path / os.fsdecode(b"m\xe9.obj"))
    assert (len(vertices), faces.tolist()) == (3, [[0, 1, 2]])


def test_a_word_where_a_number_should_be_is_shown_with_its_line(tmp_path: Path) -> None:
    path = written(tmp_path, "a.obj", "v 0 0 0\nv 1,5 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(FileError, match=r"'v 1,5 0 0' in line 2; write numbers with a point"):
        load_mesh(path)


def spellings() -> dict[str, str | bytes]:
    """The same cube, as programs write it."""
    plain = obj(CUBE, SIDES)
    interleaved = "".join(
        "".join(f"v {' '.join(map(str, CUBE[i]))}\n" for i in side) + "f -4 -3 -2 -1\n" for side in SIDES
    )
    heavy = "".join(f"v {2 * x} {2 * y} {2 * z} 2\n" for x, y, z in CUBE) + plain[plain.index("f") :]
    return {
        "plain.obj": plain,
        "tabs.obj": plain.replace(" ", "\t"),
        "v_tab.obj": plain.replace("v ", "v\t"),
        "bom.obj": b"\xef\xbb\xbf" + plain.encode(),
        "comment.obj": plain.replace("\n", " # side\n"),
        "carriage_returns.obj": plain.replace("\n", "\r"),
        "windows.obj": plain.replace("\n", "\r\n"),
        "continued.obj": plain.replace("f ", "f \\\n "),
        "first_version.obj": plain.replace("f ", "fo "),
        "relative.obj": interleaved,
        "weights.obj": heavy,
        "colours.obj": "".join(f"v {x} {y} {z} 1 0 0\n" for x, y, z in CUBE) + plain[plain.index("f") :],
        "lines.obj": "mtllib absent.mtl\no thing\n" + plain + "l 1 2\np 1\nf 1 2\n",
        "texture.obj": re.sub(r"^f (\d) (\d) (\d)", r"f \1/ \2// \3/1", plain, flags=re.M),
        "ascii.ply": ply(CUBE, SIDES, "ascii"),
        "little.ply": ply(CUBE, SIDES, "binary_little_endian"),
        "big.ply": ply(CUBE, SIDES, "binary_big_endian"),
        "plain.off": off(CUBE, SIDES),
        "modelnet.off": off(CUBE, SIDES, "OFF"),
        "normals.off": off([(*p, 0, 0, 1) for p in CUBE], SIDES, "NOFF\n"),
        "comments.off": off(CUBE, SIDES, "# made by hand\nOFF # counts\n"),
    }


@pytest.mark.parametrize("name", spellings())
def test_spellings_of_one_cube(tmp_path: Path, name: str) -> None:
    mesh = load_mesh(written(tmp_path, name, spellings()[name]))
    assert (len(mesh.vertices), len(mesh.faces)) == (8, 12)
    assert area(*mesh) == pytest.approx(6)
    assert volume(*mesh) == pytest.approx(1)
    assert mesh.report == ()
    assert mesh.offset.tolist() == [0, 0, 0]


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_faces_of_all_sizes_in_a_ply(tmp_path: Path, order: str) -> None:
    points = [(*p, 0) for p in ARROW] + [(9, 0, 0), (9, 1, 0), (10, 0, 0)]
    for faces, wanted in (([(0, 1, 2, 3), (4, 6, 5)], ARROW_AREA + 0.5), ([(4, 6, 5)], 0.5)):
        mesh = load_mesh(written(tmp_path, "a.ply", ply(points, faces, order)))
        assert area(*mesh) == pytest.approx(wanted)


def test_triangle_strips(tmp_path: Path) -> None:
    header = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
    header += "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    points = "0 0 0\n1 0 0\n0 1 0\n1 1 0\n5 5 0\n"
    mesh = load_mesh(written(tmp_path, "a.ply", f"{header}{points}8 0 1 2 3 -1 4 4 4\n"))
    corner = mesh.vertices[mesh.faces[:2]]
    assert (torch.linalg.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, 2] == 1).all()


@pytest.mark.parametrize("suffix", [".obj", ".off", ".ply"])
def test_concave_faces_are_filled_as_they_are(tmp_path: Path, suffix: str) -> None:
    """Whichever corner they begin at and whichever way round."""
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    points = (np.array([(*p, 0) for p in ARROW]) @ turn.T).tolist()
    for start, step in itertools.product(range(4), (1, -1)):
        face = [(start + step * i) % 4 for i in range(4)]
        texts = {
            ".obj": obj(points, [face]),
            ".off": off(points, [face]),
            ".ply": ply(points, [face], "ascii").decode(),
        }
        mesh = load_mesh(written(tmp_path, f"a{suffix}", texts[suffix]))
        assert area(*mesh) == pytest.approx(ARROW_AREA, rel=1e-5)


@given(st.integers(0, 10_000), st.integers(3, 12))
def test_stars_are_cut_into_triangles_of_their_area(seed: int, count: int) -> None:
    """Polygons around their centre, in any plane: all triangles are wound alike and cover it once."""
    draw = np.random.default_rng(seed)
    angle = (np.arange(count) + 0.8 * draw.random(count)) * 2 * np.pi / count
    flat = draw.uniform(0.2, 1, count)[:, None] * np.stack((np.cos(angle), np.sin(angle)), 1)
    frame = np.linalg.qr(draw.normal(size=(3, 3)))[0]
    cut = triangulate(Polygons(flat @ frame[:, :2].T, np.arange(count), np.array([count])))
    x, y = flat.T
    wanted = (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2
    corner = flat[cut.faces]
    edge, other = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    signed = (edge[:, 0] * other[:, 1] - edge[:, 1] * other[:, 0]) / 2
    assert len(cut.faces) == count - 2
    assert (signed > -1e-12).all()
    assert signed.sum() == pytest.approx(wanted)


def test_a_mesh_in_map_coordinates_is_moved_and_says_so(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(3)
    place = np.array([408201.5848, 4080928.0166, 312.25])
    path = written(tmp_path, "utm.obj", obj((ball.vertices + place).tolist(), ball.faces.tolist()))
    with pytest.warns(UserWarning, match="far from the origin"):
        mesh = load_mesh(path)
    assert [f.code for f in mesh.report] == ["mesh-moved"]
    assert torch.allclose(mesh.vertices.double() + mesh.offset, torch.tensor(ball.vertices + place), atol=1e-6, rtol=0)
    assert torch.allclose(mesh.vertices, torch.tensor(ball.vertices).float(), atol=1e-5)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_points_are_merged_relative_to_the_size(tmp_path: Path, scale: float) -> None:
    """Every triangle with points of its own, whatever the unit."""
    ball = trimesh.creation.icosphere(2, radius=scale)
    soup = ball.vertices[ball.faces].reshape(-1, 3)
    path = written(tmp_path, "soup.obj", obj(soup.tolist(), np.arange(len(soup)).reshape(-1, 3).tolist()))
    vertices, faces = load_mesh(path)
    assert (len(vertices), len(faces)) == (len(ball.vertices), len(ball.faces))
    near = [*ball.vertices.tolist(), (ball.vertices[0] + 1e4 * MERGE_DISTANCE * scale).tolist()]  # apart, and stays so
    apart = load_mesh(written(tmp_path, "near.obj", obj(near, [*ball.faces.tolist(), [0, 1, len(near) - 1]])))
    assert len(apart.vertices) == len(near)


def test_faces_that_lie_twice_are_kept_once(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(2)
    both = np.stack((ball.faces, ball.faces[:, ::-1]), 1).reshape(-1, 3)
    mesh = load_mesh(written(tmp_path, "double.obj", obj(ball.vertices.tolist(), both.tolist())))
    assert len(mesh.faces) == len(ball.faces)
    assert [(f.code, f.value) for f in mesh.report] == [("faces-twice", len(ball.faces))]
    assert torch.allclose(ton.vertex_normals(*mesh), mesh.vertices, atol=1e-5)


@given(st.integers(0, 1000), st.floats(0.05, 0.4))
def test_faces_are_wound_as_most_of_their_piece(seed: int, share: float) -> None:
    """Two balls, the second inside out: each is oriented as most of it was."""
    ball = trimesh.creation.icosphere(2)
    count = len(ball.faces)
    faces = np.concatenate((ball.faces, ball.faces[:, ::-1] + len(ball.vertices)))
    turned = np.random.default_rng(seed).random(2 * count) < share
    mixed = np.where(turned[:, None], faces[:, ::-1], faces)
    found = ton.orient_faces(torch.from_numpy(mixed))
    assert torch.equal(found, torch.from_numpy(np.ascontiguousarray(faces)))


def test_turned_faces_of_a_file_are_reported(tmp_path: Path) -> None:
    faces = [*SIDES[:5], SIDES[5][::-1]]
    mesh = load_mesh(written(tmp_path, "a.obj", obj(CUBE, faces)))
    assert volume(*mesh) == pytest.approx(1)
    assert [(f.code, f.value) for f in mesh.report] == [("faces-turned", 2)]


def test_a_moebius_strip_stays_as_it_is(tmp_path: Path) -> None:
    count = 12
    angle = np.arange(count) * 2 * np.pi / count
    across = np.stack((np.cos(angle / 2) * np.cos(angle), np.cos(angle / 2) * np.sin(angle), np.sin(angle / 2)), 1) / 4
    middle = np.stack((np.cos(angle), np.sin(angle), 0 * angle), 1)
    points = np.concatenate((middle + across, middle - across))
    strips = [(i, i + count, i + 1 + count, i + 1) for i in range(count - 1)] + [(count - 1, 2 * count - 1, 0, count)]
    mesh = load_mesh(written(tmp_path, "a.obj", obj(points.tolist(), strips)))
    assert "one-sided" in [f.code for f in mesh.report]
    assert len(mesh.faces) == 2 * count


def test_the_renderer_warns_where_faces_are_wound_against_each_other() -> None:
    ball = trimesh.creation.icosphere(1)
    vertices, faces = torch.tensor(ball.vertices).float(), torch.tensor(ball.faces)
    mixed = torch.where(torch.arange(len(faces))[:, None] % 3 == 0, faces.flip(1), faces)
    with pytest.warns(UserWarning, match="orient_faces"):
        render_normals(vertices, mixed, Camera.orthographic(), (8, 8))
    render_normals(vertices, mixed, Camera.orthographic(), (8, 8))  # once
    render_normals(vertices, mixed.clone(), Camera.orthographic(), (8, 8), smooth=False)
    render_normals(vertices, ton.orient_faces(mixed), Camera.orthographic(), (8, 8))
    with pytest.raises(ShapeError, match="faces"):
        ton.orient_faces(faces.int())


def distinct_normals(mesh: ton.Mesh) -> int:
    return len(torch.unique((ton.vertex_normals(*mesh) * 1e3).round(), dim=0))


def cube_with(statement: str, corner: str) -> str:
    """A cube whose sides state something."""
    sides = [
        statement.format(*OUTWARD[k], k=k) + "f " + " ".join(corner.format(i + 1, k=k + 1) for i in side) + "\n"
        for k, side in enumerate(SIDES)
    ]
    return obj(CUBE, []) + "".join(sides)


@pytest.mark.parametrize(
    ("text", "crease", "normals"),
    [
        (cube_with("", "{}"), None, 8),  # nothing is said: smooth
        (cube_with("vn {} {} {}\n", "{}//{k}"), None, 6),  # a normal per side
        (cube_with("vn {} {} {}\n", "{}//{k}"), math.pi, 8),
        (cube_with("vn 0 0 1\n", "{}//{k}"), None, 8),  # the same normal everywhere: no edge
        (cube_with("s off\n", "{}"), None, 6),
        (cube_with("s 1\n", "{}"), None, 8),
        (cube_with("s {k}\n", "{}"), None, 6),
        (cube_with("", "{}"), math.radians(60), 6),
        (cube_with("", "{}"), math.radians(100), 8),
    ],
)
def test_sharp_edges(tmp_path: Path, text: str, crease: float | None, normals: int) -> None:
    mesh = load_mesh(written(tmp_path, "cube.obj", text), crease=crease)
    assert distinct_normals(mesh) == normals
    assert volume(*mesh) == pytest.approx(1)


def test_a_cylinder_is_round_about_and_sharp_at_its_ends(tmp_path: Path) -> None:
    body = trimesh.creation.cylinder(1.0, 2.0, sections=24)
    path = written(tmp_path, "a.obj", obj(body.vertices.tolist(), body.faces.tolist()))
    mesh = load_mesh(path, crease=math.radians(40))
    normal = ton.vertex_normals(*mesh)
    ends = normal[:, 2].abs() > 0.5
    assert torch.allclose(normal[ends][:, 2].abs(), torch.ones(1))
    sides = mesh.vertices[~ends][:, :2]
    assert torch.allclose(normal[~ends][:, :2], sides / sides.norm(dim=1, keepdim=True), atol=0.02)
    with pytest.raises(RangeError, match="crease"):
        load_mesh(path, crease=40)


def glb(tree: dict[str, object], data: bytes) -> bytes:
    text = json.dumps(tree).encode()
    text, data = (part + pad * (-len(part) % 4) for part, pad in ((text, b" "), (data, b"\0")))
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def test_glb_with_whole_numbers_sparse_points_and_several_parts(tmp_path: Path) -> None:
    """Positions as normalised 16-bit integers; one of them replaced by a sparse accessor; two nodes, one scaled."""
    unit = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)]) * 32767
    points = np.pad(unit, ((0, 0), (0, 1))).astype("<i2").tobytes()
    index = np.array([0, 1, 2], "<u2").tobytes() + b"\0\0"
    changed = np.array([2], "<u2").tobytes() + b"\0\0" + np.array([(0, 0, 32767)], "<i2").tobytes() + b"\0\0"
    views = [(0, 24), (24, 6), (32, 2), (36, 6)]
    short = {"componentType": 5122, "count": 3, "type": "VEC3", "normalized": True, "bufferView": 0,
             "min": [0, 0, 0], "max": [32767, 32767, 32767]}  # fmt: skip
    sparse = {"count": 1, "indices": {"bufferView": 2, "componentType": 5123}, "values": {"bufferView": 3}}
    tree: dict[str, object] = {
        "asset": {"version": "2.0"},
        "extensionsRequired": ["KHR_mesh_quantization"],
        "extensionsUsed": ["KHR_mesh_quantization"],
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0}, {"mesh": 1, "scale": [2, 2, 2], "translation": [5, 0, 0]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": k}, "indices": 2}]} for k in (0, 1)],
        "accessors": [short, short | {"sparse": sparse},
                      {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"}],
        "bufferViews": [{"buffer": 0, "byteOffset": o, "byteLength": n} | ({"byteStride": 8} if o == 0 else {})
                        for o, n in views],
        "buffers": [{"byteLength": 44}],
    }  # fmt: skip
    vertices, faces = load_mesh(written(tmp_path, "a.glb", glb(tree, points + index + changed)))
    assert len(faces) == 2
    wanted = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (5, 0, 0), (7, 0, 0), (5, 0, 2)]
    assert np.allclose(sorted(map(tuple, vertices.tolist())), sorted(wanted), atol=1e-4)
    tree["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    with pytest.raises(FileError, match="KHR_draco_mesh_compression; export it without compression"):
        load_mesh(written(tmp_path, "b.glb", glb(tree, points + index + changed)))


def test_normals_of_a_glb_are_its_edges(tmp_path: Path) -> None:
    box = trimesh.creation.box()
    box.unmerge_vertices()
    box.export(tmp_path / "flat.glb", include_normals=True)
    assert distinct_normals(load_mesh(tmp_path / "flat.glb")) == 6
    assert distinct_normals(load_mesh(tmp_path / "flat.glb", crease=math.pi)) == 8


@pytest.mark.parametrize("head", [b"binary", b"solid of a CAD program"])
def test_binary_stl(tmp_path: Path, head: bytes) -> None:
    ball = trimesh.creation.icosphere(1)
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *corner.reshape(-1), 0) for corner in ball.vertices[ball.faces])

    def stl(count: int, data: bytes) -> bytes:
        return head.ljust(80, b" ") + struct.pack("<I", count) + data

    for data in (body, body + b"\0" * 37):  # some programs write more
        vertices, faces = load_mesh(written(tmp_path, "a.stl", stl(len(ball.faces), data)))
        assert (len(vertices), len(faces)) == (len(ball.vertices), len(ball.faces))
    for count, data in ((len(ball.faces), body[:-20]), (0, body), (10**9, body)):
        with pytest.raises(FileError, match=f"expected {count} triangles as it states"):
            load_mesh(written(tmp_path, "a.stl", stl(count, data)))
