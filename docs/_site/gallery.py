"""The examples as pages: their scripts run as they are, and the pictures that they write are shown."""

import ast
import shutil
from pathlib import Path
from typing import Any

from docstrings import escaped
from sphinx_gallery.scrapers import figure_rst

HEAD = """Examples
========

Each script states its equation, solves it, checks the result against a known value, and draws it. They run as they are:
``python examples/attitude_slew.py``. What a page shows, its script has printed and drawn when the site was built. Each
page has its script as a notebook too.
"""
shown: set[Path] = set()


def prepare(source: Path, target: Path) -> None:
    """Copies of the scripts whose titles are underlined, as the gallery wants them."""
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir()
    (target / "README.rst").write_text(HEAD)
    for script in sorted(source.glob("*.py")):
        text = script.read_text()
        written = ast.get_docstring(ast.parse(text), clean=False) or ""
        title, _, rest = written.partition("\n")
        body = set_off(rest)
        underlined = f"{title}\n{'=' * len(title)}\n{body}"
        text = text.removeprefix("r").replace(f'"""{written}"""', f'r"""{underlined}"""', 1)
        (target / script.name).write_text(as_page(text))


def as_page(text: str) -> str:
    """A script that runs where it lies, without a name of its file and without arguments, as notebooks have some of
    their own."""
    changed = text.replace("Path(__file__).parent", "Path()")
    if not changed.rstrip().endswith("    main()"):
        raise ValueError(f"a script of the gallery ends with a call of main(), got {changed[-60:]!r}")
    return changed.rstrip().removesuffix("main()") + "main([])\n"


def set_off(text: str) -> str:
    """The text with its indented lines as formulas, and its commands as literal blocks; signs of mathematics outside of
    roles are no markup, and lists stay lists."""
    lines: list[str] = []
    for line in text.split("\n"):
        if line.startswith("    ") and not (lines and lines[-1].strip()):
            lines += ["::" if line.startswith("    python ") else ".. math::", ""]
        marker = "* " if line.startswith("* ") else ""
        lines.append(line if line.startswith("    ") else marker + escaped(line.removeprefix(marker)))
    return "\n".join(lines)


def written(block: Any, variables: dict[str, Any], settings: dict[str, Any]) -> str:
    """The pictures that a script has written beside it since it was last asked."""
    folder = Path(variables["src_file"]).parent / "output"
    found = sorted(path for path in folder.glob("*.png") if path not in shown)
    places = []
    for picture in found:
        shown.add(picture)
        place = Path(variables["image_path_iterator"].next())
        shutil.copy(picture, place)
        places.append(str(place))
    return figure_rst(places, settings["src_dir"])
