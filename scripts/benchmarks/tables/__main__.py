"""Write the tables of the documentation from the recorded results.

    python -m scripts.benchmarks.tables [--check]

A file holds a table between ``<!-- table: NAME -->`` and ``<!-- end -->``; what stands between them is replaced. With
``--check`` nothing is written, and the exit status is 1 if a file differs from what would be written.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterable
from difflib import unified_diff
from pathlib import Path

from scripts.benchmarks.record import ROOT, NotMeasuredError
from scripts.benchmarks.tables import rendering, shading, shape, stereo

BLOCKS: dict[str, Callable[[], str]] = {
    "summary": stereo.summary,
    "photographs": stereo.photographs,
    "other methods": stereo.other_methods,
    "rendered captures": stereo.rendered,
    "few lights": stereo.few_lights,
    "wrong calibration": stereo.wrong_calibration,
    "near lights": stereo.near_lights,
    "light positions": stereo.light_positions,
    "unknown lights": stereo.unknown_lights,
    "unknown lights, few": stereo.unknown_lights_few,
    "stereo edge cases": stereo.edge_cases,
    "wrong light files": stereo.wrong_light_files,
    "network errors": stereo.network_errors,
    "several materials": stereo.several_materials,
    "confidence": stereo.confidence,
    "two roughnesses": stereo.two_roughnesses,
    "interreflection": stereo.interreflection,
    "stereo memory": stereo.stereo_memory,
    "light directions": stereo.light_directions,
    "light intensities": stereo.light_intensities,
    "batch cost": stereo.batch_cost,
    "large captures": stereo.large_captures,
    "synthetic speed": stereo.synthetic_speed,
    "synthetic switches": stereo.synthetic_switches,
    "training traffic": stereo.training_traffic,
    "integration": shape.integration,
    "integration large": shape.integration_large,
    "integration sharpness": shape.integration_sharpness,
    "shape surfaces": shape.surfaces,
    "shape pictures": shape.pictures,
    "shape ambient": shape.ambient,
    "shape steps": shape.steps,
    "shape sizes": shape.sizes,
    "shape failures": shape.failures,
    "shape counts": shape.counts,
    "shape light": shape.light,
    "models": shading.models,
    "model errors": shading.model_errors,
    "model properties": shading.properties,
    "accuracy and speed": shading.accuracy_and_speed,
    "materials": shading.materials,
    "eon roughness": shading.eon_roughness,
    "shading speed": shading.shading_speed,
    "shading memory": shading.shading_memory,
    "onnx shading": shading.onnx_shading,
    "onnx renderer": shading.onnx_renderer,
    "onnx integration": shading.onnx_integration,
    "onnx stereo": shading.onnx_stereo,
    "stability": shading.stability,
    "rounding": shading.rounding,
    "fuzzing": shading.fuzzing,
    "gpu": rendering.gpu,
    "finding codes": shading.finding_codes,
    "renderer comparison": rendering.comparison,
    "renderer accuracy": rendering.accuracy,
    "renderer steps": rendering.steps,
    "renderer memory": rendering.memory,
    "busy": rendering.busy,
}
"""What makes each table, by the name in the marker."""
MARKER = re.compile(r"(<!-- table: (?P<name>[^>]+?) -->\n).*?(<!-- end -->)", re.DOTALL)
"""A table with its markers."""


def files() -> list[Path]:
    """The documents that hold tables."""
    single = ("README.md", "scripts/benchmarks/README.md", "torch_orennayar/stereo/set_network.md")
    return [*(ROOT / name for name in single), *sorted((ROOT / "examples/guides").glob("*.md"))]


def block(name: str) -> str:
    """The table called ``name``, or that it has not been measured."""
    try:
        return BLOCKS[name]()
    except NotMeasuredError:
        return "*Not measured yet.*"


def fill(text: str) -> str:
    """``text`` with every table made anew.

    Raises:
        KeyError: a marker names no table.
    """
    return MARKER.sub(lambda found: f"{found[1]}\n{block(found['name'])}\n\n{found[3]}", text)


def update(paths: Iterable[Path], *, check: bool) -> list[str]:
    """Write the tables of files, or with ``check`` only compare; the differences as lines of a diff."""
    differences: list[str] = []
    for path in paths:
        text = path.read_text(encoding="utf-8")
        wanted = fill(text)
        differences += unified_diff(text.splitlines(), wanted.splitlines(), str(path), "from the results", lineterm="")
        if not check and wanted != text:
            path.write_text(wanted, encoding="utf-8")
    return differences


def main() -> None:
    """Write or check."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; fail if a table differs from the results")
    check = parser.parse_args().check
    differences = update(files(), check=check)
    if check and differences:
        sys.exit("\n".join([*differences, "run python -m scripts.benchmarks.tables"]))


if __name__ == "__main__":
    main()
