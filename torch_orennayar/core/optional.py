"""Third-party packages other than torch and numpy: imported where they are needed, named where they are missing."""

from __future__ import annotations

from importlib import import_module

import torch

from .errors import MissingPackageError

PACKAGES: dict[str, tuple[str, str]] = {
    "OpenImageIO": ("OpenImageIO", ""),
    "PIL": ("pillow", ""),
    "cv2": ("opencv-contrib-python-headless", ""),
    "distributed": ("distributed", "cluster"),
    "jinja2": ("jinja2", "cli"),
    "kornia": ("kornia", ""),
    "mapbox_earcut": ("mapbox_earcut", ""),
    "matplotlib": ("matplotlib", "cli"),
    "numba": ("numba", "fast"),
    "onnx": ("onnx", "export"),
    "onnxruntime": ("onnxruntime", ""),
    "onnxscript": ("onnxscript", "export"),
    "pyamg": ("pyamg", ""),
    "rich": ("rich", "cli"),
    "scipy": ("scipy", ""),
    "skimage": ("scikit-image", "scenes"),
    "threadpoolctl": ("threadpoolctl", ""),
    "trimesh": ("trimesh", ""),
    "typer": ("typer", "cli"),
}
"""Import name to the package that `pip` installs and the extra that holds it, "" for the base install; a test compares
them with ``pyproject.toml``."""


def available(*modules: str) -> bool:
    """Whether all of ``modules``, keys of `PACKAGES`, can be imported.

    Example:
        >>> from torch_orennayar.core.optional import available
        >>> available("scipy")
        True
    """
    return all(_can_import(name) for name in modules)


def require(*modules: str) -> None:
    """Raise an error that names the ``pip`` command unless all of ``modules`` can be imported.

    Every function that imports a third-party package calls this first.

    Args:
        modules: keys of `PACKAGES`.

    Raises:
        MissingPackageError: some of them are not installed.

    Example:
        >>> from torch_orennayar.core.optional import require
        >>> require("trimesh")
    """
    if torch.compiler.is_compiling():  # the compiler cannot trace import_module, but the import that follows
        return
    missing = [name for name in modules if not _can_import(name)]
    if not missing:
        return
    packages = [PACKAGES[name][0] for name in missing]
    extras = sorted({PACKAGES[name][1] for name in missing} - {""})
    whole = f', or "torch_orennayar[{",".join(extras)}]" for all that this part needs' if extras else ""
    noun = "package" if len(packages) == 1 else "packages"
    raise MissingPackageError(
        ", ".join(missing),
        expected=f"the {noun} {', '.join(packages)}",
        got="none installed",
        mend=f"pip install {' '.join(packages)}{whole}",
    )


def _can_import(name: str) -> bool:
    try:
        import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name:  # an installed package that misses one of its own
            raise
        return False
    return True
