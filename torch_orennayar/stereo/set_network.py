"""A small network that estimates a pixel's normal from its observations under any number of lights, in any order.

Every light is a token of twelve numbers. The lights are first rotated about the viewing axis so that a robust
Lambertian normal has an azimuth of 0, and the estimate is rotated back: the network is equivariant to rotations about
that axis.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..core.checks import check_floating
from ..core.network_files import load_weights, save_weights
from .linear_systems import camera_facing, solve_symmetric
from .robust_stats import MAD_TO_SIGMA, MIDDLE_RANKS, SHADOW, geman_mcclure

FEATURES = 12
"""Numbers of a token; `make_tokens` lists them."""
ROUNDS = 2
"""Reweighted solutions of the robust Lambertian normal that the network starts from. Set by hand; the weights that ship
were trained with it."""
START_NOISE = 0.02
"""Least standard deviation of the residuals in these, as a share of the pixel's mean. Set by hand; not `NOISE_FLOOR` of
`robust_stats`, because the weights that ship were trained with it."""
WEIGHTS = Path(__file__).with_name("set_network.pt")
"""File of the weights that ship, written by ``examples/train_photometric_stereo.py``."""


class Tokens(NamedTuple):
    """Input of the network.

    Attributes:
        values: (P, K, 12).
        start: (P, 3), the robust Lambertian normal, rotated so that its y is 0.
        azimuth: (P, 2), cosine and sine of its azimuth before that.
    """

    values: Tensor
    start: Tensor
    azimuth: Tensor


class SetNetwork(nn.Module):
    """Normals and their expected errors from pixels under sets of lights; invariant to the order of the lights.

    The layers' names are those in files of weights: ``mend`` outputs the correction of the robust Lambertian normal,
    ``doubt`` the logarithm of the expected error.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> lights = torch.nn.functional.normalize(torch.rand(12, 3), dim=1)
        >>> normal, error = ton.SetNetwork(width=16, blocks=2)(torch.rand(5, 12), lights)  # untrained
        >>> normal.shape, error.shape
        (torch.Size([5, 3]), torch.Size([5, 1]))
    """

    def __init__(self, width: int = 64, blocks: int = 4, heads: int = 4) -> None:
        """See the class."""
        super().__init__()
        self.shape = {"width": width, "blocks": blocks, "heads": heads}
        self.embed = nn.Sequential(nn.Linear(FEATURES, width), nn.ReLU(), nn.Linear(width, width))
        self.blocks = nn.ModuleList(_Block(width) for _ in range(blocks))
        self.attend = nn.Linear(width, heads)
        self.norm = nn.LayerNorm(2 * width)
        self.head = nn.Sequential(
            nn.Linear(2 * width, 2 * width), nn.ReLU(), nn.Linear(2 * width, 2 * width), nn.ReLU(),
        )  # fmt: skip
        self.mend = nn.Linear(2 * width, 3)
        self.doubt = nn.Sequential(nn.Linear(2 * width, 64), nn.ReLU(), nn.Linear(64, 1))
        nn.init.zeros_(self.mend.weight)  # untrained it returns the robust Lambertian normal
        nn.init.zeros_(self.mend.bias)

    def forward(self, observed: Tensor, lights: Tensor) -> tuple[Tensor, Tensor]:
        """Normals and expected errors of pixels.

        Args:
            observed: (P, K), grey, linear, in any unit.
            lights: (K, 3) or (P, K, 3), unit.

        Returns:
            ``(normal, error)``: (P, 3), unit and toward the viewer, and (P, 1), radians; differentiable in both.
        """
        return self.read(make_tokens(observed, lights))

    def read(self, tokens: Tokens) -> tuple[Tensor, Tensor]:
        """`forward` from tokens; this part alone may run in half precision."""
        pixels, count = tokens.values.shape[:2]
        # One axis for all tokens, so that a graph fuses matrix products with their biases.
        x = self.embed(tokens.values.reshape(pixels * count, FEATURES))
        for block in self.blocks:
            x = block(x, pixels, count)
        share = self.attend(x).reshape(pixels, count, self.attend.out_features).softmax(1)  # (P, K, heads)
        x = x.reshape(pixels, count, x.shape[1])
        parts = x.unflatten(2, (share.shape[2], -1))
        pooled = self.norm(torch.cat(((parts * share[..., None]).sum(1).flatten(1), x.amax(1)), 1))
        normal = F.normalize(tokens.start + self.mend(self.head(pooled)), dim=1)
        error = self.doubt(pooled.detach()).clamp(-8, 1).exp()
        return _rotated_back(normal, tokens.azimuth), error


class _Block(nn.Module):
    """A residual block: every token receives the mean and the maximum over all tokens, then passes through an MLP.

    ``tell`` makes what is pooled, ``hear`` reads the pooled values, ``think`` is the MLP.

    Only the pooled values are normalised: normalising every token would cost as much as its matrix products.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.tell, self.hear = nn.Linear(width, width), nn.Linear(2 * width, width)
        self.norm = nn.LayerNorm(2 * width)
        self.think = nn.Sequential(nn.Linear(width, 2 * width), nn.ReLU(), nn.Linear(2 * width, width))

    def forward(self, x: Tensor, pixels: int, count: int) -> Tensor:
        width = x.shape[1]
        sent = F.relu(self.tell(x)).reshape(pixels, count, width)
        received = self.hear(self.norm(torch.cat((sent.mean(1), sent.amax(1)), 1)))[:, None]
        x = (x.reshape(pixels, count, width) + received).reshape(pixels * count, width)
        result: Tensor = x + self.think(x)
        return result


