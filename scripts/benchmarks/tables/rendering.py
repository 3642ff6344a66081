"""Tables of the renderer."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress

from scripts.benchmarks.markdown import NOTHING, short, table
from scripts.benchmarks.record import NotMeasuredError, load_section, sources

RENDERER = "benchmark_renderer"
TARGETS = {"20480 triangles": "llvmpipe (OpenGL)", "327680 triangles": "Mitsuba 3 (LLVM)"}
"""The renderer whose time is aimed at, by the mesh."""
GPU_SECTIONS = ("parity", "shading", "renderer", "stereo", "data")
"""Sections of the measurement on an accelerator."""


def comparison() -> str:
    """Milliseconds of every renderer."""
    section = load_section(RENDERER, "comparison")
    names = list(dict.fromkeys(name for rows in section.results.values() for name in rows))
    body = []
    for title, rows in section.results.items():
        target = next((name for mesh, name in TARGETS.items() if title.startswith(mesh)), "")
        ratio = rows.get(target, {}).get("ours over it")
        cells = [short(rows.get(name, {}).get("ms"), 3) for name in names]
        body.append([title, *cells, f"{target}: {short(ratio)} times its time" if ratio else NOTHING])
    return f"{section.source}\n\n{table(['milliseconds', *names, 'target'], body)}"


def accuracy() -> str:
    """Mean error of the normals of every renderer."""
    section = load_section(RENDERER, "accuracy")
    shapes = list(dict.fromkeys((row["shape"], row["triangles"]) for row in section.results))
    found = {(r["renderer"], r["shape"], r["triangles"]): r["degrees"] for r in section.results}
    names = list(dict.fromkeys(row["renderer"] for row in section.results))
    rows = [[name, *(short(found.get((name, *shape))) for shape in shapes)] for name in names]
    header = ["mean error of normals in degrees", *(f"{shape}, {count:,} triangles" for shape, count in shapes)]
    return f"{section.source}\n\n{table(header, rows)}"


def steps() -> str:
    """Milliseconds of the steps, of batches, and peak memory."""
    parts = []
    for title, head in (("steps", "20,480 triangles at 512²"), ("batches", "batches at 128²")):
        section = load_section(RENDERER, title)
        rows = [[name, short(value, 3)] for name, value in section.results.items()]
        parts.append(f"{section.source}\n\n{table([head, 'milliseconds'], rows)}")
    return "\n\n".join(parts)


def memory() -> str:
    """Peak memory of a picture."""
    section = load_section(RENDERER, "memory")
    rows = [[name, short(value, 3)] for name, value in section.results.items()]
    return f"{section.source}\n\n{table(['peak memory', 'MB'], rows)}"


def gpu() -> str:
    """What `gpu` measured on an accelerator, number by number."""
    found = {}
    for title in GPU_SECTIONS:
        with suppress(NotMeasuredError):
            found[title] = load_section("gpu", title)
    rows = [[title, name, words] for title, section in found.items() for name, words in _numbers(section.results)]
    rows += [[title, "not measured yet", NOTHING] for title in GPU_SECTIONS if title not in found]
    return "\n\n".join([*([sources(*found.values())] if found else []), table(["section", "what", "value"], rows)])


def _numbers(results: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Names and values of nested results; of a ratio its median."""
    for name, value in results.items():
        whole = f"{prefix}, {name}" if prefix else name
        if isinstance(value, Mapping) and "median" in value:
            yield whole, short(value["median"])
        elif isinstance(value, Mapping):
            yield from _numbers(value, whole)
        elif isinstance(value, (int, float)):
            yield whole, f"{value:,}" if isinstance(value, int) else short(value)


def busy() -> str:
    """Slow-down beside busy processes."""
    section = load_section("busy", "slow-down")
    found = section.results
    alone, others = found["milliseconds"]["0"], [o for o in found["milliseconds"] if o != "0"]
    rows = [
        [f"`{name}`", short(ms, 3), *(f"{found['milliseconds'][o][name] / ms:.1f} x" for o in others)]
        for name, ms in alone.items()
    ]
    header = [
        f"{found['threads']} threads, {found['cores']} cores", "milliseconds alone",
        *(f"beside {o} busy processes (fair: {found['fair'][o]:.1f} x)" for o in others),
    ]  # fmt: skip
    return f"{section.source}\n\n{table(header, rows)}"
