"""Tables on the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ..core.optional import require


def print_table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table on stdout, as wide as the terminal at most."""
    require("rich")
    from rich.console import Console
    from rich.table import Table

    table = Table(*columns)
    for row in rows:
        table.add_row(*row)
    Console(highlight=False, soft_wrap=True).print(table)
