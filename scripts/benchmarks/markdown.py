"""Tables of results as Markdown for the documentation and as aligned columns for the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

NOTHING = "–"
"""What a cell shows where there is no value."""


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def aligned(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """The same for a terminal: the first column flush left, the others flush right."""
    body = [list(header), *(list(row) for row in rows)]
    widths = [max(len(row[k]) for row in body) for k in range(len(header))]
    return "\n".join(
        "  ".join([row[0].ljust(widths[0]), *(cell.rjust(w) for cell, w in zip(row[1:], widths[1:], strict=True))])
        for row in body
    )


def fixed(value: float | None, decimals: int) -> str:
    """A number with so many decimals."""
    return NOTHING if value is None else f"{value:.{decimals}f}"


def short(value: float | None, digits: int = 2) -> str:
    """A number with so many significant digits and thousands separated, never as a power of ten above 1e-4."""
    if value is None:
        return NOTHING
    if value == 0:
        return "0"
    if abs(value) < 1e-4:
        return f"{value:.{digits - 1}e}"
    decimals = max(0, digits - 1 - int(np.floor(np.log10(abs(value)))))
    return f"{float(f'{value:.{digits}g}'):,.{decimals}f}"


def least_in_bold(values: Sequence[float | None], cells: Sequence[str]) -> list[str]:
    """``cells`` with the one whose value is least in bold."""
    known = [value for value in values if value is not None]
    least = min(known) if known else None
    return [f"**{c}**" if v is not None and v == least else c for v, c in zip(values, cells, strict=True)]


def mean_of(results: Mapping[str, Mapping[str, Mapping[str, Any]]], column: str, key: str) -> float:
    """Mean over the rows of ``results`` of one number of one column."""
    return float(np.mean([row[column][key] for row in results.values()]))
