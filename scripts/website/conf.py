"""Settings of Sphinx for the site; `python -m scripts.website` runs it with the warnings as errors."""

from __future__ import annotations

from typing import Any

import torch_orennayar

project = "torch_orennayar"
author = "the torch_orennayar authors"
version = release = torch_orennayar.__version__
copyright = author  # noqa: A001
extensions = [
    "myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode", "sphinx_gallery.gen_gallery",
]  # fmt: skip
nitpicky = True
nitpick_ignore_regex = [  # types of other packages and of modules without public names, in signatures
    ("py:class", r"(torch|numpy|kornia|os|pathlib|collections|typing)\..*"),
    ("py:class", r"torch_orennayar\.\w+\.\w+\.\w+|Tensor|PinholeCamera|GeometricAugmentationBase2D"),
]
default_role = "py:obj"

html_theme = "furo"
html_title = f"torch_orennayar {release}"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_show_search_summary = False  # it would be fetched, which browsers refuse on files
html_math_renderer = "mathml"
html_theme_options: dict[str, Any] = {"footer_icons": []}
pygments_style = "default"
pygments_dark_style = "github-dark"

myst_heading_anchors = 4

sphinx_gallery_conf = {
    "examples_dirs": "../../examples/gallery",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "ExampleTitleSortKey",
    "abort_on_example_error": True,
    "doc_module": ("torch_orennayar",),
    "backreferences_dir": "gallery/uses",
    "thumbnail_size": (400, 280),
    "show_signature": False,
    "show_memory": False,
    "write_computation_times": False,
    "nested_sections": False,
}

autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 90
toc_object_entries = False
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False
napoleon_custom_sections = [("Attributes", "params_style"), "Source"]


def _mathml(formula: str, display: str) -> str:
    from latex2mathml.converter import convert

    return str(convert(formula, display=display))


def _inline(writer: Any, node: Any) -> None:
    from docutils.nodes import SkipNode

    writer.body.append(_mathml(node.astext(), "inline"))
    raise SkipNode


def _block(writer: Any, node: Any) -> None:
    from docutils.nodes import SkipNode

    writer.body.append(f'<div class="math">{_mathml(node.astext(), "block")}</div>')
    raise SkipNode


def setup(app: Any) -> None:
    """Formulas as MathML, which browsers draw without a script or a font from elsewhere."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
