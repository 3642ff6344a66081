"""
A rough ball beside Lambert's
=============================

Light from the camera. A Lambertian ball grows dark toward its edge; a rough one is nearly as bright there as in the
middle, which is why the full moon looks flat.
"""

import math

import matplotlib.pyplot as plt
import torch
import trimesh

import torch_orennayar as ton

ball = trimesh.creation.icosphere(subdivisions=5)
vertices, faces = torch.tensor(ball.vertices, dtype=torch.float32), torch.tensor(ball.faces)
seen = ton.render_normals(vertices, faces, ton.Camera.orthographic(1.05), (200, 200))
light = torch.tensor([[0.0, 0.0, 1.0]])

# %%
# One normal map serves every material: the layer takes normals, a light, albedo and roughness in radians.
degrees = (0, 15, 30, 45, 60)
shown = [seen.shade(ton.OrenNayar("vcavity"), light, albedo=0.8, roughness=math.radians(d))[0, 0] for d in degrees]

figure, axes = plt.subplots(1, len(degrees), figsize=(10, 2.3), layout="constrained")
for axis, image, d in zip(axes, shown, degrees, strict=True):
    axis.imshow(ton.linear_to_srgb(image[None])[0], cmap="gray", vmin=0, vmax=1)
    axis.set_title(f"σ = {d}°" if d else "Lambert")
    axis.axis("off")

# %%
# Across the middle, in linear light: the classic model has the shape and loses the light between facets.
classic = seen.shade(ton.OrenNayar("qualitative"), light, albedo=0.8, roughness=math.radians(45))[0, 0]
place = torch.linspace(-1.05, 1.05, 200)
figure, axis = plt.subplots(figsize=(7, 3.2), layout="constrained")
curves = (("Lambert", shown[0]), ("vcavity, σ = 45°", shown[3]), ("qualitative, σ = 45°", classic))
for name, image in curves:
    axis.plot(place, image[100].where(seen.mask[0, 0, 100], torch.nan), label=name)
axis.set_xlabel("place across the ball, radii")
axis.set_ylabel("shading")
axis.set_ylim(0)
axis.legend()
plt.show()
