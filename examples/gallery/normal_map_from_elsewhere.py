"""
A normal map from another program
=================================

Normal maps come with green up (OpenGL, Blender) or green down (DirectX, Unreal). Read the wrong way, every bump lit
from above looks like a dent.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
from PIL import Image

import torch_orennayar as ton

# What another program wrote: 8-bit colours with green down.
made = ton.SyntheticCaptures("images", seed=1, mix=ton.Ingredients.plain(rough=1.0), size=(128, 128)).sample(2)
path = Path(tempfile.mkdtemp()) / "normal_dx.png"
colours = ton.encode_normals(made["normal"], made["mask"], green="down")
Image.fromarray((255 * colours).round().byte().permute(1, 2, 0).numpy()).save(path)

# %%
# Read as stored: a normal map has no sRGB curve. Background colours become zero vectors, which are shaded to 0.
stored = torch.from_numpy(np.array(Image.open(path))).permute(2, 0, 1) / 255
right, wrong = ton.decode_normals(stored, green="down"), ton.decode_normals(stored, green="up")
mask = (right != 0).any(0, keepdim=True)
for name, normal in (("green down", right), ("green up", wrong)):
    print(f"read as {name}: {ton.angular_error(normal, made['normal'], mask).summary()['mean']:.2f} degrees off")

# %%
# Shade it, and integrate it to a height: light from above, 40 degrees of roughness.
light = torch.tensor([[0.0, 0.7, 0.714]])
layer = ton.OrenNayar("vcavity")
figure, axes = plt.subplots(1, 4, figsize=(10, 2.7), layout="constrained")
axes[0].imshow(stored.permute(1, 2, 0))
for axis, normal in ((axes[1], right), (axes[2], wrong)):
    shading = layer(normal[None], light, albedo=0.8, roughness=0.7)[0]
    axis.imshow(ton.linear_to_srgb(shading)[0], cmap="gray", vmin=0, vmax=1)
height = ton.integrate_normals(right, mask)[0]
axes[3].imshow(height.where(mask[0], torch.nan), cmap="viridis")
for axis, title in zip(axes, ("the file", "green down: right", "green up: wrong", "height"), strict=True):
    axis.set_title(title)
    axis.axis("off")
plt.show()
