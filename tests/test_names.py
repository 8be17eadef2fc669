"""Names of files and classes are nouns, of functions verbs or nouns, never past participles, but for what a list has,
which can only shrink."""

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
# Words that are verbs too, prepositions that may follow a participle, and beginnings of names that may end with one.
VERBS = frozenset({"cut", "embed", "out", "put", "read", "set", "split", "spread"}) | NOUNS
PREPOSITIONS = frozenset({"along", "at", "by", "of", "off", "on", "out"})
QUESTIONS = frozenset({"are", "find", "from", "has", "is", "require", "with", "without"})
# By file: its functions and methods, most of them public.
FUNCTIONS: dict[str, frozenset[str]] = {
    "integrators/boundary_value/solution/record.py": frozenset({"held_by"}),
    "integrators/dirac/dirac_system.py": frozenset({"controlled"}),
    "integrators/problem/quantities.py": frozenset({"bounded", "labelled", "unnamed"}),
    "integrators/problem/spline_table.py": frozenset({"tabulated"}),
    "integrators/singular/strategies/final_manifold_stages.py": frozenset({"suited"}),
    "integrators/singular/strategies/goh_reduced_integrator.py": frozenset({"suited"}),
    "integrators/singular/strategies/projection.py": frozenset({"suited"}),
    "integrators/singular/strategies/rattle.py": frozenset({"suited"}),
    "integrators/singular/strategies/stage_integrator.py": frozenset({"suited"}),
    "integrators/singular/strategies/strategy.py": frozenset({"suited"}),
    "src/retrax/plotting/conditions.py": frozenset({"conserved"}),
    "src/retrax/testing/checks/lie_group.py": frozenset({"tangent_vectors_are_trivialised_from_the_left"}),
    "src/retrax/testing/checks/retraction.py": frozenset({"domain_reaches_as_far_as_expected", "order_is_as_claimed"}),
    "src/retrax/testing/numerics.py": frozenset({"compiled"}),
    "src/retrax/undisturbed.py": frozenset({"undisturbed"}),
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


def is_function_participle(name: str) -> bool:
    """Whether a function, not a question, has a name that ends with a past participle, or with one and a
    preposition."""
    words = name.strip("_").lower().split("_")
    if words[0] in QUESTIONS:
        return False
    while len(words) > 1 and words[-1] in PREPOSITIONS:
        words = words[:-1]
    return words[-1] not in VERBS and is_participle(words)


def function_participles(path: Path) -> set[str]:
    """The participles among the functions and methods of a file; a property may be a state."""
    functions = (node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.FunctionDef))
    own = (node for node in functions if not any("property" in ast.unparse(mark) for mark in node.decorator_list))
    return {node.name for node in own if is_function_participle(node.name)}


def compare(found: dict[str, set[str]], listed: dict[str, frozenset[str]], kind: str) -> None:
    """Fail for names that are not listed, and for listed names that are gone."""
    new = {name: own - listed.get(name, set()) for name, own in found.items() if own - listed.get(name, set())}
    assert not new, f"name these by {kind} of the field: {new}"
    gone = {name: set(own - found.get(name, set())) for name, own in listed.items() if own - found.get(name, set())}
    assert not gone, f"take these off the list: {gone}"


@pytest.mark.parametrize("folder", FOLDERS[2:])
def test_functions_are_named_by_verbs_or_nouns(folder):
    paths = {path.relative_to(ROOT).as_posix(): path for path in (ROOT / folder).rglob("*.py")}
    found = {name: own for name, path in paths.items() if (own := function_participles(path))}
    listed = {name: own for name, own in FUNCTIONS.items() if name.startswith(f"{folder}/")}
    compare(found, listed, "a verb or a noun")


@pytest.mark.parametrize("folder", FOLDERS)
def test_files_and_classes_are_named_by_nouns(folder):
    paths = {path.relative_to(ROOT).as_posix(): path for path in (ROOT / folder).rglob("*.py")}
    found = {name: own for name, path in paths.items() if (own := participles(path))}
    listed = {name: own for name, own in EXCEPTIONS.items() if name.startswith(f"{folder}/")}
    compare(found, listed, "a noun")


def test_no_folder_of_the_new_layout_has_more_than_sixteen_files():
    folders = [path.parent for folder in FOLDERS[2:] for path in (ROOT / folder).rglob("__init__.py")]
    counts = {folder.relative_to(ROOT).as_posix(): len(list(folder.glob("*.py"))) for folder in folders}
    large = {name for name, count in counts.items() if count > 16}
    assert large <= {"integrators/initial_value", "src/retrax", "src/retrax/tape"}


def test_no_file_has_more_than_four_hundred_lines():
    """But the header of the core, which is its documentation for a C programmer."""
    rooms = "integrators", "manifolds", "retractions", "src"
    paths = [path for room in rooms for kind in ("*.py", "*.c", "*.h") for path in (ROOT / room).rglob(kind)]
    lines = {path.name: path.read_text().count("\n") for path in paths}
    assert len(lines) > 300
    assert {name for name, count in lines.items() if count > 400} == {"retrax_core.h"}


def test_the_test_knows_participles():
    assert all(is_participle([word]) for word in ("Found", "posed", "stored", "Traced", "held"))
    assert not any(is_participle([word]) for word in ("Solution", "set", "defect", "builder", "scaling", "Speed"))
    assert all(map(is_function_participle, ("_found", "solved", "moved_along", "_told")))
    assert not any(map(is_function_participle, ("solve", "is_found", "read", "closed_form", "from_given", "pullback")))
