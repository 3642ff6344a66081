"""Write what the page runs: graphs of shading, rendering and photometric stereo, and a normal map to start with.

python examples/web/make_graphs.py FOLDER
"""

import sys
from pathlib import Path

import cv2
import torch
import trimesh
from torch import Tensor

import torch_orennayar as ton

SIZE = (512, 512)
"""Rows and columns that the renderer draws; ``SIDE`` in `app.js` is the same."""
FRAME_HALF_HEIGHT = 1.05
"""Half height of the camera's view: the unit sphere, to which the page scales meshes, with a margin."""
MODELS = ("lambert", "qualitative", "vcavity")
"""Models that the page offers; ``NAMES`` in `app.js` has the same."""


def bumpy_ball() -> tuple[Tensor, Tensor]:
    """A sphere with smooth bumps that fits the unit sphere: vertices (V, 3) and faces (F, 3)."""
    ball = trimesh.creation.icosphere(subdivisions=6)
    points = torch.tensor(ball.vertices, dtype=torch.float32)
    x, y, z = points.unbind(1)
    bumps = 0.05 * torch.sin(6 * x + 1) * torch.cos(5 * y) + 0.035 * torch.sin(9 * y - 4 * z) + 0.02 * torch.cos(12 * x)
    points = points * (0.9 + bumps)[:, None]
    low, high = points.amin(0), points.amax(0)
    return (points - (low + high) / 2) / ((high - low).norm() / 2), torch.tensor(ball.faces)


def main(folder: str) -> None:
    """Write all files to ``folder``; every graph is verified against torch as it is written."""
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    camera = ton.Camera.orthographic(FRAME_HALF_HEIGHT)
    for model in MODELS:
        print(f"exporting shading with {model}", flush=True)
        ton.export_onnx("shading", target / f"shading_{model}.onnx", model=model)
    print("exporting photometric stereo", flush=True)
    ton.export_onnx("stereo", target / "stereo.onnx", model="vcavity")
    ton.export_onnx("stereo", target / "stereo_network.onnx", model="network")
    print("exporting integration", flush=True)
    ton.export_onnx("integration", target / "integration.onnx")
    print("exporting the renderer", flush=True)
    ton.export_onnx("renderer", target / "renderer.onnx", camera=camera, size=SIZE)
    vertices, faces = bumpy_ball()
    normal = ton.render_normals(vertices, faces, camera, SIZE).normal[0]
    colours = (ton.encode_normals(normal).double() * 255).round().byte()
    cv2.imwrite(str(target / "normal.png"), colours.permute(1, 2, 0).numpy()[..., ::-1])  # OpenCV orders B, G, R


if __name__ == "__main__":
    main(*sys.argv[1:])
