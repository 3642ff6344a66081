"""``orennayar batch``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from ..core.errors import FileError, TorchOrenNayarError
from .options import Output, StereoModel

COLUMNS = ("capture", "images", "model", "verdict", "seconds")


def batch(
    captures: Annotated[list[Path], typer.Argument(help="Folders, or text files that list folders, one per line.")],
    output: Output = Path("out"),
    model: Annotated[StereoModel, typer.Option(help="Reflectance model, or network; auto chooses.")] = "auto",
    report: Annotated[bool, typer.Option(" /--no-report", help="Write no figures and no report.html.")] = True,
    again: Annotated[bool, typer.Option("--again", help="Solve captures that have a result, too.")] = False,
) -> None:
    """Many captures, each into a folder of its own name; one that fails is named and the rest go on."""
    from .stereo import stereo
    from .tables import print_table

    folders = _folders(captures)
    rows, failed = [], 0
    for folder, name in folders.items():
        place = output / name
        typer.echo(f"{folder}")
        try:
            if again or not (place / "result.json").is_file():
                stereo(folder, place, model, report=report, animation=False)
            else:
                typer.echo("  has a result; --again solves it again")
            rows.append(_row(place, name))
        except (TorchOrenNayarError, MemoryError) as error:
            failed += 1
            typer.echo(f"  failed: {error}")
            rows.append((name, "", "", "failed", ""))
    print_table(COLUMNS, rows)
    if failed:
        raise typer.Exit(1)


def _folders(captures: list[Path]) -> dict[Path, str]:
    """Every folder once, and the name of its results: its own, with that of its parent where two are alike.

    Raises:
        FileError: a name that is neither folder nor list, or no folder at all.
    """
    found: list[Path] = []
    for entry in captures:
        if entry.is_dir() or entry.suffix.lower() == ".lp":
            found.append(entry)
        elif entry.is_file():
            lines = (line.strip() for line in entry.read_text(encoding="utf-8").splitlines())
            found += [entry.parent / line for line in lines if line and not line.startswith("#")]
        else:
            raise FileError(
                str(entry), expected="a folder, or a file that lists folders", got="nothing", mend="check it"
            )
    if not found:
        raise FileError("captures", expected="at least one folder", got="an empty list", mend="name folders")
    names: dict[Path, str] = {}
    for folder in dict.fromkeys(f.resolve() for f in found):
        name = folder.stem
        names[folder] = f"{folder.parent.name}-{name}" if name in names.values() else name
        while list(names.values()).count(names[folder]) > 1:
            names[folder] += "-2"
    return names


def _row(place: Path, name: str) -> tuple[str, ...]:
    numbers = json.loads((place / "result.json").read_text(encoding="utf-8"))
    seconds = numbers["seconds"]
    return (
        name,
        str(numbers["images"]),
        numbers["model"],
        numbers["verdict"],
        "" if seconds is None else f"{seconds:.1f}",
    )
