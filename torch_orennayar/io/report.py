"""HTML reports of one file, which open from disk: the pictures are embedded."""

from __future__ import annotations

import base64
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from .._version import __version__
from ..core.optional import require

_PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{ title }}</title>
<style>
  body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
  h1 { font-size: 1.6rem } h2 { font-size: 1.2rem; margin-top: 2.2rem }
  .pictures { display: flex; flex-wrap: wrap; gap: .8rem; margin: .8rem 0 } img { max-width: 100%; height: auto }
  table { border-collapse: collapse; margin: .8rem 0 } td, th { padding: .25rem .8rem; border-bottom: 1px solid #ddd }
  th { text-align: left } td { vertical-align: top; font-variant-numeric: tabular-nums }
  .wide { overflow-x: auto } .verdict { border-left: .5rem solid; padding: .1rem 1rem; border-radius: .3rem }
  .good { border-color: #2a8a4a; background: #eef8f0 } .look { border-color: #c58a00; background: #fdf6e3 }
  .doubtful { border-color: #b3261e; background: #fdecea } .verdict h2 { margin: .6rem 0 }
  .contact { display: grid; grid-template-columns: repeat(auto-fill, minmax(7rem, 1fr)); gap: .5rem }
  figure { margin: 0 } figcaption { font-size: .8rem; color: #555; overflow-wrap: anywhere }
  .contact img { width: 100% }
  .dial { width: 1.3rem; vertical-align: middle } .dial circle { fill: none; stroke: #888 }
  .dial line { stroke: #c58a00 } .dial .lamp { fill: #c58a00; stroke: none }
  .pictures figure { max-width: min(100%, 30rem) }
  .viewer canvas { width: min(100%, 30rem); touch-action: none }
  .viewer canvas { border: 1px solid #ddd; cursor: grab } .viewer label { margin-right: 1rem; white-space: nowrap }
  @media print { .viewer p { display: none } section { break-inside: avoid } body { margin: 0; max-width: none } }
  footer { margin: 3rem 0 1rem; color: #777; font-size: .85rem }
</style>
<h1>{{ title }}</h1>
{% for section in sections %}
<section{% if section.kind %} class="verdict {{ section.kind }}"{% endif %}>
<h2>{{ section.heading }}</h2>
{% for line in section.text %}<p>{{ line }}</p>
{% endfor %}
{% if section.rows %}<div class="wide"><table>
<tr>{% for cell in section.columns %}<th>{{ cell }}</th>{% endfor %}</tr>
{% for row in section.rows %}<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>
{% endfor %}</table></div>{% endif %}
{{ section.markup|safe }}
{% if section.pictures %}<div class="pictures">{% for picture in section.pictures %}
<img alt="{{ section.heading }}: {{ picture.stem }}" src="{{ embed(picture) }}">{% endfor %}
</div>{% endif %}
</section>
{% endfor %}
<footer>{{ footer }}</footer>
</html>
"""


@dataclass(frozen=True)
class Section:
    """A heading, paragraphs, a table and pictures, in this order.

    Attributes:
        heading: plain text.
        text: the paragraphs.
        columns: the table's header.
        rows: the table's cells.
        pictures: PNG or GIF files, embedded.
        markup: HTML that is put in as it is.
        kind: of a verdict, ``"good"``, ``"look"`` or ``"doubtful"``; else empty.
    """

    heading: str
    text: Sequence[str] = ()
    columns: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = field(default=())
    pictures: Sequence[Path] = ()
    markup: str = ""
    kind: str = ""


def write_report(path: str | os.PathLike[str], title: str, sections: Sequence[Section]) -> Path:
    """Write ``sections`` as one HTML file that embeds its pictures.

    Raises:
        MissingPackageError: jinja2 is not installed.
    """
    require("jinja2")
    import jinja2

    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    page = environment.from_string(_PAGE).render(
        title=title, sections=sections, embed=_embed, footer=f"torch_orennayar {__version__}"
    )
    target = Path(path)
    target.write_text(page, encoding="utf-8", errors="replace")  # names of files need not be UTF-8
    return target


def _embed(picture: Path) -> str:
    kind = picture.suffix.lstrip(".")
    return f"data:image/{kind};base64,{base64.b64encode(picture.read_bytes()).decode()}"
