"""Batches of samples that differ in their number of lights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict

import torch
import torch.nn.functional as F
from torch import Tensor

from ..core.errors import ShapeError
from .images import SyntheticImages


class SyntheticBatch(TypedDict):
    """B samples of kind ``"images"``; K is the largest number of lights among them.

    Attributes:
        images: (B, K, 3, H, W), 0 beyond a sample's own lights.
        lights: (B, K, 3) unit directions, (0, 0, 1) beyond a sample's own.
        valid: (B, K, 1, H, W) bool, False there, as `photometric_stereo` takes it.
        counts: (B,) int64 number of lights of each sample.
        mask: (B, 1, H, W) bool.
        normal: (B, 3, H, W).
        albedo: (B, 3, H, W).
        roughness: (B, 1, H, W) radians.
    """

    images: Tensor
    lights: Tensor
    valid: Tensor
    counts: Tensor
    mask: Tensor
    normal: Tensor
    albedo: Tensor
    roughness: Tensor


def collate_captures(samples: Sequence[SyntheticImages]) -> SyntheticBatch:
    """Stack samples of ``SyntheticCaptures("images")`` that have different numbers of lights, for a `DataLoader`.

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
    images, lights = [], []
    for sample in samples:
        missing = most - len(sample["lights"])
        images.append(F.pad(sample["images"], (0, 0, 0, 0, 0, 0, 0, missing)))
        toward_viewer = sample["lights"].new_tensor((0.0, 0.0, 1.0)).expand(missing, 3)
        lights.append(torch.cat((sample["lights"], toward_viewer)))
    there = torch.arange(most, device=counts.device) < counts[:, None]
    size = samples[0]["images"].shape[2:]
    return {
        "images": torch.stack(images),
        "lights": torch.stack(lights),
        "valid": there[:, :, None, None, None].expand(-1, -1, 1, *size),
        "counts": counts,
        "mask": torch.stack([sample["mask"] for sample in samples]),
        "normal": torch.stack([sample["normal"] for sample in samples]),
        "albedo": torch.stack([sample["albedo"] for sample in samples]),
        "roughness": torch.stack([sample["roughness"] for sample in samples]),
    }
