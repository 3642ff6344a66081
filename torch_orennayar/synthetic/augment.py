"""Augmentations of captures in a training loop: kornia's geometric ones with normals and lights turned, new lights."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, cast

import torch
from torch import Tensor, nn

from ..core.checks import check_count, check_floating
from ..core.errors import RangeError, ShapeError
from ..core.optional import require
from ..shading.layer import OrenNayar

if TYPE_CHECKING:
    from kornia.augmentation import GeometricAugmentationBase2D

Batch = TypeVar("Batch", bound=Mapping[str, Any])

INSIDE = 0.999
"""Share of a resampled pixel that must lie inside a mask for it to be inside: a little below 1, for rounding."""
UNEQUAL = 0.02
"""Largest relative difference of scales in two directions that counts as rounding of a picture's size; set by hand."""
STRETCHED = 0.25
"""Relative error of the distance between neighbouring pixels from which they are taken for padding: repeated pixels and
constants have 1, mirrored ones 2; set by hand."""
MAPS = (
    "images", "mask", "normal", "view", "depth", "albedo", "roughness", "reached", "between", "remainder", "valid",
)  # fmt: skip
"""What moves with the pixels, of what `SyntheticBatch` holds: (B, ..., C, H, W)."""
MASKS = ("mask", "valid")
"""Those that are true or false."""
VECTORS = ("normal", "view", "lights", "true_lights")
"""What holds vectors in the camera frame, x first: maps, or (B, K, 3)."""
RELIT = (
    "images",
    "lights",
    "true_lights",
    "brightness",
    "exposure",
    "reached",
    "between",
    "remainder",
    "valid",
    "counts",
)
"""What new lights replace, or what is no longer true under them."""


class AugmentCaptures(nn.Module):
    """Apply kornia's geometric augmentations to captures as wholes: maps move together, and vectors turn with them.

    Where a picture is turned or mirrored, normals, views and lights turn too, so that shading still gives the pictures.
    Depth keeps its unit, so where a picture is scaled its pixels are of another size. Pixels that are made of some
    outside the mask leave it, and padding of every kind is 0 and outside.

    kornia's own ``AugmentationSequential`` moves pictures and masks, but knows no vectors in a picture: give its
    members here instead. Photometric augmentations belong on ``batch["images"]`` alone.

    Args:
        augmentations: such as ``RandomHorizontalFlip``, ``RandomRotation``, ``RandomCrop``, ``RandomResizedCrop`` with
            ``ratio=(1, 1)``, ``RandomAffine`` without shear; applied in order, random as kornia's are (torch's seed).

    Raises:
        RangeError: an augmentation that is not geometric, or when called, one that distorts angles.
        MissingPackageError: kornia is not installed.

    Example:
        >>> import kornia.augmentation as K, torch_orennayar as ton
        >>> captures = ton.SyntheticCaptures("images", lights=(4, 4), size=(32, 32), length=2)
        >>> augment = ton.AugmentCaptures(K.RandomHorizontalFlip(), K.RandomCrop((24, 24)))
        >>> batch = augment(ton.collate_captures(list(captures)))
        >>> batch["images"].shape, batch["normal"].shape
        (torch.Size([2, 4, 3, 24, 24]), torch.Size([2, 3, 24, 24]))
    """

    def __init__(self, *augmentations: GeometricAugmentationBase2D) -> None:
        """See the class."""
        super().__init__()
        require("kornia")
        from kornia.augmentation import GeometricAugmentationBase2D

        for one in augmentations:
            if not isinstance(one, GeometricAugmentationBase2D):
                raise RangeError(
                    "augmentations",
                    expected="geometric ones of kornia.augmentation",
                    got=type(one).__name__,
                    mend='apply others to batch["images"]; give the members of a sequence one by one',
                )
        self.augmentations = nn.ModuleList(augmentations)

    def forward(self, batch: Batch) -> Batch:
        """Augment a batch of captures.

        Args:
            batch: as of `collate_captures`, or any mapping with some of its names: maps (B, ..., H, W), floating-point
                or masks, and lights (B, K, 3); maps of one pixel and what has other names are passed on.

        Returns:
            A new dictionary; differentiable in all floating-point maps.

        Raises:
            ShapeError: no map, maps of several sizes or of another type, or a single sample.
            RangeError: a transform that distorts angles: normals cannot follow it.
        """
        maps = _check_maps(batch)
        shapes = {name: value.shape[1:-2] for name, value in maps.items()}
        height, width = next(iter(maps.values())).shape[-2:]
        dtype = torch.float64 if torch.float64 in {value.dtype for value in maps.values()} else torch.float32
        flat = [(value != 0 if name in MASKS else value).to(dtype).flatten(1, -3) for name, value in maps.items()]
        column, row = torch.arange(width).to(flat[0]), torch.arange(height).to(flat[0])
        place = torch.stack((column.expand(height, width), row[:, None].expand(height, width)))
        moved = torch.cat((*flat, place.expand(len(flat[0]), -1, -1, -1)), 1)
        move = torch.eye(2).to(moved).expand(len(moved), 2, 2)
        for augmentation in self.augmentations:
            moved = augmentation(moved)
            move = _linear(cast("Tensor", augmentation.transform_matrix)).to(moved) @ move
        *parts, place = moved.split([*(math.prod(shape) for shape in shapes.values()), 2], 1)
        seen = _seen(place, move)
        turn = _turn(move)
        found: dict[str, Any] = dict(batch)
        for (name, shape), part in zip(shapes.items(), parts, strict=True):
            value = (part * seen).unflatten(1, tuple(shape))
            found[name] = value > INSIDE if name in MASKS else value.to(maps[name].dtype)
        for name in VECTORS:
            if name in found:
                found[name] = _turn_vectors(found[name], turn)
        if "normal" in maps:
            found["normal"] = _unit(found["normal"])
        if "view" in maps:  # where nothing was seen before, the camera's axis
            beyond = found["view"].square().sum(1, keepdim=True) < 0.25
            axis = found["view"].new_tensor((0.0, 0.0, 1.0)).reshape(1, 3, 1, 1)
            found["view"] = torch.where(beyond, axis, _unit(found["view"]))
        if "mask" in maps:
            for name in {"normal", "depth", "albedo", "roughness"} & maps.keys():
                found[name] = found[name] * found["mask"]
        return cast("Batch", found)


