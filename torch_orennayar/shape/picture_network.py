"""A small network that estimates normals, and how far to trust them, from one picture under a known light.

The picture is brought into a frame of its own: the mask fills it, and the light comes from the right. So the network
need not learn where things stand, how large they are and where the light comes from.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..core.network_files import load_weights, save_weights
from ..geometry.height_field import inflate, normals
from .scene import peak_brightness

SIDE = 128
"""Pixels; side of the network's frame."""
MARGIN = 1.06
"""Half the side of the frame over the greatest distance of the mask from its centre."""
CHANNELS = 8
"""Maps that the network reads; `make_input` lists them."""
WIDTHS = (40, 64, 88, 112)
"""Channels at a half, a quarter, an eighth and a sixteenth of the frame's resolution. Set by hand, for 2 MB."""
UNTRAINED_DOUBT = -1.5
"""Logarithm of the expected error in radians before training: 13 degrees, well inside what is cut."""
DOUBT_WIDTH = 32
"""Channels of what expects the error. Set by hand."""
MAX_BRIGHTNESS = 2.0
"""Times the picture's peak; brighter pixels are cut."""
WEIGHTS = Path(__file__).with_name("picture_network.pt")
"""File of the weights that ship, written by ``scripts/fit/train_picture_network.py``."""


class LearnedNormals(NamedTuple):
    """Normals (3, H, W), unit, and their expected error (1, H, W), radians; 0 outside the mask."""

    normal: Tensor
    error: Tensor


@dataclass(frozen=True)
class Frame:
    """Where the network's frame lies in a picture.

    Attributes:
        centre: row and column of its centre, pixels.
        reach: half of its side, pixels.
        azimuth: radians, counter-clockwise from the picture's right to the frame's right, where the light is.
    """

    centre: tuple[float, float]
    reach: float
    azimuth: float

    @staticmethod
    def around(mask: Tensor, light: Tensor) -> Frame:
        """The frame of a mask (1, H, W) and a direction to the light (3,)."""
        rows, columns = mask[0].nonzero().double().unbind(1)
        centre = (float(rows.min() + rows.max()) / 2, float(columns.min() + columns.max()) / 2)
        reach = float(torch.hypot(rows - centre[0], columns - centre[1]).max())
        return Frame(centre, MARGIN * max(reach, 1.0), math.atan2(float(light[1]), float(light[0])))

    def take(self, maps: Tensor) -> Tensor:
        """Maps (C, H, W) of the picture in the frame, (C, SIDE, SIDE), 0 where the picture has nothing."""
        step = max(1, int(2 * self.reach / SIDE))
        small = F.avg_pool2d(maps, step, ceil_mode=True, count_include_pad=False) if step > 1 else maps
        line = (torch.arange(SIDE).to(maps) + 0.5) * 2 / SIDE - 1
        v, u = torch.meshgrid(-line, line, indexing="ij")
        x, y = self._turned(u, v, self.azimuth)
        row, column = self.centre[0] - self.reach * y, self.centre[1] + self.reach * x
        return self._sample(small, (row + 0.5) / step - 0.5, (column + 0.5) / step - 0.5)

    def give(self, maps: Tensor, size: tuple[int, int]) -> Tensor:
        """Maps (C, SIDE, SIDE) of the frame in a picture of ``size``, (C, H, W)."""
        row, column = torch.meshgrid(*(torch.arange(n).to(maps) for n in size), indexing="ij")
        x, y = (column - self.centre[1]) / self.reach, (self.centre[0] - row) / self.reach
        u, v = self._turned(x, y, -self.azimuth)
        return self._sample(maps, (1 - v) * SIDE / 2 - 0.5, (1 + u) * SIDE / 2 - 0.5, "border")

    def take_vectors(self, vectors: Tensor) -> Tensor:
        """Vectors (3, ...) of the picture's axes in the frame's axes."""
        x, y = self._turned(vectors[0], vectors[1], -self.azimuth)
        return torch.stack((x, y, vectors[2]))

    def give_vectors(self, vectors: Tensor) -> Tensor:
        """Inverse of `take_vectors`."""
        x, y = self._turned(vectors[0], vectors[1], self.azimuth)
        return torch.stack((x, y, vectors[2]))

    @staticmethod
    def _turned(x: Tensor, y: Tensor, angle: float) -> tuple[Tensor, Tensor]:
        c, s = math.cos(angle), math.sin(angle)
        return c * x - s * y, s * x + c * y

    @staticmethod
    def _sample(maps: Tensor, row: Tensor, column: Tensor, padding: str = "zeros") -> Tensor:
        """Bilinear values of maps (C, h, w) at rows and columns, pixels."""
        height, width = maps.shape[1:]
        place = torch.stack(((2 * column + 1) / width - 1, (2 * row + 1) / height - 1), -1)
        return F.grid_sample(maps[None], place[None], padding_mode=padding, align_corners=False)[0]


def make_input(image: Tensor, mask: Tensor, slant: float) -> Tensor:
    """Maps that the network reads, (8, SIDE, SIDE).

    They are: normals of the inflated silhouette (3), the mask, the picture over its peak and the root of that, sine and
    cosine of the light's angle to the view.

    Args:
        image: (1, SIDE, SIDE) over the peak, in the frame.
        mask: (1, SIDE, SIDE) share of the pixel, in the frame.
        slant: radians, angle between light and view.
    """
    coarse = (F.avg_pool2d(mask[None], 2)[0] > 0.5).to(mask)
    start = F.interpolate(normals(inflate(coarse), None, 1.0)[None], scale_factor=2, mode="bilinear")[0]
    start = F.normalize(start, dim=0)
    image = image.clamp(0, MAX_BRIGHTNESS) * mask
    one = torch.ones_like(mask)
    return torch.cat((start * mask, mask, image, image.sqrt(), one * math.sin(slant), one * math.cos(slant)))


