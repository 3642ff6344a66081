"""A small network that reads one pixel under any number of lights, in any order, and tells its normal.

Every light is a token of twelve numbers. Lights are first turned about the viewing axis so that a robust Lambertian
normal leans to the right, and the answer is turned back: turning the scene turns the answer, exactly.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..core.errors import FileError
from ..core.files import atomic_path
from .robust_fit import solve_symmetric, upward

FEATURES = 12
ROUNDS = 2
"""Of reweighting, before the network looks."""
WEIGHTS = Path(__file__).with_name("set_network.pt")
"""What `examples/train_photometric_stereo.py` wrote."""


class Tokens(NamedTuple):
    """What the network reads.

    Attributes:
        values: (P, K, 12).
        start: (P, 3), the robust Lambertian normal, turned so that its y is 0.
        turn: (P, 2), cosine and sine of its azimuth.
    """

    values: Tensor
    start: Tensor
    turn: Tensor


class SetNetwork(nn.Module):
    """Normals and their errors from pixels under sets of lights; the order of the lights does not matter."""

    def __init__(self, width: int = 64, blocks: int = 4, heads: int = 4) -> None:
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
        nn.init.zeros_(self.mend.weight)  # it begins as least squares
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
        """As `forward`, of what `make_tokens` made: this part alone may run in half precision."""
        pixels, count = tokens.values.shape[:2]
        # Tokens in a row, so that a graph's products of matrices take the bias along.
        x = self.embed(tokens.values.reshape(pixels * count, FEATURES))
        for block in self.blocks:
            x = block(x, pixels, count)
        share = self.attend(x).reshape(pixels, count, self.attend.out_features).softmax(1)  # (P, K, heads)
        x = x.reshape(pixels, count, x.shape[1])
        parts = x.unflatten(2, (share.shape[2], -1))
        pooled = self.norm(torch.cat(((parts * share[..., None]).sum(1).flatten(1), x.amax(1)), 1))
        normal = F.normalize(tokens.start + self.mend(self.head(pooled)), dim=1)
        error = self.doubt(pooled.detach()).clamp(-8, 1).exp()
        return _turn_back(normal, tokens.turn), error


class _Block(nn.Module):
    """Every token hears the mean and the largest of all, then thinks for itself.

    Only what pixels say as a whole is normalised: to normalise every token would cost as much as its products.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.tell, self.hear = nn.Linear(width, width), nn.Linear(2 * width, width)
        self.norm = nn.LayerNorm(2 * width)
        self.think = nn.Sequential(nn.Linear(width, 2 * width), nn.ReLU(), nn.Linear(2 * width, width))

    def forward(self, x: Tensor, pixels: int, count: int) -> Tensor:
        width = x.shape[1]
        told = F.relu(self.tell(x)).reshape(pixels, count, width)
        heard = self.hear(self.norm(torch.cat((told.mean(1), told.amax(1)), 1)))[:, None]
        x = (x.reshape(pixels, count, width) + heard).reshape(pixels * count, width)
        thought: Tensor = x + self.think(x)
        return thought


def make_tokens(observed: Tensor, lights: Tensor) -> Tokens:
    """Twelve numbers for every light of every pixel."""
    lights = lights.expand(observed.shape[0], -1, -1) if lights.ndim == 2 else lights
    mean = observed.mean(1, keepdim=True).clamp_min(1e-9)
    ratio = (observed / mean).clamp(0, 6)
    rank = _ranks(observed)
    lit = ratio > 0.08 * ratio.amax(1, keepdim=True)
    vector = _robust(ratio, lights, torch.where((rank > 0.2) & (rank < 0.8) & lit, 1.0, 0.02))
    length = vector.norm(dim=1, keepdim=True).clamp_min(1e-6)
    normal = upward(vector)
    flat = normal[:, :2].norm(dim=1, keepdim=True)
    right = normal.new_tensor((1.0, 0.0)).expand(normal.shape[0], 2)
    turn = torch.where(flat > 1e-6, normal[:, :2] / flat.clamp_min(1e-6), right)
    c, s = turn[:, :1], turn[:, 1:]
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
    return Tokens(torch.stack(values, 2), start, turn)


def _ranks(observed: Tensor) -> Tensor:
    """Share of the other lights under which the pixel is darker; equals count half, so that no order of lights matters.

    Every pair is compared: dearer than to sort, but a sort would need the ties told apart, and graphs have this too.
    """
    ahead = (observed[:, :, None] - observed[:, None, :]).sign().sum(2)  # darker ones less brighter ones
    return 0.5 + ahead / (2 * observed.shape[1])


def _robust(ratio: Tensor, lights: Tensor, weight: Tensor) -> Tensor:
    """Albedo times normal, (P, 3): least squares, then some rounds in which what fits badly counts less."""
    vector = _least_squares(ratio, lights, weight)
    half = (torch.ones_like(ratio).sum(1, keepdim=True) / 2).long()  # a size is not to be asked for in a graph
    for _ in range(ROUNDS):
        shown = (lights * vector[:, None]).sum(2)
        missed = (ratio - shown.clamp_min(0)).abs()
        middle = missed.sort(1)[0].gather(1, half)
        share = missed / (2 * (1.4826 * middle).clamp_min(0.02))
        # What is left is solved for, so that nothing but what is left gets rounded.
        vector = vector + _least_squares(ratio - shown, lights, weight / (1 + share * share) ** 2)
    return vector


def _least_squares(ratio: Tensor, lights: Tensor, weight: Tensor) -> Tensor:
    """Albedo times normal, (P, 3)."""
    weighted = lights * weight[..., None]
    gram = weighted.transpose(1, 2) @ lights
    rows = [[gram[:, i, j] + (1e-6 if i == j else 0) for j in range(3)] for i in range(3)]
    right = (weighted * ratio[..., None]).sum(1)
    return torch.stack(solve_symmetric(rows, list(right.unbind(1))), 1)


def _turn_back(normal: Tensor, turn: Tensor) -> Tensor:
    c, s = turn[:, :1], turn[:, 1:]
    x, y, z = normal.split(1, dim=1)
    return torch.cat((c * x - s * y, s * x + c * y, z), 1)


def save_network(path: str | Path, network: SetNetwork) -> None:
    """Shape and weights, in half precision: what `load_network` reads."""
    weights = {name: value.detach().cpu().half() for name, value in network.state_dict().items()}
    with atomic_path(Path(path)) as temporary:
        torch.save({"shape": network.shape, "weights": weights}, temporary)


def load_network(path: str | Path = WEIGHTS) -> SetNetwork:
    """The network that ships with the package, or another one of its kind.

    Raises:
        FileError: no such file, or not such a network.

    Example:
        >>> import torch, torch_orennayar as ton
        >>> from torch_orennayar.stereo.set_network import load_network
        >>> lights = torch.nn.functional.normalize(torch.tensor([[0.5, 0, 1], [0, 0.5, 1], [-0.4, -0.3, 1]]), dim=1)
        >>> normal, error = load_network()(lights[:, 2:].T.contiguous(), lights)  # a white pixel that faces the viewer
        >>> normal[0, 2].item() > 0.9
        True
    """
    try:
        held: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
        network = SetNetwork(**held["shape"])
        network.load_state_dict({name: value.float() for name, value in held["weights"].items()})
    except Exception as error:  # torch raises many kinds for what is no checkpoint
        raise FileError(
            str(path), expected="a network of save_network", got=f"{type(error).__name__}: {error}", mend="train it"
        ) from error
    return network.eval()
