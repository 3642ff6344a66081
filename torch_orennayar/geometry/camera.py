"""Cameras: orthographic and perspective, batched.

Camera frame: x right, y up, z toward the viewer; the camera looks along -z. Image rows go down; pixel
(i, j) is sampled at (j + 1/2, i + 1/2) of a continuous image of size (H, W).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.defaults import independent_of_defaults
from ..core.errors import RangeError, ShapeError
from ..core.optional import require
from .camera_checks import check_extrinsics, check_intrinsics
from .frames import swap_opencv_frame

if TYPE_CHECKING:
    from kornia.geometry.camera import PinholeCamera

Vector = Tensor | Sequence[float]
NEAR = 1e-2
"""Default distance of the near plane, world units: set by hand for objects of about unit size."""


@dataclass(frozen=True)
class Camera:
    """A batch of cameras; made by ``orthographic``, ``perspective`` or ``from_intrinsics``.

    Image lengths are in units of half the image height, so that one camera applies to every image size (of its
    aspect ratio, where intrinsics fix one). Tensors may require gradients.

    Attributes:
        rotation: (B, 3, 3) world to camera; its rows are right, up and back.
        eye: (B, 3) position of the camera in the world.
        focal: (B, 2) half heights per world unit (orthographic) or per unit tangent (perspective), x and y.
        centre: (B, 2) the principal point relative to the image centre, in half heights, right and up.
        is_perspective: True for perspective, False for orthographic projection.
        near: depth of the near plane, world units (perspective only; orthographic cameras clip nothing).
        aspect: width / height of the images that intrinsics belong to, or None for any.
    """

    rotation: Tensor
    eye: Tensor
    focal: Tensor
    centre: Tensor
    is_perspective: bool
    near: float = NEAR
    aspect: float | None = None

    @staticmethod
    @independent_of_defaults
    def orthographic(
        half_height: float | Tensor = 1.0,
        eye: Vector = (0.0, 0.0, 2.0),
        target: Vector = (0.0, 0.0, 0.0),
        up: Vector = (0.0, 1.0, 0.0),
    ) -> Camera:
        """An orthographic camera; by default on the z axis, looking at the origin, y up.

        Args:
            half_height: half the height of the field of view, world units; number or (B,).
            eye: (3,) or (B, 3), the camera's position; depth is measured from here and may be negative.
            target: (3,) or (B, 3), the point that the camera looks at.
            up: (3,) or (B, 3), the direction that is up in the image.

        Returns:
            B cameras; differentiable in all arguments.

        Raises:
            RangeError: ``eye`` equals ``target``, ``up`` is parallel to the view, or a size is not positive.

        Example:
            >>> import torch_orennayar as ton
            >>> ton.Camera.orthographic(1.5).focal.shape
            torch.Size([1, 2])
        """
        extent = torch.as_tensor(half_height, dtype=_dtype(half_height, eye, target))
        if not bool(((extent > 0) & extent.isfinite()).all()):
            raise RangeError("half_height", expected="a positive size", got=str(half_height), mend="use e.g. 1.0")
        return _look_at(eye, target, up, 1 / extent, perspective=False)

    @staticmethod
    @independent_of_defaults
    def perspective(
        fov_y: float | Tensor,
        eye: Vector = (0.0, 0.0, 3.0),
        target: Vector = (0.0, 0.0, 0.0),
        up: Vector = (0.0, 1.0, 0.0),
        *,
        near: float = NEAR,
    ) -> Camera:
        """A pinhole camera with square pixels.

        Args:
            fov_y: vertical field of view in radians, in (0, pi); number or (B,).
            eye: (3,) or (B, 3), the position of the pinhole.
            target: (3,) or (B, 3), the point that the camera looks at.
            up: (3,) or (B, 3), the direction that is up in the image.
            near: distance of the near plane, world units: nearer surfaces are not drawn.

        Returns:
            B cameras; differentiable in all arguments but ``near``.

        Raises:
            RangeError: as `orthographic`; ``fov_y`` outside (0, pi); ``near`` not positive.

        Example:
            >>> import math, torch_orennayar as ton
            >>> round(ton.Camera.perspective(math.radians(90)).focal[0, 0].item(), 6)
            1.0
        """
        angle = torch.as_tensor(fov_y, dtype=_dtype(fov_y, eye, target))
        if not bool(((angle > 0) & (angle < math.pi)).all()):
            raise RangeError(
                "fov_y", expected="radians in (0, pi)", got=str(fov_y), mend="use math.radians for degrees"
            )
        if not near > 0:
            raise RangeError("near", expected="a positive distance", got=str(near), mend="use e.g. 0.01")
        return _look_at(eye, target, up, 1 / (angle / 2).tan(), perspective=True, near=near)

    @staticmethod
    @independent_of_defaults
    def from_intrinsics(
        intrinsics: Tensor, size: tuple[int, int], extrinsics: Tensor | None = None, *, near: float = NEAR
    ) -> Camera:
        """A camera from OpenCV's matrix K, in which integer coordinates are pixel centres.

        Args:
            intrinsics: K, (3, 3) or (B, 3, 3), without skew; differentiable.
            size: (H, W) in pixels of the images that K belongs to.
            extrinsics: (4, 4), (3, 4) or batched: world to OpenCV camera; default: the world is the OpenCV
                camera's frame. Differentiable.
            near: distance of the near plane, world units: nearer surfaces are not drawn.

        Raises:
            ShapeError: other shapes.
            RangeError: skew, focal lengths that are not positive, numbers that are not finite, or extrinsics whose
                rotation is none, beyond rounding.

        Example:
            >>> import torch, torch_orennayar as ton
            >>> k = torch.tensor([[100.0, 0, 49.5], [0, 100.0, 49.5], [0, 0, 1]])
            >>> ton.Camera.from_intrinsics(k, (100, 100)).centre.tolist()
            [[0.0, -0.0]]
        """
        k = intrinsics if intrinsics.ndim == 3 else intrinsics[None]
        if k.shape[1:] != (3, 3):
            raise ShapeError(
                "intrinsics", expected="(3, 3) or (B, 3, 3)", got=str(tuple(intrinsics.shape)), mend="give K"
            )
        check_intrinsics(k)
        focal = torch.stack((k[:, 0, 0], k[:, 1, 1]), 1)
        half = size[0] / 2
        right = (k[:, 0, 2] + 0.5 - size[1] / 2) / half
        up = -(k[:, 1, 2] + 0.5 - size[0] / 2) / half
        if extrinsics is None:
            extrinsics = torch.eye(4).to(k)
        e = extrinsics if extrinsics.ndim == 3 else extrinsics[None]
        if e.shape[1:] not in ((4, 4), (3, 4)):
            raise ShapeError("extrinsics", expected="(4, 4) or (3, 4)", got=str(tuple(e.shape)), mend="world to camera")
        check_extrinsics(e)
        rotation = swap_opencv_frame(e[:, :3, :3], dim=1)
        eye = -(e[:, :3, :3].transpose(1, 2) @ e[:, :3, 3:])[:, :, 0]
        batch = max(len(k), len(e))
        return Camera(
            rotation.expand(batch, 3, 3),
            eye.expand(batch, 3),
            (focal / half).expand(batch, 2),
            torch.stack((right, up), 1).expand(batch, 2),
            True,
            near,
            size[1] / size[0],
        )

    @staticmethod
    def from_kornia(camera: PinholeCamera) -> Camera:
        """From a ``kornia.geometry.camera.PinholeCamera`` (OpenCV frame).

        Example:
            >>> import torch, torch_orennayar as ton
            >>> camera = ton.Camera.perspective(1.0)
            >>> again = ton.Camera.from_kornia(camera.to_kornia((60, 80)))
            >>> bool(torch.allclose(again.focal, camera.focal))
            True
        """
        size = int(camera.height.flatten()[0]), int(camera.width.flatten()[0])
        return Camera.from_intrinsics(camera.intrinsics[:, :3, :3], size, camera.extrinsics)

    def to_kornia(self, size: tuple[int, int]) -> PinholeCamera:
        """As a ``kornia.geometry.camera.PinholeCamera`` for images of ``size`` (H, W); perspective only.

        Raises:
            RangeError: the camera is orthographic.
        """
        require("kornia")
        from kornia.geometry.camera import PinholeCamera

        if not self.is_perspective:
            raise RangeError("camera", expected="a perspective camera", got="orthographic", mend="use perspective()")
        half = size[0] / 2
        batch = len(self.eye)
        k = torch.eye(4).to(self.focal).repeat(batch, 1, 1)
        k[:, 0, 0], k[:, 1, 1] = self.focal[:, 0] * half, self.focal[:, 1] * half
        k[:, 0, 2] = self.centre[:, 0] * half + size[1] / 2 - 0.5
        k[:, 1, 2] = -self.centre[:, 1] * half + size[0] / 2 - 0.5
        e = torch.eye(4).to(self.focal).repeat(batch, 1, 1)
        e[:, :3, :3] = swap_opencv_frame(self.rotation, dim=1)
        e[:, :3, 3] = -(e[:, :3, :3] @ self.eye[:, :, None])[:, :, 0]
        height, width = (torch.full((batch,), s).to(self.focal) for s in size)
        return PinholeCamera(k, e, height, width)

    def to_camera_frame(self, points: Tensor) -> Tensor:
        """Transform world points (V, 3) or (B, V, 3) to the camera frame, (B, V, 3); differentiable."""
        x, y, z = (points - self.eye.to(points)[:, None]).unbind(-1)
        rows = self.rotation.to(points).unbind(1)
        # Summed in one fixed order, so that ONNX graphs round in the same way.
        return torch.stack([x * r[:, :1] + y * r[:, 1:2] + z * r[:, 2:] for r in rows], -1)

    def to_image(self, points: Tensor, size: tuple[int, int]) -> Tensor:
        """Project camera-frame points (B, V, 3) to homogeneous pixels (x w, y w, w); w is 1 if orthographic."""
        height, width = self._check_size(size)
        half = height / 2
        x, y, z = points.unbind(-1)
        w = -z if self.is_perspective else torch.ones_like(z)
        focal, centre = self.focal.to(points)[:, None], self.centre.to(points)[:, None]
        u = width / 2 * w + half * (focal[..., 0] * x + centre[..., 0] * w)
        v = height / 2 * w - half * (focal[..., 1] * y + centre[..., 1] * w)
        return torch.stack((u, v, w), -1)

    def rays(self, size: tuple[int, int]) -> Tensor:
        """The point on every pixel's line of sight at depth 1 (perspective) or 0 (orthographic).

        Args:
            size: (H, W) in pixels.

        Returns:
            (B, 3, H, W), camera frame, z = -1 or 0; differentiable in the camera.
        """
        height, width = self._check_size(size)
        half = height / 2
        column = (torch.arange(width).to(self.focal) + 0.5 - width / 2) / half
        row = -(torch.arange(height).to(self.focal) + 0.5 - height / 2) / half
        x = (column - self.centre[:, :1]) / self.focal[:, :1]  # (B, W)
        y = (row - self.centre[:, 1:]) / self.focal[:, 1:]  # (B, H)
        shape = (len(self.focal), height, width)
        z = (x[:, None] * 0 - float(self.is_perspective)).expand(shape)
        return torch.stack((x[:, None].expand(shape), y[:, :, None].expand(shape), z), 1)

    def view_directions(self, size: tuple[int, int]) -> Tensor:
        """Unit directions from the surface to the camera at every pixel, (B, 3, H, W), camera frame; differentiable.

        Example:
            >>> import torch_orennayar as ton
            >>> ton.Camera.orthographic().view_directions((1, 1)).flatten().tolist()
            [0.0, 0.0, 1.0]
        """
        if self.is_perspective:
            return -F.normalize(self.rays(size), dim=1)
        rays = self.rays(size)
        return torch.zeros_like(rays) + rays.new_tensor((0.0, 0.0, 1.0)).reshape(1, 3, 1, 1)

    def points(self, depth: Tensor) -> Tensor:
        """Unproject depth (B, 1, H, W) to surface points (B, 3, H, W) in the camera frame; differentiable."""
        rays = self.rays((depth.shape[-2], depth.shape[-1])).to(depth)
        if self.is_perspective:
            return rays * depth
        return rays - depth * rays.new_tensor((0.0, 0.0, 1.0)).reshape(1, 3, 1, 1)

    def _check_size(self, size: tuple[int, int]) -> tuple[int, int]:
        height, width = size
        if height < 1 or width < 1:
            raise ShapeError("size", expected="(H, W) of at least 1", got=str(size), mend="give pixels")
        # Set by hand: allows for sizes that were rounded to whole pixels.
        if self.aspect is not None and abs(width / height / self.aspect - 1) > 1.5 / min(size):
            raise ShapeError(
                "size",
                expected=f"the aspect ratio {self.aspect:.4g} of the intrinsics",
                got=f"{width} x {height}",
                mend="crop the intrinsics or change the size",
            )
        return height, width


def _dtype(*values: object) -> torch.dtype:
    """The dtype of the first floating-point tensor, or torch's default."""
    kinds = [v.dtype for v in values if isinstance(v, Tensor) and v.is_floating_point()]
    return kinds[0] if kinds else torch.get_default_dtype()