def make_tokens(observed: Tensor, lights: Tensor) -> Tokens:
    """Twelve numbers for every light of every pixel.

    They are: the rotated direction to the light (3), the observation over the pixel's mean less 1, half the logarithm
    of that ratio, the observation over the brightest one, the residual of the robust Lambertian fit, the cosine of
    incidence, a term that is largest where a highlight would be, the observation's rank, and x and z of the rotated
    Lambertian normal.

    Args:
        observed: (P, K), grey, linear, in any unit.
        lights: (K, 3) or (P, K, 3), unit.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> lights = torch.nn.functional.normalize(torch.rand(12, 3), dim=1)
        >>> ton.make_tokens(torch.rand(5, 12), lights).values.shape
        torch.Size([5, 12, 12])
    """
    check_floating(observed=observed, lights=lights)
    lights = lights.expand(observed.shape[0], -1, -1) if lights.ndim == 2 else lights
    mean = observed.mean(1, keepdim=True).clamp_min(1e-9)
    ratio = (observed / mean).clamp(0, 6)
    rank = _ranks(observed)
    lit = ratio > SHADOW * ratio.amax(1, keepdim=True)
    vector = _robust_lambert(
        ratio, lights, torch.where((rank > MIDDLE_RANKS[0]) & (rank < MIDDLE_RANKS[1]) & lit, 1.0, 0.02)
    )
    length = vector.norm(dim=1, keepdim=True).clamp_min(1e-6)
    normal = camera_facing(vector)
    flat = normal[:, :2].norm(dim=1, keepdim=True)
    right = normal.new_tensor((1.0, 0.0)).expand(normal.shape[0], 2)
    azimuth = torch.where(flat > 1e-6, normal[:, :2] / flat.clamp_min(1e-6), right)
    c, s = azimuth[:, :1], azimuth[:, 1:]
    x, y, z = lights.unbind(2)
    turned = torch.stack((c * x + s * y, c * y - s * x, z), 2)
    start = torch.cat((flat, torch.zeros_like(flat), normal[:, 2:]), 1)
    ci = (turned * start[:, None]).sum(2)
    half = F.normalize(turned + turned.new_tensor((0.0, 0.0, 1.0)), dim=2)
    values = (
        *turned.unbind(2),
        ratio - 1,
        0.5 * (ratio + 0.02).log(),
        observed / observed.amax(1, keepdim=True).clamp_min(1e-9),
        (ratio / length - ci.clamp_min(0)).clamp(-3, 3),
        ci,
        4 * ((half * start[:, None]).sum(2) - 0.9),
        rank - 0.5,
        start[:, :1].expand_as(ci),
        start[:, 2:].expand_as(ci),
    )
    return Tokens(torch.stack(values, 2), start, azimuth)


