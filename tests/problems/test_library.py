"""Every problem of the library is solved from its default guess, in one call, or is listed here with the reason."""

import importlib
import re
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax import problems
from retrax.compute.at_points import evaluate_at_each
from retrax.manifolds import InvalidInputError, Product, RetraxError

pytestmark = pytest.mark.usefixtures("traced_once")

SITE = Path(__file__).parents[2] / "docs" / "_site"
QUICK = (
    "kinematic-slew",
    "sphere-geodesic",
    "grushin",
    "heisenberg",
    "regulator",
    "least-effort",
    "detumbling",
    "rendezvous",
    "zermelo",
    "orbit-raising",
    "catalyst-mixing",
)
UNSOLVED: dict[str, str] = {}


@cache
def entries() -> dict[str, problems.KnownProblem]:
    return {entry.name: entry for entry in problems.all()}


def arrives(name: str) -> tuple[bool, str]:
    """Whether the optimum comes out of one call, and what is said of it."""
    entry = problems.get(name)
    try:
        solution = entry.solve(throw=False)
    except RetraxError as error:
        return False, str(error)
    distance = entry.distance(solution.cost)
    return solution.success and abs(distance) <= entry.error, f"{distance:.1e} from the optimum: {solution.result}"


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[] if n in QUICK else [pytest.mark.slow]) for n in problems.names()]
)
@pytest.mark.usual(2)
def test_a_problem_is_solved_from_its_default_guess_unless_it_is_listed(name):
    arrived, said = arrives(name)
    assert arrived == (name not in UNSOLVED), said


def test_the_list_names_problems():
    assert set(UNSOLVED) <= set(problems.names())
    assert set(QUICK) <= set(problems.names()) - set(UNSOLVED)


@pytest.mark.parametrize("name", problems.names())
@pytest.mark.usual(12)
def test_a_record_is_complete(name):
    entry = entries()[name]
    assert entry.name == name
    assert entry.title
    assert entry.equations
    assert entry.source
    assert entry.origin
    assert entry.states
    assert entry.controls
    assert np.isfinite(entry.optimum)
    assert entry.digits >= 5
    assert name in repr(entry)


def fixed(manifold, point):
    """The factors of a manifold that an end prescribes, with their points."""
    if isinstance(manifold, Product) and isinstance(point, tuple):
        return [pair for factor, part in zip(manifold.factors, point, strict=True) for pair in fixed(factor, part)]
    return [] if point is None else [(manifold, point)]


@pytest.mark.parametrize("name", problems.names())
def test_ends_and_guesses_are_on_the_manifold(name):
    entry = entries()[name]
    manifold = entry.problem.manifold
    for factor, point in (*fixed(manifold, entry.start), *fixed(manifold, entry.end)):
        assert max(factor.violations(jax.tree.map(np.asarray, point)).values(), default=0.0) < 1e-14
    if entry.guess is not None:
        violations = evaluate_at_each(manifold.violations, entry.guess.states)
        assert max((float(np.max(v)) for v in violations.values()), default=0.0) < 1e-12


@pytest.mark.parametrize("name", problems.names())
def test_functions_return_a_velocity_and_a_number(name):
    problem = entries()[name].problem
    at = problem.manifold.ambient, problem.controls.ambient, *[jnp.zeros(())] * problem.time_dependent
    velocity = jax.eval_shape(problem.dynamics, *at)
    assert jax.tree.map(jnp.shape, velocity) == jax.tree.map(jnp.shape, problem.manifold.ambient)
    assert jnp.shape(jax.eval_shape(problem.running_cost, *at)) == ()
    if problem.terminal_cost is not None:
        assert jnp.shape(jax.eval_shape(problem.terminal_cost, *at[:1], *at[2:])) == ()


def test_a_name_that_no_problem_has_is_refused():
    with pytest.raises(InvalidInputError, match=r"'bets'; the names are .*betts"):
        problems.get("bets")


@pytest.fixture
def pages(monkeypatch):
    monkeypatch.syspath_prepend(str(SITE))
    return importlib.import_module("problem_pages")


def test_the_index_of_the_site_has_every_problem_with_its_optimum(pages):
    rows = re.findall(r"^\| \[([^]]+)\]\(\1\.md\) \|.*?\| (\S+) \|", pages.index(), re.MULTILINE)
    assert dict(rows) == {name: f"{e.optimum:.{min(e.digits, 10)}g}" for name, e in entries().items()}
    assert len(rows) == len(entries())


@pytest.mark.parametrize("name", problems.names())
def test_the_page_of_a_problem_states_it_in_latex(name, pages):
    """Braces are balanced, each symbol of the record is in the equations, and so is what limits the controls."""
    entry = entries()[name]
    solved = pages.Solved(20, entry.optimum, True)
    page, said = pages.page(entry, solved), " ".join(entry.equations)
    assert said.startswith(r"\text{minimise }")
    for text in (*entry.equations, entry.formula):
        assert text.count("{") == text.count("}")
        assert text.count(r"\left") == text.count(r"\right")
    for row in re.findall(r"^\| (?:state|control) \$([^$]+)\$ \|", page, re.MULTILINE):
        for symbol in row.replace("_{", "_").replace("}", "").split(", "):
            letter = re.sub(r"\\dot |_\w+", "", symbol)
            assert re.search(rf"(?<![a-zA-Z\\]){letter}(?![a-zA-Z])", said.replace(r"\dot", r"\dot ")), symbol
    assert not re.search(r"\$\s*\$|\bnan\b", page.replace("$$", ""))
    if entry.problem.control_bounds is not None or entry.problem.constraints:
        assert r"\le" in said or r"\ge" in said
