"""Checks of a camera's matrices."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.errors import RangeError

ROUNDING = 1e-3
"""Error of a matrix's entries, relative to 1 or to the focal length, that three written digits leave."""


def check_intrinsics(k: Tensor) -> None:
    """Check that matrices K (B, 3, 3) are finite, with positive focal lengths and without skew, to rounding."""
    last_row = (k[:, 2] - k.new_tensor((0.0, 0.0, 1.0))).abs() <= ROUNDING
    focal = k[:, (0, 1), (0, 1)]
    sound = bool((focal > 0).all()) and bool(k.isfinite().all()) and bool(last_row.all())
    if not sound or bool((k[:, 0, 1].abs() > ROUNDING * k[:, 0, 0]).any()):
        raise RangeError(
            "intrinsics",
            expected="finite, positive focal lengths, no skew, last row 0 0 1",
            got=str(k[0].tolist()),
            mend="rectify the images",
        )


def check_extrinsics(extrinsics: Tensor) -> None:
    """Check that (B, 3|4, 4) are finite and hold rotations, to rounding."""
    if not bool(extrinsics.isfinite().all()):
        raise RangeError("extrinsics", expected="finite numbers", got="NaN or infinity", mend="correct them")
    turn = extrinsics[:, :3, :3].detach().double()
    error = (turn @ turn.transpose(1, 2) - torch.eye(3, dtype=turn.dtype, device=turn.device)).abs().max().item()
    if error > 4 * ROUNDING or bool((torch.linalg.det(turn) < 0).any()):
        raise RangeError(
            "extrinsics",
            expected="a rotation R with R R^T = 1 and determinant 1",
            got="a mirrored one" if error <= 4 * ROUNDING else f"R R^T that differs from 1 by {error:.2g}",
            mend="divide R by its scale; give world to camera in OpenCV's frame, right-handed",
        )
    if extrinsics.shape[1] == 4:
        last = extrinsics[:, 3].detach() - extrinsics.new_tensor((0.0, 0.0, 0.0, 1.0))
        if bool((last.abs() > ROUNDING).any()):
            got = str(extrinsics[0, 3].tolist())
            raise RangeError("extrinsics", expected="last row 0 0 0 1", got=got, mend="transpose the matrix")
