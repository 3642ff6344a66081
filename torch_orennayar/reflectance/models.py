"""Diffuse reflectance models: each a short function of three cosines, albedo and roughness.

Symbols as in the formulas of Oren & Nayar (1994): ``ci = n.l``, ``co = n.v``, ``lv = l.v``,
``s = lv - ci co = sin(ti) sin(to) cos(dphi)``, ``x = sigma**2``, ``rho`` the facet albedo. A model
function returns ``pi f_r``: a Lambertian surface gives its albedo. The cosines it receives are
positive (the caller guards the horizon), so no formula needs angles, azimuths or a projected vector.

Albedo above 1 (a capture of unknown exposure) scales the result; light between facets is computed
with the albedo cut to 1, beyond which the inter-reflection series means nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import torch
from torch import Tensor

from ..core.checks import check_range
from ..core.errors import ModelError
from . import gradients
from .coefficients import VCAVITY_LINEAR, VCAVITY_SHAPE
from .theory import floored_sine, theory

ModelFunction = Callable[[Tensor, Tensor, Tensor, Tensor, Tensor], Tensor]
ModelDerivatives = Callable[[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor], tuple[Tensor, gradients.Partials]]


@dataclass(frozen=True)
class Model:
    """One diffuse reflectance model and what is known of it.

    Attributes:
        name: the key in ``MODELS``.
        function: ``(ci, co, lv, albedo, roughness) -> pi f_r``, element-wise, differentiable.
        source: where the formula comes from.
        cost: eager forward time relative to ``lambert``, as ``scripts/benchmarks/benchmark_shading.py`` prints it.
        error: RMS error of the shading against the V-cavity theory with all bounces
            (``scripts/benchmarks/evaluate_reflectance.py``).
        gradients: where the function has a kink.
        derivatives: ``(ci, co, lv, albedo, roughness, weight) -> (pi f_r, weight times its derivatives)``, one
            derivative per argument, or None for 0; where a model has no such function, autograd serves.
    """

    name: str
    function: ModelFunction
    source: str
    cost: float | None = None
    error: float | None = None
    gradients: str = "smooth"
    derivatives: ModelDerivatives | None = None


def lambert(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """Lambert (1760): the albedo, whatever the directions and the roughness."""
    # The zero keeps every argument in the graph: its gradient is 0, not absent, and models can be swapped.
    return rho + 0.0 * (ci + co + lv + sigma)


def _a_b(sigma: Tensor, a_constant: float) -> tuple[Tensor, Tensor]:
    """A and B of Oren & Nayar (1994), eq. 30."""
    x = sigma * sigma
    return 1 - 0.5 * (x / (x + a_constant)), 0.45 * (x / (x + 0.09))


def _classic(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor, a_constant: float) -> Tensor:
    """Oren & Nayar (1994), eq. 30, in cosines; at the kink ``s = 0`` the slope is that of ``s < 0``."""
    a, b = _a_b(sigma, a_constant)
    return rho * torch.addcmul(a, b, (lv - ci * co).relu() / torch.maximum(ci, co))


def qualitative(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """The qualitative model, Oren & Nayar (1994), eq. 30: ``rho (A + B max(0, s) / max(ci, co))``."""
    return _classic(ci, co, lv, rho, sigma, 0.33)


def qualitative_057(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """The qualitative model with 0.57 in A, which Oren & Nayar suggest to stand for inter-reflection."""
    return _classic(ci, co, lv, rho, sigma, 0.57)


def fujii(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """Fujii (2012), "improved Oren-Nayar": keeps negative ``s`` and the mean inter-reflection term."""
    a, b = _a_b(sigma, 0.33)
    x, s = sigma * sigma, lv - ci * co
    bounce = 0.17 * rho.clamp_max(1) * (x / (x + 0.13))
    return rho * torch.addcmul(a + bounce, b, s.clamp_max(0) + s.relu() / torch.maximum(ci, co))


def full(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """The full 1994 model (eqs. 27-29) without azimuths; may go slightly below zero near the horizon.

    Sines are floored at 1e-6 before any division, which keeps gradients finite at the normal.
    """
    a, b = _a_b(sigma, 0.33)
    x = sigma * sigma
    c_beta, c_alpha = torch.maximum(ci, co), torch.minimum(ci, co)
    sin_a, sin_b = floored_sine(c_alpha), floored_sine(c_beta)
    alpha, beta = (sin_a / c_alpha).atan(), (sin_b / c_beta).atan()  # acos has no slope at the normal
    s = lv - ci * co
    cos_phi = (s / (sin_a * sin_b)).clamp(-1, 1)
    back = cos_phi.clamp_max(0) * (beta * (2 / torch.pi)) ** 3 * sin_b
    c2_term = b * (s - back) / c_beta
    c3 = 0.125 * (x / (x + 0.09)) * (alpha * beta * (4 / torch.pi**2)) ** 2
    c3_term = (1 - cos_phi.abs()) * c3 * (sin_a + sin_b) / (ci + co)
    bounce = 0.17 * rho.clamp_max(1) * (x / (x + 0.13)) * (1 - cos_phi * (beta * (2 / torch.pi)) ** 2)
    return rho * (a + c2_term + c3_term + bounce)


def vcavity(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """Closed-form fit to the V-cavity theory with all bounces; smooth and reciprocal.

    ``scripts/fit/fit_vcavity.py`` writes the coefficients.
    """
    # The floor acts on dark surfaces rougher than 80 degrees alone, light and view opposite at the horizon.
    return rho * vcavity_form(ci, co, lv, rho, sigma, VCAVITY_SHAPE, VCAVITY_LINEAR).relu()


def vcavity_form(
    ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor, shape: Sequence[float], linear: Sequence[float]
) -> Tensor:
    """The form of `vcavity` over albedo, with 7 shape constants and 24 linear coefficients, which its fit moves.

    ``u`` is masking and shadowing, one factor for each direction. ``r`` knows how far light and view are apart
    as a groove sees it: masking grows with |tan ti - tan to| along the groove, so the natural variable is
    ``ci**2 + co**2 - 2 ci co lv``. ``y`` is 0 for a smooth surface; ``b`` and ``l``, the albedo and its
    bounces, multiply the light of two bounces and of all later ones. The result is a polynomial in ``u``, written
    for few operations (``gradients.vcavity`` goes back through the same lines).
    """
    c, beta, k0, k1, k2, kappa, turn = shape
    a, g, d = linear[:14], linear[14:19], linear[19:]
    x = sigma * sigma
    y = x / (x + c)
    b = rho.clamp_max(1)
    yy, l = y * y, y * (b / (1 - beta * b))  # noqa: E741
    q, p, h = ci * co, ci + co, 1 + lv
    s, pp = lv - q, p * p
    k = k0 + k1 * y + k2 * yy
    m, hq = 1 - k, (2 * h) * q
    mq = m * q
    u = y / (k * (k + m * (pp - 2 * q)) + mq * mq).sqrt()  # the root of (k + m ci^2) (k + m co^2)
    r = (pp + (kappa + turn * y) * (pp - hq) + 1e-12).rsqrt()
    hr, qr, pr, yp = h * r, q * r, p * r, yy * p
    zero = qr * (a[0] * hr + a[2]) + a[1] * pr + a[3] * yp + b * (g[0] + g[1] * yy + g[2] * p)
    zero = 1 + y * (zero + l * (d[0] + y * (d[1] * q + d[2] * h)))
    one = hr * (a[4] + y * (a[5] + a[6] * q + a[7] * pr)) + s * (a[8] + a[9] * s + a[10] * yp)
    one = one + y * (a[11] + b * (r * (g[3] * qr + (g[4] * h) * p))) + l * (d[3] * q)
    two = a[12] + a[13] * p + l * (d[4] * (s * s))
    return zero + u * (one + u * two)


def eon(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """Energy-preserving Oren-Nayar (Portsmouth, Kutz & Hill 2024), its r mapped from ``sigma``.

    ``r = x / (0.2859 + 1.1110 x)`` brings it nearest to the V-cavity theory (``scripts/fit/fit_eon.py``).
    """
    x = sigma * sigma
    return eon_from_r(ci, co, lv, rho, x / (0.2859 + 1.1110 * x))


def eon_from_r(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, r: Tensor) -> Tensor:
    """EON with its own roughness r in [0, 1].

    Light lost by one bounce is written as ``1 - E = r A (c1 - G)``, which needs no 0/0 at r = 0.
    """
    c1, c2 = 0.5 - 2 / (3 * torch.pi), 2 / 3 - 28 / (15 * torch.pi)
    a = 1 / (1 + c1 * r)
    s = lv - ci * co
    single = a * (1 + r * (s.clamp_max(0) + s.relu() / torch.maximum(ci, co)))
    bounce_rho = rho.clamp_max(1)
    mean_albedo = a * (1 + c2 * r)
    lost = (c1 - _eon_g(ci)).clamp_min(0) * (c1 - _eon_g(co)).clamp_min(0) * r * a / (c1 - c2)
    multiple = bounce_rho * mean_albedo / (1 - bounce_rho * (1 - mean_albedo)) * lost
    return rho * (single + multiple)


def _eon_g(cosine: Tensor) -> Tensor:
    """G(theta)/pi of the EON paper, its published polynomial in ``1 - cos``."""
    m = 1 - cosine
    return m * (0.0571085289 + m * (0.491881867 + m * (-0.332181442 + m * 0.0714429953)))


def slope_from_roughness(roughness: Tensor) -> Tensor:
    """Standard deviation of the elevation gradient (rise over run) for that of the slope angle: ``tan``.

    Oren and Nayar's roughness is the standard deviation of the facets' slope *angle*; some texts use that of
    the elevation *gradient* instead. The two differ by a third of the cube, so they agree for small values.
    The tangent takes the facets one standard deviation from flat to the same facets; moments of the gradient
    are of no use, since those of a normal distribution of angles do not exist.

    Args:
        roughness: radians in [0, pi/2), any shape, differentiable.

    Returns:
        The gradient's standard deviation, a ratio without unit.

    Raises:
        RangeError: roughness out of range.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> round(ton.slope_from_roughness(torch.tensor(0.1)).item(), 4)
        0.1003
    """
    check_range("roughness", roughness, 0.0, math.pi / 2 - 1e-6, "it is in radians, below pi/2")
    return roughness.tan()


def roughness_from_slope(slope: Tensor) -> Tensor:
    """Roughness (standard deviation of the slope angle, radians) for that of the elevation gradient: ``atan``.

    The inverse of `slope_from_roughness`, which says what is kept.

    Args:
        slope: >= 0, rise over run, any shape, differentiable.

    Returns:
        Radians in [0, pi/2).

    Raises:
        RangeError: a negative slope.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> round(ton.roughness_from_slope(torch.tensor(0.5)).item(), 4)
        0.4636
    """
    check_range("slope", slope, 0.0, math.inf, "it is a standard deviation")
    return slope.atan()


def register_model(
    name: str,
    function: ModelFunction,
    *,
    source: str = "user",
    cost: float | None = None,
    error: float | None = None,
    gradients: str = "not stated",
    derivatives: ModelDerivatives | None = None,
) -> Model:
    """Add a diffuse model under ``name``; it works at once in the layer, the solvers and the export.

    Args:
        name: a new name; the names of existing models are refused.
        function: ``(ci, co, lv, albedo, roughness) -> pi f_r``. Its tensors broadcast against each
            other, ``ci`` and ``co`` are positive, ``roughness`` is in radians; it must be element-wise
            and built from torch operations, so that it differentiates and exports.
        source: where the formula comes from.
        cost: time relative to ``lambert``, if measured.
        error: RMS error against the theory, if measured.
        gradients: where the function has kinks.
        derivatives: by hand, as `Model` describes; default: by autograd, which is slower.

    Returns:
        The registered `Model`.

    Raises:
        ModelError: the name is taken, the function fails on, or does not broadcast over, a trial, or its derivatives
            are not those of autograd there.

    Example:
        >>> import torch_orennayar as ton
        >>> model = ton.register_model("minnaert-demo", lambda ci, co, lv, rho, k: rho * (ci * co) ** k)
        >>> ton.MODELS["minnaert-demo"].source
        'user'
    """
    if name in _models:
        raise ModelError("name", expected="a new name", got=f"{name!r}, which exists", mend="choose another")
    trial = torch.tensor([[0.3, 0.6, 1.0]])
    try:
        result = function(trial, trial, trial * trial, torch.full((2, 1), 0.5), torch.tensor(0.4))
    except Exception as error_raised:
        raise ModelError(
            "function",
            expected="a function of (ci, co, lv, albedo, roughness)",
            got=f"{type(error_raised).__name__}: {error_raised}",
            mend="make it accept five broadcasting tensors",
        ) from error_raised
    element_wise = isinstance(result, Tensor) and result.shape in ((2, 3), (2, 1), (1, 3))
    if not element_wise or not bool(result.isfinite().all()):
        raise ModelError(
            "function",
            expected="finite values of the broadcast shape (2, 3) on a trial",
            got=f"shape {tuple(result.shape)}" if isinstance(result, Tensor) else type(result).__name__,
            mend="return pi f_r, element by element",
        )
    model = Model(name, function, source, cost, error, gradients, derivatives)
    if derivatives is not None:
        _check_derivatives(function, derivatives)
    _models[name] = model
    return model


def _check_derivatives(function: ModelFunction, derivatives: ModelDerivatives) -> None:
    """Derivatives by hand are autograd's on a trial away from the usual kinks."""
    rows = ((0.3, 0.6, 0.9), (0.8, 0.5, 0.7), (0.5, 0.9, 0.4), (0.3, 0.5, 0.7), (0.4, 0.2, 0.9), (1.0, -2.0, 0.5))
    ci, co, lv, rho, sigma, weight = (torch.tensor(row, dtype=torch.float64) for row in rows)
    arguments = ci, co, lv, rho, sigma
    with torch.enable_grad():
        leaves = [t.clone().requires_grad_() for t in arguments]
        value = function(*leaves).expand(3)
    parts = torch.autograd.grad(value, leaves, weight, allow_unused=True) if value.requires_grad else [None] * 5
    wanted = [value, *(torch.zeros(3) if p is None else p for p in parts)]
    try:
        found_value, found_parts = derivatives(*arguments, weight)
        found = [found_value, *(torch.zeros(3) if p is None else p for p in found_parts)]
        differ = [
            k for k, (a, b) in enumerate(zip(found, wanted, strict=True)) if not torch.allclose(a.double(), b.double())
        ]
    except Exception as error:
        got = f"{type(error).__name__}: {error}"
    else:
        names = ("the value", "ci", "co", "lv", "albedo", "roughness")
        got = "another result for " + ", ".join(names[k] for k in differ) if differ else ""
    if got:
        raise ModelError(
            "derivatives",
            expected="pi f_r and weight times its five derivatives, in the weight's shape, as autograd finds them",
            got=got,
            mend="return (value, (by_ci, by_co, by_lv, by_albedo, by_roughness)), or leave it out",
        )


