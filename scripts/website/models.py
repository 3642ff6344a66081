"""One page per reflectance model: formula, code, pictures beside the theory, errors, cost, kinks, when it is chosen."""

from __future__ import annotations

import inspect
import math
from collections.abc import Sequence
from pathlib import Path

from scripts.benchmarks.baselines import BASELINES
from scripts.benchmarks.markdown import fixed, short, table
from scripts.benchmarks.record import load_section
from scripts.benchmarks.tables import shading
from scripts.website.formulas import NOTES
from scripts.website.spheres import draw
from torch_orennayar import MODELS, TorchOrenNayarError, simplest_model
from torch_orennayar.reflectance import coefficients, formulas, theory

ROUGHEST = (10, 20, 30, 45, 60)
"""Upper ends of the ranges of roughness in the tables of choices, degrees."""
TOLERANCES = (0.1, 0.05, 0.03, 0.01, 0.003)
"""Errors allowed in these tables."""
SYMBOLS = r"""Symbols are those of Oren and Nayar:

- {math}`\theta_i, \phi_i` and {math}`\theta_r, \phi_r` are the directions of light and view about the normal,
  {math}`\alpha` the larger and {math}`\beta` the smaller of {math}`\theta_i` and {math}`\theta_r`;
  {math}`\sigma` is the standard deviation of the facets' slope angle in radians, {math}`\rho` their albedo,
  {math}`E_0` the irradiance of a plane that faces the light.
- In code, `ci` is {math}`\cos\,\theta_i`, `co` {math}`\cos\,\theta_r`, `lv` the cosine between light and view,
  and `lv - ci * co` is {math}`s = \sin\,\theta_i \sin\,\theta_r \cos(\phi_r - \phi_i)`. No angle is computed.
  What functions return is {math}`\pi f_r = \pi L_r / (E_0 \cos\,\theta_i)`.
"""


def write(folder: Path) -> None:
    """Write the index and the pages, with their pictures."""
    (folder / "images").mkdir(parents=True)
    names = [name for name in MODELS if name in NOTES]
    for name in names:
        (folder / f"{name}.md").write_text(_page(name), encoding="utf-8")
    draw(folder / "images", names)
    uses = table(["model", "when to use it"], [[f"[{name}]({name}.md)", NOTES[name].use] for name in names])
    toctree = "\n```{toctree}\n:hidden:\n\n" + "\n".join(names) + "\n```\n"
    parts = [
        "# Reflectance models\n", uses, toctree, "## Symbols\n", SYMBOLS, "## Error and cost\n", shading.models(),
        "\n## Which one is chosen\n", _choices(None),
    ]  # fmt: skip
    (folder / "index.md").write_text("\n".join(parts), encoding="utf-8")


def _page(name: str) -> str:
    model, notes = MODELS[name], NOTES[name]
    parts = [
        f"# {name}\n", f"{notes.use}\n", f"Source: {model.source}.\n", "## Formula\n",
        *(f"{lead}\n\n```{{math}}\n{formula}\n```\n" for lead, formula in notes.formula),
        "The symbols are explained [with the list of models](index.md#symbols).\n",
    ]  # fmt: skip
    if name == "vcavity":
        parts.append(_coefficients())
    parts += ["## Code\n", f"```python\n{_code(notes.code)}```\n", "## Pictures\n"]
    parts.append(
        f"![Spheres of {name} and of the theory by roughness and light](images/{name}.png)\n\n"
        "*Albedo 0.8, orthographic view, light at 0, 45 and 75 degrees from it. The column of σ = 0 is Lambert.*\n"
    )
    parts += ["## Error and cost\n", _errors(name), "## Gradients\n", f"{model.gradients.capitalize()}.\n"]
    parts.append(
        f"![Shading and its derivative across the plane of incidence](images/{name}-gradients.png)\n\n"
        "*View at 40 degrees, σ = 30 degrees, albedo 0.8. Dotted: the light on the normal (s = 0) and at the view.*\n"
    )
    parts += ["## When `simplest_model` picks it\n", _choices(name), "## Slips that circulate\n"]
    return "\n".join([*parts, *(f"- {slip}" for slip in notes.slips), "", _copies(notes.copies)])


def _code(names: Sequence[str]) -> str:
    """The source of the functions that make up a model."""
    return "\n\n".join(inspect.getsource(getattr(formulas, n, None) or getattr(theory, n)) for n in names)


