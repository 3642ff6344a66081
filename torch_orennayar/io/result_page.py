"""The page ``report.html`` of one reconstruction."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from ..stereo.material import Material
from .contact_sheet import Thumbnail, contact_markup
from .figures import crop_to, save_bars, show_light, show_normals
from .images import picture_bytes
from .report import Section, write_report
from .result_maps import ResultMaps
from .result_numbers import ResultNumbers
from .srgb import as_rgb
from .verdict import Verdict

PICTURE_SIDE = 640
"""Pixels to which the longer side of the pictures of normals, albedo and depth is thinned, about."""
SHADE_LIGHT = (-0.5, 0.5, 0.71)
"""Toward the light under which the depth is drawn: from the upper left, as maps draw relief."""
CONVENTIONS = (
    ("normals", "x right, y up, z to the camera; normal_gl.png: green up (OpenGL, Blender); normal_dx.png: green down"),
    ("albedo.png", "sRGB; the linear albedo times the exposure below"),
    ("roughness.png", "perceptual roughness of highlights, 0 to 1 (glTF, Unity, Principled BSDF); 1 where matt"),
    ("roughness_sigma.png", "standard deviation of the facets' slope angle (Oren and Nayar's sigma) over 90 degrees"),
    (
        "mesh.glb",
        "relief with textures; metres where a pixel's size is known, else the photographs' longer side is 1",
    ),
    ("height.exr, depth.npy", "the same heights, toward the viewer, in pixels or the unit below"),
    ("mesh.ply", "the relief in that unit, without textures, for measuring"),
)
"""What the files hold."""


@dataclass(frozen=True)
class ResultPage:
    """The page of one result, whose maps are drawn in ``folder`` already.

    Attributes:
        folder: of the results.
        numbers: of ``result.json``.
        maps: of the result.
        viewer: HTML of the viewer, or nothing.
        photographs: small pictures of the photographs.
    """

    folder: Path
    numbers: ResultNumbers
    maps: ResultMaps
    viewer: str
    photographs: Sequence[Thumbnail]

    def write(self, trust: Verdict) -> None:
        """Write ``report.html`` and the chart that only it shows."""
        sections = [Section(trust.title, trust.reasons, kind=trust.word)]
        if self.photographs:
            markup = contact_markup(self.photographs, self.numbers["images"])
            balls = [path for path in (self.folder / "ball.png",) if path.is_file()]
            text = ("Dials show where each light stood: in the middle behind the camera, at the edge grazing.",)
            sections.append(Section("Photographs and lights", text, markup=markup, pictures=balls))
        sections.append(Section("Surface", markup=self._surface()))
        if self.viewer:
            sections.append(Section("Under another light, from another side", markup=self.viewer))
        if self.numbers["scores"]:
            sections.append(self._choice())
        names = ("error", "residual", "confidence", "material_map", "roughness_map", "specular")
        maps = [path for path in (self.folder / f"{name}.png" for name in names) if path.is_file()]
        sections += [
            Section("Maps", pictures=maps),
            self._numbers(),
            Section("Files", (), ("file", "holds"), CONVENTIONS),
        ]
        write_report(self.folder / "report.html", self.numbers["title"], sections)

    def _surface(self) -> str:
        rows, columns = crop_to(self.maps.mask)
        step = self.maps.step
        thin_rows = slice(rows.start // step, -(-rows.stop // step))
        thin_columns = slice(columns.start // step, -(-columns.stop // step))
        shown = {
            "normals: red right, green up, blue to the camera": show_normals(self.maps.normal, self.maps.mask)[
                :, rows, columns
            ],
            "albedo": show_light(as_rgb(self.maps.display_albedo), self.maps.mask)[:, rows, columns],
            "depth, as a relief lit from the upper left": _relief(self.maps)[:, thin_rows, thin_columns],
        }
        figures = "".join(
            f'<figure><img alt="" src="data:image/png;base64,{_png(picture)}"><figcaption>{name}</figcaption></figure>'
            for name, picture in shown.items()
        )
        return f'<div class="pictures">{figures}</div>'

    def _choice(self) -> Section:
        numbers = self.numbers
        chosen = Material(
            numbers["model"], minnaert_exponent=numbers["falloff"], exponents=tuple(numbers["exponents"])
        ).name
        unit = "score, share of the mean"
        picture = save_bars(self.folder / "scores.png", numbers["scores"], unit=unit, highlight=chosen)
        text = (
            "Each candidate was fitted twice, each time without some of the lights. The bars show its error on these, "
            "plus a tenth of the angle in radians between the normals of the two fits. The simplest candidate within "
            "2 % of the best was chosen; it is drawn in colour.",
        )
        return Section("Why this model", text, pictures=(picture,))

    def _numbers(self) -> Section:
        numbers = self.numbers
        unit = numbers["height_unit"]
        rows = [
            ("model", numbers["model"]),
            ("roughness", _roughness_text(numbers)),
            ("falloff at grazing light", "none" if numbers["falloff"] == 1 else f"exponent {numbers['falloff']:.2f}"),
            ("highlights", ", ".join(f"exponent {p}" for p in numbers["exponents"]) or "none"),
            ("images", str(numbers["images"])),
            ("pixels", str(numbers["pixels"])),
            ("exposure of albedo.png", f"{numbers['albedo_exposure']:.4g}"),
            ("unit of height.exr and mesh.ply", unit),
        ]
        if numbers["pixel_mm"] is not None:
            rows.append(("size of a pixel", f"{numbers['pixel_mm']:.4g} mm"))
        if numbers["seconds"] is not None:
            rows.append(("seconds to solve", f"{numbers['seconds']:.1f}"))
        error = numbers["normal_error_degrees"]
        if error:
            rows.append(("normal error, mean / median", f"{error['mean']:.2f} / {error['median']:.2f} degrees"))
        return Section("Numbers and findings", tuple(numbers["report"]), ("what", "value"), rows)


def _relief(maps: ResultMaps) -> Tensor:
    """The depth (3, h, w) under one light."""
    mask = maps.mask[:, :: maps.step, :: maps.step]
    right = torch.gradient(maps.depth[0].float(), dim=1)[0] if maps.depth.shape[2] > 1 else maps.depth[0] * 0
    down = torch.gradient(maps.depth[0].float(), dim=0)[0] if maps.depth.shape[1] > 1 else maps.depth[0] * 0
    slope = torch.stack((-right, down, torch.full_like(right, float(maps.step))))
    toward = slope.new_tensor(SHADE_LIGHT).reshape(3, 1, 1)
    shade = (torch.nn.functional.normalize(slope, dim=0) * toward).sum(0, keepdim=True).clamp_min(0)
    return show_light(shade, mask)


def _png(picture: Tensor) -> str:
    step = max(1, max(picture.shape[1:]) // PICTURE_SIDE)
    return base64.b64encode(picture_bytes(picture[:, ::step, ::step], ".png")).decode()


def _roughness_text(numbers: ResultNumbers) -> str:
    if numbers["model"] == "lambert":
        return "none"
    least, most = numbers["roughness_range_degrees"]
    angle = f"{most:.1f} degrees" if most - least < 0.1 else f"{least:.1f} to {most:.1f} degrees"
    error = numbers["roughness_error_degrees"]
    return f"{angle}, not determined by the photographs" if error is None else f"{angle}, standard error {error:.1f}"
