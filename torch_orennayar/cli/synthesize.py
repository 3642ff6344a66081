"""``orennayar synthesize``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..core.files import check_output
from .options import Output, Seed


def synthesize(
    output: Output = Path("out"),
    count: Annotated[int, typer.Option("-n", "--count", help="Number of captures.", min=1)] = 1000,
    size: Annotated[int, typer.Option(help="Height and width in pixels.", min=8, max=1024)] = 64,
    lights: Annotated[int, typer.Option(help="Photographs of a capture.", min=1, max=1000)] = 4,
    per_shard: Annotated[int, typer.Option("--per-shard", help="Captures of a file.", min=1)] = 1000,
    workers: Annotated[int, typer.Option(help="Processes that make captures; 0: this one.", min=0)] = 0,
    seed: Seed = 0,
) -> None:
    """Synthetic captures with their truth as shards in the format of WebDataset; an interrupted run goes on."""
    from ..io.shards import write_shards
    from ..synthetic.captures import SyntheticCaptures

    check_output(output)
    captures = SyntheticCaptures("images", seed=seed, size=(size, size), lights=(lights, lights))
    shards = write_shards(captures, output, count, per_shard=per_shard, workers=workers)
    total = sum(shard.stat().st_size for shard in shards)
    typer.echo(f"{count} captures in {len(shards)} shards, {total / 1e6:.1f} MB; open {shards[0]} with WebDataset")
