"""Write reconstructions and renderings as folders of files that people and programs open."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..core.files import atomic_directory, atomic_path
from ..geometry.camera import Camera
from ..geometry.integrate import integrate_normals
from ..geometry.mesh import depth_to_mesh, normalise_mesh, save_mesh
from ..geometry.metrics import angular_error
from ..reconstruction import Reconstruction
from ..render.normal_map import NormalMap, render_normals
from ..shading.layer import OrenNayar
from ..stereo.material import Material
from .capture import Capture
from .figures import crop_to, save_bars, save_maps, save_sheet, show_light, show_normals
from .images import encode_normals, linear_to_srgb, write_animation, write_image
from .report import Section, write_report

OPTIONAL = {"error.npy", "error.png", "scores.png", "specular.npy", "specular.png", "turntable.gif"}
"""Files that not every reconstruction has."""
MAX_DEPTH_PIXELS = 4_000_000


@dataclass(frozen=True)
class Written:
    """What `write_reconstruction` wrote: the folder and the numbers in its ``result.json``."""

    folder: Path
    numbers: dict[str, Any]


def write_reconstruction(
    folder: str | os.PathLike[str], found: Reconstruction, capture: Capture, *, title: str, seconds: float | None = None
) -> Written:
    """Write every result of one capture; the folder's files appear together or not at all.

    ``normal.png`` (16-bit, green up) and ``normal.npy``; ``albedo.png`` (sRGB, stretched) and
    ``albedo.npy`` (linear); ``roughness``, ``residual``, ``confidence``, ``specular`` where highlights were
    fitted and, where truth is known, ``error`` as ``.png`` and ``.npy``; ``depth.npy`` (pixels toward the viewer);
    ``mesh.ply``; ``relight.gif`` and ``turntable.gif``; ``result.json``; ``report.html``.
    Depth and mesh of more than 4 million pixels are made at a fraction of the resolution, which ``result.json`` names.

    Args:
        folder: made if need be; files of other names in it stay.
        found: an unbatched result for ``capture``.
        capture: what was loaded.
        title: heading of the report.
        seconds: time spent on solving, for the report.

    Returns:
        The folder and the numbers.

    Raises:
        FileError: the place cannot be written.
    """
    mask = capture.mask.cpu()
    arrays = {name: getattr(found, name).cpu() for name in ("normal", "albedo", "roughness", "residual", "confidence")}
    depth, step = (found.depth.cpu(), 1) if found.depth is not None else _integrate(arrays["normal"], mask)
    error = None
    if capture.normal is not None:
        error = angular_error(arrays["normal"], capture.normal, mask)
        arrays["error"] = error.as_subclass(torch.Tensor)
    numbers: dict[str, Any] = {
        "title": title,
        "images": len(capture.lights),
        "pixels": int(mask.sum()),
        "model": found.model,
        "scores": found.scores,
        "roughness_degrees": math.degrees(arrays["roughness"].max().item()),
        "roughness_range_degrees": np.percentile(np.degrees(arrays["roughness"][mask].numpy()), (5, 95))
        .round(2)
        .tolist(),
        "roughness_error_degrees": _in_degrees(found.roughness_error),
        "falloff": found.falloff,
        "exponents": list(found.exponents),
        "depth_step": step,
        "normal_error_degrees": None if error is None else error.summary(),
        "seconds": seconds,
        "report": [*capture.notes, *found.report],
    }
    if found.specular is not None:
        arrays["specular"] = found.specular.cpu()
    with atomic_directory(folder) as temporary:
        for name, array in (*arrays.items(), ("depth", depth)):
            np.save(temporary / f"{name}.npy", array.numpy())
        write_image(temporary / "normal.png", encode_normals(arrays["normal"], mask), bits=16)
        stretched, top = _stretch(arrays["albedo"], mask)
        write_image(temporary / "albedo.png", linear_to_srgb(stretched) * mask)
        _draw_maps(temporary, arrays, mask)
        _write_mesh(temporary / "mesh.ply", depth, stretched[:, ::step, ::step], mask[:, ::step, ::step])
        _write_relighting(temporary / "relight.gif", found, top)
        _write_turntable(temporary / "turntable.gif", depth, stretched[:, ::step, ::step], mask[:, ::step, ::step])
        (temporary / "result.json").write_text(json.dumps(numbers, indent=2) + "\n")
        _write_page(temporary, title, numbers, arrays, stretched, top, mask)
        written = {p.name for p in temporary.iterdir()}
    for name in OPTIONAL - written:  # of an earlier run into the same folder
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
        folder: made if need be; files of other names in it stay.
        seen: a `NormalMap` of one view.
        pictures: caption to linear light (1|3, H, W).
        lights: the same for a second sheet, or None.

    Raises:
        FileError: the place cannot be written.
    """
    normal, mask = seen.normal[0].detach().cpu(), seen.mask[0].cpu()
    sheet = {"normal": show_normals(normal, mask)} | {name: show_light(p, mask) for name, p in pictures.items()}
    with atomic_directory(folder) as temporary:
        write_image(temporary / "normal.png", encode_normals(normal, mask), bits=16)
        np.save(temporary / "normal.npy", normal.numpy())
        np.save(temporary / "depth.npy", seen.depth[0].detach().cpu().numpy())
        write_image(temporary / "mask.png", mask.float())
        write_image(temporary / "shaded.png", linear_to_srgb(list(pictures.values())[-1]))
        save_sheet(temporary / "sheet.png", [sheet])
        if lights:
            shown = [(name, show_light(p, mask)) for name, p in lights.items()]
            columns = min(6, len(shown))
            save_sheet(temporary / "lights.png", [dict(shown[k : k + columns]) for k in range(0, len(shown), columns)])


