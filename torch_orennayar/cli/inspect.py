"""``orennayar inspect``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..core.files import check_output
from .options import ChromeFolder, EncodingOption, LightFile, MaskFile, Output

FILES = {"inspection.html", "ball.png", "object_mask.png", "outline.png"}
"""Files that the command may write."""


def inspect(
    capture: Annotated[Path, typer.Argument(help="Folder of images, with or without a light file, or .lp file.")],
    output: Output = Path("out"),
    lights: LightFile = None,
    mask: MaskFile = None,
    chrome: ChromeFolder = None,
    encoding: EncodingOption = "auto",
) -> None:
    """What a folder holds and how it is understood, as a table and a contact sheet, before anything is solved."""
    from ..core.files import results_directory
    from ..io.contact_sheet import contact_markup
    from ..io.images import write_image
    from ..io.inspection import inspect_folder
    from ..io.report import Section, write_report
    from .tables import print_table

    check_output(output, FILES)
    seen = inspect_folder(capture, encoding, lights=lights, mask=mask, chrome=chrome)
    with results_directory(output) as folder:
        pictures = {"outline.png": seen.mask_picture, "ball.png": seen.ball_picture}
        for name, picture in pictures.items():
            if picture is not None:
                write_image(folder / name, picture)
        if seen.mask is not None:
            write_image(folder / "object_mask.png", seen.mask.float())
        drawn = [folder / name for name, picture in pictures.items() if picture is not None]
        sections = (
            Section("What was understood", seen.findings, ("what", "found"), seen.rows),
            Section("Photographs", markup=contact_markup(seen.shown, seen.count), pictures=drawn),
        )
        write_report(folder / "inspection.html", capture.resolve().name, sections)
    print_table(("what", "found"), seen.rows)
    for finding in seen.findings:
        typer.echo(finding)
    if seen.mask is not None:
        typer.echo(f"edit {output / 'object_mask.png'} and give it as --mask where it is not the object")
    typer.echo(f"open {output / 'inspection.html'}")