class PictureNetwork(nn.Module):
    """Normals and their expected errors from one picture in its `Frame`: a U-Net over the inflated silhouette.

    The layers' names are those in files of weights: ``mend`` outputs what is added to the inflated silhouette's
    normals, ``doubt`` the logarithm of the expected error.
    """

    def __init__(self, widths: tuple[int, ...] = WIDTHS) -> None:
        """See the class."""
        super().__init__()
        self.widths = tuple(widths)
        self.enter = nn.Conv2d(4 * CHANNELS, widths[0], 3, padding=1)
        self.down = nn.ModuleList(nn.Conv2d(a, b, 2, 2) for a, b in pairwise(widths))
        self.encode = nn.ModuleList(_Block(width) for width in widths)
        self.up = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in pairwise(widths))
        self.decode = nn.ModuleList(_Block(width) for width in widths[:-1])
        self.mend = nn.Conv2d(widths[0], 4 * 3, 3, padding=1)
        self.doubt = _Doubt(widths[0], widths[-1])
        for values in self.mend.parameters():
            nn.init.zeros_(values)  # untrained it returns the inflated silhouette

    def forward(self, maps: Tensor) -> tuple[Tensor, Tensor]:
        """Of `make_input`'s maps (B, 8, S, S) unit normals (B, 3, S, S) and expected errors (B, 1, S, S), radians."""
        x = self.enter(F.pixel_unshuffle(maps, 2))
        kept = []
        for k, block in enumerate(self.encode):
            x = block(x)
            if k < len(self.down):
                kept.append(x)
                x = self.down[k](x)
        deepest = x
        for k in reversed(range(len(self.up))):
            x = self.decode[k](kept[k] + self.up[k](F.interpolate(x, scale_factor=2, mode="nearest")))
        start = maps[:, :3] + maps.new_tensor((0.0, 0.0, 1e-3)).reshape(1, 3, 1, 1)
        normal = F.normalize((start + F.pixel_shuffle(self.mend(x), 2)).float(), dim=1)
        error = F.pixel_shuffle(self.doubt(x.detach(), deepest.detach()), 2).float().clamp(-4.0, 0.5).exp()
        return normal, error


class _Block(nn.Module):
    """Two convolutions beside the identity."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = nn.GroupNorm(8, width)
        self.first = nn.Conv2d(width, width, 3, padding=1)
        self.second = nn.Conv2d(width, width, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        result: Tensor = x + self.second(F.silu(self.first(F.silu(self.norm(x)))))
        return result


class _Doubt(nn.Module):
    """Logarithm of the expected error, of the last features and of the mean of the deepest ones."""

    def __init__(self, width: int, deepest: int) -> None:
        super().__init__()
        self.near, self.far = nn.Conv2d(width, DOUBT_WIDTH, 3, padding=1), nn.Linear(deepest, DOUBT_WIDTH)
        self.last = nn.Conv2d(DOUBT_WIDTH, 4, 3, padding=1)
        nn.init.zeros_(self.last.weight)
        nn.init.constant_(cast("Tensor", self.last.bias), UNTRAINED_DOUBT)

    def forward(self, x: Tensor, deepest: Tensor) -> Tensor:
        whole = self.far(deepest.mean((2, 3)))[:, :, None, None]
        result: Tensor = self.last(F.silu(self.near(x) + whole))
        return result


def save_picture_network(path: str | Path, network: PictureNetwork) -> None:
    """Write widths and weights, these in half precision, to the file that `load_picture_network` reads."""
    save_weights(path, network, {"widths": network.widths})


def load_picture_network(path: str | Path = WEIGHTS) -> PictureNetwork:
    """The network that ships with the package, or another one that `save_picture_network` wrote.

    Raises:
        FileError: no such file, or one that holds no such network.
    """
    return load_weights(path, PictureNetwork, "save_picture_network")


@torch.no_grad()
def learned_normals(
    image: Tensor, light: Tensor, mask: Tensor, network: PictureNetwork | None = None
) -> LearnedNormals:
    """What the network says of a picture, in its precision.

    The network reads the picture and its mirror image about the plane of light and view, and the mean counts.

    Args:
        image: (C, H, W) linear light, finite inside the mask.
        light: (3, 1, 1) or (3, H, W) unit directions.
        mask: (1, H, W) bool, not empty.
        network: default the one that ships.
    """
    network = (network or load_picture_network()).to(image.device)
    grey = torch.where(mask, image.mean(0, keepdim=True), 0).float()
    main = F.normalize(light.float().expand(3, *mask.shape[1:])[:, mask[0]].mean(1), dim=0)
    frame = Frame.around(mask, main)
    seen, share = frame.take(torch.cat((grey / peak_brightness(grey, mask), mask.float()))).split(1)
    maps = make_input(seen / share.clamp_min(0.5), share, math.acos(float(main[2].clamp(-1, 1))))
    mirror = maps.new_tensor((1.0, -1.0, 1.0)).reshape(3, 1, 1)
    flipped = torch.cat((maps[:3] * mirror, maps[3:])).flip(1)
    normal, error = network(torch.stack((maps, flipped)))
    normal = normal[0] + (normal[1] * mirror).flip(1)
    both = torch.cat((frame.give_vectors(normal), (error[0] + error[1].flip(1)) / 2))
    found = torch.where(mask, frame.give(both, (mask.shape[1], mask.shape[2])), 0).to(image)
    return LearnedNormals(F.normalize(found[:3], dim=0), found[3:])
