"""The registry of diffuse reflectance models: what is known of each, and how users add their own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import torch
from torch import Tensor

from ..core.checks import broadcast_shape
from ..core.errors import ModelError
from . import gradients
from .formulas import eon, fujii, full, lambert, qualitative, qualitative_057, vcavity
from .theory import theory

ModelFunction = Callable[[Tensor, Tensor, Tensor, Tensor, Tensor], Tensor]
ModelDerivatives = Callable[[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor], tuple[Tensor, gradients.Partials]]


@dataclass(frozen=True)
class Model:
    """A diffuse reflectance model with its source, cost and error.

    Attributes:
        name: the key in ``MODELS``.
        function: ``(ci, co, lv, albedo, roughness) -> pi f_r``, element-wise, differentiable.
        source: where the formula comes from.
        cost: eager forward time relative to ``lambert``, from ``scripts/benchmarks/benchmark_shading.py``.
        error: RMS error of the shading against the V-cavity theory with all bounces, from
            ``scripts/benchmarks/evaluate_reflectance.py``.
        gradients: where the function has a kink.
        derivatives: ``(ci, co, lv, albedo, roughness, weight) -> (pi f_r, weight times its derivatives)``, one
            derivative per argument, or None for 0; None where autograd differentiates the model.

    Example:
        >>> import torch_orennayar as ton
        >>> ton.MODELS["fujii"].source, ton.MODELS["fujii"].gradients
        ('Y. Fujii 2012', 'kinks at ci = co and s = 0')
    """

    name: str
    function: ModelFunction
    source: str
    cost: float | None = None
    error: float | None = None
    gradients: str = "smooth"
    derivatives: ModelDerivatives | None = None


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
    """Add a diffuse model under ``name``, for use in the layer, the solvers and the export.

    Args:
        name: a new name; the names of existing models are refused.
        function: ``(ci, co, lv, albedo, roughness) -> pi f_r``. Its tensors broadcast against each
            other, ``ci`` and ``co`` are positive, ``roughness`` is in radians; it must be element-wise
            and built from torch operations, so that it differentiates and exports.
        source: where the formula comes from.
        cost: time relative to ``lambert``, if measured.
        error: RMS error against the theory, if measured.
        gradients: where the function has kinks.
        derivatives: analytic derivatives, as `Model` describes; default: autograd, which is slower.

    Returns:
        The registered `Model`.

    Raises:
        ModelError: the name is taken, the function fails on trial values or does not broadcast over them, or its
            derivatives differ from those of autograd there.

    Example:
        >>> import torch_orennayar as ton
        >>> model = ton.register_model("minnaert-demo", lambda ci, co, lv, rho, k: rho * (ci * co) ** k)
        >>> ton.MODELS["minnaert-demo"].source
        'user'
    """
    if name in _models:
        raise ModelError("name", expected="a new name", got=f"{name!r}, which exists", mend="choose another")
    _check_function(function)
    if derivatives is not None:
        _check_derivatives(function, derivatives)
    model = _models[name] = Model(name, function, source, cost, error, gradients, derivatives)
    return model


def unregister_model(name: str) -> None:
    """Remove a registered model, if there is one of that name; for tests and notebooks that register again."""
    _models.pop(name, None)


def get_model(name: object) -> Model:
    """Look up a model.

    Raises:
        ModelError: there is no model called ``name``; the message lists the names.
    """
    if not isinstance(name, str) or name not in _models:
        raise ModelError(
            "model", expected=f"one of {', '.join(_models)}", got=repr(name), mend="or add it with register_model"
        )
    return _models[name]


def value_and_vjp(
    model: Model, arguments: tuple[Tensor, Tensor, Tensor, Tensor, Tensor], weight: Tensor
) -> tuple[Tensor, gradients.Partials]:
    """A model's value and its vector-Jacobian product, by analytic derivatives where the model has them.

    Args:
        model: the model.
        arguments: ``ci, co, lv, albedo, roughness``, which broadcast.
        weight: the gradient with respect to the value, in the broadcast shape.

    Returns:
        ``(pi f_r, weight times its derivative by each argument)``; None for a derivative of 0.
    """
    if model.derivatives is not None:
        return model.derivatives(*arguments, weight)
    with torch.enable_grad():
        leaves = [t.detach().requires_grad_() for t in arguments]
        value = expand_value(model.function(*leaves), leaves)
        if not value.requires_grad:  # the model is a constant
            return value, (None, None, None, None, None)
        ci, co, lv, rho, sigma = torch.autograd.grad(value, leaves, weight, allow_unused=True)
        return value.detach(), (ci, co, lv, rho, sigma)


def expand_value(value: Tensor, arguments: Sequence[Tensor]) -> Tensor:
    """``value`` in the broadcast shape of a model's arguments, of which the model may use only some."""
    shape = broadcast_shape(*(t.shape for t in arguments))
    return value if value.shape == shape else value.expand(shape)


def _check_function(function: Callable[..., object]) -> None:
    """Call a new model's function on trial values that broadcast to (2, 3)."""
    trial = torch.tensor([[0.3, 0.6, 1.0]])
    try:
        result = function(trial, trial, trial * trial, torch.full((2, 1), 0.5), torch.tensor(0.4))
    except Exception as error:
        raise ModelError(
            "function",
            expected="a function of (ci, co, lv, albedo, roughness)",
            got=f"{type(error).__name__}: {error}",
            mend="make it accept five broadcasting tensors",
        ) from error
    shapes = (2, 3), (2, 1), (1, 3)
    if not isinstance(result, Tensor) or result.shape not in shapes or not bool(result.isfinite().all()):
        raise ModelError(
            "function",
            expected="finite values of the broadcast shape (2, 3) on a trial",
            got=f"shape {tuple(result.shape)}" if isinstance(result, Tensor) else type(result).__name__,
            mend="return pi f_r, element by element",
        )


def _check_derivatives(function: ModelFunction, derivatives: ModelDerivatives) -> None:
    """Compare analytic derivatives with autograd on trial values away from the usual kinks."""
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
            expected="pi f_r and weight times its five derivatives, in the weight's shape, equal to those of autograd",
            got=got,
            mend="return (value, (by_ci, by_co, by_lv, by_albedo, by_roughness)), or leave it out",
        )


_KINKS = "kinks at ci = co and s = 0"
_BUILT_IN = (
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
    Model(
        "theory",
        theory,
        "Oren & Nayar 1994: the V-cavity integral, with all bounces",
        73000.0,
        0.00005,
        "those of the quadrature",
    ),
)
"""The package's own models; costs and errors as `Model` describes them."""
_models: dict[str, Model] = {m.name: m for m in _BUILT_IN}
MODELS: Mapping[str, Model] = MappingProxyType(_models)
"""Read-only mapping from name to `Model`; `register_model` adds to it."""
