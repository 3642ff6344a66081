"""Write reconstructions and renderings as folders of files that people and programs open."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from torch import Tensor

from ..core.files import results_directory
from ..reconstruction import Reconstruction
from ..render.normal_map import NormalMap
from .capture import Capture
from .figures import save_sheet, show_light, show_normals
from .images import encode_normals, write_image
from .result_animations import write_relighting, write_turntable
from .result_maps import ResultMaps
from .result_numbers import ResultNumbers, result_numbers
from .result_page import write_result_page
from .srgb import linear_to_srgb

OPTIONAL = {"error.npy", "error.png", "scores.png", "specular.npy", "specular.png", "turntable.gif"}
"""Files that not every reconstruction has; those of an earlier run into the same folder are removed."""
RECONSTRUCTION_FILES = OPTIONAL | {
    "albedo.npy", "albedo.png", "confidence.npy", "confidence.png", "depth.npy", "mesh.ply", "normal.npy", "normal.png",
    "relight.gif", "report.html", "residual.npy", "residual.png", "result.json", "roughness.npy", "roughness.png",
}  # fmt: skip
"""Files that `write_reconstruction` may write."""
RENDER_FILES = {"depth.npy", "lights.png", "mask.png", "normal.npy", "normal.png", "shaded.png", "sheet.png"}
"""Files that `write_render` may write."""
SHEET_COLUMNS = 6
"""Pictures in a row of a contact sheet of lights, at most; set by hand, for a page's width."""


@dataclass(frozen=True)
class Written:
    """What `write_reconstruction` wrote: the folder and the numbers in its ``result.json``."""

    folder: Path
    numbers: ResultNumbers


def write_reconstruction(
    folder: str | os.PathLike[str], found: Reconstruction, capture: Capture, *, title: str, seconds: float | None = None
) -> Written:
    """Write every result of one capture; the folder's files appear together or not at all.

    ``normal.png`` (16-bit, green up) and ``normal.npy``; ``albedo.png`` (sRGB, scaled to its 99th percentile) and
    ``albedo.npy`` (linear); ``roughness``, ``residual``, ``confidence``, ``specular`` where highlights were
    fitted and, where true normals are known, ``error`` as ``.png`` and ``.npy``; ``depth.npy`` (pixels toward the
    viewer); ``mesh.ply``; ``relight.gif`` and ``turntable.gif``; ``result.json`` (`ResultNumbers`); ``report.html``.
    Depth and mesh of more than 4 million pixels are made at a fraction of the resolution, which ``result.json`` names.

    Args:
        folder: made if need be; files of other names in it stay, and those that others wrote are not overwritten.
        found: an unbatched result for ``capture``.
        capture: what was loaded.
        title: heading of the report.
        seconds: time spent on solving, for the report.

    Returns:
        The folder and the numbers.

    Raises:
        FileError: the place cannot be written, or holds a file of these names that this package did not write.
        ShapeError: ``found`` is a batch.
        MissingPackageError: a package that draws or writes is not installed.
    """
    maps = ResultMaps.of(found, capture)
    numbers = result_numbers(found, capture, maps, title=title, seconds=seconds)
    with results_directory(folder) as temporary:
        for name, array in maps.arrays().items():
            np.save(temporary / f"{name}.npy", array.numpy())
        write_image(temporary / "normal.png", encode_normals(maps.normal, maps.mask), bits=16)
        write_image(temporary / "albedo.png", linear_to_srgb(maps.display_albedo) * maps.mask)
        maps.draw(temporary)
        maps.write_mesh(temporary / "mesh.ply")
        write_relighting(temporary / "relight.gif", found, maps.display_top)
        write_turntable(temporary / "turntable.gif", maps)
        (temporary / "result.json").write_text(json.dumps(numbers, indent=2) + "\n")
        write_result_page(temporary, numbers, maps)
        written = {p.name for p in temporary.iterdir()}
    for name in OPTIONAL - written:
        (Path(folder) / name).unlink(missing_ok=True)
    return Written(Path(folder), numbers)


def write_render(
    folder: str | os.PathLike[str],
    seen: NormalMap,
    pictures: Mapping[str, Tensor],
    lights: Mapping[str, Tensor] | None = None,
) -> None:
    """Write one rendered view: normals, depth, mask, the last picture by itself, and all on a sheet.

    ``normal.png`` (16-bit, green up), ``normal.npy``, ``depth.npy`` (infinite outside the mask),
    ``mask.png``, ``shaded.png`` (sRGB), ``sheet.png``, ``lights.png``; together or not at all.

    Args:
        folder: made if need be; files of other names in it stay, and those that others wrote are not overwritten.
        seen: a `NormalMap` of one view.
        pictures: caption to linear light (1|3, H, W).
        lights: the same for a second sheet, or None.

    Raises:
        FileError: the place cannot be written, or holds a file of these names that this package did not write.
        MissingPackageError: a package that draws or writes is not installed.
    """
    normal, mask = seen.normal[0].detach().cpu(), seen.mask[0].cpu()
    sheet = {"normal": show_normals(normal, mask)} | {name: show_light(p, mask) for name, p in pictures.items()}
    with results_directory(folder) as temporary:
        write_image(temporary / "normal.png", encode_normals(normal, mask), bits=16)
        np.save(temporary / "normal.npy", normal.numpy())
        np.save(temporary / "depth.npy", seen.depth[0].detach().cpu().numpy())
        write_image(temporary / "mask.png", mask.float())
        write_image(temporary / "shaded.png", linear_to_srgb(list(pictures.values())[-1]))
        save_sheet(temporary / "sheet.png", [sheet])
        if lights:
            shown = [(name, show_light(p, mask)) for name, p in lights.items()]
            rows = [dict(shown[k : k + SHEET_COLUMNS]) for k in range(0, len(shown), SHEET_COLUMNS)]
            save_sheet(temporary / "lights.png", rows)
