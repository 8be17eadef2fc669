"""The record of a solution: immutable, printable, storable, and a guess for the next one."""

from dataclasses import FrozenInstanceError, fields

import jax
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Result, Solution, load_solution, solve
from retrax.manifolds import ConvergenceError, Euclidean, Product, hat
from retrax.retractions import Exponential, Midpoint

from .problems import IDENTITY, REST, SO3, rotation

STEPS = 4
NESTED = Product(Product(SO3, Euclidean(3)), Euclidean(1))
PROBLEM = OptimalControlProblem(
    NESTED, lambda q, u: ((q[0][0] @ hat(q[0][1]), u), u[:1]), lambda q, u: u @ u / 2 + q[1] @ q[1], 3
)


def solve_nested(turn: float = 0.7, **options) -> Solution:
    start, end = ((IDENTITY, REST), np.zeros(1)), ((rotation([turn, 0.2, 0.1]), REST), None)
    return solve(PROBLEM, start, end, 2.0, method=Midpoint(Exponential(NESTED)), steps=STEPS, **options)


@pytest.fixture(scope="module")
def solution() -> Solution:
    return solve_nested()


def same(a: object, b: object) -> bool:
    """Equal field by field, arrays bit by bit and with their types."""
    one, other = jax.tree.flatten(a), jax.tree.flatten(b)
    equal = [
        np.array_equal(x, y) and np.asarray(x).dtype == np.asarray(y).dtype
        for x, y in zip(one[0], other[0], strict=True)
    ]
    return one[1] == other[1] and all(equal)


def test_nodes_and_stages_are_numpy_arrays_along_the_leading_axis(solution):
    (attitude, rate), last = solution.states
    assert all(
        type(leaf) is np.ndarray for leaf in jax.tree.leaves((solution.states, solution.controls, solution.costates))
    )
    assert attitude.shape == (STEPS + 1, 3, 3)
    assert rate.shape == solution.costates[0][1].shape == (STEPS + 1, 3)
    assert last.shape == (STEPS + 1, 1)
    assert solution.controls.shape == (STEPS, 3)
    assert solution.stage_states[0][0].shape == (STEPS, 3, 3)
    assert solution.hamiltonians.shape == solution.stage_times.shape == (STEPS,)
    assert np.allclose(solution.times, [0.0, 0.5, 1.0, 1.5, 2.0])
    assert np.allclose(solution.stage_times, [0.25, 0.75, 1.25, 1.75])
    assert solution.steps == STEPS


def test_a_solution_cannot_be_changed(solution):
    for record in (solution, solution.checks, solution.statistics):
        for field in fields(record):
            with pytest.raises(FrozenInstanceError):
                setattr(record, field.name, None)
    for leaf in jax.tree.leaves((solution.times, solution.states, solution.controls, solution.momenta)):
        with pytest.raises(ValueError, match="read-only"):
            leaf[...] = 0


def test_the_report_has_the_numbers(solution, capsys):
    solution.report()
    text = capsys.readouterr().out
    assert text.strip() == str(solution).strip()
    checks = solution.checks
    for number in (
        f"{solution.cost:.12g}",
        f"{checks.defect:.1e}",
        f"{checks.stationarity:.1e}",
        f"{checks.hamiltonian:.10g}",
    ):
        assert number in text
    for words, violation in checks.violations.items():
        assert f"{words}: {violation:.1e}" in text
    for name, spread in checks.momentum_spreads.items():
        assert name in text
        whole = checks.conserved[name] == solution.momenta[name].shape[1]
        assert (f"spread over the nodes {spread:.1e}" in " ".join(text.split())) == whole
    assert solution.result in text
    assert f"{solution.statistics.iterations} Newton steps" in text
    assert "strict local minimum" in text


def test_momenta_of_every_factor_are_found_by_their_path(solution):
    assert [name.split(",")[0] for name in solution.momenta] == ["factor 0", "factor 0", "factor 1"]
    assert len(solution.body_costates) == len(solution.spatial_costates) == 1
    (body,), (spatial,) = solution.body_costates.values(), solution.spatial_costates.values()
    turned = np.einsum("kij,kj->ki", solution.states[0][0], body)
    assert np.max(np.abs(turned - spatial)) < 1e-14
    assert np.max(np.ptp(spatial, axis=0)) < 1e-10  # the problem does not see how the body is turned


def test_saving_and_loading_returns_the_same_record(solution, tmp_path):
    path = tmp_path / "solution.npz"
    solution.save(path)
    loaded = load_solution(path)
    for field in fields(Solution):
        mine, theirs = getattr(solution, field.name), getattr(loaded, field.name)
        if field.name in ("checks", "statistics"):
            assert mine == theirs
        else:
            assert same(mine, theirs), field.name
    assert str(loaded) == str(solution)


@pytest.mark.parametrize("kind", [str, lambda path: path], ids=["text", "path"])
def test_a_solution_is_loaded_from_the_name_it_was_saved_under(solution, tmp_path, kind):
    name = kind(tmp_path / "without_an_ending")
    solution.save(name)
    assert load_solution(name).cost == solution.cost


def test_a_solution_is_a_guess_that_is_right_at_once(solution):
    again = solve_nested(guess=solution)
    assert again.statistics.iterations <= 1
    assert again.cost == pytest.approx(solution.cost, rel=1e-13)
    loaded_guess = solve_nested(guess=solution.guess())
    assert loaded_guess.statistics.iterations <= 1


def test_a_solution_is_a_good_guess_for_a_nearby_problem(solution):
    near = solve_nested(turn=0.71, guess=solution)
    assert near.statistics.iterations <= 4
    assert near.success


def test_an_unfinished_solution_says_so_and_can_be_required(solution):
    unfinished = solve_nested(turn=2.5, max_iterations=1, throw=False)
    assert not unfinished.success
    assert unfinished.result == Result[Result.too_many_iterations]
    assert unfinished.result in " ".join(str(unfinished).split())  # on several lines
    with pytest.raises(ConvergenceError, match="iteration limit"):
        unfinished.require_success()
    assert solution.require_success() is solution
