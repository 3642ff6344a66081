"""The part of the photographs that is worked on, and at which size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from ..core.errors import RangeError
from ..core.optional import require
from ..geometry.primitives import Ball

Number = TypeVar("Number", float, Tensor)


@dataclass(frozen=True)
class Region:
    """A rectangle of upright photographs, reduced.

    Attributes:
        crop: left, top, width and height in pixels of the whole photographs; None for all of them.
        scale: factor of the size, in (0, 1].
    """

    crop: Sequence[int] | None = None
    scale: float = 1.0

    def __post_init__(self) -> None:
        """Check the scale and the kind of numbers.

        Raises:
            RangeError: out of range.
        """
        if not 0 < self.scale <= 1:
            raise RangeError("scale", expected="a factor above 0, at most 1", got=str(self.scale), mend="give 0.5 say")
        if self.crop is not None and (len(self.crop) != 4 or min(self.crop[:2]) < 0 or min(self.crop[2:]) < 1):
            mend = "give left, top, width and height in pixels"
            raise RangeError("crop", expected="left, top >= 0 and width, height >= 1", got=str(self.crop), mend=mend)

    @property
    def is_whole(self) -> bool:
        """Whether nothing is cut or reduced."""
        return self.crop is None and self.scale == 1

    def check(self, size: tuple[int, int]) -> None:
        """Check that the rectangle lies inside pictures of height and width ``size``.

        Raises:
            RangeError: it does not.
        """
        if self.crop is not None and (self.crop[0] + self.crop[2] > size[1] or self.crop[1] + self.crop[3] > size[0]):
            mend = "give left, top, width and height in pixels of the upright photographs"
            expected = f"a rectangle inside {size[1]} x {size[0]} pixels"
            raise RangeError("crop", expected=expected, got=str(self.crop), mend=mend)

    def apply(self, picture: Tensor) -> Tensor:
        """The region of (C, H, W) float, each pixel the mean of the area that it covers."""
        if self.is_whole:
            return picture
        require("cv2")
        import cv2

        left, top, width, height = self.crop or (0, 0, picture.shape[2], picture.shape[1])
        cut = picture[:, top : top + height, left : left + width]
        if self.scale == 1:
            return cut
        height, width = (max(1, round(n * self.scale)) for n in cut.shape[1:])
        planes = [
            cv2.resize(np.ascontiguousarray(plane.numpy()), (width, height), interpolation=cv2.INTER_AREA)
            for plane in cut.float()
        ]
        return torch.from_numpy(np.stack(planes))

    def apply_mask(self, mask: Tensor, share: float = 0.5) -> Tensor:
        """The region of (1, H, W) bool: where at least ``share`` of the area is True."""
        return mask if self.is_whole else self.apply(mask.float()) >= share - 1e-6

    def apply_normals(self, normal: Tensor | None) -> Tensor | None:
        """The region of (3, H, W) normals, unit again, 0 where they are."""
        if normal is None or self.scale == 1:
            return normal if normal is None else self.apply(normal)
        return torch.nn.functional.normalize(self.apply(normal), dim=0)

    def move(self, ball: Ball) -> Ball:
        """Where a ball of the whole photographs lies in the region."""
        left, top = (0, 0) if self.crop is None else self.crop[:2]
        x, y = ((v + 0.5) * self.scale - 0.5 for v in (ball.x - left, ball.y - top))
        return Ball(x, y, ball.radius * self.scale)

    def to_whole(self, column: Number, row: Number) -> tuple[Number, Number]:
        """Where a pixel of the region lies in the whole photographs; numbers or tensors."""
        left, top = (0, 0) if self.crop is None else self.crop[:2]
        return (column + 0.5) / self.scale - 0.5 + left, (row + 0.5) / self.scale - 0.5 + top


WHOLE = Region()
"""Everything, at its size."""
