"""`Draw`: the random numbers of one sample."""

from __future__ import annotations

import math

import torch
from torch import Tensor


class Draw:
    """The random numbers of one sample, on one device."""

    def __init__(self, seed: int, device: torch.device | str = "cpu") -> None:
        self.generator = torch.Generator(device).manual_seed(seed)
        self.device = torch.device(device)

    def fork(self) -> Draw:
        """Random numbers of their own, however many are drawn of them."""
        return Draw(int(torch.randint(2**62, (), generator=self.generator, device=self.device)), self.device)

    def uniform(self, *shape: int, low: float = 0.0, high: float = 1.0) -> Tensor:
        """Uniform in [low, high)."""
        return low + (high - low) * torch.rand(shape, generator=self.generator, device=self.device)

    def normal(self, *shape: int) -> Tensor:
        """Standard normal."""
        return torch.randn(shape, generator=self.generator, device=self.device)

    def bernoulli(self, probability: float, *shape: int) -> Tensor:
        """1 with this probability, otherwise 0."""
        return (self.uniform(*shape) < probability).float()

    def log_uniform(self, *shape: int, low: float, high: float) -> Tensor:
        """Numbers in [low, high) whose logarithms are uniform."""
        return self.uniform(*shape, low=math.log(low), high=math.log(high)).exp()
