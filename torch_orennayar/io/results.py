"""Write reconstructions and renderings as folders of files that people and programs open."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from torch import Tensor

from ..core.files import results_directory
from ..reconstruction import Reconstruction
from ..render.normal_map import NormalMap
from .capture import Capture
from .contact_sheet import Thumbnail, thumbnails
from .figures import save_sheet, show_light, show_normals
from .images import encode_normals, write_image
from .result_animations import write_relighting, write_turntable
from .result_maps import ResultMaps
from .result_numbers import ResultNumbers, result_numbers
from .result_page import ResultPage
from .result_viewer import viewer_markup
from .srgb import linear_to_srgb
from .textured_mesh import write_glb
from .textures import perceptual_roughness, write_textures
from .verdict import verdict

OPTIONAL = {
    "ball.png", "error.npy", "error.png", "material.npy", "material_map.png", "relight.gif", "report.html",
    "roughness_map.png", "scores.png", "specular.npy", "specular.png", "turntable.gif",
}  # fmt: skip
"""Files that not every reconstruction has; those of an earlier run into the same folder are removed."""
RECONSTRUCTION_FILES = OPTIONAL | {
    "albedo.npy", "albedo.png", "confidence.npy", "confidence.png", "depth.npy", "height.exr", "mesh.glb",
    "mesh.ply", "normal.exr", "normal.npy", "normal.png", "normal_dx.png", "normal_gl.png", "object_mask.png",
    "residual.npy", "residual.png", "result.json", "roughness.npy", "roughness.png", "roughness_sigma.png",
}  # fmt: skip
"""Files that `write_reconstruction` may write."""
RENDER_FILES = {"depth.npy", "lights.png", "mask.png", "normal.npy", "normal.png", "shaded.png", "sheet.png"}
"""Files that `write_render` may write."""
SHEET_COLUMNS = 6
"""Pictures in a row of a contact sheet of lights, at most; set by hand, for a page's width."""


@dataclass(frozen=True)
class Written:
    """What `write_reconstruction` wrote.

    Attributes:
        numbers: the content of ``result.json``.
        seconds: what each step took, by its name.
    """

    numbers: ResultNumbers
    seconds: dict[str, float]


def write_reconstruction(
    folder: str | os.PathLike[str],
    found: Reconstruction,
    capture: Capture,
    *,
    title: str,
    seconds: float | None = None,
    pixel_mm: float | None = None,
    shown: Sequence[Thumbnail] | None = None,
    report: bool = True,
    animation: bool = True,
) -> Written:
    """Write every result of one capture: first what programs read, then what people look at, each together or not.

    The maps as ``.npy`` (`ResultMaps.arrays`: normals, linear albedo, roughness in radians, residual, confidence, depth
    in pixels toward the viewer, and highlights, materials and true error where there are any), `write_textures`,
    ``mesh.glb`` (`write_glb`), ``mesh.ply`` for measuring, ``result.json`` (`ResultNumbers`). Then figures with scales,
    ``report.html``, ``relight.gif`` and ``turntable.gif``, and ``ball.png`` where lights come from a ball. Depth and
    mesh of more than 4 million pixels are made at a fraction of the resolution, which ``result.json`` names.

    Args:
        folder: made if need be; files of other names in it stay, and those that others wrote are not overwritten.
        found: an unbatched result for ``capture``.
        capture: what was loaded.
        title: heading of the report.
        seconds: time spent on solving, for the report.
        pixel_mm: size of a pixel of the object in millimetres, where it is known.
        shown: small pictures of the photographs; default: made from ``capture``.
        report: write figures and ``report.html``.
        animation: write ``relight.gif`` and ``turntable.gif``.

    Returns:
        The numbers and the seconds.

    Raises:
        FileError: the place cannot be written, or holds a file of these names that this package did not write.
        ShapeError: ``found`` is a batch.
        MissingPackageError: a package that draws or writes is not installed.
    """
    taken, clock = dict[str, float](), time.perf_counter()

    def step(name: str) -> None:
        nonlocal clock
        taken[name], clock = time.perf_counter() - clock, time.perf_counter()

    maps = ResultMaps.of(found, capture)
    step("integrating")
    trust = verdict((*capture.notes, *found.report), maps)
    numbers = result_numbers(found, capture, maps, title=title, trust=trust, seconds=seconds, pixel_mm=pixel_mm)
    with results_directory(folder) as temporary:
        _write_data(temporary, found, maps, pixel_mm)
        (temporary / "result.json").write_text(json.dumps(numbers, indent=2) + "\n")
        written = {p.name for p in temporary.iterdir()}
    step("writing maps and meshes")
    with results_directory(folder) as temporary:
        if report:
            photographs = thumbnails(capture, found.lights) if shown is None else shown
            if capture.ball_picture is not None:
                write_image(temporary / "ball.png", capture.ball_picture)
            maps.draw(temporary)
            ResultPage(temporary, numbers, maps, viewer_markup(found, maps), photographs).write(trust)
            step("drawing the report")
        if animation:
            write_relighting(temporary / "relight.gif", found, maps.display_top)
            write_turntable(temporary / "turntable.gif", maps)
            step("animations")
        written |= {p.name for p in temporary.iterdir()}
    for name in OPTIONAL - written:
        (Path(folder) / name).unlink(missing_ok=True)
    return Written(numbers, taken)


def _write_data(folder: Path, found: Reconstruction, maps: ResultMaps, pixel_mm: float | None) -> None:
    """What programs read."""
    for name, array in maps.arrays().items():
        np.save(folder / f"{name}.npy", array.numpy())
    write_textures(folder, maps, found.exponents, pixel_mm or 1.0)
    maps.write_mesh(folder / "mesh.ply", pixel_mm or 1.0)
    write_glb(folder / "mesh.glb", maps, perceptual_roughness(maps, found.exponents), pixel_mm)


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