def get_model(name: str) -> Model:
    """The model called ``name``; a `ModelError` that lists the names where there is none."""
    if not isinstance(name, str) or name not in _models:
        raise ModelError(
            "model", expected=f"one of {', '.join(_models)}", got=repr(name), mend="or add it with register_model"
        )
    return _models[name]


_KINKS = "kinks at ci = co and s = 0"
_SLOW = "those of the quadrature"
_KNOWN = (
    Model("lambert", lambert, "Lambert 1760", 1.0, 0.141, derivatives=gradients.lambert),
    Model("qualitative", qualitative, "Oren & Nayar 1994, eq. 30", 1.25, 0.070, _KINKS, gradients.qualitative),
    Model(
        "qualitative-0.57",
        qualitative_057,
        "Oren & Nayar 1994, remark on eq. 30",
        1.25,
        0.061,
        _KINKS,
        gradients.qualitative_057,
    ),
    Model("fujii", fujii, "Y. Fujii 2012", 1.6, 0.035, _KINKS, gradients.fujii),
    Model("full", full, "Oren & Nayar 1994, eqs. 27-29", 2.8, 0.036, _KINKS),
    Model(
        "vcavity",
        vcavity,
        "this project's rational fit to the V-cavity theory, all bounces",
        3.4,
        0.0028,
        derivatives=gradients.vcavity,
    ),
    Model("eon", eon, "Portsmouth, Kutz & Hill 2024", 2.2, 0.083, _KINKS),
    Model("theory", theory, "Oren & Nayar 1994: the V-cavity integral, with all bounces", 73000.0, 0.00005, _SLOW),
)
_models: dict[str, Model] = {m.name: m for m in _KNOWN}
MODELS: Mapping[str, Model] = MappingProxyType(_models)
"""Read-only mapping from name to `Model`; `register_model` adds to it."""
