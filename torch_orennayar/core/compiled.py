"""How numba compiles this package's inner loops over float32 numbers; imported only where it is installed.

The machine code on disk belongs to the file of a function, not to those of the functions that it calls: after a change
to one of these, remove ``__pycache__/*.nbi``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]
Ints = npt.NDArray[np.int64]
Function = TypeVar("Function", bound=Callable[..., object])


OPTIONS: dict[str, Any] = {
    "cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract", "reassoc", "nsz"}
}  # fmt: skip
"""Of the compiler: machine code is kept on disk, Python's other threads run meanwhile, a division by 0 gives infinity,
and sums may be taken in any order, so that loops are vectorised. So terms of very different size must not be added
and subtracted."""


def compiled(function: Function) -> Function:
    """Compile a function."""
    return cast("Function", numba.njit(**OPTIONS)(function))


def inlined(function: Function) -> Function:
    """Compile a function of single numbers as part of those that call it, so that their loops are vectorised."""
    return cast("Function", numba.njit(inline="always", **OPTIONS)(function))
