"""Every link of the site to itself leads to a file that is there, and to an anchor that is in it."""

from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class Page(HTMLParser):
    """The anchors and the links of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: set[str] = set()
        self.feed(path.read_text())

    def handle_starttag(self, tag, attrs):
        """Collect what is pointed at, and what points."""
        given = dict(attrs)
        self.anchors |= {given[name] for name in ("id", "name") if given.get(name)}
        self.links |= {given[name] for name in ("href", "src") if given.get(name) and tag in ("a", "img")}


def broken(root: Path, pages: list[Path]) -> tuple[list[str], int]:
    """The links of pages in a folder that lead nowhere in it, in words, and how many links there are."""
    read, found, count = {path: Page(path) for path in pages}, [], 0
    for path, page in read.items():
        for link in sorted(page.links):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            count += 1
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.exists():
                found.append(f"{path.relative_to(root)} links to {link}, a file that is not there")
            elif parts.fragment and target in read and unquote(parts.fragment) not in read[target].anchors:
                found.append(f"{path.relative_to(root)} links to {link}, an anchor that is not there")
    return found, count


def check(app, exception):
    """Warn of each link that leads nowhere; warnings are errors."""
    from sphinx.util import logging

    if exception or app.builder.name != "html":
        return
    root = Path(app.outdir).resolve()
    found, count = broken(root, [root / app.builder.get_target_uri(name) for name in sorted(app.env.all_docs)])
    for words in found:
        logging.getLogger(__name__).warning(words)
    logging.getLogger(__name__).info(f"{count} links of the site to itself, {len(found)} of them lead nowhere")
