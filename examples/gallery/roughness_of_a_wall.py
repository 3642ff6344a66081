"""
Roughness of a wall from eight pictures
=======================================

A plastered wall, eight pictures under known lights: photometric stereo finds normals, albedo and one roughness, with
its standard error.
"""

import math

import matplotlib.pyplot as plt
import torch
import torch.nn.functional as F

import torch_orennayar as ton

# A wall with trowel marks: smoothed noise as its height, which gives normals (1, 3, 96, 96).
noise = torch.Generator().manual_seed(3)
height = torch.randn(1, 1, 14, 14, generator=noise)
depth = -3.0 * F.interpolate(height, (96, 96), mode="bicubic")[0]  # distance along the view, pixels
normal = ton.depth_to_normals(depth[None])

turn = torch.arange(8) * (2 * math.pi / 8)
tilt = torch.tensor([0.5, 0.9]).repeat(4)
lights = torch.stack((turn.cos() * tilt.sin(), turn.sin() * tilt.sin(), tilt.cos()), 1)

# %%
# Pictures by the slow theory would be fairest; its closed form with sensor noise is close.
true_degrees = 35.0
images = ton.OrenNayar("vcavity")(normal, lights[None], albedo=0.7, roughness=math.radians(true_degrees))[0]
images = (images + 0.003 * torch.randn(images.shape, generator=noise)).clamp_min(0)
found = ton.photometric_stereo(images, lights, model="vcavity")
degrees, error = found.roughness.median().rad2deg().item(), math.degrees(found.roughness_error)
print(f"roughness {degrees:.1f} ± {error:.1f} degrees, true {true_degrees:.1f}")
print(f"normals off by {ton.angular_error(found.normal, normal[0]).summary()['mean']:.2f} degrees")

# %%
# Lambert's model on the same pictures takes roughness for shape, and flattens the marks.
lambert = ton.photometric_stereo(images, lights, model="lambert")
print(f"by Lambert off by {ton.angular_error(lambert.normal, normal[0]).summary()['mean']:.2f} degrees")
figure, axes = plt.subplots(1, 4, figsize=(10, 2.7), layout="constrained")
axes[0].imshow(images[0, 0], cmap="gray", vmin=0)
axes[0].set_title("a picture")
axes[1].imshow(ton.encode_normals(found.normal).permute(1, 2, 0))
axes[1].set_title("normals, vcavity")
for axis, result, name in ((axes[2], found, "vcavity"), (axes[3], lambert, "lambert")):
    axis.imshow(ton.angular_error(result.normal, normal[0])[0], vmin=0, vmax=10, cmap="magma")
    axis.set_title(f"error, {name}")
figure.colorbar(axes[3].images[0], ax=axes[3], label="degrees")
for axis in axes:
    axis.axis("off")
plt.show()
