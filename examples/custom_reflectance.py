"""Reflectance models of your own: a Minnaert law and a toon step, registered and then used like any other model.

python examples/custom_reflectance.py
python -m scripts.benchmarks.chart_reflectance --plugin examples/custom_reflectance.py     # adds them to the chart
"""

import sys
from pathlib import Path

import torch
import torch.nn.functional as F
from PIL import Image

import torch_orennayar as ton


def minnaert(ci: torch.Tensor, co: torch.Tensor, lv: torch.Tensor, rho: torch.Tensor, k: torch.Tensor) -> torch.Tensor:
    """Minnaert (1941): ``rho (ci co)^k``, the limb darkening of planets; k takes the place of roughness."""
    return rho * (ci * co) ** k


def toon(ci: torch.Tensor, co: torch.Tensor, lv: torch.Tensor, rho: torch.Tensor, sigma: torch.Tensor) -> torch.Tensor:
    """Three flat tones: ``pi f_r ci`` is rounded to thirds by smooth steps, so that gradients remain."""
    step = torch.sigmoid((ci[..., None] - torch.tensor([0.1, 0.4, 0.8]).to(ci)) / (0.01 + 0.05 * sigma[..., None]))
    return rho * step.sum(-1) / 3 / ci


def toon_specular(ci: torch.Tensor, co: torch.Tensor, lv: torch.Tensor) -> torch.Tensor:
    """A flat highlight: Blinn's lobe against a threshold. Lobes are plain functions that the caller adds."""
    return torch.sigmoid((ton.blinn_phong(ci, co, lv, 60.0) - 4) / 0.2) / ci.clamp_min(0.05)


ton.register_model("minnaert", minnaert, source="Minnaert 1941", gradients="smooth above the horizon")
ton.register_model("toon", toon, source="three tones, this example", gradients="steep at the steps")


def main(path: str = "custom.png") -> None:
    """Draw a sphere by Lambert, Minnaert, toon, and toon with a highlight, and export the toon model as ONNX."""
    y, x = torch.meshgrid(torch.linspace(1.1, -1.1, 256), torch.linspace(-1.1, 1.1, 256), indexing="ij")
    inside = x * x + y * y < 1
    normal = torch.stack((x, y, (1 - x * x - y * y).clamp_min(0).sqrt())) * inside
    light = F.normalize(torch.tensor([[0.5, 0.6, 0.7]]), dim=1)
    view = torch.tensor([[0.0, 0.0, 1.0]])
    images = []  # (1, 256, 256) each, linear light
    for name, roughness in (("lambert", 0.0), ("minnaert", 0.6), ("toon", 0.2)):
        images.append(ton.OrenNayar(name)(normal[None], light, albedo=0.8, roughness=roughness)[0])
    ci, co = ((normal * d.reshape(3, 1, 1)).sum(0, keepdim=True) for d in (light, view))
    lit = (ci > 0) & (co > 0)
    images.append(images[-1] + 0.4 * toon_specular(ci, co, (light * view).sum()) * ci * lit)

    white = [torch.where(inside, ton.linear_to_srgb(image), 1.0) for image in images]
    pixels = (255 * torch.cat(white, dim=2)[0]).round().byte()  # side by side
    Image.fromarray(pixels.numpy()).convert("RGB").save(path)
    print(f"wrote {path}")
    print(f"wrote {ton.export_onnx('shading', Path(path).with_suffix('.onnx'), model='toon')}")


if __name__ == "__main__":
    main(*sys.argv[1:])
