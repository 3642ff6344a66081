"""Error and time of photometric stereo on captures that come with true normals, as the README quotes them.

    python scripts/evaluate_stereo.py FOLDER...

Per folder: mean angular error of plain least squares, of the robust Lambertian solver and of `auto`, what `auto` chose,
its seconds with and without loading, and Spearman's rank correlation of its confidence with its error (-1 is ideal).
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

from scipy.stats import spearmanr

from torch_orennayar import Reconstruction, angular_error, load_capture, photometric_stereo


def main(folders: list[str]) -> None:
    """Print one line per folder."""
    if not folders:
        sys.exit("name at least one capture folder")
    print("capture         pixels  least sq.  lambert    auto  chosen     solve    all   rank")
    for folder in folders:
        begun = time.perf_counter()
        capture = load_capture(folder)
        truth, mask = capture.normal, capture.mask
        if truth is None:
            sys.exit(f"{folder} has no true normals")
        loaded = time.perf_counter()
        auto = photometric_stereo(capture.images, capture.lights, mask)
        done = time.perf_counter()
        lambert = photometric_stereo(capture.images, capture.lights, mask, model="lambert")
        plain = photometric_stereo(capture.images, capture.lights, mask, model="lambert", robust=False)

        def mean(found: Reconstruction) -> float:
            return angular_error(found.normal, truth, mask).summary()["mean"]  # noqa: B023

        rank = spearmanr(auto.confidence[mask], angular_error(auto.normal, truth, mask)[mask], nan_policy="omit")[0]
        print(
            f"{Path(folder).name:14}{int(mask.sum()):8d}{mean(plain):11.2f}{mean(lambert):9.2f}{mean(auto):8.2f}"
            f"  {auto.model!s:10}{done - loaded:6.1f}s{done - begun:6.1f}s{rank:+7.2f}"
        )


if __name__ == "__main__":
    main(sys.argv[1:])
