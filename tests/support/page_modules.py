"""The Python code of pages as modules, for type checkers: ``python tests/support/page_modules.py FOLDER PAGE...``."""

import re
import sys
from pathlib import Path


def code(page: str) -> str:
    """The Python blocks of a page, one after the other."""
    return "\n".join(re.findall(r"^```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE))


def write(folder: Path, pages: list[Path]) -> list[Path]:
    """Write a module for each page with Python code; returns the modules."""
    texts = {folder / f"page_{page.stem.lower()}.py": code(page.read_text()) for page in pages}
    written = [module for module, text in texts.items() if text]
    for module in written:
        module.write_text(texts[module])
    return written


if __name__ == "__main__":
    write(Path(sys.argv[1]), [Path(page) for page in sys.argv[2:]])
