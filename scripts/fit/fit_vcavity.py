"""Fit the coefficients of `vcavity` to the V-cavity theory, and write them into the package.

    python -m scripts.fit.fit_vcavity [--check]

The training set is 2500 cosine-weighted, 700 retro-grazing and 600 horizontal pairs of directions (seeds 1, 2, 4) at
roughness 5 to 90 degrees and albedo 0.05 to 1, evaluated by this package's quadrature of the theory with all bounces.
The form is linear in most of its coefficients and nonlinear in 7 shape constants: the Nelder-Mead simplex moves the
latter, and the former are solved for at each step. Residuals are weighted by the root mean square of both cosines, more
at small roughness and less above 60 degrees; a white surface must also reflect all light for every view. Reports the
error on 3000 other cosine-weighted pairs (seed 3), which the fit does not use.
`--check` reports on the coefficients in use, without fitting. The fit takes about three minutes.

The form itself (which products of the variables take part) is given: it was found by forward selection with exchange
over such products, which is not part of this script.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from scipy.optimize import minimize
from torch import Tensor

from scripts.fit.theory_reference import Directions, cosine_weighted, from_angles, grazing, horizon, join, theory
from torch_orennayar.reflectance import formulas
from torch_orennayar.reflectance.coefficients import VCAVITY_LINEAR, VCAVITY_SHAPE
from torch_orennayar.reflectance.theory import gauss_legendre

TARGET = Path(formulas.__file__).with_name("coefficients.py")
"""The module that the fit writes."""
ROUGHNESS = torch.arange(5, 91, 5, dtype=torch.float64)
"""Roughness of the training set in degrees."""
ALBEDO = torch.tensor([0.05, 0.2, 0.5, 0.9, 1.0], dtype=torch.float64)
"""Albedos of the training set."""
JUDGED_ROUGHNESS, JUDGED_ALBEDO = (5, 10, 20, 30, 40, 50, 60), (0.2, 0.5, 0.9)
"""Roughness in degrees and albedos of the report."""
VIEWS = torch.tensor([0.03, 0.08, 0.15, 0.25, 0.4, 0.6, 0.8, 0.95], dtype=torch.float64)
"""Cosines of the views for which the directional albedo of a white surface is held to 1."""
WHITE = 0.04
"""Weight of the white furnace against the training directions; set by hand."""
START = (0.5677, 0.7984, 0.0028, 1.0221, 2.6028, 3.7791, 0.5148)
"""Shape constants that the fit starts from: those at which the forward selection ended."""
STEPS = 800
"""Most steps of the simplex."""


def form(pairs: Directions, shape: list[float], linear: list[float], sigma: Tensor, rho: Tensor = ALBEDO) -> Tensor:
    """``pi f_r / rho`` of the form for (S, N, K): roughness, directions, albedo."""
    ci, co, lv = (c[:, None] for c in (pairs.ci, pairs.co, pairs.lv))
    return formulas.vcavity_form(ci, co, lv, rho, sigma.deg2rad()[:, None, None], shape, linear)


def columns(pairs: Directions, shape: list[float], rho: Tensor = ALBEDO) -> tuple[Tensor, Tensor]:
    """The form with all linear coefficients 0, and its derivative by each: it is linear in them."""
    zero = [0.0] * len(VCAVITY_LINEAR)
    base = form(pairs, shape, zero, ROUGHNESS, rho)
    parts = [form(pairs, shape, [*zero[:k], 1.0, *zero[k + 1 :]], ROUGHNESS, rho) - base for k in range(len(zero))]
    return base, torch.stack(parts, -1)


def furnace(shape: list[float]) -> tuple[Tensor, Tensor]:
    """`columns` of a white surface integrated over the light, (S, V) and (S, V, 24) for V views; the true sum is 1."""
    node, weight = gauss_legendre(12)
    ci, co, turn = (t.reshape(-1) for t in torch.meshgrid(node, VIEWS, torch.pi * node, indexing="ij"))
    base, parts = columns(from_angles(ci.acos(), co.acos(), turn), shape, torch.ones(1, dtype=torch.float64))
    share = (2 * node * weight)[:, None, None] * weight  # light's cosine, view, azimuth
    folded = [t.reshape(len(ROUGHNESS), 12, len(VIEWS), 12, -1) * share[..., None] for t in (base, parts)]
    return folded[0].sum((1, 3))[..., 0], folded[1].sum((1, 3))


def furnace_of(shape: list[float], linear: list[float]) -> Tensor:
    """Directional albedo of a white surface, roughness 5 to 60 degrees."""
    base, parts = furnace(shape)
    return (base + parts @ torch.tensor(linear, dtype=torch.float64))[ROUGHNESS <= 60]


def solve(pairs: Directions, shape: list[float], truth: Tensor, weight: Tensor) -> tuple[list[float], float]:
    """Linear coefficients for given shape constants, and the weighted RMS residual."""
    base, parts = columns(pairs, shape)
    white, white_parts = furnace(shape)
    scale_white = WHITE * len(pairs) ** 0.5
    a = torch.cat(((parts * weight[..., None]).flatten(0, -2), white_parts.flatten(0, -2) * scale_white)).numpy()
    b = torch.cat((((truth - base) * weight).flatten(), (1 - white).flatten() * scale_white)).numpy()
    scale = np.sqrt((a * a).sum(0))
    normal = a.T @ a / scale / scale[:, None] + 1e-11 * np.eye(len(scale))
    linear = np.linalg.solve(normal, a.T @ b / scale) / scale
    return linear.tolist(), float(np.sqrt(np.square(a @ linear - b).mean()))


def fit() -> tuple[list[float], list[float]]:
    """Shape constants and linear coefficients from the training directions."""
    pairs = join(cosine_weighted(2500, 1), grazing(700, 2), horizon(600, 4))
    truth = theory(pairs, ROUGHNESS.deg2rad(), ALBEDO, "theory, training").sum(-1)
    pixel = ((pairs.ci.square() + pairs.co.square()) / 2).sqrt()
    pixel[2500:] *= 0.6
    emphasis = np.interp(ROUGHNESS.numpy(), [5, 10, 20, 60, 65, 90], [1.3, 1.2, 1, 1, 0.25, 0.15])
    weight = torch.from_numpy(emphasis)[:, None, None] * pixel[:, None]
    # The simplex uses every fifth direction, the final solution all of them.
    few = slice(None, None, 5)
    some = Directions(pairs.ci[few], pairs.co[few], pairs.lv[few])

    def residual(shape: npt.NDArray[np.float64]) -> float:
        c, beta, k0, _, _, kappa, turn = shape.tolist()
        if not (0.05 < c < 3 and 0.5 < beta < 0.9 and k0 >= 1e-3 and kappa > 0 and kappa + turn > 0):
            return 9.0
        with np.errstate(all="ignore"):
            return solve(some, shape.tolist(), truth[:, few], weight[:, few])[1]

    start = np.array(START)
    corners = start + np.vstack((np.zeros(len(start)), np.diag(0.15 * np.abs(start) + 0.01)))
    corners[:, 1] = np.minimum(corners[:, 1], 0.85)
    found = minimize(
        residual, start, method="Nelder-Mead",
        options={"maxiter": STEPS, "xatol": 1e-5, "fatol": 1e-8, "initial_simplex": corners},
    )  # fmt: skip
    shape = [float(f"{v:.5g}") for v in found.x]
    linear, rms = solve(pairs, shape, truth, weight)
    print(f"training: weighted RMS {rms:.5f}")
    return shape, [float(f"{v:.6g}") for v in linear]


def report(shape: list[float], linear: list[float]) -> None:
    """RMS and maximum of the shading on the test directions, per roughness and albedo."""
    pairs = cosine_weighted(3000, 3)
    sigma = torch.tensor(JUDGED_ROUGHNESS, dtype=torch.float64)
    keep = [ALBEDO.tolist().index(a) for a in JUDGED_ALBEDO]
    truth = theory(pairs, sigma.deg2rad(), ALBEDO[keep], "theory, test").sum(-1)
    error = (form(pairs, shape, linear, sigma)[..., keep] - truth) * pairs.ci[:, None]
    rms, worst = error.square().mean(1).sqrt(), error.abs().amax(1)
    print("test: RMS / maximum of pi f_r cos / rho, by roughness (down) and albedo")
    print(" " * 8 + "".join(f"{a:>16}" for a in JUDGED_ALBEDO))
    for s, row, top in zip(JUDGED_ROUGHNESS, rms.tolist(), worst.tolist(), strict=True):
        print(f"{s:6d}  " + "".join(f"{r:9.4f} / {t:.3f}" for r, t in zip(row, top, strict=True)))
    white = furnace_of(shape, linear)
    print(f"white furnace, roughness up to 60 degrees: {white.min().item():.4f} to {white.max().item():.4f}")
    print(f"all: RMS {error.square().mean().sqrt().item():.5f}, maximum {error.abs().max().item():.4f}")


def write(shape: list[float], linear: list[float]) -> None:
    """Write ``torch_orennayar/reflectance/coefficients.py``."""

    def lines(values: list[float]) -> str:
        return "\n".join(f"    {v:g}," for v in values)

    TARGET.write_text(
        '"""Coefficients of `formulas.vcavity_form`, written by scripts/fit/fit_vcavity.py; do not edit."""\n\n'
        f"VCAVITY_SHAPE = (\n{lines(shape)}\n)\n"
        '"""c, beta, k0, k1, k2, kappa and turn: found by a simplex search; without unit."""\n\n'
        f"VCAVITY_LINEAR = (\n{lines(linear)}\n)\n"
        '"""a (14 values), g (5) and d (5): found by weighted least squares; without unit."""\n',
        encoding="utf-8",
    )


def main() -> None:
    """Fit, write and report, or report alone."""
    shape, linear = list(VCAVITY_SHAPE), list(VCAVITY_LINEAR)
    if "--check" not in sys.argv[1:]:
        shape, linear = fit()
        write(shape, linear)
    report(shape, linear)


if __name__ == "__main__":
    main()