def _say_roughness(numbers: dict[str, Any]) -> str:
    if numbers["model"] == "lambert":
        return "none"
    error = numbers["roughness_error_degrees"]
    least, most = numbers["roughness_range_degrees"]
    one = most - least < 0.1
    return (f"{most:.1f} degrees, " if one else f"{least:.1f} to {most:.1f} degrees, ") + (
        "not told by the photographs" if error is None else f"standard error {error:.1f}"
    )


def _stretch(albedo: Tensor, mask: Tensor) -> tuple[Tensor, float]:
    """Albedo over its 99th percentile, for looking at: the exposure of a capture is seldom known."""
    values = albedo[:, mask[0]].amax(0)
    top = max(values.double().quantile(0.99).item() if values.numel() < 10_000_000 else values.max().item(), 1e-12)
    return (albedo / top).clamp(0, 1), top


def _draw_maps(folder: Path, arrays: dict[str, Tensor], mask: Tensor) -> None:
    save_maps(folder / "roughness.png", {"roughness": arrays["roughness"].rad2deg()}, mask, unit="degrees", top=60)
    save_maps(folder / "residual.png", {"residual": arrays["residual"]}, mask, unit="image units")
    save_maps(
        folder / "confidence.png", {"confidence": arrays["confidence"]}, mask, unit="share", top=1, palette="viridis"
    )
    if "specular" in arrays:
        lobes = {f"highlight {k + 1}": lobe.mean(0, True) for k, lobe in enumerate(arrays["specular"])}
        save_maps(folder / "specular.png", lobes, mask, unit="strength", palette="viridis")
    if "error" in arrays:
        save_maps(folder / "error.png", {"angular error": arrays["error"]}, mask, unit="degrees", top=20)


def _in_degrees(angle: float | tuple[float, ...]) -> float | None:
    """None for infinity, which JSON does not know."""
    return math.degrees(angle) if isinstance(angle, float) and math.isfinite(angle) else None


def _integrate(normal: Tensor, mask: Tensor) -> tuple[Tensor, int]:
    """Height toward the viewer in pixels, and every how many pixels it was taken."""
    step = math.ceil(math.sqrt(max(1.0, int(mask.sum()) / MAX_DEPTH_PIXELS)))
    return integrate_normals(normal[:, ::step, ::step], mask[:, ::step, ::step]) * step, step


def _write_relighting(path: Path, found: Reconstruction, top: float) -> None:
    """The object under a light that goes round it, at a size for looking."""
    step = math.ceil(max(found.normal.shape[1:]) / 320)
    small = replace(
        found,
        **{name: getattr(found, name)[:, ::step, ::step].cpu() for name in ("normal", "albedo", "roughness")},
        specular=None if found.specular is None else found.specular[:, :, ::step, ::step].cpu(),
    )
    mask = (small.normal != 0).any(0, keepdim=True)
    angle = torch.arange(24) * (2 * math.pi / 24)
    lights = torch.stack((angle.sin(), angle.cos(), torch.full_like(angle, 1.2)), 1)
    images = small.shade(torch.nn.functional.normalize(lights, dim=1)) / top
    write_animation(
        path, [show_light(image if len(image) in (1, 3) else image.mean(0, True), mask) for image in images]
    )


