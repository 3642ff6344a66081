"""
Light between surfaces
======================

In a hollow, parts of a surface light each other, and photometric stereo takes that light for a flatter shape. The
default, ``model="auto"``, looks for it and takes it away before it solves.
"""

import matplotlib.pyplot as plt
import torch
import trimesh

import torch_orennayar as ton

# Four bright balls in a heap.
ball = trimesh.creation.icosphere(subdivisions=4)
unit, faces = 0.5 * torch.tensor(ball.vertices, dtype=torch.float32), torch.tensor(ball.faces)
places = 1.02 * torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 0.87, 0.0], [0.5, 0.29, 0.8]])
heap = torch.cat([unit + place for place in places]), torch.cat([faces + k * len(unit) for k in range(4)])
mix = ton.Ingredients.plain(rough=1.0, shadows=1, bounce=True)
captures = ton.SyntheticCaptures("images", seed=2, mix=mix, size=(64, 64), lights=(16, 16), meshes=[heap])
made = captures.sample(1)
images, lights, normal, mask = made["images"], made["lights"], made["normal"], made["mask"]
share = (made["between"].sum() / images.sum()).item()
print(f"{100 * share:.1f} % of the light in these pictures came from other parts of the object")

# %%
# A sample holds that light by itself, so it can be looked at.
ignored = ton.photometric_stereo(images, lights, mask, model="vcavity")
solved = ton.photometric_stereo(images, lights, mask)
for finding in solved.report:
    print(f"{finding.code}: {finding}")

figure, axes = plt.subplots(1, 4, figsize=(10, 2.7), layout="constrained")
axes[0].imshow(ton.linear_to_srgb((images[0] / images.max()).clamp(0, 1)).permute(1, 2, 0))
axes[0].set_title("a picture")
between = made["between"].mean(0)
axes[1].imshow((between / between.max()).clamp(0, 1).permute(1, 2, 0))
axes[1].set_title("light between parts")
for axis, found, name in ((axes[2], ignored, "vcavity"), (axes[3], solved, "auto")):
    error = ton.angular_error(found.normal, normal, mask)
    axis.imshow(error[0], vmin=0, vmax=12, cmap="magma")
    axis.set_title(f"{name}: {error.summary()['mean']:.2f}° off")
figure.colorbar(axes[3].images[0], ax=axes[3], label="degrees")
for axis in axes:
    axis.axis("off")
plt.show()
