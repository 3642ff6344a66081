"""Pictures of the models' pages: spheres and a mesh by roughness and light, and derivatives across the kinks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from torch import Tensor

from scripts.benchmarks.charts import ACCENT, OTHERS, OURS
from torch_orennayar import Camera, OrenNayar, linear_to_srgb, oren_nayar, render_normals
from torch_orennayar.geometry.primitives import bumpy_ball

ROUGHNESS = (0, 10, 20, 30, 45, 60)
"""Columns, degrees."""
LIGHTS = (0, 45, 75)
"""Rows: angles between light and view, degrees."""
ALBEDO = 0.8
"""Of every picture."""
SIDE, COARSE = 96, 16
"""Samples across a sphere, and those at which the slow theory is computed."""
VIEW_DEGREES, SIGMA_DEGREES = 40, 30
"""View and roughness of the charts of derivatives."""

Picture = npt.NDArray[np.float32]


def draw(folder: Path, names: Sequence[str]) -> None:
    """Write ``NAME.png`` and ``NAME-gradients.png`` for every model."""
    truth = {(light, sigma): _sphere("theory", light, sigma) for light in LIGHTS for sigma in ROUGHNESS}
    steps = torch.linspace(-80, 80, 161, dtype=torch.float64)
    reference = _across("theory", steps)
    for name in names:
        _draw_spheres(name, truth).savefig(folder / f"{name}.png", dpi=110)
        _draw_gradients(name, steps, reference).savefig(folder / f"{name}-gradients.png", dpi=110)


def _half_sphere(side: int) -> Tensor:
    """Normals (3, side / 2, side) of the upper half of a sphere in its square; beyond the rim those of the rim."""
    across = (torch.arange(side) + 0.5) * (2 / side) - 1
    y, x = torch.meshgrid(across.flip(0)[: side // 2], across, indexing="ij")
    radius = (x * x + y * y).sqrt()
    inward = (0.9995 / radius).clamp_max(1)
    x, y = x * inward, y * inward
    return torch.stack((x, y, (1 - x * x - y * y).sqrt()))


def _direction(degrees: float) -> Tensor:
    """A direction in the plane of x and z, that many degrees from the view."""
    return torch.tensor([math.sin(math.radians(degrees)), 0.0, math.cos(math.radians(degrees))])


def _shade(name: str, side: int, light: float, sigma: float) -> Tensor:
    """Shading of the upper half of a sphere, (1, 1, side / 2, side)."""
    toward, view = _direction(light).reshape(1, 3, 1, 1), _direction(0).reshape(1, 3, 1, 1)
    return oren_nayar(_half_sphere(side)[None], toward, view, ALBEDO, math.radians(sigma), model=name)


def _sphere(name: str, light: float, sigma: float) -> Picture:
    """(SIDE, SIDE) sRGB values; the lower half mirrors the upper one, since the light has no height.

    How the theory differs from its fit varies slowly over a sphere: that alone is interpolated from a coarse one.
    """
    if sigma == 0 or name != "theory":
        shading = _shade("lambert" if sigma == 0 else name, SIDE, light, sigma)
    else:
        off = _shade("theory", COARSE, light, sigma) - _shade("vcavity", COARSE, light, sigma)
        shading = _shade("vcavity", SIDE, light, sigma)
        shading = shading + F.interpolate(off, shading.shape[2:], mode="bilinear") * (shading > 0)
    half = linear_to_srgb(shading[0].clamp(0, 1))[0]
    return torch.cat((half, half.flip(0))).numpy()


def _draw_spheres(name: str, truth: dict[tuple[int, int], Picture]) -> Figure:
    """A pair of rows per light, the model and the theory, and a row of a mesh."""
    rows = ["theory"] if name == "theory" else [name, "theory"]
    count = len(LIGHTS) * len(rows) + (name != "theory")  # which is too slow for the mesh
    figure = Figure(figsize=(8, 1.3 * count + 0.3))
    place = {"left": 0.05, "right": 0.995, "top": 1 - 0.3 / (1.3 * count + 0.3), "bottom": 0.005}
    axes = figure.subplots(count, len(ROUGHNESS), gridspec_kw={**place, "wspace": 0.06, "hspace": 0.06})
    for k, (light, row) in enumerate((light, row) for light in LIGHTS for row in rows):
        for axis, sigma in zip(axes[k], ROUGHNESS, strict=True):
            picture = truth[light, sigma] if row == "theory" else _sphere(name, light, sigma)
            image = axis.imshow(picture, cmap="gray", vmin=0, vmax=1, extent=(-1, 1, -1, 1), interpolation="bicubic")
            image.set_clip_path(Circle((0, 0), 0.985, transform=axis.transData))
        axes[k, 0].set_ylabel(f"{row}\nlight {light}°", fontsize=8)
    if name != "theory":
        for axis, picture in zip(axes[-1], _mesh(name), strict=True):
            axis.imshow(picture, cmap="gray", vmin=0, vmax=1)
        axes[-1, 0].set_ylabel(f"{name}\nmesh, light 45°", fontsize=8)
    for axis, sigma in zip(axes[0], ROUGHNESS, strict=True):
        axis.set_title(f"σ = {sigma}°", fontsize=9)
    for axis in axes.flat:
        _bare(axis)
    return figure


def _bare(axis: Axes) -> None:
    axis.set_xticks([])
    axis.set_yticks([])
    axis.spines[:].set_visible(False)


def _mesh(name: str) -> list[Picture]:
    """A bumpy ball by roughness, light at 45 degrees."""
    seen = render_normals(*bumpy_ball(), Camera.orthographic(1.2), (2 * SIDE, 2 * SIDE))
    pictures = []
    for sigma in ROUGHNESS:
        layer = OrenNayar("lambert" if sigma == 0 else name)
        shading = seen.shade(layer, _direction(45)[None], albedo=ALBEDO, roughness=math.radians(sigma))[0]
        shown = linear_to_srgb(shading.clamp(0, 1))[0]
        pictures.append(torch.where(seen.mask[0, 0], shown, 1.0).numpy())
    return pictures


def _across(name: str, degrees: Tensor) -> tuple[Tensor, Tensor]:
    """Shading and its derivative by the light's angle, per radian, in the plane of normal and view."""
    angle = degrees.deg2rad().requires_grad_()
    light = torch.stack((angle.sin(), torch.zeros_like(angle), angle.cos()), -1)
    up, view = _direction(0).double()[None], _direction(VIEW_DEGREES).double()[None]
    shading = oren_nayar(up, light, view, ALBEDO, math.radians(SIGMA_DEGREES), model=name)[:, 0]
    (slope,) = torch.autograd.grad(shading.sum(), angle)
    return shading.detach(), slope


def _draw_gradients(name: str, degrees: Tensor, reference: tuple[Tensor, Tensor]) -> Figure:
    """The model over the theory: value on the left, derivative on the right."""
    figure = Figure(figsize=(8, 2.8), layout="constrained")
    titles = ("shading", "derivative by the light's angle")
    for axis, title, own, truth in zip(figure.subplots(1, 2), titles, _across(name, degrees), reference, strict=True):
        axis.plot(degrees, truth, color=OTHERS, linewidth=3, label="theory")
        if name != "theory":
            axis.plot(degrees, own, color=OURS, linewidth=1.3, label=name)
        for kink in (0, VIEW_DEGREES):
            axis.axvline(kink, color=ACCENT, linewidth=0.8, linestyle=":")
        axis.set_title(title, fontsize=9)
        axis.set_xlabel("angle of the light, degrees", fontsize=8)
        axis.tick_params(labelsize=8)
        axis.spines[["top", "right"]].set_visible(False)
        axis.legend(fontsize=8, frameon=False)
    return figure
