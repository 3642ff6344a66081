"""Figures for reports: normal maps in colour, maps with a colour bar, contact sheets, charts."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from ..core.optional import require
from .images import encode_normals
from .srgb import linear_to_srgb

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PathLike = str | os.PathLike[str]
LARGEST_SIDE = 1200
"""Pixels to which the longer side of pictures on sheets and maps is thinned, about; set by hand, for file size."""
DPI = 130
"""Dots per inch of written figures, whose sizes are in inches; set by hand."""


def show_normals(normal: Tensor, mask: Tensor) -> Tensor:
    """Normals (3, H, W) as colours (3, H, W) on white."""
    return torch.where(mask, encode_normals(normal, mask), 1.0)


def show_light(image: Tensor, mask: Tensor) -> Tensor:
    """Linear light (1|3, H, W) as sRGB colours (3, H, W) on white, cut at 1."""
    return torch.where(mask, linear_to_srgb(image.expand(3, -1, -1)), 1.0)


def crop_to(mask: Tensor) -> tuple[slice, slice]:
    """Rows and columns of the mask's bounding box, with a small margin."""
    spans = []
    for axis, size in ((1, mask.shape[1]), (0, mask.shape[2])):
        inside = mask[0].any(axis).nonzero().flatten().tolist() or [0, size - 1]
        margin = 2 + (inside[-1] - inside[0]) // 40
        spans.append(slice(max(inside[0] - margin, 0), min(inside[-1] + margin + 1, size)))
    return spans[0], spans[1]


def _thinned(picture: Tensor) -> Tensor:
    """(C, H, W) with its longer side thinned to about `LARGEST_SIDE` pixels."""
    step = max(1, max(picture.shape[1:]) // LARGEST_SIDE)
    return picture[:, ::step, ::step]


def save_sheet(path: PathLike, rows: Sequence[Mapping[str, Tensor]], *, labels: Sequence[str] = ()) -> Path:
    """Write a contact sheet: one row per mapping from caption to (3, H, W) colours; ``labels`` name the rows."""
    columns = max(len(row) for row in rows)
    figure, axes = _grid(len(rows), columns)
    for row, line in zip(rows, axes, strict=True):
        for axis in line:
            axis.axis("off")
        for axis, (caption, picture) in zip(line, row.items(), strict=False):
            axis.imshow(_thinned(picture).permute(1, 2, 0).cpu().numpy().clip(0, 1))
            axis.set_title(caption, fontsize=9)
    for label, line in zip(labels, axes, strict=False):
        line[0].text(-0.06, 0.5, label, transform=line[0].transAxes, rotation=90, va="center", ha="right", fontsize=9)
    return _save(figure, path)


def save_maps(
    path: PathLike,
    maps: Mapping[str, Tensor],
    mask: Tensor,
    *,
    unit: str,
    top: float | None = None,
    palette: str = "inferno",
) -> Path:
    """Write maps (1, H, W) side by side with one colour bar that starts at 0; outside ``mask`` they are white.

    ``top`` is the bar's upper end; default: the largest 99th percentile of the maps.
    """
    mask = _thinned(mask)
    inside = mask[0].cpu().numpy()
    part = crop_to(mask)
    arrays = {
        caption: np.where(inside, _thinned(m)[0].detach().cpu().numpy(), np.nan)[part] for caption, m in maps.items()
    }
    highest = top or max(float(np.nanpercentile(a, 99)) for a in arrays.values()) or 1.0
    over = any(np.nanmax(a) > highest for a in arrays.values())
    figure, axes = _grid(1, len(arrays))
    shown = []
    for axis, (caption, array) in zip(axes[0], arrays.items(), strict=True):
        shown.append(axis.imshow(array, vmin=0, vmax=highest, cmap=palette))
        axis.set_title(caption, fontsize=9)
        axis.axis("off")
    figure.colorbar(shown[-1], ax=list(axes[0]), label=unit, shrink=0.85, extend="max" if over else "neither")
    return _save(figure, path)


def save_bars(path: PathLike, values: Mapping[str, float], *, unit: str, highlight: str = "") -> Path:
    """Write a chart of horizontal bars with their values; lower is better, ``highlight`` is drawn in colour."""
    require("matplotlib")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 0.6 + 0.45 * len(values)), layout="constrained")
    axis = figure.subplots()
    names = list(values)[::-1]
    bars = axis.barh(
        names, [values[n] for n in names], color=["#c2571a" if n == highlight else "#8a93a6" for n in names]
    )
    axis.bar_label(bars, [f" {values[n]:.3g}" for n in names], fontsize=9)
    axis.margins(x=0.15)
    axis.set_xlabel(f"{unit} (lower is better)", fontsize=9)
    axis.spines[["top", "right"]].set_visible(False)
    return _save(figure, path)


def _grid(rows: int, columns: int) -> tuple[Figure, Sequence[Sequence[Axes]]]:
    require("matplotlib")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(2.1 * columns + 0.4, 2.3 * rows + 0.2), layout="constrained")
    axes: Any = figure.subplots(rows, columns, squeeze=False)
    return figure, axes


def _save(figure: Figure, path: PathLike) -> Path:
    figure.savefig(path, dpi=DPI)
    return Path(path)
