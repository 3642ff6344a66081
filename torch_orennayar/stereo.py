"""Photometric stereo: normals, albedo and roughness from photographs under known lights."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from . import _robust_fit as robust_fit
from ._checks import check_floating, check_unit
from .errors import CaptureError, RangeError, ShapeError
from .reflectance import get_model

AUTO_MODEL = "vcavity"
"""The Oren-Nayar model that ``auto`` weighs against Lambert: the one nearest to the theory."""
TOLERANCE = 0.02
"""The simplest model within this share of the best held-out score is chosen."""
SAMPLE_PIXELS = 1500
MIN_LIGHTS_ROUGHNESS = 5
MIN_LIGHTS_HELD_OUT = 8
MAX_CONDITION = 30
ERROR_CAP = 0.15
"""Scores cut absolute errors at this share of a pixel's mean, so that shadows and highlights weigh little."""
_COARSE = tuple(math.radians(s) for s in (0, 8, 16, 24, 32, 40, 48, 56, 64))
_FINE = math.radians(4)


@dataclass(frozen=True)
class Reconstruction:
    """What a solver found; every tensor has B in front for batched input.

    Attributes:
        normal: (3, H, W) unit normals in the camera frame, 0 outside the mask.
        albedo: (C, H, W) linear, in the unit of the images, 0 outside the mask.
        roughness: (1, H, W) radians, 0 for a Lambertian result and outside the mask.
        residual: (1, H, W) mean absolute difference of grey observation and model over all lights.
        confidence: (1, H, W) in [0, 1]: ``1 / (1 + (e / 2 deg)**2)`` with e the standard error of the
            normal that the fit's curvature and residuals predict; 0 outside the mask and where a pixel
            does not determine its normal.
        model: the model in use (one per capture of a batch, as a tuple).
        scores: held-out error of every candidate as a share of the pixel's mean, lower is better; empty
            where nothing was chosen (one per capture of a batch, as a tuple).
        report: what happened, one sentence each: pixels that could not be solved, warnings, the choice.
        specular: None; no specular lobe is fitted.
        depth: None from photometric stereo; `integrate_normals` gives it.
    """

    normal: Tensor
    albedo: Tensor
    roughness: Tensor
    residual: Tensor
    confidence: Tensor
    model: str | tuple[str, ...]
    scores: dict[str, float] | tuple[dict[str, float], ...]
    report: tuple[str, ...]
    specular: Tensor | None = None
    depth: Tensor | None = None


