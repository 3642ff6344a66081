"""Edge cases in which shading formulas fail, and the verdict on an implementation in one of them.

``stability.py`` makes a map of all verdicts; the tests require that this package is right in every case.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from torch_orennayar import TorchOrenNayarError, oren_nayar

Shade = Callable[[Tensor, Tensor, Tensor, Tensor, Tensor], Tensor]
FORMATS = (torch.float64, torch.float32, torch.bfloat16, torch.float16)
"""Number formats that are judged."""
ALLOWED = {torch.float64: 1e-9, torch.float32: 1e-4, torch.bfloat16: 1.6e-2, torch.float16: 2e-3}
"""Largest error that counts as right. Of half precision two units in the last place; of float32 what 0.1 degrees above
the horizon leaves, where a cosine of 0.0017 has a rounding error of 6e-8 and so a slope one of 4e-5."""


@dataclass(frozen=True)
class EdgeCase:
    """Pixels to shade, float64.

    Attributes:
        name: title of the row in the map.
        group: ``"geometry"``, ``"parameters"`` or ``"bad data"``.
        normal: (N, 3), as ``light`` and ``view``.
        light: unit, from surface to light.
        view: unit, from surface to camera.
        albedo: (N, 1).
        roughness: (N, 1), radians.
        dark: (N,) pixels that must be 0 with gradients 0, whatever their inputs.
        mistake: a call that should be refused.
        edge: at the kink of ``max(0, n.l)``, where any finite gradient is one of its sides.
    """

    name: str
    group: str
    normal: Tensor
    light: Tensor
    view: Tensor
    albedo: Tensor
    roughness: Tensor
    dark: Tensor
    mistake: bool = False
    edge: bool = False


@dataclass(frozen=True)
class Verdict:
    """What an implementation does in an edge case.

    Attributes:
        kind: ``"right"``, ``"wrong"`` (finite), ``"not finite"`` or ``"refused"``.
        error: largest difference from float64; of gradients, over 1 + their size.
    """

    kind: str
    error: float = math.nan


def tilted(degrees: float, azimuth: float = 0.0) -> list[float]:
    """The unit vector at an angle from +z; exact at 0 and 90 degrees."""
    t, a = math.radians(degrees), math.radians(azimuth)
    s, c = (1.0, 0.0) if degrees == 90 else (math.sin(t), math.cos(t))
    return [s * math.cos(a), s * math.sin(a), c]


def make(name: str, group: str, pairs: list[tuple[list[float], list[float]]], **changes: object) -> EdgeCase:
    """An edge case from pairs of light and view about the normal +z, at albedo 0.7 and three roughnesses."""
    light, view = (torch.tensor(d, dtype=torch.float64).repeat(3, 1) for d in zip(*pairs, strict=True))
    count = len(light)
    fields: dict[str, object] = {
        "normal": torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64).repeat(count, 1),
        "light": light,
        "view": view,
        "albedo": torch.full((count, 1), 0.7, dtype=torch.float64),
        "roughness": torch.tensor([0.2, 0.5, 1.0], dtype=torch.float64).repeat_interleave(count // 3)[:, None],
        "dark": torch.zeros(count, dtype=torch.bool),
    }
    for key, value in changes.items():
        fields[key] = value(fields) if callable(value) else value
    return EdgeCase(name, group, **fields)  # type: ignore[arg-type]


def edge_cases() -> list[EdgeCase]:
    """All edge cases."""
    usual = [(tilted(40, 20), tilted(25, 80)), (tilted(60, -30), tilted(50, 150)), (tilted(15, 200), tilted(70, 10))]
    hair = math.degrees(1e-4)

    def constant(name: str, value: float) -> Callable[[dict[str, Tensor]], Tensor]:
        return lambda f: torch.full_like(f[name], value)

    def first_normal(*numbers: float) -> Callable[[dict[str, Tensor]], Tensor]:
        return lambda f: torch.cat((torch.tensor([numbers], dtype=torch.float64), f["normal"][1:]))

    def first(f: dict[str, Tensor]) -> Tensor:
        return torch.arange(len(f["dark"])) == 0

    def every(f: dict[str, Tensor]) -> Tensor:
        return torch.ones_like(f["dark"])

    nan, inf = math.nan, math.inf
    low, beyond = tilted(100, 30), tilted(90, 120)
    g, p, b = "geometry", "parameters", "bad data"
    return [
        make("usual directions", g, usual),
        make("light along the normal", g, [(tilted(0), tilted(35, 70))]),
        make("view along the normal", g, [(tilted(35, 70), tilted(0))]),
        make("light = view = normal", g, [(tilted(0), tilted(0))]),
        make("light = view, oblique", g, [(tilted(50, 20), tilted(50, 20)), (tilted(89, 20), tilted(89, 20))]),
        make("both 1e-4 rad from the normal", g, [(tilted(hair, 20), tilted(hair, 130))]),
        make("light 1e-4 rad from the normal", g, [(tilted(hair, 20), tilted(50, 130))]),
        make("light at the horizon", g, [(tilted(90), tilted(30, 40))], dark=every, edge=True),
        make("view at the horizon", g, [(tilted(30, 40), tilted(90))], dark=every),
        make("both at the horizon", g, [(tilted(90), tilted(90)), (tilted(90), beyond)], dark=every, edge=True),
        make("light 0.1 degrees above it", g, [(tilted(89.9), tilted(30, 40)), (tilted(89.9), tilted(80, 170))]),
        make("both 0.1 degrees above it", g, [(tilted(89.9), tilted(89.9)), (tilted(89.9), tilted(89.9, 180))]),
        make("light below", g, [(low, tilted(30, 40))], dark=every),
        make("view below", g, [(tilted(30, 40), low)], dark=every),
        make("both below", g, [(low, low)], dark=every),
        make("roughness 0", p, usual, roughness=constant("roughness", 0.0)),
        make("roughness 1e-8", p, usual, roughness=constant("roughness", 1e-8)),
        make("roughness 1.57", p, usual, roughness=constant("roughness", 1.57)),
        make("roughness 2 (above 90 degrees)", p, usual, roughness=constant("roughness", 2.0), mistake=True),
        make("roughness negative", p, usual, roughness=constant("roughness", -0.2), mistake=True),
        make("albedo 0", p, usual, albedo=constant("albedo", 0.0)),
        make("albedo 1", p, usual, albedo=constant("albedo", 1.0)),
        make("albedo 1.5", p, usual, albedo=constant("albedo", 1.5)),
        make("albedo negative", p, usual, albedo=constant("albedo", -0.2), mistake=True),
        make("one normal of length 0", b, usual, normal=first_normal(0, 0, 0), dark=first),
        make("one normal NaN", b, usual, normal=first_normal(nan, nan, nan), dark=first),
        make("one normal infinite", b, usual, normal=first_normal(inf, 0, inf), dark=first),
        make("all normals of length 2", b, usual, normal=lambda f: 2 * f["normal"], mistake=True),
        make("roughness NaN", b, usual, roughness=constant("roughness", nan), mistake=True),
    ]


def judge(shade: Shade, reference: Shade, at: EdgeCase, dtype: torch.dtype) -> tuple[Verdict, Verdict]:
    """Values and gradients of ``shade`` in ``dtype`` against ``reference`` in float64, on the same rounded numbers."""
    rounded = [t.to(dtype) for t in (at.normal, at.light, at.view, at.albedo, at.roughness)]
    leaves = [t.clone().requires_grad_() for t in rounded]
    try:
        value = shade(*leaves)
        gradients: tuple[Tensor | None, ...] = torch.autograd.grad(value.double().sum(), leaves, allow_unused=True)
    except TorchOrenNayarError:
        return Verdict("refused"), Verdict("refused")
    if at.mistake:
        finite = bool(value.isfinite().all())
        return (Verdict("wrong" if finite else "not finite"),) * 2
    keep = ~at.dark
    exact = [t.double()[keep].requires_grad_() for t in rounded]
    wanted = torch.zeros(len(keep), 1, dtype=torch.float64)
    slopes: tuple[Tensor | None, ...] = (None,) * len(exact)
    if bool(keep.any()):
        truth = reference(*exact)
        slopes = torch.autograd.grad(truth.sum(), exact, allow_unused=True)
        wanted[keep] = truth.detach()
    kinds = [_verdict((value.detach().double() - wanted).abs(), dtype)]
    most = torch.finfo(dtype).max
    errors = []
    for k, (leaf, found) in enumerate(zip(leaves, gradients, strict=True)):
        right = torch.zeros(leaf.shape, dtype=torch.float64)
        slope = slopes[k]
        if slope is not None:
            right[keep] = slope
        right = right.clamp(-most, most)  # half precision saturates
        error = (torch.zeros_like(right) if found is None else found.double()) - right
        if k < 3:
            # Formulas may differ off the unit sphere: only the gradient along rotations of a direction is judged.
            unit = torch.nn.functional.normalize(leaf.detach().double(), dim=-1)
            error = torch.where(at.dark[:, None], error, error - (error * unit).sum(-1, keepdim=True) * unit)
        if at.edge:
            error = error * 0  # NaN stays
        errors.append((error.abs() / (1 + right.abs().amax(-1, keepdim=True))).flatten())
    return kinds[0], _verdict(torch.cat(errors), dtype)


def _verdict(error: Tensor, dtype: torch.dtype) -> Verdict:
    if not bool(error.isfinite().all()):
        return Verdict("not finite")
    worst = float(error.max())
    return Verdict("right" if worst <= ALLOWED[dtype] else "wrong", worst)


def member(name: str) -> Shade:
    """A model of this package."""
    return lambda *scene: oren_nayar(*scene, model=name, dim=-1)
