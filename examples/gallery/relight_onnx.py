"""
Relight by an ONNX graph
========================

An app that relights needs neither torch nor this package: it runs a graph in ONNX Runtime. The graph is compared with
torch before it is written.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import onnxruntime
import torch

import torch_orennayar as ton

path = ton.export_onnx("shading", Path(tempfile.mkdtemp()) / "shading.onnx", model="vcavity")
print(f"{path.stat().st_size / 1000:.0f} kB")

# %%
# From here on numpy and ONNX Runtime suffice. The maps may come from photometric stereo; these are made up.
made = ton.SyntheticCaptures("images", seed=1, mix=ton.Ingredients.plain(rough=1.0), size=(160, 160)).sample(4)
normal, albedo, mask = (made[name][None].numpy() for name in ("normal", "albedo", "mask"))
session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
for value in session.get_inputs():
    print(value.name, value.shape)


def relight(light: tuple[float, float, float], degrees: float) -> np.ndarray:
    """The picture, (H, W, 3), under one light."""
    vectors = np.array([light, (0.0, 0.0, 1.0)], np.float32).reshape(2, 1, 3, 1, 1)
    roughness = np.full((1, 1, 1, 1), np.deg2rad(degrees), np.float32)
    feeds = {"normal": normal, "light": vectors[0], "view": vectors[1], "albedo": albedo, "roughness": roughness}
    (shading,) = session.run(None, feeds)
    return np.asarray(np.where(mask, shading, 1.0)[0].transpose(1, 2, 0))


# %%
# Columns are lights, rows are roughness 0 and 45 degrees.
figure, axes = plt.subplots(2, 5, figsize=(10, 4.2), layout="constrained")
for column, x in enumerate((-0.8, -0.4, 0.0, 0.4, 0.8)):
    for row, degrees in enumerate((0, 45)):
        shading = torch.from_numpy(relight((x, 0.3, (1 - x * x - 0.09) ** 0.5), degrees)).permute(2, 0, 1)
        axes[row, column].imshow(ton.linear_to_srgb(shading.clamp(0, 1)).permute(1, 2, 0))
        axes[row, column].axis("off")
plt.show()