def _vectors(name: str, value: Vector) -> Tensor:
    """Bring (3,) or (B, 3) to (B, 3)."""
    vectors = torch.as_tensor(value)
    if vectors.ndim not in (1, 2) or vectors.shape[-1] != 3:
        raise ShapeError(name, expected="(3,) or (B, 3)", got=str(tuple(vectors.shape)), mend="give x, y, z")
    return vectors.reshape(-1, 3)


def _look_at(
    eye: Vector, target: Vector, up: Vector, focal: Tensor, *, perspective: bool, near: float = NEAR
) -> Camera:
    """A camera at ``eye`` that looks at ``target``, with focal lengths (B,) or a number, equal in x and y."""
    device = next((v.device for v in (eye, target, up) if isinstance(v, Tensor)), focal.device)
    focal = focal.to(device)
    place, goal, upward = (_vectors(name, v).to(focal) for name, v in (("eye", eye), ("target", target), ("up", up)))
    back = place - goal
    right = torch.linalg.cross(*torch.broadcast_tensors(upward, back))
    degenerate = ~(right.norm(dim=1) > 1e-6 * back.norm(dim=1) * upward.norm(dim=1))
    if bool(degenerate.any()):
        raise RangeError(
            "eye, target, up",
            expected="an eye apart from the target, and an up that is not the view's direction",
            got=f"such a view at index {degenerate.nonzero()[0].item()} of the batch",
            mend="move the eye or choose another up",
        )
    back, right = F.normalize(back, dim=1), F.normalize(right, dim=1)
    rotation = torch.stack(
        torch.broadcast_tensors(right, torch.linalg.cross(*torch.broadcast_tensors(back, right)), back), 1
    )
    batch = max(len(rotation), len(place), focal.numel())
    return Camera(
        rotation.expand(batch, 3, 3),
        place.expand(batch, 3),
        focal.reshape(-1, 1).expand(batch, 2),
        torch.zeros(batch, 2).to(focal),
        perspective,
        near,
    )
