"""The `typer` application: every command with its example, ``--version``, and how mistakes in choices are reported."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Annotated

import typer
from typer.core import TyperCommand

from .._version import __version__
from ..core.errors import RangeError
from .batch import batch
from .calibrate import calibrate
from .demo import demo
from .export import export
from .info import info
from .inspect import inspect
from .options import join_vectors
from .render import render
from .shape import shape
from .stereo import stereo
from .synthesize import synthesize

COMMANDS: tuple[tuple[Callable[..., None], str], ...] = (
    (demo, "demo --size 128 -o out"),
    (render, "render bunny.obj --roughness 40 --light 0.3,0.4,0.86 --turntable bunny.gif"),
    (stereo, "stereo photographs --mask mask.png -o out"),
    (inspect, "inspect photographs -o out"),
    (batch, "batch monday/* tuesday/* -o results"),
    (synthesize, "synthesize -n 100000 --workers 8 -o shards"),
    (shape, "shape photo.png --light 0.3,0.4,0.86 --mask mask.png -o out"),
    (calibrate, "calibrate chrome ball --circle 310,245,120 -o photographs"),
    (export, "export renderer.onnx --graph renderer --size 256 --elevation 20"),
    (info, "info shading.onnx"),
)
"""Every command, in the order of the help, and the example that ends its help."""


class Command(TyperCommand):
    """A command whose vectors may be written with spaces, and which reports a wrong choice as one line."""

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]
        """Parse ``args``.

        Raises:
            RangeError: a value that is not one of an option's choices.
        """
        try:
            return super().parse_args(ctx, join_vectors(args))
        except typer.BadParameter as mistake:
            wrong = re.search(r"'(.*?)' is not one of (.*'(?=\.?$))", mistake.message)
            if wrong is None or mistake.param is None:
                raise
            choices = [word.strip("' ") for word in wrong[2].split(",")]
            raise RangeError(
                mistake.param.opts[0] if mistake.param.opts[0].startswith("-") else mistake.param.opts[0].upper(),
                expected=f"one of {', '.join(choices[:-1])} or {choices[-1]}",
                got=wrong[1],
                mend="choose one",
            ) from mistake


app = typer.Typer(
    help="Rough surfaces: shading, rendering, photometric stereo, shape from shading, ONNX export. Angles are degrees.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for _function, _example in COMMANDS:
    # \b keeps the line whole in the wrapped help.
    app.command(cls=Command, epilog=f"\b\nExample:\n  orennayar {_example}")(_function)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def _options_of_all(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version and exit.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """Options that stand before the command."""
