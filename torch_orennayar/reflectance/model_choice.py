"""Choice of the cheapest reflectance model whose measured error stays below a tolerance."""

from __future__ import annotations

import itertools
import json
import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from torch import Tensor

from ..core.checks import check_range
from ..core.errors import ModelError, RangeError
from .models import MODELS

Range = float | tuple[float, float] | Tensor
TABLE = Path(__file__).with_name("model_errors.json")
"""Written by ``scripts/fit/tabulate_errors.py``: RMS error per model, roughness, albedo and largest angle."""


class ModelChoice(str):
    """The name of the chosen model, accepted wherever a name is, with the reasons for the choice.

    Attributes:
        error: its largest RMS error over the given ranges of roughness and albedo.
        cost: its eager forward time relative to ``lambert``.
        reason: sentences that explain the choice and state error and cost of the next more accurate model.
        candidates: every model's error over the ranges, cheapest first.

    Example:
        >>> import torch_orennayar as ton
        >>> choice = ton.simplest_model(roughness=0.3, albedo=0.5, tolerance=0.05)
        >>> choice.name, choice.candidates[choice] <= 0.05, ton.OrenNayar(choice)
        ('qualitative', True, OrenNayar(model='qualitative', dim=1))
    """

    error: float
    cost: float
    reason: str
    candidates: Mapping[str, float]

    def __new__(cls, name: str, error: float, cost: float, reason: str, candidates: Mapping[str, float]) -> ModelChoice:
        """A string with attributes."""
        choice = super().__new__(cls, name)
        choice.error, choice.cost, choice.reason = error, cost, reason
        choice.candidates = MappingProxyType(dict(candidates))
        return choice

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle and copy with all attributes; a read-only mapping alone cannot be pickled."""
        return ModelChoice, (str(self), self.error, self.cost, self.reason, dict(self.candidates))

    @property
    def name(self) -> str:
        """The name as a plain string."""
        return str(self)


def simplest_model(
    *,
    roughness: Range = (0.0, math.pi / 3),
    albedo: Range = (0.0, 1.0),
    angles: float = math.pi / 2,
    tolerance: float = 0.01,
) -> ModelChoice:
    """The cheapest model whose error against the V-cavity theory is at most ``tolerance``.

    The error is that of a pixel's shading divided by its albedo (a white surface facing the light has 1), RMS over
    pairs of light and view that are cosine-weighted up to ``angles`` from the normal, and the largest over the ranges
    of roughness and albedo. It is interpolated linearly in a table of measurements that comes with the package
    (``scripts/fit/tabulate_errors.py``). A registered model is considered if ``register_model`` was given its
    ``error`` and ``cost``.

    Args:
        roughness: radians in [0, pi/2]: a number, ``(low, high)``, or a tensor, whose minimum and maximum are used.
        albedo: the same, in [0, 1].
        angles: largest angle between normal and light or view in the scene, radians in (0, pi/2].
        tolerance: largest RMS error accepted, > 0.

    Returns:
        A `ModelChoice`: the name of the model, a string with its error, cost and the reason as attributes.

    Raises:
        RangeError: roughness, albedo, angles or tolerance out of range, or ``low > high``.
        ModelError: no model is within ``tolerance``.

    Example:
        >>> import torch_orennayar as ton
        >>> choice = ton.simplest_model(roughness=0.0, albedo=0.5, tolerance=0.001)
        >>> choice, choice.error
        ('lambert', 0.0)
        >>> str(ton.simplest_model(roughness=(0.0, 0.9), albedo=(0.1, 0.9), tolerance=0.01))
        'vcavity'
    """
    sigmas, rhos = _ends("roughness", roughness, math.pi / 2), _ends("albedo", albedo, 1.0)
    check_range("angles", angles, 1e-3, math.pi / 2 + 1e-6, "it is in radians")
    check_range("tolerance", tolerance, 1e-9, math.inf, "it is an RMS error of shading over albedo")
    table = _table()
    nodes = [[math.radians(s) for s in table["roughness_degrees"]], table["albedo"]]
    corners = list(itertools.product(*(_within(*ends, grid) for ends, grid in zip((sigmas, rhos), nodes, strict=True))))
    grids = (*nodes, [math.radians(a) for a in table["angle_degrees"]])
    errors = {}
    for name, model in sorted(MODELS.items(), key=lambda item: item[1].cost or math.inf):
        if name in table["rms"]:
            errors[name] = max(_interpolate(table["rms"][name], grids, (*corner, angles)) for corner in corners)
        elif model.error is not None and model.cost is not None:
            errors[name] = model.error
    sufficient = [name for name, error in errors.items() if error <= tolerance]
    if not sufficient:
        nearest = min(errors, key=lambda name: errors[name])
        raise ModelError(
            "tolerance",
            expected=f"at least {errors[nearest]:.2g}, the error of {nearest} over this range",
            got=f"{tolerance:g}",
            mend="allow more, or narrow the range of roughness, albedo or angles",
        )
    name = sufficient[0]
    scene = (
        f"roughness {_degrees(sigmas)}, albedo {_span(rhos)}, light and view up to {math.degrees(angles):.0f} degrees "
        "from the normal"
    )
    return ModelChoice(name, errors[name], _cost(name), _reason(name, errors, scene, tolerance), errors)


def _reason(name: str, errors: Mapping[str, float], scene: str, tolerance: float) -> str:
    """Sentences about the choice and its alternatives."""
    cheaper = [f"{n} ({errors[n]:.2g})" for n in errors if _cost(n) < _cost(name)]
    better = [n for n in errors if errors[n] < errors[name] and _cost(n) > _cost(name)]
    lines = [f"{name} errs by {errors[name]:.2g} RMS over {scene}; {tolerance:g} is allowed."]
    if cheaper:
        lines.append(f"Cheaper but not accurate enough: {', '.join(cheaper)}.")
    if better:
        up = better[0]
        lines.append(
            f"The next one up, {up}, errs by {errors[up]:.2g} at {_cost(up) / _cost(name):.3g} times the cost."
        )
    else:
        lines.append("No more expensive model is more accurate.")
    return " ".join(lines)


def _cost(name: str) -> float:
    """Relative cost; infinite where it was not measured."""
    return MODELS[name].cost or math.inf


@cache
def _table() -> dict[str, Any]:
    """The measured errors: node lists by axis, and nested lists by model."""
    table: dict[str, Any] = json.loads(TABLE.read_text(encoding="utf-8"))
    return table


def _ends(argument: str, value: Range, high: float) -> tuple[float, float]:
    """Minimum and maximum of a number, a pair or a tensor, checked."""
    if isinstance(value, Tensor):
        ends = (float(value.min()), float(value.max())) if value.numel() else (0.0, 0.0)
    elif isinstance(value, Sequence):
        if len(value) != 2:
            raise RangeError(argument, expected="a pair (low, high)", got=repr(value), mend="give its two ends")
        ends = (float(value[0]), float(value[1]))
    else:
        ends = (float(value), float(value))
    for end in ends:
        check_range(argument, end, 0.0, high + 1e-6, "roughness is in radians, albedo in [0, 1]")
    if ends[0] > ends[1]:
        raise RangeError(argument, expected="low <= high", got=repr(value), mend="give the lower end first")
    return ends


def _within(low: float, high: float, grid: Sequence[float]) -> list[float]:
    """The ends and the grid's nodes between them: a function linear between nodes has its maximum on one."""
    return sorted({low, high, *(node for node in grid if low < node < high)})


def _interpolate(values: Any, grids: Sequence[Sequence[float]], point: Sequence[float]) -> float:
    """Multilinear interpolation in nested lists, constant beyond the ends of the grids."""
    if not grids:
        return float(values)
    grid, at = grids[0], min(max(point[0], grids[0][0]), grids[0][-1])
    index = min(bisect_right(grid, at), len(grid) - 1) - 1
    share = (at - grid[index]) / (grid[index + 1] - grid[index])
    low = _interpolate(values[index], grids[1:], point[1:])
    return low + share * (_interpolate(values[index + 1], grids[1:], point[1:]) - low) if share else low


def _span(ends: tuple[float, float]) -> str:
    return f"{ends[0]:.2g}" if ends[0] == ends[1] else f"{ends[0]:.2g} to {ends[1]:.2g}"


def _degrees(ends: tuple[float, float]) -> str:
    low, high = (math.degrees(e) for e in ends)
    return f"{low:.0f} degrees" if low == high else f"{low:.0f} to {high:.0f} degrees"
