"""Imports go down the floors of docs/architecture.md, and no files import one another in a circle.

Imports inside functions and under ``TYPE_CHECKING`` count.
"""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = {
    "src/retrax": "retrax",
    "manifolds": "retrax.manifolds",
    "retractions": "retrax.retractions",
    "integrators": "retrax.integrators",
}
VALUE = "integrators.boundary_value"
# From the ground up; a module belongs to the floor of the longest prefix of its name.
FLOORS = (
    ("tools", "errors hooks module optional progress former_names newton_constants jaxpr_tools constant_folding "
     "tracing index_bounds undisturbed _version "
     "compute.threads compute.working_memory compute.binding"),
    ("tape", "tape"),
    ("manifolds", "manifolds"),
    ("retractions", "retractions"),
    ("reporting", "integrators.reporting former_order"),
    ("compute", "compute"),
    ("problem", "integrators.problem"),
    ("stages", "integrators.stages"),
    ("problem checks", "integrators.problem_checks"),
    ("initial value", "integrators.initial_value"),
    ("dirac", "integrators.dirac"),
    ("singular", "integrators.singular"),
    ("inputs", f"{VALUE}.inputs {VALUE}.guess {VALUE}.iteration_reports"),
    ("transcription", f"{VALUE}.transcription"),
    ("solution", f"{VALUE}.solution"),
    ("reformulations and audit", " ".join(
        f"{VALUE}.{name}"
        for name in ("reformulations", "audit", "shooting", "regularity", "regular_extremals", "solution_builder")
    )),
    ("export", f"{VALUE}.export"),
    ("solver", f"{VALUE}.solver"),
    ("drivers", f"{VALUE}.drivers"),
    ("closed loop", "integrators.closed_loop"),
    ("solve", f"{VALUE} integrators"),
    ("doors", "named_columns loading interop testing problems plotting sweeps"),
    ("retrax", "__main__ presentation "),
)  # fmt: skip


def modules() -> dict[str, Path]:
    """The files of the project by the names of their modules, without ``retrax.``."""
    found = {}
    for folder, package in FOLDERS.items():
        for path in (ROOT / folder).rglob("*.py"):
            parts = [package, *path.relative_to(ROOT / folder).with_suffix("").parts]
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            found[name.removeprefix("retrax").removeprefix(".")] = path
    return found


def imported(name: str, source: str, is_package: bool, known: set[str]) -> set[str]:
    """The modules of the project that a module imports anywhere."""
    found: set[str] = set()
    parts = name.split(".") if name else []
    package = parts if is_package else parts[:-1]
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.ImportFrom):
            continue
        asked = node.module.split(".") if node.module else []
        if node.level:
            base = [*package[: len(package) - node.level + 1], *asked]
        elif asked[0] == "retrax":
            base = asked[1:]
        else:
            continue
        for alias in node.names:
            whole = ".".join([*base, alias.name])
            found.add(whole if whole in known else ".".join(base))
    return found - {name}


@cache
def graph() -> dict[str, frozenset[str]]:
    """The imports of each module."""
    files = modules()
    return {
        name: frozenset(imported(name, path.read_text(), path.name == "__init__.py", set(files)))
        for name, path in files.items()
    }


def floor(name: str) -> int:
    """The floor of a module, counted from the ground."""
    best, level = -1, -1
    for k, (_, prefixes) in enumerate(FLOORS):
        for prefix in prefixes.split(" "):
            if (name == prefix or name.startswith(f"{prefix}.") or not prefix) and len(prefix) > best:
                best, level = len(prefix), k
    return level


def arrows_up(imports: dict[str, frozenset[str]]) -> dict[str, list[str]]:
    """The imports of a higher floor, by module."""
    found = {name: sorted(other for other in own if floor(other) > floor(name)) for name, own in imports.items()}
    return {name: others for name, others in sorted(found.items()) if others}


def circles(imports: dict[str, frozenset[str]]) -> list[set[str]]:
    """The sets of modules that reach one another by imports, Tarjan (1972), largest first."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[set[str]] = []

    def visit(name: str) -> None:
        index[name] = low[name] = len(index)
        stack.append(name)
        for other in imports.get(name, ()):
            if other not in index:
                visit(other)
            if other in stack:
                low[name] = min(low[name], low[other])
        if low[name] == index[name]:
            at = stack.index(name)
            found.append(set(stack[at:]))
            del stack[at:]

    for name in imports:
        if name not in index:
            visit(name)
    return sorted((circle for circle in found if len(circle) > 1), key=len, reverse=True)


def test_imports_go_down():
    assert not arrows_up(graph())


def test_no_files_import_one_another_in_a_circle():
    assert not circles(graph())


def test_the_test_sees_an_import_in_a_function_and_a_circle():
    source = "def f():\n    from ..problem.notation import g\n    return g\n"
    known = {"integrators.problem.notation", "integrators.reporting.text"}
    assert imported("integrators.reporting.text", source, False, known) == {"integrators.problem.notation"}
    absolute = source.replace("..problem", "retrax.integrators.problem")
    assert imported("integrators.reporting.text", absolute, False, known) == {"integrators.problem.notation"}
    below = {"integrators.reporting.text": frozenset({"integrators.problem.notation"})}
    assert arrows_up(below) == {"integrators.reporting.text": ["integrators.problem.notation"]}
    assert circles({"a": frozenset("b"), "b": frozenset("c"), "c": frozenset("a"), "d": frozenset("a")}) == [
        {"a", "b", "c"}
    ]
