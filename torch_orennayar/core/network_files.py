"""Files of networks: what their class is called with, and their weights in half precision."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import nn

from .errors import FileError
from .files import atomic_path

Network = TypeVar("Network", bound=nn.Module)


def save_weights(path: str | Path, network: nn.Module, shape: Mapping[str, object]) -> None:
    """Write ``shape``, the arguments of the network's class, and its weights to the file that `load_weights` reads."""
    weights = {name: value.detach().cpu().half() for name, value in network.state_dict().items()}
    with atomic_path(Path(path)) as temporary:
        torch.save({"shape": dict(shape), "weights": weights}, temporary)


def load_weights(path: str | Path, make: Callable[..., Network], writer: str) -> Network:
    """The network of a file, made by ``make(**shape)``; ``writer`` is the function that writes such files.

    Raises:
        FileError: no such file, or one that holds no such network.
    """
    try:
        saved: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
        network = make(**saved["shape"])
        network.load_state_dict({name: value.float() for name, value in saved["weights"].items()})
    except Exception as error:  # torch raises many kinds for what is no checkpoint
        got = f"{type(error).__name__}: {error}"
        raise FileError(str(path), expected=f"a network of {writer}", got=got, mend="train it") from error
    return network.eval()