@torch.no_grad()
def photometric_stereo(
    images: Tensor,
    lights: Tensor,
    mask: Tensor | None = None,
    *,
    model: str = "auto",
    robust: bool = True,
    seed: int = 0,
) -> Reconstruction:
    """Recover normals, albedo and roughness from images under known distant lights, orthographic view.

    The robust solver starts from least squares on the middle ranks of every pixel's observations and
    goes on with Gauss-Newton steps under Geman-McClure weights: for Lambert on those ranks (which leave
    out highlights and shadows), for other models on all observations that are not in shadow. A model
    with roughness gets one roughness per capture, of at most 68 degrees. ``auto`` fits Lambert and
    ``vcavity`` on three lights of four, scores both on the rest, and takes the simplest within 2 % of the
    best.

    Models with inter-reflection take albedo in the unit of the images (1 is white), cut to [0, 1]. Not
    differentiable. float64 is solved in float64, all else in float32. The same seed gives the same
    result on the same machine.

    Args:
        images: (K, C, H, W) or (B, K, C, H, W) linear light, intensities divided out; normals come from
            the mean of the channels.
        lights: (K, 3) or (B, K, 3) unit directions to the lights, camera frame.
        mask: (1, H, W) or (B, 1, H, W) bool; default all pixels. Outside it images may hold anything.
        model: ``"auto"`` or a name in ``MODELS``.
        robust: ``False`` is plain least squares over all observations, for ``"lambert"`` only.
        seed: picks the pixels and the held-out lights on which roughness and model are decided.

    Returns:
        A `Reconstruction`.

    Raises:
        ShapeError: shapes do not fit together.
        RangeError: NaN inside the mask, or lights that are no unit vectors.
        CaptureError: fewer than 3 lights, lights nearly in one plane or mostly behind the object, an
            empty mask, no pixel that three lights reach, too few lights for a roughness.
        ModelError: unknown model.

    Source:
        Woodham 1980, "Photometric method for determining surface orientation from multiple images";
        weights of Geman & McClure 1987.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> lights = torch.nn.functional.normalize(torch.tensor([[0.0, 0, 1], [1, 0, 2], [-1, 1, 2]]), dim=-1)
        >>> normal = torch.tensor([0.0, 0.6, 0.8]).reshape(1, 3, 1, 1)
        >>> images = ton.OrenNayar("lambert")(normal, lights[None], albedo=0.5)[0]
        >>> found = ton.photometric_stereo(images, lights, model="lambert")
        >>> [round(v, 3) for v in found.normal.flatten().tolist()], round(found.albedo.item(), 3)
        ([0.0, 0.6, 0.8], 0.5)
    """
    check_floating(images=images, lights=lights)
    if model != "auto":
        get_model(model)
    if not robust and model != "lambert":
        raise CaptureError(
            "robust", expected="True, or model='lambert'", got=f"False with {model!r}", mend="change one of them"
        )
    if images.ndim == 5:
        return _solve_batch(images, lights, mask, model, robust, seed)
    inside = _check(images, lights, mask)
    report: list[str] = []
    _check_conditioning(lights, report)
    colour = _gather(images, inside)
    grey = colour.mean(1).T.contiguous()  # (P, K)
    directions = lights.to(grey)
    dark = _undetermined(grey)
    scores: dict[str, float] = {}
    sigma = 0.0
    if robust:
        sample = grey[_sample(dark, seed)]
        if model == "auto":
            model, scores = _choose(sample, directions, seed, report)
        if model != "lambert":
            sigma = _find_roughness(sample, directions, model, report)
        fitted = robust_fit.fit(grey, directions, model, sigma, show="solving")
    else:
        fitted = robust_fit.least_squares(grey, directions)
    spread = torch.where(_unsure(dark, fitted, len(lights), model, report), torch.inf, fitted.spread)

    def canvas(values: Tensor) -> Tensor:
        empty = values.new_zeros(values.shape[1], *inside.shape)
        empty[:, inside] = values.T
        return empty

    return Reconstruction(
        normal=canvas(fitted.normal),
        albedo=canvas(robust_fit.albedo_per_channel(fitted, colour, directions, model, sigma)),
        roughness=canvas(torch.full_like(fitted.albedo, sigma)),
        residual=canvas(fitted.residual),
        confidence=canvas(1 / (1 + (spread / math.radians(2)) ** 2)),
        model=model,
        scores=scores,
        report=tuple(report),
    )


def _gather(images: Tensor, inside: Tensor) -> Tensor:
    """Observations inside the mask, (K, C, P), float32 or float64, all finite."""
    dtype = torch.float64 if images.dtype == torch.float64 else torch.float32
    colour = images[:, :, inside].to(dtype)
    if not bool(colour.isfinite().all()):
        count = int((~colour.isfinite()).flatten(0, 1).any(0).sum())
        raise RangeError(
            "images",
            expected="finite values inside the mask",
            got=f"NaN or infinity in {count} pixels",
            mend="take those pixels out of the mask",
        )
    return colour


def _unsure(dark: Tensor, fitted: robust_fit.PixelFit, lights: int, model: str, report: list[str]) -> Tensor:
    """Pixels that get no confidence, (P, 1) bool; reports them, and albedo outside the unit of the images."""
    if bool(dark.any()):
        report.append(f"{int(dark.sum())} pixels are lit by fewer than 3 lights; their confidence is 0.")
    if lights == 3:
        report.append("3 lights leave no observation to check the normals with: all confidence is 0.")
    beyond = int((fitted.albedo > 1.05).sum())
    if model != "lambert" and beyond:
        report.append(
            f"albedo is above 1 in {beyond} pixels: images are not in units of white, and light between facets "
            "is taken as of a white surface there."
        )
    return (dark | (lights == 3))[:, None]