def _ranks(observed: Tensor) -> Tensor:
    """Share of the lights under which the pixel is darker, (P, K); ties count half, so that no order of lights matters.

    All pairs are compared: that costs more than sorting, but sorting would order ties, and graphs have this operation.
    """
    ahead = (observed[:, :, None] - observed[:, None, :]).sign().sum(2)  # number of darker ones less brighter ones
    return 0.5 + ahead / (2 * observed.shape[1])


def _robust_lambert(ratio: Tensor, lights: Tensor, weight: Tensor) -> Tensor:
    """Albedo times normal, (P, 3): weighted least squares, then `ROUNDS` solutions with Geman-McClure weights."""
    vector = _least_squares(ratio, lights, weight)
    half = (
        torch.ones_like(ratio).sum(1, keepdim=True) / 2
    ).long()  # counted from the tensor, so that a graph does not fix it
    for _ in range(ROUNDS):
        shown = (lights * vector[:, None]).sum(2)
        missed = (ratio - shown.clamp_min(0)).abs()
        middle = missed.sort(1)[0].gather(1, half)
        reweighted = geman_mcclure(weight, missed, (MAD_TO_SIGMA * middle).clamp_min(START_NOISE))
        # Solving for the correction, not for the vector, keeps rounding errors in proportion to it.
        vector = vector + _least_squares(ratio - shown, lights, reweighted)
    return vector


def _least_squares(ratio: Tensor, lights: Tensor, weight: Tensor) -> Tensor:
    """Albedo times normal, (P, 3); `linear_systems.weighted_lambert` says why this is another function."""
    weighted = lights * weight[..., None]
    gram = weighted.transpose(1, 2) @ lights
    rows = [[gram[:, i, j] + (1e-6 if i == j else 0) for j in range(3)] for i in range(3)]
    right = (weighted * ratio[..., None]).sum(1)
    return torch.stack(solve_symmetric(rows, list(right.unbind(1))), 1)


def _rotated_back(normal: Tensor, azimuth: Tensor) -> Tensor:
    """Normals rotated about the viewing axis by the azimuth whose cosine and sine are ``azimuth``, (P, 3)."""
    c, s = azimuth[:, :1], azimuth[:, 1:]
    x, y, z = normal.split(1, dim=1)
    return torch.cat((c * x - s * y, s * x + c * y, z), 1)


def save_network(path: str | Path, network: SetNetwork) -> None:
    """Write shape and weights, these in half precision, to the file that `load_network` reads.

    Example:
        >>> import pathlib, tempfile, torch_orennayar as ton
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "network.pt"
        >>> ton.save_network(path, ton.SetNetwork(width=16, blocks=2))
        >>> type(ton.load_network(path)).__name__
        'SetNetwork'
    """
    save_weights(path, network, network.shape)


def load_network(path: str | Path = WEIGHTS) -> SetNetwork:
    """The network that ships with the package, or another one that `save_network` wrote.

    Raises:
        FileError: no such file, or one that holds no such network.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> from torch_orennayar.stereo.set_network import load_network
        >>> lights = torch.nn.functional.normalize(torch.tensor([[0.5, 0, 1], [0, 0.5, 1], [-0.4, -0.3, 1]]), dim=1)
        >>> normal, error = load_network()(lights[:, 2:].T.contiguous(), lights)  # a white pixel that faces the viewer
        >>> normal[0, 2].item() > 0.9
        True
    """
    return load_weights(path, SetNetwork, "save_network")
