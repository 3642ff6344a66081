"""Follow the guides to captures and draw their pictures; prints the errors that the photographs' truth shows.

The picture of failures is that of `examples/gallery/where_methods_fail.py`.

python -m scripts.benchmarks.guide_pictures [--output .github/images]
"""

from __future__ import annotations

import argparse
import os
import runpy
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import torch
from torch import Tensor

from scripts.benchmarks.record import ROOT
from tests.support.guides import follow, normal_error
from torch_orennayar.io.figures import save_sheet
from torch_orennayar.io.images import read_image
from torch_orennayar.io.picture import to_unit

PICTURES = {
    "mirror-ball": {
        "a photograph": "photographs/IMG_2001.JPG", "the ball": "out/ball.png", "the object": "out/object_mask.png",
        "normals": "out/normal.png", "albedo": "out/albedo.png",
    },
    "unknown-lights": {
        "a photograph": "photographs/IMG_2001.JPG", "the object": "out/object_mask.png", "normals": "out/normal.png",
        "albedo": "out/albedo.png",
    },
    "near-lamps": {
        "a photograph": "photographs/IMG_2001.JPG", "normals, as distant": "distant/normal.png",
        "normals": "out/normal.png", "albedo": "out/albedo.png",
    },
}  # fmt: skip
"""What each guide shows: captions and files, of those that its commands leave."""
FAILURES_DPI = 80
"""Dots per inch of the picture of failures, as wide as a page."""


def main() -> None:
    """Follow every guide in a folder of its own."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=ROOT / ".github" / "images")
    output = parser.parse_args().output.resolve()
    for guide, files in PICTURES.items():
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            follow(f"{guide}.md", run)
            for results in sorted(
                file.parent for file in Path().glob("*/normal.npy") if (file.parent / "result.json").exists()
            ):
                print(f"{guide}, {results}: normals {normal_error(str(results)):.2f} degrees off")
            save_sheet(output / f"guide_{guide.replace('-', '_')}.png", [{c: picture(f) for c, f in files.items()}])
            os.chdir(ROOT)
    plt.switch_backend("agg")
    runpy.run_path(str(ROOT / "examples" / "gallery" / "where_methods_fail.py"))
    plt.gcf().savefig(output / "failures.png", dpi=FAILURES_DPI)


def run(*words: object) -> None:
    """Run the command in a process of its own."""
    subprocess.run([sys.executable, "-m", "torch_orennayar", *map(str, words)], check=True)


def picture(file: str) -> Tensor:
    """(3, H, W) colours of a picture."""
    shown = torch.from_numpy(to_unit(read_image(Path(file))))
    return shown.expand(3, *shown.shape) if shown.ndim == 2 else shown.permute(2, 0, 1)


if __name__ == "__main__":
    main()
