"""Write what the page runs: shading graphs, a renderer, photometric stereo, and a normal map to begin with.

python examples/web/make_graphs.py FOLDER
"""

import sys
from pathlib import Path

import torch_orennayar as ton
from torch_orennayar.geometry.mesh import normalise_mesh
from torch_orennayar.geometry.primitives import bumpy_ball
from torch_orennayar.io.images import write_image

SIZE = (512, 512)
MODELS = ("lambert", "qualitative", "vcavity")


def main(folder: str) -> None:
    """Everything is verified against torch as it is written."""
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    camera = ton.Camera.orthographic(1.05)
    for model in MODELS:
        print(f"exporting shading with {model}", flush=True)
        ton.export_onnx("shading", target / f"shading_{model}.onnx", model=model)
    print("exporting photometric stereo", flush=True)
    ton.export_onnx("stereo", target / "stereo.onnx", model="vcavity")
    ton.export_onnx("stereo", target / "stereo_network.onnx", model="network")
    print("exporting the renderer, about half a minute", flush=True)
    ton.export_onnx("renderer", target / "renderer.onnx", camera=camera, size=SIZE)
    vertices, faces = bumpy_ball()
    seen = ton.render_normals(normalise_mesh(vertices), faces, camera, SIZE)
    write_image(target / "normal.png", ton.encode_normals(seen.normal[0]))


if __name__ == "__main__":
    main(*sys.argv[1:])
