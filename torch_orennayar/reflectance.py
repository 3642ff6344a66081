"""Diffuse reflectance models: each a short function of three cosines, albedo and roughness.

Symbols as in the formulas of Oren & Nayar (1994): ``ci = n.l``, ``co = n.v``, ``lv = l.v``,
``s = lv - ci co = sin(ti) sin(to) cos(dphi)``, ``x = sigma**2``, ``rho`` the facet albedo. A model
function returns ``pi f_r``: a Lambertian surface gives its albedo. The cosines it receives are
positive (the caller guards the horizon), so no formula needs angles, azimuths or a projected vector.

Albedo above 1 (a capture of unknown exposure) scales the result; light between facets is computed
with the albedo cut to [0, 1], outside of which the inter-reflection series means nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import torch
from torch import Tensor

from .errors import ModelError

ModelFunction = Callable[[Tensor, Tensor, Tensor, Tensor, Tensor], Tensor]


@dataclass(frozen=True)
class Model:
    """One diffuse reflectance model and what is known of it.

    Attributes:
        name: the key in ``MODELS``.
        function: ``(ci, co, lv, albedo, roughness) -> pi f_r``, element-wise, differentiable.
        source: where the formula comes from.
        cost: eager forward time relative to ``lambert``, as ``scripts/evaluate_reflectance.py`` prints it.
        error: RMS error of the shading against the V-cavity theory with all bounces (same script).
        gradients: where the function has a kink.
    """

    name: str
    function: ModelFunction
    source: str
    cost: float | None = None
    error: float | None = None
    gradients: str = "smooth"


def lambert(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """Lambert (1760): the albedo, whatever the directions and the roughness."""
    # The zero keeps every argument in the graph: its gradient is 0, not absent, and models can be swapped.
    return rho + 0.0 * (ci + co + lv + sigma)


def _classic(ci: Tensor, co: Tensor, lv: Tensor, sigma: Tensor, a_constant: float) -> tuple[Tensor, ...]:
    """A, B and s of Oren & Nayar (1994), eq. 30."""
    x = sigma * sigma
    return 1 - 0.5 * x / (x + a_constant), 0.45 * x / (x + 0.09), lv - ci * co


def qualitative(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """The qualitative model, Oren & Nayar (1994), eq. 30: ``rho (A + B max(0, s) / max(ci, co))``."""
    a, b, s = _classic(ci, co, lv, sigma, 0.33)
    return rho * (a + b * s.clamp_min(0) / torch.maximum(ci, co))


def qualitative_057(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """The qualitative model with 0.57 in A, which Oren & Nayar suggest to stand for inter-reflection."""
    a, b, s = _classic(ci, co, lv, sigma, 0.57)
    return rho * (a + b * s.clamp_min(0) / torch.maximum(ci, co))


def fujii(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """Fujii (2012), "improved Oren-Nayar": keeps negative ``s`` and the mean inter-reflection term."""
    a, b, s = _classic(ci, co, lv, sigma, 0.33)
    x = sigma * sigma
    bounce = 0.17 * rho.clamp(0, 1) * x / (x + 0.13)
    return rho * (a + bounce + b * s / torch.where(s > 0, torch.maximum(ci, co), 1))


def full(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """The full 1994 model (eqs. 27-29) without azimuths; may go slightly below zero near the horizon.

    Sines are floored at 1e-6 before any division, which keeps gradients finite at the normal.
    """
    x = sigma * sigma
    c_beta, c_alpha = torch.maximum(ci, co), torch.minimum(ci, co)
    sin_a, sin_b = _sine(c_alpha), _sine(c_beta)
    alpha, beta = torch.atan2(sin_a, c_alpha), torch.atan2(sin_b, c_beta)
    s = lv - ci * co
    cos_phi = (s / (sin_a * sin_b)).clamp(-1, 1)
    back = torch.where(s < 0, cos_phi * (beta * (2 / torch.pi)) ** 3 * sin_b, 0)
    c2_term = 0.45 * x / (x + 0.09) * (s - back) / c_beta
    c3 = 0.125 * x / (x + 0.09) * (alpha * beta * (4 / torch.pi**2)) ** 2
    c3_term = (1 - cos_phi.abs()) * c3 * (sin_a + sin_b) / (ci + co)
    bounce = 0.17 * rho.clamp(0, 1) * x / (x + 0.13) * (1 - cos_phi * (beta * (2 / torch.pi)) ** 2)
    return rho * (1 - 0.5 * x / (x + 0.33) + c2_term + c3_term + bounce)


def _sine(cosine: Tensor) -> Tensor:
    return ((1 - cosine) * (1 + cosine)).clamp_min(1e-12).sqrt()


def vcavity(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """Rational fit to the V-cavity theory with all bounces; smooth and reciprocal.

    The natural variable is ``ci**2 + co**2 - 2 ci co lv``: masking grows with |tan ti - tan to|
    along the groove. ``r1`` is the first bounce, ``r2`` the second, ``tail`` all the others.
    """
    x = sigma * sigma
    y = x / (x + 0.384)
    k = 0.001 + 1.04 * x / (1 + 1.55 * x)
    kappa = 3.641
    bounce_rho = rho.clamp(0, 1)
    q, p, s, h = ci * co, ci + co, lv - ci * co, 1 + lv
    u = torch.rsqrt((k + (1 - k) * ci * ci) * (k + (1 - k) * co * co))
    r = torch.rsqrt((1 + kappa) * (ci * ci + co * co) + 2 * q * (1 - kappa * lv) + 1e-12)
    qr, pr = q * r, p * r
    r1 = 1 + y * (-0.236 + y * (-0.6721 + 0.5907 * y)) + 0.356 * y * y * s * p
    r1 = r1 + u * (
        s * (0.3263 * y + y * (0.1289 + y * (0.5742 - 1.1969 * y)) * q * u)
        + h * (y * (0.016 + y * (0.3286 - 0.0404 * y)) * r + 1.1862 * y * y * qr * r)
        - h * y * (0.0618 + 0.4584 * y) * pr
    )
    r2 = y * (0.3977 + y * (-0.4146 + 0.2482 * y)) - 0.8216 * y * y * y * s * q
    r2 = r2 + u * (
        s * (-0.0689 * y * y * y * u + y * y * (-1.3112 + 1.8154 * y) * q)
        + y * y * (1.4323 - 0.8203 * y) * qr
        - 0.2074 * y * y * p * pr
    )
    tail = (y * y) * ((0.272 - 0.2216 * y) + (0.9775 - 0.7173 * y) * qr)
    tail = tail * bounce_rho * bounce_rho / (1 + y * (5.544 * bounce_rho - 6.129 * bounce_rho**1.348))
    return rho * (r1 + bounce_rho * r2 + tail)


def eon(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:
    """Energy-preserving Oren-Nayar (Portsmouth, Kutz & Hill 2024), its r mapped from ``sigma``.

    ``r = x / (0.2871 + 1.1252 x)`` brings it nearest to `vcavity` (``scripts/fit_eon.py``).
    """
    x = sigma * sigma
    return eon_from_r(ci, co, lv, rho, x / (0.2871 + 1.1252 * x))


def eon_from_r(ci: Tensor, co: Tensor, lv: Tensor, rho: Tensor, r: Tensor) -> Tensor:
    """EON with its own roughness r in [0, 1].

    Light lost by one bounce is written as ``1 - E = r A (c1 - G)``, which needs no 0/0 at r = 0.
    """
    c1, c2 = 0.5 - 2 / (3 * torch.pi), 2 / 3 - 28 / (15 * torch.pi)
    a = 1 / (1 + c1 * r)
    s = lv - ci * co
    single = a * (1 + r * s / torch.where(s > 0, torch.maximum(ci, co), 1))
    bounce_rho = rho.clamp(0, 1)
    mean_albedo = a * (1 + c2 * r)
    lost = (c1 - _eon_g(ci)).clamp_min(0) * (c1 - _eon_g(co)).clamp_min(0) * r * a / (c1 - c2)
    multiple = bounce_rho * mean_albedo / (1 - bounce_rho * (1 - mean_albedo)) * lost
    return rho * (single + multiple)


def _eon_g(cosine: Tensor) -> Tensor:
    """G(theta)/pi of the EON paper, its published polynomial in ``1 - cos``."""
    m = 1 - cosine
    return m * (0.0571085289 + m * (0.491881867 + m * (-0.332181442 + m * 0.0714429953)))


def register_model(
    name: str,
    function: ModelFunction,
    *,
    source: str = "user",
    cost: float | None = None,
    error: float | None = None,
    gradients: str = "not stated",
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

    Returns:
        The registered `Model`.

    Raises:
        ModelError: the name is taken, or the function fails on, or does not broadcast over, a trial.

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
    model = Model(name, function, source, cost, error, gradients)
    _models[name] = model
    return model


def get_model(name: str) -> Model:
    """The model called ``name``; a `ModelError` that lists the names where there is none."""
    if name not in _models:
        raise ModelError(
            "model", expected=f"one of {', '.join(_models)}", got=repr(name), mend="or add it with register_model"
        )
    return _models[name]


_KINKS = "kinks at ci = co and s = 0"
_models: dict[str, Model] = {
    m.name: m
    for m in (
        Model("lambert", lambert, "Lambert 1760", 1.0, 0.141),
        Model("qualitative", qualitative, "Oren & Nayar 1994, eq. 30", 1.4, 0.070, _KINKS),
        Model("qualitative-0.57", qualitative_057, "Oren & Nayar 1994, remark on eq. 30", 1.3, 0.061, _KINKS),
        Model("fujii", fujii, "Y. Fujii 2012", 1.7, 0.035, _KINKS),
        Model("full", full, "Oren & Nayar 1994, eqs. 27-29", 2.7, 0.036, _KINKS),
        Model("vcavity", vcavity, "this project's rational fit to the V-cavity theory, all bounces", 3.6, 0.0036),
        Model("eon", eon, "Portsmouth, Kutz & Hill 2024", 1.9, 0.083, _KINKS),
    )
}
MODELS: Mapping[str, Model] = MappingProxyType(_models)
"""Read-only mapping from name to `Model`; `register_model` adds to it."""
