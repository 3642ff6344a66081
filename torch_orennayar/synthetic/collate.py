"""Batches of samples that differ in their number of lights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.errors import ShapeError
from .images import SyntheticImages

PER_LIGHT = {"images": 0.0, "lights": 0.0, "reached": 0.0, "between": 0.0, "remainder": 0.0, "true_lights": 0.0,
             "brightness": 1.0}  # fmt: skip
"""What has a first axis of lights, and the value that stands for lights that a sample does not have."""


class SyntheticBatch(SyntheticImages):
    """B samples of kind ``"images"``: every tensor of `SyntheticImages` with B in front.

    K is the largest number of lights among them. Beyond a sample's own lights pictures are 0, lights (0, 0, 1) and
    brightness 1.

    Attributes:
        valid: (B, K, 1, H, W) bool, False there, as `photometric_stereo` takes it.
        counts: (B,) int64 number of lights of each sample.

    Example:
        >>> import torch_orennayar as ton
        >>> captures = ton.SyntheticCaptures("images", seed=1, size=(16, 16), lights=(2, 4))
        >>> batch = ton.collate_captures([captures.sample(k) for k in range(3)])
        >>> batch["images"].shape[0], batch["valid"].shape[1] == batch["counts"].max()
        (3, tensor(True))
    """

    valid: Tensor
    counts: Tensor


def collate_captures(samples: Sequence[SyntheticImages]) -> SyntheticBatch:
    """Stack samples of ``SyntheticCaptures("images")`` that have different numbers of lights, for a ``DataLoader``.

    Args:
        samples: one or more, of one size.

    Returns:
        A `SyntheticBatch`.

    Raises:
        ShapeError: no samples, samples of kind ``"pixels"``, or of different sizes.

    Example:
        >>> import torch_orennayar as ton
        >>> captures = ton.SyntheticCaptures("images", lights=(3, 9), size=(16, 16), length=4)
        >>> loader = torch.utils.data.DataLoader(captures, batch_size=2, collate_fn=ton.collate_captures)
        >>> batch = next(iter(loader))
        >>> batch["images"].shape[1] == batch["counts"].max().item()
        True
    """
    if not samples or any("images" not in sample for sample in samples):
        got = "none" if not samples else "samples of pixels"
        mend = "give SyntheticCaptures('images'); a sample of pixels is a batch: DataLoader(batch_size=None)"
        raise ShapeError("samples", expected="samples of images", got=got, mend=mend)
    sizes = {tuple(sample["images"].shape[2:]) for sample in samples}
    if len(sizes) > 1:
        raise ShapeError("samples", expected="one size", got=str(sorted(sizes)), mend="crop them alike")
    counts = torch.tensor([len(sample["lights"]) for sample in samples], device=samples[0]["lights"].device)
    most = int(counts.max())
    batch: dict[str, Tensor] = {}
    for name in SyntheticImages.__annotations__:  # a reader of files may add names of its own
        values = [cast("Tensor", sample[name]) for sample in samples]  # type: ignore[literal-required]
        if name in PER_LIGHT:
            values = [_pad(value, most, PER_LIGHT[name]) for value in values]
        batch[name] = torch.stack(values)
    there = torch.arange(most, device=counts.device) < counts[:, None]
    for name in ("lights", "true_lights"):
        batch[name][~there] = batch[name].new_tensor((0.0, 0.0, 1.0))
    size = samples[0]["images"].shape[2:]
    batch |= {"valid": there[:, :, None, None, None].expand(-1, -1, 1, *size), "counts": counts}
    return cast("SyntheticBatch", batch)


def _pad(values: Tensor, count: int, value: float) -> Tensor:
    """(K, ...) with ``value`` up to ``count`` along the first axis."""
    return F.pad(values, (0, 0) * (values.ndim - 1) + (0, count - len(values)), value=value)
