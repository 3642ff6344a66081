"""Photometric stereo under near lights: normals and depth are solved in alternation."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..core.checks import check_floating, check_mask
from ..core.defaults import independent_of_defaults
from ..core.errors import RangeError, ShapeError
from ..core.findings import Finding
from ..core.progress import track
from ..geometry.camera import Camera
from ..geometry.integrate import integrate_normals
from ..reconstruction import Reconstruction
from ..shading.point_light import point_light
from .broken_frames import find_broken_frames
from .capture_checks import find_dark_pixels, find_valid, leave_out
from .pixel_sample import SAMPLE_PIXELS, PixelSample, draw_places
from .solver import photometric_stereo

DARK = 1e-3
"""Least irradiance that images are divided by, as a share of its light's mean over the object: behind a light there is
none. Set by hand."""


@torch.no_grad()
@independent_of_defaults
def near_light_stereo(
    images: Tensor,
    positions: Tensor,
    mask: Tensor | None = None,
    *,
    camera: Camera | None = None,
    distance: float | None = None,
    model: str = "auto",
    rounds: int = 2,
    valid: Tensor | None = None,
    seed: int = 0,
) -> Reconstruction:
    """Recover normals, depth, albedo, roughness and highlights from images under near point lights.

    Normals and depth are solved in alternation: the depth gives the direction and irradiance of each light at every
    pixel (`point_light`), `photometric_stereo` the normals, `integrate_normals` the depth. The first round starts from
    a plane that faces the camera. All rounds take Lambert's model but the last one, which takes ``model``. Perspective
    views are solved in each pixel's own frame. Photographs that contradict the others are left out before the last
    round. Not differentiable.

    Args:
        images: (K, C, H, W) linear light, divided by the lights' intensities: their irradiance at distance 1.
        positions: (K, 3) of the lights in the camera frame (x right, y up, z toward the viewer, the eye at 0, so that
            what it sees has negative z), in the unit of ``distance``. Without a camera: in pixels from the middle of
            the picture, z from the object's mean height, as `find_light_positions` gives them.
        mask: (1, H, W) bool; default all pixels. Regions that do not touch get the same mean distance.
        camera: one camera; None for an orthographic view in pixels.
        distance: of the object from the camera along its axis: the mean of an orthographic view's depth, the
            geometric mean of a perspective view's. Not found from the images: measure it. None without a camera.
        model: as for `photometric_stereo`.
        rounds: of the alternation before the last one.
        valid: as for `photometric_stereo`.
        seed: as for `photometric_stereo`.

    Returns:
        A `Reconstruction` with depth, (1, H, W), along the camera's axis, 0 outside the mask; without a camera height
        toward the viewer in pixels. Albedo is that of a source of irradiance 1.

    Raises:
        ShapeError: shapes do not fit together.
        RangeError: a distance that is not positive (perspective) or finite, a light in or behind the surface for
            most pixels, less than one round.
        CaptureError: as `photometric_stereo`.

    Source:
        Alternation between normals and depth as in Papadhimitri & Favaro 2014, "Uncalibrated near-light photometric
        stereo"; here with calibrated lights.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> from torch_orennayar.geometry.primitives import spiral_lights
        >>> positions = 3 * spiral_lights(8) - torch.tensor([0.0, 0.0, 4.0])
        >>> camera = ton.Camera.orthographic()
        >>> plane = camera.points(torch.full((1, 1, 9, 9), 4.0))
        >>> light, irradiance = ton.point_light(plane, positions.reshape(8, 3, 1, 1), 1.0)
        >>> images = 0.5 * irradiance * light[:, 2:]  # a Lambertian plane of albedo 0.5
        >>> found = ton.near_light_stereo(images, positions, camera=camera, distance=4.0, model="lambert")
        >>> [round(x.item(), 3) for x in found.albedo.aminmax()]
        [0.5, 0.5]
    """
    check_floating(images=images, positions=positions)
    if rounds < 1:
        raise RangeError("rounds", expected="at least 1", got=str(rounds), mend="use the default, 2")
    flat = camera is None
    if camera is None:
        if distance is not None:
            raise RangeError("distance", expected="None without a camera", got=str(distance), mend="give both or none")
        camera = Camera.orthographic(images.shape[-2] / 2)
    elif distance is None:
        raise RangeError("distance", expected="a number with a camera", got="None", mend="measure it")
    scene = _Scene.of(images, positions, mask, valid, camera, 0.0 if distance is None else distance)
    depth = torch.full_like(images[0, :1], scene.distance)
    for _ in track(range(rounds), "near lights", rounds):
        _, depth = scene.solve(scene.as_distant(depth), "lambert", seed)
    lit = scene.as_distant(depth)
    scene, findings = scene.without_broken_frames(lit, seed)
    if findings:
        _, depth = scene.solve(scene.as_distant(depth), "lambert", seed)
        lit = scene.as_distant(depth)
    found, depth = scene.solve(lit, model, seed)
    depth = torch.where(scene.inside, -depth if flat else depth, 0)
    return replace(found, depth=depth, report=(*findings, *found.report))


@dataclass(frozen=True)
class _Scene:
    """Photographs under near lights.

    Attributes:
        images: (K, C, H, W).
        positions: (K, 3) in the camera frame.
        inside: (1, H, W) bool, the object.
        valid: (K, 1, H, W) bool, the samples that count.
        camera: one.
        distance: of the object from the camera.
    """

    images: Tensor
    positions: Tensor
    inside: Tensor
    valid: Tensor
    camera: Camera
    distance: float

    @staticmethod
    def of(
        images: Tensor, positions: Tensor, mask: Tensor | None, valid: Tensor | None, camera: Camera, distance: float
    ) -> _Scene:
        """Check that all fits together."""
        inside = _check(images, positions, mask, camera, distance)
        counted = find_valid(images, inside[0], valid)
        if counted is None:
            counted = torch.ones_like(images[:, :1], dtype=torch.bool)
        return _Scene(images, positions, inside, counted, camera, float(distance))

    def as_distant(self, depth: Tensor) -> tuple[Tensor, Tensor]:
        """Images (K, C, H, W) under lights of irradiance 1, and directions (K, 3, H, W) to these in pixels' own frames.

        ``depth``: (1, H, W) of the surface.
        """
        points, view = self.camera.points(depth[None]), self._view()
        light, irradiance = point_light(points, self.positions[:, :, None, None].to(self.images), 1.0)
        _check_lights(light, view, self.inside)
        irradiance = torch.maximum(irradiance, DARK * irradiance[:, :, self.inside[0]].mean(2, keepdim=True)[..., None])
        return torch.where(self.inside, self.images / irradiance, 0), _rotate(light, view)

    def solve(self, lit: tuple[Tensor, Tensor], model: str, seed: int) -> tuple[Reconstruction, Tensor]:
        """What `photometric_stereo` finds for what `as_distant` gives, and the depth of its normals."""
        seen, light = lit
        found = photometric_stereo(seen, light, self.inside, model=model, valid=self.valid, seed=seed)
        normal = torch.where(self.inside, _rotate(found.normal, self._view(), back=True), 0)
        return replace(found, normal=normal), _integrate(normal, self.inside, self.camera, self.distance)

    def without_broken_frames(self, lit: tuple[Tensor, Tensor], seed: int) -> tuple[_Scene, list[Finding]]:
        """The photographs that do not contradict the others by what `as_distant` gives, and a finding on those left."""
        seen, _ = leave_out(lit[0], self.valid, self.inside[0])
        bright = self.inside[0] & ~find_dark_pixels(seen, self.inside[0])
        sample = PixelSample.gather(seen, lit[1], draw_places(bright, SAMPLE_PIXELS, seed))
        broken, findings = find_broken_frames(sample)
        kept = replace(self, images=self.images[~broken], positions=self.positions[~broken], valid=self.valid[~broken])
        return (kept, findings) if findings else (self, [])

    def _view(self) -> Tensor:
        return self.camera.view_directions((self.images.shape[2], self.images.shape[3]))[0].to(self.images)


def _integrate(normal: Tensor, inside: Tensor, camera: Camera, distance: float) -> Tensor:
    """Depth (1, H, W) of the surface with these normals at this mean distance; outside the mask a plane."""
    depth = integrate_normals(normal, inside, camera=camera)
    return torch.where(inside, depth * distance if camera.is_perspective else depth + distance, distance)


def _rotate(vectors: Tensor, view: Tensor, *, back: bool = False) -> Tensor:
    """Rotate (..., 3, H, W) by the smallest angle that makes every pixel's view (3, H, W) the z axis, or back."""
    x, y, z = view.unbind(0)
    share = 1 / (1 + z)
    rows = (
        torch.stack((1 - x * x * share, -x * y * share, -x)),
        torch.stack((-x * y * share, 1 - y * y * share, -y)),
        torch.stack((x, y, z)),
    )
    matrix = torch.stack(rows)  # (3, 3, H, W), row by row
    return torch.einsum("jihw,...jhw->...ihw" if back else "ijhw,...jhw->...ihw", matrix, vectors)


