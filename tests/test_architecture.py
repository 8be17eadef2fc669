"""Files and folders that docs/architecture.md names exist, and its floors are those of the test of imports."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "architecture.md").read_text()


def rows(heading: str) -> list[list[str]]:
    """The cells of the table under a heading, without its first two lines."""
    section = PAGE.split(f"## {heading}\n")[1].split("\n## ")[0]
    lines = [line for line in section.split("\n") if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def test_every_file_to_open_exists():
    table = rows("To change X, open Y")
    assert len(table) >= 20
    for change, place in table:
        path = ROOT / place.strip("`")
        assert path.is_file(), f"{change}: there is no {place}"


def test_every_folder_of_a_floor_exists():
    for _, folders, _ in rows("Floors"):
        places = re.findall(r"`([^`]+)`", folders)
        assert places
        assert all((ROOT / place).exists() for place in places), places


def test_names_of_classes_on_the_page_are_in_the_code():
    section = PAGE.split("## One solve\n")[1].split("\n## ")[0]
    sources = "".join(path.read_text() for path in (ROOT / "integrators").rglob("*.py"))
    steps = re.findall(r"^\d+\. ", section, re.MULTILINE)
    assert len(steps) == 12
    for name in re.findall(r"`([A-Za-z_]+)(?:\.\w+)?`", section):
        assert re.search(rf"^(?:class|def) {name}\b", sources, re.MULTILINE) or name in (
            "steps",
            "shooting",
            "ConvergenceError",
        ), name
