from __future__ import annotations

import inspect
import pickle
import pydoc
import re
import subprocess
import sys
from importlib import metadata

import pytest

import torch_orennayar as ton

HEAVY = ("cv2", "trimesh", "onnxruntime", "onnx", "scipy", "matplotlib", "kornia", "PIL", "typer", "jinja2", "pyamg")


@pytest.mark.slow
def test_import_is_light() -> None:
    code = (
        f"import sys, torch; before = set(sys.modules); import torch_orennayar; new = set(sys.modules) - before; "
        f"print([m for m in {HEAVY!r} if m in new])"
    )
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"


def test_public_names() -> None:
    contract = {
        "oren_nayar", "brdf", "directional_albedo", "OrenNayar", "MODELS", "register_model", "point_light", "Camera",
        "render_normals", "NormalMap", "load_mesh", "save_mesh", "load_capture", "Capture", "photometric_stereo",
        "simplest_model", "Reconstruction", "integrate_normals", "angular_error", "export_onnx", "TorchOrenNayarError",
    }  # fmt: skip
    assert contract <= set(ton.__all__)
    assert all(hasattr(ton, name) for name in ton.__all__)
    assert list(ton.__all__) == sorted(ton.__all__, key=lambda n: (not n.isupper(), n[0].islower() or n[0] == "_", n))


@pytest.mark.parametrize("name", sorted(set(ton.__all__) - {"MODELS", "__version__"}))
def test_every_public_name_is_documented(name: str) -> None:
    doc = getattr(ton, name).__doc__
    assert doc
    assert doc.strip().splitlines()[0].endswith((".", ":", ","))


@pytest.mark.parametrize("name", sorted(set(ton.__all__) - {"MODELS", "__version__"}))
def test_every_public_name_has_an_example(name: str) -> None:
    value = getattr(ton, name)
    members = vars(value).values() if isinstance(value, type) else ()
    kind_of_error = isinstance(value, type) and issubclass(value, ton.TorchOrenNayarError)
    documents = [inspect.getdoc(part) or "" for part in (value, *members, *([ton.TorchOrenNayarError] * kind_of_error))]
    assert any("Example:" in document for document in documents)


def test_completion_offers_public_names_only() -> None:
    assert set(dir(ton)) == set(ton.__all__)


def test_help_of_the_layer_leads_with_what_is_ours() -> None:
    text = pydoc.plain(pydoc.render_doc(ton.OrenNayar))
    ours, inherited = text.split("Methods inherited from torch", 1)
    assert "Example:" in ours
    assert re.search(r"forward\([\s|]*self,[\s|]*normal:", ours)  # Python 3.13 breaks the line
    assert "ScriptModule" not in ours
    assert "forward(" not in inherited


def test_version_is_the_installed_one() -> None:
    assert metadata.version("torch_orennayar") == ton.__version__


def test_errors_survive_a_process_border() -> None:
    error = pickle.loads(pickle.dumps(ton.RangeError("sigma", expected="a", got="b", mend="c")))
    assert isinstance(error, ton.RangeError)
    assert str(error) == "sigma: expected a, got b; c"
    assert error.mend == "c"


def test_command_runs_as_a_module() -> None:
    text = subprocess.check_output([sys.executable, "-m", "torch_orennayar", "--help"], text=True)
    for command in ("demo", "render", "stereo", "export", "info"):
        assert command in text