def _solve_batch(
    images: Tensor, lights: Tensor, mask: Tensor | None, model: str, robust: bool, seed: int
) -> Reconstruction:
    """One capture after the other: each has its own model and roughness."""
    batch = len(images)
    for name, value, ndim in (("lights", lights, 3), ("mask", mask, 4)):
        if value is not None and (value.ndim != ndim or len(value) != batch):
            raise ShapeError(
                name, expected=f"{batch} captures in a batch", got=str(tuple(value.shape)), mend="stack one per capture"
            )
    found = [
        photometric_stereo(
            images[b], lights[b], None if mask is None else mask[b], model=model, robust=robust, seed=seed
        )
        for b in range(batch)
    ]
    if not found:
        raise ShapeError("images", expected="at least one capture", got=str(tuple(images.shape)), mend="add one")
    joined = {
        f.name: torch.stack([getattr(r, f.name) for r in found])
        for f in fields(Reconstruction)
        if isinstance(getattr(found[0], f.name), Tensor)
    }
    return Reconstruction(
        **joined,
        model=tuple(str(r.model) for r in found),
        scores=tuple(r.scores for r in found if isinstance(r.scores, dict)),
        report=tuple(f"capture {b}: {line}" for b, r in enumerate(found) for line in r.report),
    )


def _check(images: Tensor, lights: Tensor, mask: Tensor | None) -> Tensor:
    """Shapes and units; the mask as (H, W) bool."""
    if images.ndim != 4 or 0 in images.shape:
        raise ShapeError("images", expected="(K, C, H, W)", got=str(tuple(images.shape)), mend="stack the images")
    if lights.shape != (len(images), 3):
        raise ShapeError(
            "lights", expected=f"({len(images)}, 3)", got=str(tuple(lights.shape)), mend="one light per image"
        )
    size = tuple(images.shape[-2:])
    if mask is None:
        mask = torch.ones(1, *size, dtype=torch.bool, device=images.device)
    if tuple(mask.shape) != (1, *size) or mask.dtype != torch.bool:
        raise ShapeError(
            "mask", expected=f"{(1, *size)} bool", got=f"{tuple(mask.shape)} {mask.dtype}", mend="mask[None] > 0.5"
        )
    if not bool(mask.any()):
        raise CaptureError("mask", expected="some pixels", got="none", mend="mark the object")
    check_unit("lights", lights, 1, gaps=False)
    behind = int((lights[:, 2] <= 0).sum())
    if 2 * behind > len(lights):
        raise CaptureError(
            "lights",
            expected="most lights on the camera's side (z > 0: x right, y up, z toward the camera)",
            got=f"{behind} of {len(lights)} behind the object",
            mend="use swap_opencv_frame if they are in OpenCV's frame",
        )
    return mask[0]


def _check_conditioning(lights: Tensor, report: list[str]) -> None:
    """Lights must span space: warn from a condition number of 10, refuse above 30."""
    if len(lights) < 3:
        raise CaptureError("lights", expected="at least 3", got=str(len(lights)), mend="photograph under more lights")
    condition = _condition(lights)
    if condition > MAX_CONDITION:
        raise CaptureError(
            "lights",
            expected="directions that span space (condition number up to 30)",
            got=f"{condition:.3g}" if condition < 1e6 else "directions in one plane",
            mend="photograph under lights from more directions",
        )
    if condition > 10:
        report.append(f"lights lie close together (condition number {condition:.1f}): noise is amplified.")
        warnings.warn(report[-1], stacklevel=4)


def _undetermined(grey: Tensor) -> Tensor:
    """Pixels with fewer than three observations that are clearly above zero, (P,) bool; not all of them."""
    level = robust_fit.SHADOW * grey.amax(1, keepdim=True)
    dark = (grey > level.clamp_min(0)).sum(1) < 3
    if bool(dark.all()):
        raise CaptureError(
            "images",
            expected="pixels that at least 3 lights reach",
            got="none inside the mask",
            mend="check exposure, mask and the order of the lights",
        )
    return dark


def _sample(dark: Tensor, seed: int) -> Tensor:
    """Indices of the pixels that decide, among those that are not ``dark``."""
    lit = (~dark).nonzero().flatten()
    generator = torch.Generator().manual_seed(seed)
    return lit[torch.randperm(len(lit), generator=generator)[:SAMPLE_PIXELS].to(lit.device)]


