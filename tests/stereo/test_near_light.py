"""Photometric stereo under near lights against spheres that are shaded exactly."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from torch_orennayar import (
    Camera,
    OrenNayar,
    RangeError,
    ShapeError,
    angular_error,
    near_light_stereo,
    photometric_stereo,
    point_light,
)
from torch_orennayar.geometry.primitives import spiral_lights

DISTANCE = 4.0
CAMERAS = [Camera.orthographic(1.1), Camera.perspective(math.radians(32))]
SIZE = (72, 72)


def sphere(camera: Camera) -> tuple[Tensor, Tensor, Tensor]:
    """Normal, mask and depth of a unit sphere at `DISTANCE` (its centre): rays against the sphere."""
    centre = torch.tensor([0.0, 0.0, -DISTANCE])
    ray = camera.rays(SIZE)[0].double()
    if camera.is_perspective:
        a, b = ray.square().sum(0), -DISTANCE * ray[2]
        root = b * b - a * (DISTANCE**2 - 1)
        mask = root > 0.02
        depth = (b - root.clamp_min(0).sqrt()) / a
    else:
        root = 1 - ray[:2].square().sum(0)
        mask = root > 0.02
        depth = DISTANCE - root.clamp_min(0).sqrt()
    points = camera.points(depth[None, None].float())[0]
    normal = torch.where(mask, points - centre[:, None, None], 0)
    return torch.nn.functional.normalize(normal, dim=0), mask[None], depth[None].float()


def photographs(camera: Camera, model: str, roughness: float) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Images under lights about two diameters away, their positions; normal, mask, depth."""
    normal, mask, depth = sphere(camera)
    positions = 3.0 * spiral_lights(16) - torch.tensor([0.0, 0.0, DISTANCE])
    points = camera.points(depth[None])
    light, irradiance = point_light(points, positions[:, :, None, None], 1.0)
    view = camera.view_directions(SIZE)
    images = OrenNayar(model)(
        normal[None].expand(16, -1, -1, -1), light, view, albedo=0.6, roughness=roughness, irradiance=irradiance
    )
    noise = torch.randn(images.shape, generator=torch.Generator().manual_seed(0))
    return images * mask + 0.0005 * noise, positions, normal, mask, depth


@pytest.mark.filterwarnings("ignore:take the roughness as unknown")  # near lights taken as distant do not determine it
@pytest.mark.parametrize("camera", CAMERAS, ids=["orthographic", "perspective"])
@pytest.mark.parametrize(("model", "roughness"), [("lambert", 0.0), ("vcavity", math.radians(30))])
@pytest.mark.slow
def test_sphere_under_near_lights(camera: Camera, model: str, roughness: float) -> None:
    images, positions, normal, mask, depth = photographs(camera, model, roughness)
    # The distance that a user measures is the mean of the surface itself.
    seen = depth[mask]
    distance = seen.log().mean().exp().item() if camera.is_perspective else seen.mean().item()
    found = near_light_stereo(images, positions, mask, camera=camera, distance=distance, model=model)
    assert found.depth is not None
    assert angular_error(found.normal, normal, mask).summary()["mean"] < 1.0
    assert (found.depth - depth)[mask].abs().mean() < 0.02  # of a radius of 1
    assert abs(found.albedo[mask].mean() - 0.6) < 0.02
    far = torch.nn.functional.normalize(positions + torch.tensor([0.0, 0.0, DISTANCE]), dim=1)
    as_distant = photometric_stereo(images, far, mask, model=model)
    assert angular_error(as_distant.normal, normal, mask).summary()["mean"] > 4.0
    if model != "lambert":
        assert abs(found.roughness[mask].mean() - roughness) < math.radians(3)


@pytest.mark.slow
def test_maps_of_distant_lights_are_distant_lights() -> None:
    images, _, _, mask, _ = photographs(CAMERAS[0], "vcavity", 0.5)
    lights = spiral_lights(16)
    with pytest.warns(UserWarning, match="roughness as unknown"):  # they were near
        distant = photometric_stereo(images, lights, mask, model="vcavity")
    with pytest.warns(UserWarning, match="roughness as unknown"):
        mapped = photometric_stereo(images, lights[:, :, None, None].expand(-1, -1, *SIZE), mask, model="vcavity")
    assert torch.allclose(distant.normal, mapped.normal, atol=1e-4)
    assert abs(distant.roughness.max() - mapped.roughness.max()) < 1e-4


def test_mistakes_are_named() -> None:
    images, positions, _, mask, depth = photographs(CAMERAS[0], "lambert", 0.0)
    camera, distance = CAMERAS[0], float(depth[mask].mean())
    with pytest.raises(RangeError, match="z points forward"):
        near_light_stereo(images, positions * torch.tensor([1.0, 1.0, 6.0]), mask, camera=camera, distance=distance)
    with pytest.raises(ShapeError, match="positions"):
        near_light_stereo(images, positions[:3], mask, camera=camera, distance=distance)
    with pytest.raises(ShapeError, match="mask"):
        near_light_stereo(images, positions, mask[0], camera=camera, distance=distance)
    with pytest.raises(RangeError, match="distance"):
        near_light_stereo(images, positions, mask, camera=CAMERAS[1], distance=-1.0)
    with pytest.raises(RangeError, match="rounds"):
        near_light_stereo(images, positions, mask, camera=camera, distance=distance, rounds=0)
