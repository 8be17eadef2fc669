"""Files and folders that docs/architecture.md names exist, and its floors are those of the test of imports."""

import re
from pathlib import Path

from .test_layers import FLOORS, FOLDERS, floor

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "architecture.md").read_text()


def rows(heading: str) -> list[list[str]]:
    """The cells of the tables under a heading, without the first two lines of each."""
    section = PAGE.split(f"## {heading}\n")[1].split("\n## ")[0]
    tables = re.findall(r"^\|.*\n\|---.*\n((?:\|.*\n)+)", section, re.MULTILINE)
    lines = [line for table in tables for line in table.splitlines()]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_every_file_to_open_exists():
    table = rows("To change X, open Y")
    assert len(table) >= 20
    for change, cell in table:
        places = re.findall(r"`([^`]+)`", cell)
        assert places
        assert all((ROOT / place).is_file() for place in places), f"{change}: {cell}"


def module(place: str) -> str:
    """The name of the module at a place of the repository, without ``retrax.``."""
    folder = max((folder for folder in FOLDERS if f"{place}/".startswith(f"{folder}/")), key=len)
    parts = FOLDERS[folder].split(".") + place.removeprefix(folder).strip("/").split("/")
    return ".".join(part.removesuffix(".py") for part in parts[1:] if part not in ("", "__init__.py"))


def test_the_floors_are_those_of_the_test_of_imports():
    table = rows("Floors")
    assert [name for name, _, _ in table] == [name for name, _ in reversed(FLOORS)]
    for level, (name, cell, _) in enumerate(reversed(table)):
        places = re.findall(r"`([^`]+)`", cell)
        own = {module(place): ROOT / place for place in places if place != "src/retrax"}
        assert all(path.exists() for path in own.values()), places
        assert {floor(one) for one in own} == {level}, name
        missing = set(FLOORS[level][1].split(" ")) - own.keys()
        if "and the files of `src/retrax` in no other row" in cell:
            missing = {one for one in missing if not (ROOT / "src" / "retrax" / f"{one}.py").is_file()}
        assert not missing, name


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