def _write_turntable(path: Path, depth: Tensor, albedo: Tensor, mask: Tensor) -> None:
    """The surface as seen from the right, the left and back, at a size for looking; the light stays with the viewer."""
    step = math.ceil(max(mask.shape[1:]) / 160)
    small, kept = depth[:, ::step, ::step].float() / step, mask[:, ::step, ::step]
    vertices, faces, pixels = depth_to_mesh(small, kept)
    if len(faces) == 0:
        return
    vertices = normalise_mesh(vertices)
    colours = albedo[:, ::step, ::step].flatten(1)[:, pixels].T
    layer, light = OrenNayar("lambert"), torch.nn.functional.normalize(torch.tensor([[0.4, 0.5, 1.0]]), dim=1)
    pictures = []
    for k in range(24):
        azimuth = math.radians(50) * math.sin(2 * math.pi * k / 24)
        eye = (3 * math.sin(azimuth), 0.6, 3 * math.cos(azimuth))
        seen = render_normals(vertices, faces, Camera.perspective(math.radians(40), eye), (240, 240))
        at_corners = colours[faces[seen.face[0, 0].clamp_min(0)]]  # (H, W, 3, C)
        tint = torch.einsum("hwkc,khw->chw", at_corners, seen.barycentric[0])[None]
        pictures.append(show_light(seen.shade(layer, light, albedo=tint)[0], seen.mask[0]))
    write_animation(path, pictures)


def write_lights(folder: str | os.PathLike[str], name: str, values: Tensor) -> Path:
    """Write light directions or intensities, a line per light, as `load_capture` reads them."""
    target = Path(folder) / name
    with atomic_path(target) as temporary:
        np.savetxt(temporary, values.cpu().double().numpy(), fmt="%.8f")
    return target


def _write_mesh(path: Path, depth: Tensor, albedo: Tensor, mask: Tensor) -> None:
    vertices, faces, pixels = depth_to_mesh(depth, mask)
    colours = linear_to_srgb(albedo).expand(3, -1, -1).flatten(1)[:, pixels].T
    save_mesh(path, vertices, faces, colours)


def _write_page(
    folder: Path,
    title: str,
    numbers: dict[str, Any],
    arrays: dict[str, Tensor],
    albedo: Tensor,
    albedo_top: float,
    mask: Tensor,
) -> None:
    rows_in, columns_in = crop_to(mask)
    overview = {"normal": show_normals(arrays["normal"], mask), "albedo": show_light(albedo, mask)}
    overview = {name: picture[:, rows_in, columns_in] for name, picture in overview.items()}
    save_sheet(folder / "overview.png", [overview])
    rows = [
        ("model", str(numbers["model"])),
        ("roughness", _say_roughness(numbers)),
        ("falloff at grazing light", "none" if numbers["falloff"] == 1 else f"exponent {numbers['falloff']:.2f}"),
        ("highlights", ", ".join(f"exponent {p}" for p in numbers["exponents"]) or "none"),
        ("images", str(numbers["images"])),
        ("pixels", str(numbers["pixels"])),
    ]
    if numbers["seconds"] is not None:
        rows.append(("seconds to solve", f"{numbers['seconds']:.1f}"))
    error = numbers["normal_error_degrees"]
    if error:
        rows.append(("normal error, mean / median", f"{error['mean']:.2f} / {error['median']:.2f} degrees"))
    sections = [
        Section(
            "Result",
            (*numbers["report"], f"Albedo is drawn over its 99th percentile, {albedo_top:.3g}."),
            ("what", "value"),
            rows,
            (folder / "overview.png",),
        )
    ]
    if numbers["scores"]:
        chosen = Material(
            numbers["model"], minnaert_exponent=numbers["falloff"], exponents=tuple(numbers["exponents"])
        ).name
        save_bars(folder / "scores.png", numbers["scores"], unit="score, share of the mean", highlight=chosen)
        text = (
            "Each candidate was fitted twice, each time without some of the lights. The bars show its error on these, "
            "and a tenth of the angle in radians between the normals of the two fits. The simplest within 2 % of the "
            "best, drawn in colour, was taken.",
        )
        sections.append(Section("Why this model", text, pictures=(folder / "scores.png",)))
    moving = [folder / name for name in ("relight.gif", "turntable.gif") if (folder / name).is_file()]
    sections.append(Section("Under other lights, from other sides", pictures=moving))
    names = ("residual", "confidence", "roughness", *(("specular",) if "specular" in arrays else ()))
    maps = [folder / f"{name}.png" for name in names]
    if "error" in arrays:
        sections.append(Section("Error against the true normals", pictures=(folder / "error.png",)))
    sections.append(Section("Maps", pictures=maps))
    write_report(folder / "report.html", title, sections)
