"""Build the site in out/site from docstrings, guides, gallery, recorded results and changelog; warnings are errors.

python -m scripts.website [options of sphinx-build]
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

from scripts.benchmarks import history
from scripts.benchmarks.record import ROOT
from scripts.website import commands, links, models, pages, reference

SOURCE, CACHE, SITE = (ROOT / "out" / name for name in ("site-source", "site-cache", "site"))


def main(options: list[str]) -> None:
    """Write the source tree, run Sphinx on it and check every link of what comes out."""
    for folder in (SOURCE, CACHE, SITE):
        shutil.rmtree(folder, ignore_errors=True)
    SOURCE.mkdir(parents=True)
    pages.write(SOURCE)
    reference.write(SOURCE / "reference")
    commands.write(SOURCE / "commands.md")
    models.write(SOURCE / "models")
    history.write(SOURCE)
    command = [sys.executable, "-m", "sphinx", "-c", "scripts/website", "-W", "--keep-going", "--quiet", *options]
    # The gallery's warnings would show with the paths of this machine; the reports that it prints say the same.
    environment = {**os.environ, "MPLBACKEND": "agg", "PYTHONWARNINGS": "ignore::UserWarning"}
    command += ["-d", str(CACHE), str(SOURCE), str(SITE)]
    status = subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode
    if status:
        sys.exit(status)
    wrong = links.check(SITE)
    if wrong:
        sys.exit("\n".join(wrong))
    print(f"{SITE.relative_to(ROOT)}/index.html")


if __name__ == "__main__":
    main(sys.argv[1:])
