"""``orennayar demo``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..core.files import check_output
from .options import Output, Seed


def demo(
    output: Output = Path("out"),
    size: Annotated[int, typer.Option(help="Height and width of the pictures in pixels.", min=32, max=1024)] = 256,
    seed: Seed = 0,
) -> None:
    """Render a rough object, recover it from the pictures, and write a report."""
    from ..demo import run_demo
    from .tables import print_table

    check_output(output)
    numbers = run_demo(output, size=size, seed=seed)
    print_table(
        ("solved with", "normal error, mean", "roughness (truth 30)", "albedo error"),
        [
            (
                name if name != "auto" else f"auto: {n['model']}",
                f"{n['normal_error_degrees']['mean']:.2f} degrees",
                f"{n['roughness_degrees']:.1f} degrees",
                f"{n['albedo_error_share']:.1%}",
            )
            for name, n in numbers.items()
        ],
    )
    typer.echo(f"open {output / 'report.html'}")
