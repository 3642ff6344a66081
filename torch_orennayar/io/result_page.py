"""The page ``report.html`` of one reconstruction."""

from __future__ import annotations

from pathlib import Path

from ..stereo.material import Material
from .figures import crop_to, save_bars, save_sheet, show_light, show_normals
from .report import Section, write_report
from .result_maps import ResultMaps
from .result_numbers import ResultNumbers


def write_result_page(folder: Path, numbers: ResultNumbers, maps: ResultMaps) -> None:
    """Write ``report.html`` and the pictures that only it shows; the maps are drawn in ``folder`` already."""
    sections = [_result(folder, numbers, maps)]
    if numbers["scores"]:
        sections.append(_choice(folder, numbers))
    moving = [folder / name for name in ("relight.gif", "turntable.gif") if (folder / name).is_file()]
    sections.append(Section("Under other lights, from other sides", pictures=moving))
    if maps.error is not None:
        sections.append(Section("Error against the true normals", pictures=(folder / "error.png",)))
    names = ("residual", "confidence", "roughness", *(("specular",) if maps.specular is not None else ()))
    sections.append(Section("Maps", pictures=[folder / f"{name}.png" for name in names]))
    write_report(folder / "report.html", numbers["title"], sections)


def _result(folder: Path, numbers: ResultNumbers, maps: ResultMaps) -> Section:
    rows_in, columns_in = crop_to(maps.mask)
    overview = {
        "normal": show_normals(maps.normal, maps.mask),
        "albedo": show_light(maps.display_albedo, maps.mask),
    }
    picture = save_sheet(
        folder / "overview.png", [{name: shown[:, rows_in, columns_in] for name, shown in overview.items()}]
    )
    rows = [
        ("model", numbers["model"]),
        ("roughness", _roughness_text(numbers)),
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
    text = (*numbers["report"], f"Albedo is drawn over its 99th percentile, {maps.display_top:.3g}.")
    return Section("Result", text, ("what", "value"), rows, (picture,))


def _choice(folder: Path, numbers: ResultNumbers) -> Section:
    chosen = Material(
        numbers["model"], minnaert_exponent=numbers["falloff"], exponents=tuple(numbers["exponents"])
    ).name
    unit = "score, share of the mean"
    picture = save_bars(folder / "scores.png", numbers["scores"], unit=unit, highlight=chosen)
    text = (
        "Each candidate was fitted twice, each time without some of the lights. The bars show its error on these, "
        "plus a tenth of the angle in radians between the normals of the two fits. The simplest candidate within 2 % "
        "of the best was chosen; it is drawn in colour.",
    )
    return Section("Why this model", text, pictures=(picture,))


def _roughness_text(numbers: ResultNumbers) -> str:
    if numbers["model"] == "lambert":
        return "none"
    least, most = numbers["roughness_range_degrees"]
    angle = f"{most:.1f} degrees" if most - least < 0.1 else f"{least:.1f} to {most:.1f} degrees"
    error = numbers["roughness_error_degrees"]
    return f"{angle}, not determined by the photographs" if error is None else f"{angle}, standard error {error:.1f}"