def _check_lights(light: Tensor, view: Tensor, inside: Tensor) -> None:
    """Refuse positions if most lights lie behind most of the object: then frames are mixed up."""
    front = (light * view).sum(1)[:, inside[0]] > 0
    behind = (front.double().mean(1) < 0.5).nonzero().flatten().tolist()
    if 2 * len(behind) > len(light):
        raise RangeError(
            "positions",
            expected="lights on the camera's side of the object (camera frame: the eye at 0, the object at z < 0)",
            got=f"{len(behind)} of {len(light)} behind it",
            mend="check unit and frame; swap_opencv_frame helps where z points forward",
        )


def _check(images: Tensor, positions: Tensor, mask: Tensor | None, camera: Camera, distance: float) -> Tensor:
    """Check shapes and ranges that `photometric_stereo` does not check; return the mask, (1, H, W) bool."""
    if images.ndim != 4:
        raise ShapeError("images", expected="(K, C, H, W)", got=str(tuple(images.shape)), mend="one capture at a time")
    if positions.shape != (len(images), 3):
        raise ShapeError(
            "positions", expected=f"({len(images)}, 3)", got=str(tuple(positions.shape)), mend="one per image"
        )
    if len(camera.focal) != 1:
        raise ShapeError("camera", expected="one camera", got=f"a batch of {len(camera.focal)}", mend="pass one")
    if not math.isfinite(distance) or (camera.is_perspective and distance <= 0):
        raise RangeError("distance", expected="a positive number", got=str(distance), mend="measure it")
    return check_mask(mask, images)
