"""Implementations of Oren-Nayar in circulation, to be measured beside this package's models and not to be used.

Each takes unit vectors (..., 3) and returns the shading ``pi f_r max(0, n.l)``, written as its source writes it
(in angles, with normalised projected vectors), so that its time, error and gradients are those of the source.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

Shader = Callable[[Tensor, Tensor, Tensor, Tensor, Tensor], Tensor]


@dataclass(frozen=True)
class Baseline:
    """A formula in circulation.

    Attributes:
        name: short, for charts.
        shade: ``(normal, light, view, albedo, roughness) -> shading``; 3 along the last axis.
        source: who uses it.
        link: where to read about it.
    """

    name: str
    shade: Shader
    source: str
    link: str


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(-1, keepdim=True)


def _constants(sigma: Tensor) -> tuple[Tensor, Tensor]:
    x = sigma * sigma
    return 1 - 0.5 * x / (x + 0.33), 0.45 * x / (x + 0.09)


def angles(n: Tensor, l: Tensor, v: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:  # noqa: E741
    """The classic form by ``acos``, ``sin`` and ``tan``, azimuth from normalised projected vectors."""
    a, b = _constants(sigma)
    ci, co = _dot(n, l), _dot(n, v)
    theta_i, theta_o = ci.clamp(-1, 1).acos(), co.clamp(-1, 1).acos()
    cos_phi = _dot(F.normalize(l - n * ci, dim=-1), F.normalize(v - n * co, dim=-1))
    alpha, beta = torch.maximum(theta_i, theta_o), torch.minimum(theta_i, theta_o)
    return rho * ci.clamp_min(0) * (a + b * cos_phi.clamp_min(0) * alpha.sin() * beta.tan())


def normalised(n: Tensor, l: Tensor, v: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:  # noqa: E741
    """The rewrite for shaders: no angles, but both projected vectors are normalised by a plain division."""
    a, b = _constants(sigma)
    ci, co = _dot(n, l), _dot(n, v)
    across_l, across_v = l - n * ci, v - n * co
    gamma = _dot(across_l / _dot(across_l, across_l).sqrt(), across_v / _dot(across_v, across_v).sqrt())
    c = ((1 - co * co) * (1 - ci * ci)).sqrt() / torch.maximum(ci, co)
    return rho * ci.clamp_min(0) * (a + b * gamma.clamp_min(0) * c)


def textbook(n: Tensor, l: Tensor, v: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:  # noqa: E741
    """The full 1994 model in angles, as textbooks print it."""
    a, b = _constants(sigma)
    x = sigma * sigma
    ci, co = _dot(n, l), _dot(n, v)
    theta_i, theta_o = ci.clamp(-1, 1).acos(), co.clamp(-1, 1).acos()
    cos_phi = _dot(F.normalize(l - n * ci, dim=-1), F.normalize(v - n * co, dim=-1))
    alpha, beta = torch.maximum(theta_i, theta_o), torch.minimum(theta_i, theta_o)
    ratio = 2 * beta / torch.pi
    c2 = b * torch.where(cos_phi >= 0, alpha.sin(), alpha.sin() - ratio**3)
    c3 = 0.125 * x / (x + 0.09) * (4 * alpha * beta / torch.pi**2) ** 2
    first = a + cos_phi * c2 * beta.tan() + (1 - cos_phi.abs()) * c3 * ((alpha + beta) / 2).tan()
    second = 0.17 * rho * x / (x + 0.13) * (1 - cos_phi * ratio**2)
    return rho * ci.clamp_min(0) * (first + second)


def sine_sine(n: Tensor, l: Tensor, v: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:  # noqa: E741
    """The error ``sin(alpha) sin(beta)`` for ``sin(alpha) tan(beta)``."""
    a, b = _constants(sigma)
    ci, co = _dot(n, l), _dot(n, v)
    return rho * ci.clamp_min(0) * (a + b * (_dot(l, v) - ci * co).clamp_min(0))


def rising(n: Tensor, l: Tensor, v: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:  # noqa: E741
    """The error ``A = 1 + x (rho / (x + 0.13) + 0.5 / (x + 0.33))``, a plus for a minus: roughness brightens."""
    x = sigma * sigma
    a = 1 + x * (rho / (x + 0.13) + 0.5 / (x + 0.33))
    ci, co = _dot(n, l), _dot(n, v)
    s = _dot(l, v) - ci * co
    t = torch.where(s > 0, torch.maximum(ci, co), 1)
    return rho * ci.clamp_min(0) * (a + _constants(sigma)[1] * s / t)


def doubled(n: Tensor, l: Tensor, v: Tensor, rho: Tensor, sigma: Tensor) -> Tensor:  # noqa: E741
    """The error ``A = 1 - x / (2 x + 0.33)``, a bracket lost from ``0.5 x / (x + 0.33)``."""
    x = sigma * sigma
    a = 1 - x / (2 * x + 0.33)
    ci, co = _dot(n, l), _dot(n, v)
    s = (_dot(l, v) - ci * co).clamp_min(0)
    return rho * ci.clamp_min(0) * (a + _constants(sigma)[1] * s / torch.maximum(ci, co))


def memory_floor(
    normal: Tensor, light: Tensor, view: Tensor, albedo: Tensor, roughness: Tensor, *, dim: int = -1
) -> Tensor:
    """The lower bound of time: reads and writes the same bytes as a model and computes next to nothing."""
    x, y, z = (a * b for a, b in zip(normal.unbind(dim), light.unbind(dim), strict=True))
    return albedo * (x + y + z).unsqueeze(dim).relu() * (1 + 1e-9 * roughness)


_WIKIPEDIA = "https://en.wikipedia.org/wiki/Oren%E2%80%93Nayar_reflectance_model"
BASELINES = (
    Baseline("acos", angles, "course notes: the classic form in angles", _WIKIPEDIA),
    Baseline(
        "HLSL rewrite",
        normalised,
        "R. van Ouwerkerk's rewrite for shaders",
        "http://shaderjvo.blogspot.com/2011/08/van-ouwerkerks-rewrite-of-oren-nayar.html",
    ),
    Baseline("textbook", textbook, "textbooks: the full model in angles", _WIKIPEDIA),
    Baseline("sin sin", sine_sine, "an error found on web pages", _WIKIPEDIA),
    Baseline(
        "A plus", rising, "an error copied in public shaders", "https://github.com/glslify/glsl-diffuse-oren-nayar"
    ),
    Baseline("A bracket", doubled, "an error found in public shaders", _WIKIPEDIA),
)
