"""The conformance kit catches what is wrong, and the documentation says truly which check catches what.

``python -m tests.testing.test_mutants`` writes the tables of the documentation.
"""

import re
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


# What a fact writes in ASCII, and how a page sets it.
WORDS = "momentum|hat|vee|Ad|ad|body|spatial|covector|vector|kinetic_energy|chart|frame|both_ways|exp|log|det|Id"
LATEX = (
    (r"-> ", r"\\mapsto "),
    (r"<([^<>]*)>", r"\\langle \1\\rangle"),
    (r"<([^<>]*)>", r"\\langle \1\\rangle"),  # around the one above
    (r"sqrt\(eps\)", r"\\sqrt{\\varepsilon}"),
    (r"\^\(([^)]*)\)|\^(-\d)", r"^{\1\2}"),
    (r"sum_(\w+)", r"\\sum_{\1}"),
    (r"\beps\b", r"\\varepsilon"),
    (r"\b(theta|omega|mu|xi)(?=\b|_)", r"\\\1"),
    (r"\b([pqz])dot\b", r"\\dot \1"),
    (r"g_f\(x\)", "g_{f(x)}"),
    (r"\bpr([12])\*", r"\\mathrm{pr}_\1^*"),
    (r"\bDR\*", "DR^*"),
    (r"\bR([12])\b", r"R^\1"),
    (r"\b([xpq])([01])\b", r"\1_\2"),
    (rf"(?<!\\)\b({WORDS})\b", lambda word: rf"\operatorname{{{word[0]}}}".replace("_", r"\_")),
    (r" \. ", r" \\cdot "),
)
CODE = "vmap", "reach"


def latex(formula: str) -> str:
    """A formula in ASCII as LaTeX; names of the code as code."""
    if formula in CODE:
        return f"`{formula}`"
    for pattern, replacement in LATEX:
        formula = re.sub(pattern, replacement, formula)
    return f"${formula.strip()}$"


def as_page(text: str) -> str:
    """Text with its formulas in LaTeX."""
    return re.sub(r"(`+)(.+?)\1", lambda found: latex(found[2]), text)


def measured_row(name: str) -> str:
    """A mutant and the checks that it fails."""
    check, subject, options = MUTANTS[name]
    failures = check(subject, throw=False, **options).failures
    return f"| {as_page(name)} | {', '.join(f'`{outcome.check.name}`' for outcome in failures)} |"


def fact_rows() -> list[str]:
    """The checks of each suite with the facts they state."""
    every = ((kind, check) for kind, checks in SUITES.items() for check in checks)
    return [f"| {kind} | `{check.name}` | {as_page(check.fact)} |" for kind, check in every]


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
@pytest.mark.usual(2)
def test_the_table_says_which_checks_catch_a_mutant(name):
    row = measured_row(name)
    assert row in documented_rows("Which check catches which mutant")
    assert not row.endswith("|  |")


def test_the_tables_have_a_row_for_each_mutant_and_each_check():
    assert [
        row.split(" | ")[0].removeprefix("| ") for row in documented_rows("Which check catches which mutant")
    ] == list(map(as_page, MUTANTS))
    assert documented_rows("The checks") == fact_rows()


def write() -> None:
    """Write both tables into the documentation, instead of those that are there."""
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