def _check_maps(batch: Mapping[str, Any]) -> dict[str, Tensor]:
    """The maps of a batch that are larger than a pixel.

    Raises:
        ShapeError: none, a single sample, maps that differ in size or number, or of another type.
    """
    present = {name: batch[name] for name in MAPS if name in batch}
    maps = {name: value for name, value in present.items() if tuple(value.shape[-2:]) != (1, 1)}
    if not maps:
        raise ShapeError("batch", expected=f"a map, one of {', '.join(MAPS)}", got=", ".join(batch), mend="add one")
    flat = [name for name, value in maps.items() if value.ndim < 4]
    flat += [name for name in ("lights", "true_lights") if name in batch and batch[name].ndim != 3]
    if flat:
        got = f"{flat[0]} {tuple(batch[flat[0]].shape)}"
        mend = "give a batch: collate_captures([sample])"
        raise ShapeError("batch", expected="maps (B, ..., H, W), lights (B, K, 3)", got=got, mend=mend)
    kinds = {name: (len(value), *value.shape[-2:]) for name, value in maps.items()}
    if len(set(kinds.values())) > 1 or not kinds[next(iter(kinds))][0]:
        raise ShapeError("batch", expected="maps of one size (B, ..., H, W)", got=str(kinds), mend="crop them alike")
    for name, value in maps.items():
        if name not in MASKS and not value.is_floating_point():
            mend = "divide 8-bit pictures by 255 and undo their sRGB curve (srgb_to_linear)"
            raise ShapeError("batch", expected="floating-point maps", got=f"{name} of {value.dtype}", mend=mend)
    return maps


def _linear(matrix: Tensor) -> Tensor:
    """How pixels move, (B, 2, 2), without translation.

    Raises:
        RangeError: a matrix (B, 3, 3) that is no rotation, reflection, scaling and translation.
    """
    linear = matrix[:, :2, :2]
    unit = linear / torch.linalg.det(linear).abs().clamp_min(1e-12).sqrt()[:, None, None]
    square = unit @ unit.mT - torch.eye(2).to(unit)
    if not bool((square.abs() < UNEQUAL).all() and (matrix[:, 2, :2].abs() < 1e-6).all()):
        raise RangeError(
            "augmentations",
            expected="transforms that keep angles",
            got="shear, perspective or scales that differ by more than 2 %",
            mend="leave shear out, keep the ratio of the sides, or give ratio=(1, 1)",
        )
    return linear


def _seen(place: Tensor, move: Tensor) -> Tensor:
    """Where a picture shows pixels and not padding, (B, 1, H, W) of 0 and 1.

    Args:
        place: (B, 2, H, W) column and row that each pixel came from, padded as the pictures are.
        move: (B, 2, 2) how pixels moved: neighbours must lie as far apart as its inverse says.
    """
    inverse = torch.linalg.inv(move)
    allowed = STRETCHED * inverse.flatten(1).norm(dim=1)[:, None, None] / math.sqrt(2)
    seen = torch.ones_like(place[:, 0], dtype=torch.bool)
    for axis in (0, 1):
        if place.shape[3 - axis] < 2:
            continue
        right = (place.diff(dim=3 - axis) - inverse[:, :, axis, None, None]).norm(dim=1) < allowed
        before, after = ((0, 1), (1, 0)) if axis == 0 else ((0, 0, 0, 1), (0, 0, 1, 0))
        seen = seen & (nn.functional.pad(right, before) | nn.functional.pad(right, after))
    return seen[:, None].to(place)


def _turn(linear: Tensor) -> Tensor:
    """How x and y of vectors in the camera frame turn, (B, 2, 2), with pixels that move by ``linear``."""
    u, _, v = torch.linalg.svd(linear)
    linear = u @ v  # without scale
    down = linear.new_tensor((1.0, -1.0))  # rows count downward, y upward
    turned: Tensor = down[:, None] * linear * down
    return turned


