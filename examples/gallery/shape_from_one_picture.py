"""
Shape from one picture
======================

One photograph of a matt object under one known light. Its outline fixes the normals at the edge, the shading does the
rest, if the model of the surface is right.
"""

import matplotlib.pyplot as plt
import torch
import trimesh

import torch_orennayar as ton

# A bumpy ellipsoid, photographed under one light.
ball = trimesh.creation.icosphere(subdivisions=5)
unit = torch.tensor(ball.vertices, dtype=torch.float32)
bumps = 1 + 0.08 * (5 * unit[:, :1]).sin() * (4 * unit[:, 1:2] + 1).sin()
vertices, faces = unit * bumps * torch.tensor([1.0, 0.75, 0.7]), torch.tensor(ball.faces)
seen = ton.render_normals(vertices, faces, ton.Camera.orthographic(1.15), (112, 112))
light = torch.tensor([0.36, 0.48, 0.8])
image = seen.shade(ton.OrenNayar("vcavity"), light[None], albedo=0.8, roughness=0.5)[0]
mask, normal = seen.mask[0], seen.normal[0]

# %%
# The outline alone, the picture taken as Lambertian, and with the right roughness.
results = {
    "outline alone": ton.silhouette_normals(mask),
    "Lambert": ton.shape_from_shading(image, light, mask, albedo=0.8, roughness=0.0).normal,
    "roughness given": ton.shape_from_shading(image, light, mask, albedo=0.8, roughness=0.5).normal,
}
figure, axes = plt.subplots(2, 4, figsize=(10, 4.6), layout="constrained")
axes[0, 0].imshow(ton.linear_to_srgb(image)[0], cmap="gray", vmin=0, vmax=1)
axes[0, 0].set_title("the picture")
axes[1, 0].imshow(ton.encode_normals(normal, mask).permute(1, 2, 0))
axes[1, 0].set_title("true normals")
for column, (name, found) in zip(axes.T[1:], results.items(), strict=True):
    error = ton.angular_error(found, normal, mask)
    print(f"{name}: {error.summary()['median']:.1f} degrees median, {error.summary()['mean']:.1f} mean")
    column[0].imshow(ton.encode_normals(found, mask).permute(1, 2, 0))
    column[0].set_title(name)
    column[1].imshow(error[0], vmin=0, vmax=25, cmap="magma")
    column[1].set_title(f"error, mean {error.summary()['mean']:.1f}°")
figure.colorbar(axes[1, 3].images[0], ax=axes[1, 3], label="degrees")
for axis in axes.flat:
    axis.axis("off")
plt.show()
