"""The part of ``report.html`` in which the light is dragged and the relief is turned: markup, data and script."""

from __future__ import annotations

import base64
import json
import math
from importlib.resources import files

import torch
from torch import Tensor

from ..reconstruction import Reconstruction
from ..reflectance.coefficients import VCAVITY_LINEAR, VCAVITY_SHAPE
from .result_maps import ResultMaps
from .srgb import as_rgb

SHADED = frozenset({"lambert", "qualitative", "qualitative-0.57", "fujii", "full", "vcavity", "eon"})
"""Models whose formulas the script has."""
VIEWER_SIDE, RELIEF_SIDE = 384, 128
"""Pixels of the longer side of the relit picture and of the relief, about; set by hand, for the page's size."""
OUTSIDE = -32768
"""Stored height where there is no surface."""
FULL = 32767
"""Largest stored value."""

_MARKUP = """<div class="viewer">
<canvas id="viewer" tabindex="0" role="img"
 aria-label="The object; drag, or press the arrow keys, to move the light or to turn it"></canvas>
<p><label><input type="radio" name="viewer-mode" value="light" checked> Drag moves the light</label>
<label><input type="radio" name="viewer-mode" value="turn"> Drag turns the surface</label></p>
<p id="viewer-says" role="status"></p>
</div>
<script type="application/json" id="viewer-data">{data}</script>
<script>{script}</script>"""


def viewer_markup(found: Reconstruction, maps: ResultMaps) -> str:
    """HTML of the viewer, or nothing where the model's formula is not among the script's.

    Args:
        found: the result.
        maps: its maps.
    """
    if found.model not in SHADED:
        return ""
    script = files(__package__).joinpath("result_viewer.js").read_text(encoding="utf-8")
    return _MARKUP.format(data=json.dumps(viewer_data(found, maps)), script=script)


def viewer_data(found: Reconstruction, maps: ResultMaps) -> dict[str, object]:
    """What the script reads: thinned maps as 16-bit integers and the model's numbers."""
    step = math.ceil(max(maps.mask.shape[1:]) / VIEWER_SIDE)
    normal, albedo, roughness, mask = (
        part[:, ::step, ::step] for part in (maps.normal, maps.albedo, maps.roughness, maps.mask)
    )
    highlights = [] if maps.specular is None else [lobe[:, ::step, ::step] for lobe in maps.specular]
    return {
        "width": mask.shape[2],
        "height": mask.shape[1],
        "model": found.model,
        "falloff": found.falloff,
        "exponents": list(found.exponents),
        "exposure": 1 / maps.display_top,
        "shape": VCAVITY_SHAPE,
        "linear": VCAVITY_LINEAR,
        "normals": _stored(torch.cat((normal, roughness))),
        "albedos": _stored(torch.cat((as_rgb(albedo), mask.float()))),
        "highlights": [_stored(torch.cat((as_rgb(lobe), mask.float()))) for lobe in highlights],
        "heights": _heights(maps),
    }


def _stored(values: Tensor) -> dict[str, object]:
    """(4, H, W) pixel by pixel, each channel over its largest magnitude."""
    scale = values.abs().amax((1, 2)).clamp_min(1e-12)
    whole = (values / scale[:, None, None] * FULL).round().to(torch.int16).permute(1, 2, 0)
    return {"scale": scale.tolist(), "values": _base64(whole)}


def _heights(maps: ResultMaps) -> dict[str, object]:
    """The relief over the longer side of the picture, around 0."""
    mask = maps.mask[:, :: maps.step, :: maps.step]
    step = math.ceil(max(mask.shape[1:]) / RELIEF_SIDE)
    height, inside = maps.depth[0, ::step, ::step] / max(maps.mask.shape[1:]), mask[0, ::step, ::step]
    seen = height[inside]
    height = height - (seen.mean() if len(seen) else 0.0)
    scale = height[inside].abs().max().clamp_min(1e-9).item() if len(seen) else 1.0
    whole = torch.where(inside, (height / scale * FULL).round(), OUTSIDE).to(torch.int16)
    return {"size": list(whole.shape), "scale": scale, "values": _base64(whole)}


def _base64(values: Tensor) -> str:
    return base64.b64encode(values.contiguous().numpy().astype("<i2").tobytes()).decode()
