"""Open the page: make environment and graphs if they are missing, fetch the runtime, serve to this machine only.

python3 examples/web/serve.py [--port 8000] [--no-open] [--prepare]
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import webbrowser
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

HERE = Path(__file__).resolve().parent
"""The folder that is served."""
ROOT = HERE.parent.parent
"""The repository."""


class Handler(SimpleHTTPRequestHandler):
    """Serves the page with the headers that allow threads and forbid other origins."""

    extensions_map = SimpleHTTPRequestHandler.extensions_map | {
        ".js": "text/javascript",
        ".mjs": "text/javascript",
        ".wasm": "application/wasm",
        ".onnx": "application/octet-stream",
    }

    def end_headers(self) -> None:
        """Add the headers: browsers allow threads only in pages isolated from other origins."""
        self.send_header("Cross-Origin-Opener-Policy", "same-origin")
        self.send_header("Cross-Origin-Embedder-Policy", "require-corp")
        self.send_header("Cache-Control", "no-cache")
        super().end_headers()

    def log_message(self, *_: object) -> None:
        """Log nothing: the page itself shows what is missing."""


def outdated() -> bool:
    """Whether the graphs are missing, or older than the Python package."""
    sources = [*(ROOT / "torch_orennayar").rglob("*.p[ty]"), HERE / "make_graphs.py"]
    last = HERE / "graphs" / "normal.png"  # the last file that make_graphs.py writes
    return not last.exists() or last.stat().st_mtime < max(s.stat().st_mtime for s in sources)


def install() -> None:
    """Install the page's packages, unless they are those of the lock file."""
    locked = HERE / "node_modules" / ".package-lock.json"
    if not locked.exists() or locked.stat().st_mtime < (HERE / "package-lock.json").stat().st_mtime:
        npm = shutil.which("npm")
        if npm is None:
            sys.exit("npm is needed to fetch the packages of the page: install Node.js 20 or newer")
        print("fetching the page's packages", flush=True)
        subprocess.run([npm, "ci", "--silent", "--no-audit", "--no-fund", "--ignore-scripts"], cwd=HERE, check=True)


def prepare() -> None:
    """`install`, and write the graphs unless they are newer than the Python package."""
    install()
    if outdated():
        sys.path.insert(0, str(ROOT))
        from scripts.environment import prepare as environment

        subprocess.run([environment("all"), HERE / "make_graphs.py", HERE / "graphs"], check=True)


def server(port: int) -> ThreadingHTTPServer:
    """A server that only this machine reaches; port 0 is any free port."""
    return ThreadingHTTPServer(("127.0.0.1", port), partial(Handler, directory=str(HERE)))


def main() -> None:
    """Prepare, then serve until Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--port", type=int, default=8000)
    parser.add_argument("--no-open", action="store_true", help="do not open a browser")
    parser.add_argument("--prepare", action="store_true", help="fetch and export, then exit")
    options = parser.parse_args()
    prepare()
    if options.prepare:
        return
    try:
        page = server(options.port)
    except OSError as error:
        sys.exit(f"port {options.port} is not free ({error.strerror}): try --port {options.port + 1}")
    address = f"http://localhost:{page.server_address[1]}/"
    print(f"{address}   (Ctrl-C ends)", flush=True)
    if not options.no_open:
        webbrowser.open(address)
    try:
        page.serve_forever()
    except KeyboardInterrupt:
        print()


if __name__ == "__main__":
    main()
