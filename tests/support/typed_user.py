"""What a type checker must infer for a user's code; mypy reads this file, and nothing runs it."""

from __future__ import annotations

from torch import Tensor
from typing_extensions import assert_type

import torch_orennayar as ton


def shading(normal: Tensor, light: Tensor, points: Tensor) -> None:
    """A call of the layer is a tensor, although ``nn.Module`` declares calls as ``Any``."""
    layer = ton.OrenNayar("vcavity")
    assert_type(layer(normal, light, albedo=0.5, roughness=0.3), Tensor)
    assert_type(layer.choice, ton.ModelChoice | None)
    assert_type(ton.oren_nayar(normal, light, light, 0.5, 0.3, irradiance=2.0), Tensor)
    assert_type(ton.point_light(points, light, 1.0), tuple[Tensor, Tensor])
    assert_type(ton.simplest_model(tolerance=0.01).error, float)
    assert_type(ton.MODELS["vcavity"].cost, float | None)
    layer(normal, light, rougness=0.3)  # type: ignore[call-arg]


def rendering(vertices: Tensor, faces: Tensor, light: Tensor) -> None:
    """Maps of a view, and images shaded from it."""
    seen = ton.render_normals(ton.normalise_mesh(vertices), faces, ton.Camera.orthographic(), (32, 32))
    assert_type(seen.normal, Tensor)
    assert_type(seen.camera, ton.Camera)
    assert_type(seen.shade(ton.OrenNayar(), light), Tensor)
    assert_type(ton.antialias(seen.mask.float(), seen, vertices, faces), Tensor)
    assert_type(ton.angular_error(seen.normal, seen.normal).summary(), dict[str, float])


def recovering(capture: ton.Capture) -> None:
    """The result of a single capture names one model."""
    found = ton.photometric_stereo(capture.images, capture.lights, capture.mask)
    assert_type(found.normal, Tensor)
    assert_type(found.model, str)


def learning() -> None:
    """Samples of the synthetic captures are typed by key."""
    images = ton.SyntheticCaptures("images").sample(0)
    assert_type(images["images"], Tensor)
    pixels = ton.SyntheticCaptures("pixels").sample(0)
    assert_type(pixels["observed"], Tensor)
