"""Decisions that one file takes: no other file of the solver of boundary-value problems writes them."""

import ast
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "integrators" / "boundary_value"
RECORDS = frozenset({"Solution", "PhasedSolution", "replace", "renewed"})


def writers(names: frozenset[str]) -> set[str]:
    """Files with calls that make or change a record and set one of these fields by its name."""
    found = set()
    for path in FOLDER.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
                name = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
                if name in RECORDS and any(own.arg in names for own in node.keywords):
                    found.add(path.relative_to(FOLDER).as_posix())
    return found


def test_success_and_result_are_written_by_the_status_alone() -> None:
    assert writers(frozenset({"success", "result"})) == {"audit/status.py"}


def test_what_is_sought_can_be_found() -> None:
    assert writers(frozenset({"statistics"})) >= {"solution/diagnostics.py", "drivers/mesh_refinement.py"}
