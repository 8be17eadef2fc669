"""Pages of the gallery without the times of the computer that builds the site."""

import re
from typing import Any

TIME = re.compile(r"^ *time +\d.*(to prepare and check|with compilation).*\n", re.MULTILINE)  # of a report


def process(app: Any, docname: str, source: list[str]) -> None:
    """Remove the lines with times from the source of a page of the gallery, in place."""
    if docname.startswith("examples/"):
        source[0] = TIME.sub("", source[0])
