"""True normals beside a capture, where it has them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from ..core.errors import FileError, MissingPackageError
from ..core.optional import require

TRUTH_FILES = ("Normal_gt.mat", "normal_gt.npy")
"""Names of the file of true normals, the first that exists is read; the first is DiLiGenT's (Shi et al. 2016)."""


def read_truth(folder: Path, size: tuple[int, int]) -> Tensor | None:
    """True normals (3, H, W) float32, or None without such a file.

    Raises:
        FileError: a damaged file, or one of another size.
    """
    file = next((folder / name for name in TRUTH_FILES if (folder / name).is_file()), None)
    if file is None:
        return None
    try:
        array = _load_truth(file)
    except MissingPackageError:
        raise
    except Exception as error:  # scipy and numpy raise many kinds for damaged files
        raise FileError(
            str(file), expected="an array of true normals", got=str(error), mend="replace or remove the file"
        ) from error
    if array.shape != (*size, 3):
        raise FileError(
            str(file), expected=f"shape {(*size, 3)}", got=str(array.shape), mend="crop it as the images are"
        )
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32)).permute(2, 0, 1)


def _load_truth(file: Path) -> npt.NDArray[np.float64]:
    if file.suffix == ".npy":
        return np.asarray(np.load(file, allow_pickle=False))
    require("scipy")
    from scipy.io import loadmat

    return np.asarray(loadmat(file, variable_names=["Normal_gt"])["Normal_gt"])
