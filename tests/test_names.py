"""Names of files and classes are nouns, never past participles, but for what a list has, which can only shrink."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = "manifolds", "retractions", "integrators", "src/retrax"
IRREGULAR = frozenset(
    {
        "begun",
        "bound",
        "built",
        "cut",
        "done",
        "drawn",
        "found",
        "given",
        "gone",
        "held",
        "kept",
        "known",
        "laid",
        "left",
        "lost",
        "made",
        "met",
        "out",
        "put",
        "read",
        "seen",
        "sent",
        "set",
        "shown",
        "split",
        "spread",
        "spent",
        "stood",
        "taken",
        "told",
        "written",
    }
)
NOUNS = frozenset({"set", "bound", "seed", "speed", "need", "level_set"})
# By file: the file itself as "file", or its classes.
EXCEPTIONS: dict[str, frozenset[str]] = {
    "retractions/constructions/stabilized.py": frozenset({"file"}),
    "retractions/groups/group_map.py": frozenset({"Translated"}),
    "retractions/groups/special_euclidean.py": frozenset({"SEDecoupled"}),
    "retractions/restored.py": frozenset({"file"}),
    "src/retrax/undisturbed.py": frozenset({"file"}),
}


def is_participle(words: list[str]) -> bool:
    """Whether a name of these words ends with a past participle."""
    last = words[-1].lower()
    return last not in NOUNS and (last in IRREGULAR or re.search(r"[^aeiou]?ed$", last) is not None)


def participles(path: Path) -> set[str]:
    """The participles among the name of a file, as ``file``, and its classes."""
    found = {"file"} if is_participle(path.stem.strip("_").split("_")) else set[str]()
    for node in ast.walk(ast.parse(path.read_text())):
        words = re.findall(r"[A-Z]+[a-z]*", node.name) if isinstance(node, ast.ClassDef) else []
        if words and is_participle(words):
            found.add(node.name)
    return found


@pytest.mark.parametrize("folder", FOLDERS)
def test_files_and_classes_are_named_by_nouns(folder):
    paths = {path.relative_to(ROOT).as_posix(): path for path in (ROOT / folder).rglob("*.py")}
    found = {name: own for name, path in paths.items() if (own := participles(path))}
    listed = {name: set(own) for name, own in EXCEPTIONS.items() if name.startswith(f"{folder}/")}
    new = {name: own - listed.get(name, set()) for name, own in found.items() if own - listed.get(name, set())}
    assert not new, f"name these by a noun of the field: {new}"
    gone = {name: own - found.get(name, set()) for name, own in listed.items() if own - found.get(name, set())}
    assert not gone, f"take these off the list: {gone}"


def test_no_folder_of_the_new_layout_has_more_than_sixteen_files():
    folders = [path.parent for folder in FOLDERS[2:] for path in (ROOT / folder).rglob("__init__.py")]
    counts = {folder.relative_to(ROOT).as_posix(): len(list(folder.glob("*.py"))) for folder in folders}
    large = {name for name, count in counts.items() if count > 16}
    assert large <= {"integrators/initial_value", "src/retrax", "src/retrax/tape"}


def test_the_test_knows_participles():
    assert all(is_participle([word]) for word in ("Found", "posed", "stored", "Traced", "held"))
    assert not any(is_participle([word]) for word in ("Solution", "set", "defect", "builder", "scaling", "Speed"))
