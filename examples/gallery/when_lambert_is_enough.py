"""
When Lambert is enough
======================

`~torch_orennayar.simplest_model` takes the cheapest model whose measured error stays within a tolerance for the
roughness, albedo and angles of a scene. Often that is Lambert.
"""

import math

import matplotlib.pyplot as plt
import numpy as np
import torch
from matplotlib.patches import Patch

import torch_orennayar as ton

choice = ton.simplest_model(roughness=(0.0, math.radians(15)), albedo=(0.1, 0.8), tolerance=0.05)
print(choice, choice.error)
print(choice.reason)

# %%
# What is chosen for all roughness up to a limit (across) and an error allowed (down), for any albedo and angle:
names = list(ton.MODELS)
limits, tolerances = np.arange(2, 61, 2), np.geomspace(0.1, 0.004, 25)
chosen = np.full((len(tolerances), len(limits)), np.nan)
for row, tolerance in enumerate(tolerances):
    for column, limit in enumerate(limits):
        picked = ton.simplest_model(roughness=(0.0, math.radians(limit)), tolerance=float(tolerance))
        chosen[row, column] = names.index(picked)

figure, axis = plt.subplots(figsize=(7, 4), layout="constrained")
colours = plt.get_cmap("tab10", 10)
axis.pcolormesh(limits, tolerances, chosen, cmap=colours, vmin=-0.5, vmax=9.5)
axis.set_yscale("log")
axis.set_xlabel("roughness up to, degrees")
axis.set_ylabel("RMS error allowed, of shading over albedo")
used = sorted(set(chosen.flatten().astype(int)))
axis.legend(handles=[Patch(color=colours(k), label=names[k]) for k in used], loc="upper right")

# %%
# The choice is a string, accepted wherever the name of a model is.
layer = ton.OrenNayar(choice)
up = torch.tensor([0.0, 0.0, 1.0]).reshape(1, 3, 1, 1)
print(layer, layer(up, torch.tensor([0.0, 0.0, 1.0]), albedo=0.8, roughness=0.2).item())
plt.show()
