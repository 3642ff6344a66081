"""Check a built site: every link into it leads somewhere, and no page loads anything from another machine."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADED = {"script": "src", "img": "src", "iframe": "src", "source": "src", "video": "src", "link": "href"}
"""Tags whose address a browser loads by itself, and the attribute that holds it."""


class _Page(HTMLParser):
    """The names on a page that links may lead to, where its links lead, and what it loads."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.names: set[str] = set()
        self.links: set[str] = set()
        self.loads: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what one tag holds."""
        given = {name: value for name, value in attrs if value}
        self.names |= {given[name] for name in ("id", "name") if name in given}
        address = given.get(LOADED.get(tag, "href" if tag == "a" else ""))
        if address:
            self.links.add(address)
            if tag != "a" and given.get("rel") not in ("canonical", "prev", "next", "search", "index", "genindex"):
                self.loads.add(address)


def check(site: Path) -> list[str]:
    """A line for every broken link and for everything that is loaded from elsewhere."""
    pages = {file: _Page(file.read_text(encoding="utf-8")) for file in sorted(site.rglob("*.html"))}
    wrong = []
    for file, page in pages.items():
        place = file.relative_to(site)
        wrong += [f"{place}: loads {address}" for address in sorted(page.loads) if urlsplit(address).netloc]
        for address in sorted(page.links):
            parts = urlsplit(address)
            if parts.scheme or parts.netloc:
                continue
            target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
            target = target / "index.html" if target.is_dir() else target
            if not target.is_file():
                wrong.append(f"{place}: {address} does not exist")
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].names | {"top"}:
                wrong.append(f"{place}: {address} leads to no place on its page")
    for sheet in site.rglob("*.css"):
        text = sheet.read_text(encoding="utf-8")
        if "url(http" in text or "url(//" in text or "@import" in text:
            wrong.append(f"{sheet.relative_to(site)}: loads from elsewhere")
    return wrong