def _hold_out(lights: Tensor, seed: int) -> Tensor | None:
    """A quarter of the lights, drawn so that the others still span space, (K,) bool; None if none does."""
    generator = torch.Generator().manual_seed(seed)
    for _ in range(50):
        held = torch.zeros(len(lights), dtype=torch.bool)
        held[torch.randperm(len(lights), generator=generator)[: len(lights) // 4]] = True
        held = held.to(lights.device)
        if _condition(lights[~held]) <= MAX_CONDITION:
            return held
    return None


def _condition(lights: Tensor) -> float:
    largest, *_, smallest = torch.linalg.svdvals(lights.detach().cpu().double()).tolist()
    return float(largest / max(smallest, 1e-12))


def _score(observed: Tensor, predicted: Tensor, scale: Tensor) -> float:
    """Mean absolute error as a share of the pixel's mean, cut at ``ERROR_CAP``."""
    return ((predicted - observed).abs() / scale).clamp(max=ERROR_CAP).mean().item()


def _scale(grey: Tensor) -> Tensor:
    return grey.abs().mean(1, keepdim=True).clamp_min(1e-12)


def _choose(sample: Tensor, lights: Tensor, seed: int, report: list[str]) -> tuple[str, dict[str, float]]:
    """Lambert or Oren-Nayar, by the error on lights that were held out."""
    count = len(lights)
    if count < MIN_LIGHTS_HELD_OUT:
        report.append(f"lambert: {count} lights are too few to hold any out (from {MIN_LIGHTS_HELD_OUT} on).")
        return "lambert", {}
    held = _hold_out(lights, seed)
    if held is None:
        report.append("lambert: no quarter of the lights can be held out, the others would lie in one plane.")
        return "lambert", {}
    scale = _scale(sample)
    scores: dict[str, float] = {}
    listed = []
    for model in ("lambert", AUTO_MODEL):
        sigma = 0.0 if model == "lambert" else _find_roughness(sample[:, ~held], lights[~held], model, [])
        fitted = robust_fit.fit(sample[:, ~held], lights[~held], model, sigma, lit_only=True)
        predicted = robust_fit.predict(fitted, lights[held], model, sigma)
        scores[model] = _score(sample[:, held], predicted, scale)
        rough = f" with roughness {math.degrees(sigma):.1f} degrees" if model != "lambert" else ""
        listed.append(f"{model}{rough} {scores[model]:.4f}")
    best = min(scores.values())
    chosen = next(model for model, score in scores.items() if score <= best * (1 + TOLERANCE))
    report.append(
        f"{chosen} chosen: error on {int(held.sum())} held-out lights, as a share of the mean: {', '.join(listed)}; "
        f"the simplest model within {TOLERANCE:.0%} of the best is taken."
    )
    return chosen, scores


def _find_roughness(sample: Tensor, lights: Tensor, model: str, report: list[str]) -> float:
    """The roughness that explains the sample best: a coarse grid, a finer one, then a parabola."""
    if len(lights) < MIN_LIGHTS_ROUGHNESS:
        raise CaptureError(
            "lights",
            expected=f"at least {MIN_LIGHTS_ROUGHNESS} to find a roughness",
            got=str(len(lights)),
            mend="photograph under more lights, or use model='lambert'",
        )
    scale = _scale(sample)

    fits: dict[float, robust_fit.PixelFit] = {}
    costs: dict[float, float] = {}

    def visit(sigma: float, start: robust_fit.PixelFit | None) -> None:
        fits[sigma] = robust_fit.fit(sample, lights, model, sigma, steps=4 if start else 8, start=start)
        costs[sigma] = _score(sample, robust_fit.predict(fits[sigma], lights, model, sigma), scale)

    for before, sigma in zip((None, *_COARSE), _COARSE, strict=False):
        visit(sigma, None if before is None else fits[before])
    best = min(costs, key=costs.__getitem__)
    for sigma in (best - _FINE, best + _FINE):
        if sigma > 0:
            visit(sigma, fits[best])
    best = min(costs, key=costs.__getitem__)
    sigma = _parabola(costs, best)
    limit = " (the end of the search: it may be more)" if sigma >= _COARSE[-1] else ""
    report.append(f"roughness {math.degrees(sigma):.1f} degrees{limit}, one for the whole capture.")
    return sigma


def _parabola(costs: dict[float, float], best: float) -> float:
    """Lowest point of the parabola through the best sample and its neighbours; ``best`` at an end."""
    ordered = sorted(costs)
    at = ordered.index(best)
    if at in (0, len(ordered) - 1):
        return best
    x0, x1, x2 = ordered[at - 1 : at + 2]
    left, right = (costs[x1] - costs[x0]) / (x1 - x0), (costs[x2] - costs[x1]) / (x2 - x1)
    curvature = (right - left) / (x2 - x0)
    return min(max((x0 + x1) / 2 - left / (2 * curvature), x0), x2) if curvature > 0 else best