def _coefficients() -> str:
    """The numbers of the fit, as `scripts/fit/fit_vcavity.py` wrote them."""
    shape = ("c", "\\beta", "k_0", "k_1", "k_2", "\\kappa", "\\tau")
    linear = [*(f"a_{{{k}}}" for k in range(14)), *(f"g_{k}" for k in range(5)), *(f"d_{k}" for k in range(5))]
    pairs = zip((*shape, *linear), (*coefficients.VCAVITY_SHAPE, *coefficients.VCAVITY_LINEAR), strict=True)
    cells = [f"{{math}}`{name}` = {value:.6g}" for name, value in pairs]
    rows = [cells[k : k + 5] + [""] * (5 - len(cells[k : k + 5])) for k in range(0, len(cells), 5)]
    return f"Coefficients, by `scripts/fit/fit_vcavity.py`, rounded:\n\n{table(['', '', '', '', ''], rows)}\n"


def _errors(name: str) -> str:
    """Error against the theory by roughness and albedo, and cost."""
    summary = load_section("evaluate_reflectance", "errors").results[name]
    white = load_section("evaluate_reflectance", "properties").results[name]
    chart = load_section("chart_reflectance", "models")
    found, (dark, middle, bright) = chart.results["entries"][name], chart.results["albedo"]
    time = found["time"]
    facts = [
        ["RMS error, all bounces", fixed(summary["RMS"], 4)],
        ["largest error", fixed(summary["maximum"], 3)],
        ["RMS error, two bounces", fixed(summary["RMS, two bounces"], 4)],
        ["RMS error, light and view both grazing", fixed(found["grazing"], 4)],
        ["reflected by a white surface", f"{white['furnace, least']:.3f} – {white['furnace, most']:.3f}"],
        *([f"{shading.KINDS[kind]}, ms per megapixel", short(time[kind], 3)] for kind in time),
    ]
    by_roughness = [
        [f"{degrees}", *(fixed(c, 4) for c in cells)]
        for degrees, cells in zip(chart.results["roughness_degrees"], found["cells"], strict=True)
    ]
    header = ["RMS error at σ, degrees", *(f"albedo {a:g}" for a in (dark, middle, bright))]
    return (
        f"Errors are those of shading over albedo against the V-cavity theory "
        f"([measurements](../measurements.md#reflectance-models)).\n\n{table(['', name], facts)}\n\n"
        f"{table(header, by_roughness)}\n\n{chart.source}\n"
    )


def _choice(degrees: float, tolerance: float) -> str:
    """The choice for roughness from 0 up to ``degrees``, any albedo and angle."""
    try:
        return simplest_model(roughness=(0.0, math.radians(degrees)), tolerance=tolerance).name
    except TorchOrenNayarError:
        return "none"


def _choices(own: str | None) -> str:
    """The choices by roughness and tolerance, with those of one model in bold."""
    chosen = {t: [_choice(degrees, t) for degrees in ROUGHEST] for t in TOLERANCES}
    rows = [[f"{t:g}", *(f"**{c}**" if c == own else c for c in row)] for t, row in chosen.items()]
    header = ["error allowed", *(f"σ up to {degrees}°" for degrees in ROUGHEST)]
    never = own and not any(own in row for row in chosen.values())
    said = "Never, in this table: another is cheaper or nearer to the theory wherever this one suffices.\n\n"
    return (said if never else "") + "Any albedo, any angle:\n\n" + table(header, rows) + "\n"


def _copies(names: Sequence[str]) -> str:
    """Measured implementations in circulation."""
    if not names:
        return ""
    chart = load_section("chart_reflectance", "models")
    unfit = load_section("stability", "map").results["counts"]
    rows = []
    for copy in (b for b in BASELINES if b.name in names):
        found, cases = chart.results["entries"][copy.name], unfit.get(copy.name)
        what = " ".join((copy.shade.__doc__ or "").split())
        finite = str(cases["not finite"]) if cases else "–"
        source = f"{copy.source} ([on the formula]({copy.link}))"
        rows.append([copy.name, what, source, fixed(found["rms"], 4), fixed(found["max"], 3), finite])
    header = ["copied as", "what it computes", "found in", "RMS error", "largest", "edge cases not finite"]
    return f"Measured beside the models of this package:\n\n{table(header, rows)}\n"
