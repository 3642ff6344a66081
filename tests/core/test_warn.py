"""Warnings are attributed to the line of the user's module, simulated by source written to a temporary file."""

from __future__ import annotations

import functools
import importlib.util
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest
import torch
from torch import nn

import torch_orennayar as ton
from torch_orennayar.core.warn import warn

USER = """
import torch


def direct(warning_function):
    return warning_function()  # the line


def through_a_module(module):
    return module(torch.zeros(1))  # the line


@torch.no_grad()
def in_a_decorated_function(warning_function):
    return warning_function()  # the line


def in_vmap(warning_function):
    def mapped(value):
        warning_function()  # the line
        return value

    return torch.func.vmap(mapped)(torch.zeros(2))
"""
PACKAGE = """
import torch

from torch_orennayar.core.warn import warn


def outer():
    return inner()


def inner():
    return [warn("from the package") for _ in range(1)]


@torch.no_grad()
def decorated():
    inner()


@torch.inference_mode()
def decorated_twice():
    decorated()


class Layer(torch.nn.Module):
    def forward(self, value):
        inner()
        return value


stacked = torch.nn.Sequential(torch.nn.Identity(), torch.nn.Sequential(Layer()))
"""


def load(name: str, path: Path, source: str) -> ModuleType:
    path.write_text(source)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def user(tmp_path: Path) -> ModuleType:
    return load("a_users_module", tmp_path / "a_users_module.py", USER)


@pytest.fixture
def package(tmp_path: Path) -> Iterator[ModuleType]:
    """A module that counts as one of this package."""
    name = "torch_orennayar.made_for_a_test"
    yield load(name, tmp_path / "made_for_a_test.py", PACKAGE)
    sys.modules.pop(name, None)


def place_of_warning(call: Callable[[], object]) -> tuple[Path, str]:
    """File and source line that the one warning of ``call`` is attributed to."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        call()
    (warning,) = caught
    assert warning.category is UserWarning
    assert str(warning.message) == "from the package"
    file = Path(warning.filename)
    return file, file.read_text().splitlines()[warning.lineno - 1]


@pytest.mark.parametrize("function", ["outer", "inner", "decorated", "decorated_twice"])
@pytest.mark.parametrize("caller", ["direct", "in_a_decorated_function", "in_vmap"])
def test_the_line_of_the_user(user: ModuleType, package: ModuleType, function: str, caller: str) -> None:
    file, line = place_of_warning(lambda: getattr(user, caller)(getattr(package, function)))
    assert file.name == "a_users_module.py"
    assert line.endswith("# the line")


def test_the_line_that_calls_a_module(user: ModuleType, package: ModuleType) -> None:
    stacked: nn.Module = package.stacked
    file, line = place_of_warning(lambda: user.through_a_module(stacked))
    assert file.name == "a_users_module.py"
    assert "module(torch.zeros(1))" in line


def test_a_package_whose_name_only_begins_alike_is_the_users(tmp_path: Path, package: ModuleType) -> None:
    app = load("torch_orennayar_app", tmp_path / "torch_orennayar_app.py", USER)
    file, line = place_of_warning(lambda: app.direct(package.outer))
    assert file.name == "torch_orennayar_app.py"
    assert line.endswith("# the line")


def test_called_without_anything_between() -> None:
    with pytest.warns(UserWarning, match="directly") as caught:
        warn("directly")
    assert Path(caught[0].filename) == Path(__file__)


@pytest.mark.parametrize("caller", ["direct", "in_a_decorated_function"])
def test_a_real_warning_behind_a_decorator(user: ModuleType, caller: str) -> None:
    """`photometric_stereo` runs under ``torch.no_grad``."""
    tilts = torch.tensor([[0.0, 0, 1], [0.15, 0, 1], [0, 0.15, 1], [0.15, 0.15, 1]])
    lights = nn.functional.normalize(tilts, dim=1)
    images = lights[:, 2].reshape(4, 1, 1, 1).expand(4, 1, 6, 6).contiguous()
    with pytest.warns(UserWarning, match="condition number") as caught:
        getattr(user, caller)(functools.partial(ton.photometric_stereo, images, lights, model="lambert"))
    (warning,) = caught
    assert Path(warning.filename).name == "a_users_module.py"
    line = Path(warning.filename).read_text().splitlines()[warning.lineno - 1]
    assert line.endswith("# the line")
