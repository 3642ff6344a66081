"""Relight a normal map, render a mesh or solve photographs with only onnxruntime, numpy and OpenCV.

    python app.py relight shading.onnx normal.png out.png --light 0.3 0.4 0.86 --roughness 35 --albedo 0.8
    python app.py render renderer.onnx shading.onnx mesh.obj out.png --light 0.3 0.4 0.86 --roughness 35
    python app.py solve stereo.onnx photographs/ out/

The graphs come from `orennayar export`, in float32 or float16. Angles are in degrees. 8-bit photographs are read as
sRGB, 16-bit ones as linear light, turned upright as their Exif says. A folder of photographs holds their lights in
light_directions.txt, lights.txt or one .lp file, and may hold mask.png, light_intensities.txt and a picture called
ambient, taken with all lights off. Meshes are OBJ, or PLY in text.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnxruntime

Array = np.ndarray[Any, Any]
PHOTOGRAPH_SUFFIXES = {".png", ".jpg", ".jpeg", ".tif", ".tiff"}
"""Suffixes, in lower case, of files that are taken for photographs where there is no filenames.txt."""
OTHER_PICTURES = ("mask", "normal", "ambient")
"""How the names of pictures begin that are no photographs of the capture."""
LIGHT_FILES = ("light_directions.txt", "lights.txt")
"""Names of files of light directions; the first is that of the DiLiGenT captures."""
NUMBERS: dict[str, Any] = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(int64)": np.int64,
    "tensor(bool)": np.bool_,
}
"""Types of what a graph takes, as numpy has them."""
TINY = 1e-12
"""Lower limit of lengths and maxima that are divided by."""


def run(graph: str, **feeds: Array) -> dict[str, Array]:
    """The outputs of a graph by name."""
    if not Path(graph).is_file():
        sys.exit(f"{graph}: no such file; write it with `orennayar export`")
    try:
        session = onnxruntime.InferenceSession(graph, providers=["CPUExecutionProvider"])
    except Exception as error:  # the runtime's errors have no common base class
        sys.exit(f"{graph}: not a graph that ONNX Runtime loads ({error})")
    types = {i.name: i.type for i in session.get_inputs()}
    if types.keys() != feeds.keys():
        sys.exit(f"{graph}: takes {', '.join(sorted(types))}; this command needs one that takes {', '.join(feeds)}")
    given = {name: value.astype(NUMBERS[types[name]]) for name, value in feeds.items()}
    try:
        found = session.run(None, given)
    except Exception as error:  # as above
        sys.exit(f"{graph}: ONNX Runtime stopped ({error})")
    outputs = [o.name for o in session.get_outputs()]
    return {name: v.astype(np.float32) if v.dtype == np.float16 else v for name, v in zip(outputs, found, strict=True)}


def to_linear(values: Array) -> Array:
    """Decode sRGB values to linear light (IEC 61966-2-1)."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def to_srgb(light: Array) -> Array:
    """Encode linear light as sRGB (IEC 61966-2-1)."""
    light = np.clip(light, 0, 1)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def read(path: Path) -> tuple[Array, int]:
    """The stored RGB values of a picture, (3, H, W) in [0, 1], and their number of bits."""
    pixels = cv2.imread(str(path), cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH)  # these turn a picture upright
    if pixels is None:
        sys.exit(f"{path}: not a picture that OpenCV reads")
    bits = 16 if pixels.dtype == np.uint16 else 8
    pixels = pixels if pixels.ndim == 3 else pixels[..., None].repeat(3, 2)
    rgb = pixels[..., 2::-1].astype(np.float32) / (2**bits - 1)
    return np.ascontiguousarray(rgb.transpose(2, 0, 1)), bits


