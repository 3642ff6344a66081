"""
From photographs to GLB
=======================

Twelve JPEG photographs, one lamp carried around the object, nothing measured. The command ``orennayar stereo`` finds
the lights, the surface and its material, and writes a mesh that any viewer opens.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
from PIL import Image

import torch_orennayar as ton

# Photographs of a made-up object; put your own folder in their place.
mix = ton.Ingredients.plain(rough=1.0, shadows=1)
made = ton.SyntheticCaptures("images", seed=1, mix=mix, size=(112, 112), lights=(12, 12)).sample(3)
folder = Path(tempfile.mkdtemp())
(folder / "photographs").mkdir()
for k, image in enumerate(made["images"]):
    encoded = 255 * ton.linear_to_srgb((0.9 * image / made["images"].max()).clamp(0, 1))
    picture = Image.fromarray(encoded.round().byte().permute(1, 2, 0).numpy())
    picture.save(folder / "photographs" / f"IMG_{k + 1:02}.jpg", quality=95)

# %%
command = [sys.executable, "-m", "torch_orennayar", "stereo", "photographs", "-o", "out", "--no-report"]
said = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout
print(said)
print(sorted(file.name for file in (folder / "out").iterdir()))

# %%
# The GLB has the mesh, its texture and the roughness. Here it is rendered from the front and from the side.
mesh = ton.load_mesh(next((folder / "out").glob("*.glb")))
vertices = ton.normalise_mesh(mesh.vertices)
shown = []
for eye in ((0.0, 0.0, 4.0), (2.8, 0.6, 2.8)):
    seen = ton.render_normals(vertices, mesh.faces, ton.Camera.perspective(0.5, eye), (200, 200))
    grey = seen.shade(ton.OrenNayar("vcavity"), torch.tensor([[-0.48, 0.36, 0.8]]), albedo=0.7, roughness=0.5)
    shown.append(torch.where(seen.mask, ton.linear_to_srgb(grey), 1.0)[0, 0])
figure, axes = plt.subplots(1, 4, figsize=(10, 2.7), layout="constrained")
axes[0].imshow(np.asarray(Image.open(folder / "photographs" / "IMG_01.jpg")))
axes[1].imshow(np.asarray(Image.open(folder / "out" / "normal.png").convert("RGB")))
axes[2].imshow(shown[0], cmap="gray", vmin=0, vmax=1)
axes[3].imshow(shown[1], cmap="gray", vmin=0, vmax=1)
for axis, title in zip(axes, ("a photograph", "normals", "mesh", "from the side"), strict=True):
    axis.set_title(title)
    axis.axis("off")
plt.show()
