"""Import examples as modules and serve the page of `examples/web`, for tests and benchmarks."""

from __future__ import annotations

import importlib.util
import shutil
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
WEB = EXAMPLES / "web"
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
"""Commands by which Chromium is installed."""
CHROMIUM = next((path for name in BROWSERS if (path := shutil.which(name))), "")
"""Path of the first of them, or nothing."""
CAN_BROWSE = bool(CHROMIUM) and (shutil.which("npm") is not None or (WEB / "node_modules").is_dir())
"""Whether the page can be opened: it needs a browser, and npm unless its modules are installed."""


def load(name: str) -> ModuleType:
    """Import an example by its path below `examples`, without the suffix."""
    spec = importlib.util.spec_from_file_location(Path(name).name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)  # dataclasses look up their module there
    spec.loader.exec_module(module)
    return module


@contextmanager
def served_page() -> Iterator[str]:
    """Prepare and serve the page; its address."""
    serve = load("web/serve")
    if serve.outdated():  # in this process, so that graphs which other tests trace too are traced once
        load("web/make_graphs").main(str(serve.HERE / "graphs"))
    serve.prepare()
    server = serve.server(0)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://localhost:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()