def write(path: Path, planes: Array, *, bits: int = 8) -> None:
    """Write values in [0, 1], (3, H, W) or (1, H, W), as a PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.round(np.clip(planes, 0, 1) * (2**bits - 1)).astype(np.uint16 if bits == 16 else np.uint8)
    if not cv2.imwrite(str(path), pixels[::-1].transpose(1, 2, 0)):
        sys.exit(f"{path}: cannot be written")


def encode_normals(normal: Array) -> Array:
    """Colours of unit normals, (3, H, W); the background is black."""
    colours: Array = (normal + 1) / 2 * (normal != 0).any(0)
    return colours


def decode_normals(colours: Array) -> Array:
    """Unit normals of colours, (3, H, W), whose green channel points up."""
    normal: Array = 2 * colours - 1
    normal /= np.maximum(np.linalg.norm(normal, axis=0), TINY)
    normal *= (colours != 0).any(0)
    return normal


def shade(graph: str, normal: Array, options: argparse.Namespace) -> Array:
    """Shading of a normal map (3, H, W) by a graph: linear light, (1, H, W)."""
    light = np.asarray(options.light, np.float32)
    if not np.linalg.norm(light) > 0:
        sys.exit("--light: needs a direction")

    def constant(*values: float) -> Array:
        return np.asarray(values, np.float32).reshape(1, -1, 1, 1)

    outputs = run(
        graph,
        normal=normal[None].astype(np.float32),
        light=constant(*(light / np.linalg.norm(light))),
        view=constant(0, 0, 1),
        albedo=constant(options.albedo),
        roughness=constant(np.radians(options.roughness)),
    )
    shading: Array = outputs["shading"][0]
    return shading


def relight(options: argparse.Namespace) -> None:
    """Shade a normal map."""
    normal = decode_normals(read(options.normals)[0])
    write(options.output, to_srgb(shade(options.shading, normal, options)))


def render(options: argparse.Namespace) -> None:
    """Render and shade a mesh, centred and scaled to the unit sphere."""
    vertices, faces = read_mesh(options.mesh)
    low, high = vertices.min(0), vertices.max(0)
    vertices = (vertices - (low + high) / 2) / max(float(np.linalg.norm(high - low)) / 2, TINY)
    seen = run(options.renderer, vertices=vertices.astype(np.float32), faces=faces)
    write(options.output, to_srgb(shade(options.shading, seen["normal"][0], options)))


def read_mesh(path: Path) -> tuple[Array, Array]:
    """Vertices (V, 3) and triangles (F, 3) of an OBJ file or of a PLY file in text."""
    if not path.is_file():
        sys.exit(f"{path}: no such file")
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
        vertices, polygons = (parse_ply if path.suffix.lower() == ".ply" else parse_obj)(lines)
    except (ValueError, IndexError) as error:
        sys.exit(f"{path}: not a mesh that this app reads ({error})")
    faces = np.asarray([[p[0], *pair] for p in polygons for pair in itertools.pairwise(p[1:])], np.int64)
    if not len(faces) or faces.min() < 0 or faces.max() >= len(vertices):
        sys.exit(f"{path}: no triangles, or faces with vertices that do not exist")
    return np.asarray(vertices), faces


def parse_obj(lines: list[str]) -> tuple[list[list[float]], list[list[int]]]:
    """Vertices and polygons of an OBJ file."""
    vertices: list[list[float]] = []
    polygons: list[list[int]] = []
    for line in lines:
        kind, *words = line.split() or [""]
        if kind == "v":
            vertices.append([float(word) for word in words[:3]])
        elif kind == "f":
            corners = [int(word.split("/")[0]) for word in words]
            polygons.append([c - 1 if c > 0 else c + len(vertices) for c in corners])
    return vertices, polygons


def parse_ply(lines: list[str]) -> tuple[list[list[float]], list[list[int]]]:
    """Vertices and polygons of a PLY file in text, whose vertices begin with x, y and z and whose faces are lists."""
    end = lines.index("end_header")
    header = [line.split() for line in lines[:end]]
    if ["format", "ascii", "1.0"] not in header:
        raise ValueError("a binary PLY; write it as text")
    counts = {words[1]: int(words[2]) for words in header if words[0] == "element"}
    body = [line.split() for line in lines[end + 1 :]]
    first = counts["vertex"]
    vertices = [[float(word) for word in words[:3]] for words in body[:first]]
    return vertices, [[int(w) for w in words[1 : 1 + int(words[0])]] for words in body[first : first + counts["face"]]]


def solve(options: argparse.Namespace) -> None:
    """Solve photographs under known lights; writes normals and albedo as .png and .npy."""
    folder: Path = options.photographs
    names, lights = find_photographs(folder)
    images = read_photographs(folder, names)
    mask = np.ones((1, *images.shape[2:]), bool)
    if (folder / "mask.png").is_file():
        mask = read(folder / "mask.png")[0][:1] > 0.5
    if mask.shape[1:] != images.shape[2:] or not mask.any():
        sys.exit("mask.png: empty, or of another size than the photographs")
    found = run(options.stereo, images=images, lights=lights.astype(np.float32), mask=mask)
    output: Path = options.output
    write(output / "normal.png", encode_normals(found["normal"]), bits=16)
    write(output / "albedo.png", to_srgb(found["albedo"] / max(float(found["albedo"].max()), TINY)))
    np.save(output / "normal.npy", found["normal"])
    np.save(output / "albedo.npy", found["albedo"])
    print(f"{len(names)} photographs, {int(mask.sum())} pixels, roughness {np.degrees(found['roughness'].max()):.1f}")


def read_photographs(folder: Path, names: list[str]) -> Array:
    """Linear light over the intensity of the light, (K, 3, H, W)."""
    file = folder / "light_intensities.txt"
    intensities = table(file) if file.is_file() else np.ones((len(names), 1))
    if len(intensities) != len(names):
        sys.exit(f"{file}: {len(intensities)} lines for {len(names)} photographs")
    pictures = (f for f in folder.iterdir() if f.suffix.lower() in PHOTOGRAPH_SUFFIXES)
    dark = next((read_linear(f) for f in pictures if f.stem.lower() == "ambient"), np.zeros((3, 1, 1), np.float32))
    images: list[Array] = []
    for name, intensity in zip(names, intensities, strict=True):
        light = read_linear(folder / name)
        if images and light.shape != images[0].shape:
            sys.exit(f"{name}: {light.shape[2]} x {light.shape[1]}, unlike the first photograph")
        if dark.shape[1:] not in ((1, 1), light.shape[1:]):
            sys.exit("ambient: another size than the photographs")
        images.append((np.maximum(light - dark, 0) / intensity.reshape(-1, 1, 1)).astype(np.float32))
    return np.stack(images)


def read_linear(path: Path) -> Array:
    """Linear light of a picture, (3, H, W)."""
    picture, bits = read(path)
    return to_linear(picture) if bits == 8 else picture


def find_photographs(folder: Path) -> tuple[list[str], Array]:
    """File names of the photographs and their unit light directions, (K, 3)."""
    listing = sorted(folder.glob("*.lp"))
    file = next((folder / name for name in LIGHT_FILES if (folder / name).is_file()), None)
    listed = folder / "filenames.txt"
    if file is not None:
        lights = table(file)
        pictures = (f for f in folder.iterdir() if f.suffix.lower() in PHOTOGRAPH_SUFFIXES)
        names = sorted(f.name for f in pictures if not f.stem.lower().startswith(OTHER_PICTURES))
        if listed.is_file():
            names = listed.read_text().split()
    elif len(listing) == 1:
        file = listing[0]
        names, lights = read_lp(file)
    else:
        sys.exit(f"{folder}: needs {' or '.join(LIGHT_FILES)}, a line `x y z` per photograph, or one .lp file")
    if lights.shape != (len(names), 3) or len(names) < 3:
        sys.exit(f"{file}: {lights.shape[0]} lights for {len(names)} photographs; 3 or more of both are needed")
    lengths = np.linalg.norm(lights, axis=1, keepdims=True)
    if not (lengths > 0).all():
        sys.exit(f"{file}: a light without a direction")
    return names, lights / lengths


def read_lp(file: Path) -> tuple[list[str], Array]:
    """File names and directions of an .lp file: a number of lines, then `name x y z` in each."""
    first, *lines = file.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    rows = [line.rsplit(maxsplit=3) for line in lines if line.strip()]
    try:
        if int(first.split()[0]) != len(rows):
            sys.exit(f"{file}: states {first.split()[0]} lights and lists {len(rows)}")
        lights = np.asarray([[float(word) for word in words[1:]] for words in rows])
    except ValueError as error:
        sys.exit(f"{file}: not an .lp file ({error})")
    return [words[0].replace("\\", "/").rsplit("/", 1)[-1].strip('"') for words in rows], lights


def table(file: Path) -> Array:
    """The numbers of a text file, a row per line."""
    try:
        return np.loadtxt(file, ndmin=2)
    except ValueError as error:
        sys.exit(f"{file}: not a table of numbers ({error})")


def main() -> None:
    """Run the command that the arguments name."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)

    def command(work: Callable[[argparse.Namespace], None], *arguments: str) -> argparse.ArgumentParser:
        part = commands.add_parser(work.__name__, help=work.__doc__)
        for argument in arguments:
            part.add_argument(argument, type=str if argument in ("shading", "renderer", "stereo") else Path)
        part.set_defaults(work=work)
        return part

    for part in (
        command(relight, "shading", "normals", "output"),
        command(render, "renderer", "shading", "mesh", "output"),
    ):
        part.add_argument("--light", type=float, nargs=3, default=(0.3, 0.4, 0.86))
        part.add_argument("--roughness", type=float, default=35.0)
        part.add_argument("--albedo", type=float, default=0.8)
    command(solve, "stereo", "photographs", "output")
    options = parser.parse_args()
    options.work(options)


if __name__ == "__main__":
    main()