def _turn_vectors(vectors: Tensor, turn: Tensor) -> Tensor:
    """Turn maps (B, 3, H, W) or rows (B, K, 3) by (B, 2, 2) in x and y."""
    axis = 1 if vectors.ndim == 4 else 2
    x, y, z = vectors.unbind(axis)
    t = turn.to(vectors).reshape(len(turn), 2, 2, *(1,) * (x.ndim - 1))
    return torch.stack((t[:, 0, 0] * x + t[:, 0, 1] * y, t[:, 1, 0] * x + t[:, 1, 1] * y, z), axis)


def _unit(vectors: Tensor) -> Tensor:
    """Maps (B, 3, H, W) of unit length, zero where they are nearly zero."""
    length = vectors.square().sum(1, keepdim=True).clamp_min(1e-12).sqrt()
    return torch.where(length > 1e-3, vectors / length, 0.0)


class RandomRelight(nn.Module):
    """Pictures of any normal map and albedo under new random lights, through the layer; for data sets of one's own.

    Args:
        lights: number of new lights.
        model: reflectance, a name in ``MODELS``.
        widest: largest angle between a light and the axis of the camera, radians; directions are uniform within it.
        roughness: range that one roughness per picture is drawn from, radians, where the batch has none.
        generator: of the random numbers; default torch's own.

    Raises:
        RangeError: less than one light, an angle outside (0, pi/2], or a range out of order.
        ModelError: unknown ``model``.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> normal = torch.tensor([0.0, 0.0, 1.0]).reshape(1, 3, 1, 1).expand(2, 3, 8, 8)
        >>> batch = ton.RandomRelight(lights=5)({"normal": normal, "albedo": torch.full((2, 3, 8, 8), 0.5)})
        >>> batch["images"].shape, batch["lights"].shape
        (torch.Size([2, 5, 3, 8, 8]), torch.Size([2, 5, 3]))
    """

    def __init__(
        self,
        lights: int = 1,
        *,
        model: str = "vcavity",
        widest: float = math.radians(60),
        roughness: tuple[float, float] = (0.0, 1.0),
        generator: torch.Generator | None = None,
    ) -> None:
        """See the class."""
        super().__init__()
        check_count("lights", lights)
        if not 0 < widest <= math.pi / 2:
            raise RangeError("widest", expected="radians in (0, pi/2]", got=str(widest), mend="use math.radians")
        if not _is_pair(roughness) or not 0 <= roughness[0] <= roughness[1] <= math.pi / 2:
            mend = "use math.radians, lower end first"
            raise RangeError("roughness", expected="radians, 0 to pi/2", got=str(roughness), mend=mend)
        self.lights, self.widest, self.roughness, self.generator = lights, widest, roughness, generator
        self.layer = OrenNayar(model)

    def extra_repr(self) -> str:
        """What ``print`` shows."""
        return f"lights={self.lights}, widest={self.widest:.3g}, roughness={self.roughness}"

    def forward(self, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Shade a batch anew.

        Args:
            batch: ``normal`` (B, 3, H, W) unit, camera frame; and where there are any ``albedo`` (B, C, H, W), default
                1, ``roughness`` (B, 1, H, W) radians, ``view`` (B, 3, H, W); what has other names is passed on.

        Returns:
            A new dictionary with ``images`` (B, K, C, H, W), ``lights`` and ``true_lights`` (B, K, 3), and
            ``roughness`` (B, 1, 1, 1) where it was drawn; without what the old lights made. Differentiable in normal,
            albedo, roughness and view.

        Raises:
            ShapeError: no normals, or shapes that do not fit.
        """
        if "normal" not in batch:
            raise ShapeError("batch", expected="'normal' (B, 3, H, W)", got=", ".join(batch), mend="add the normals")
        normal = batch["normal"]
        check_floating(normal=normal)
        drawn = torch.rand(len(normal), self.lights, 2, generator=self.generator, device=self._device(normal)).to(
            normal
        )
        cosine = 1 - drawn[..., 0] * (1 - math.cos(self.widest))
        sine, azimuth = (1 - cosine * cosine).sqrt(), 2 * math.pi * drawn[..., 1]
        lights = torch.stack((sine * azimuth.cos(), sine * azimuth.sin(), cosine), -1)
        roughness = batch.get("roughness")
        if roughness is None:
            share = torch.rand(len(normal), 1, 1, 1, generator=self.generator, device=self._device(normal)).to(normal)
            roughness = self.roughness[0] + (self.roughness[1] - self.roughness[0]) * share
        images = self.layer(normal, lights, batch.get("view"), batch.get("albedo"), roughness)
        kept = {name: value for name, value in batch.items() if name not in RELIT}
        return kept | {"images": images, "lights": lights, "true_lights": lights, "roughness": roughness}

    def _device(self, like: Tensor) -> torch.device:
        """Where random numbers are drawn."""
        return like.device if self.generator is None else self.generator.device


def _is_pair(value: object) -> bool:
    return isinstance(value, tuple) and len(value) == 2 and all(isinstance(n, (int, float)) for n in value)
