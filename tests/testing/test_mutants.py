"""The conformance kit catches what is wrong, and the documentation says truly which check catches what.

``python -m tests.testing.test_mutants`` writes the tables of the documentation.
"""

from pathlib import Path

import jax
import pytest
from retrax.testing.checks import (
    COTANGENT_LIFT_CHECKS,
    DISCRETIZATION_CHECKS,
    LIE_GROUP_CHECKS,
    MANIFOLD_CHECKS,
    METRIC_CHECKS,
    RETRACTION_CHECKS,
)

from .mutants import MUTANTS

DOCUMENT = Path(__file__).parents[2] / "docs" / "conformance_checks.md"
SUITES = {
    "manifold": MANIFOLD_CHECKS,
    "Lie group": LIE_GROUP_CHECKS[len(MANIFOLD_CHECKS) :],
    "metric": METRIC_CHECKS,
    "retraction": RETRACTION_CHECKS,
    "discretization map": DISCRETIZATION_CHECKS,
    "cotangent lift": COTANGENT_LIFT_CHECKS,
}


def measured_row(name: str) -> str:
    """A mutant and the checks that it fails."""
    check, subject, options = MUTANTS[name]
    failures = check(subject, throw=False, **options).failures
    return f"| {name} | {', '.join(f'`{outcome.check.name}`' for outcome in failures)} |"


def fact_rows() -> list[str]:
    """The checks of each suite with the facts they state."""
    return [f"| {kind} | `{check.name}` | {check.fact} |" for kind, checks in SUITES.items() for check in checks]


def documented_rows(heading: str) -> list[str]:
    """Rows of the table below a heading of the documentation."""
    section = DOCUMENT.read_text().split(f"## {heading}\n")[1].split("\n## ")[0]
    return [line for line in section.splitlines() if line.startswith("| ")][1:]


# One of a kind by default, all with the slow tests.
QUICK = (
    "a manifold whose projection is missing",
    "a basis that is constant",
    "`R(x, -v)`",
    "a first-order retraction",
    "an inverse valid only near zero, said",
    "a derivative that is NaN at the identity",
    "a map that claims",
    "a lift with the sign of `p` flipped",
    "violations without the absolute value",
    "random points on a spiral",
    "a momentum",
    "a metric with twice the energy",
    "an inverse of points outside the image that",
)


def marked(name: str):
    return pytest.param(name, marks=[pytest.mark.slow] * (not name.startswith(QUICK)))


@pytest.mark.parametrize("name", [marked(name) for name in MUTANTS])
def test_the_table_says_which_checks_catch_a_mutant(name):
    row = measured_row(name)
    assert row in documented_rows("Which check catches which mutant")
    assert not row.endswith("|  |")


def test_the_tables_have_a_row_for_each_mutant_and_each_check():
    assert [
        row.split(" | ")[0].removeprefix("| ") for row in documented_rows("Which check catches which mutant")
    ] == list(MUTANTS)
    assert documented_rows("The checks") == fact_rows()


def write() -> None:
    """Write both tables into the documentation, in place of those that are there."""
    tables = {
        "The checks": ["| of a | check | fact |", "|---|---|---|", *fact_rows()],
        "Which check catches which mutant": ["| mutant | caught by |", "|---|---|", *map(measured_row, MUTANTS)],
    }
    text = DOCUMENT.read_text()
    for heading, table in tables.items():
        before, after = text.split(f"## {heading}\n")
        section, *rest = after.split("\n## ", 1)
        words = section.split("\n|")[0].rstrip()
        section = "\n".join([words, "", *table]) + "\n"
        text = f"{before}## {heading}\n" + "\n## ".join([section, *rest])
    DOCUMENT.write_text(text)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    write()
