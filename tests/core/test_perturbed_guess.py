"""Guesses that the core moves aside, beside those of the engine."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute.binding.search import Search, SearchStatus
from retrax.integrators import OptimalControlProblem, Solver
from retrax.integrators.boundary_value.engine.aside import aside
from retrax.integrators.boundary_value.transcription import core_search
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Cayley, Gauss, Midpoint

from ..integrators.problems import IDENTITY, REST, RIGID, SLEW, half_square
from ..integrators.search_cases import CASES
from .test_transcription import posed, put, run_on_core

SPACE, PLANE = Euclidean(3), Euclidean(2)


def car(q: Any, u: Any) -> Any:
    """A car, which cannot move sideways."""
    return jnp.stack([u[0] * jnp.cos(q[2]), u[0] * jnp.sin(q[2]), u[1]])


def heisenberg(q: Any, u: Any) -> Any:
    """A curve in the plane with the area that it sweeps."""
    return jnp.stack([u[0], u[1], (q[0] * u[1] - q[1] * u[0]) / 2])


def beside(field: Any, end: tuple[float, ...], method: Any, **options: Any) -> tuple[Solver, tuple, dict[str, Any]]:
    """A way to a point that no control leads to at first."""
    problem = OptimalControlProblem(SPACE, field, half_square, 2, **options)
    return Solver(problem, method, 12), (np.zeros(3), np.array(end), 1.0), {}


OPPOSITE = IDENTITY @ np.diag([-1.0, -1.0, 1.0]), REST
DEGENERATE = {
    "a car": lambda: beside(car, (0.0, 1.0, 0.0), Midpoint(Addition(SPACE))),
    "a car by collocation": lambda: beside(car, (0.0, 1.0, 0.0), Gauss(2, Addition(SPACE))),
    "a limited car": lambda: beside(car, (0.0, 1.0, 0.0), Midpoint(Addition(SPACE)), control_bounds=(-9.0, 9.0)),
    "a limited car by collocation": lambda: beside(
        car, (0.0, 1.0, 0.0), Gauss(2, Addition(SPACE)), control_bounds=(-9.0, 9.0)
    ),
    "an area": lambda: beside(heisenberg, (0.0, 0.0, 1.0), Midpoint(Addition(SPACE))),
}  # fmt: skip
OTHERS = {
    "half a turn": lambda: (Solver(SLEW, Midpoint(Cayley(RIGID)), 12), ((IDENTITY, REST), OPPOSITE, 60.0), {}),
    "half a turn by collocation": lambda: (
        Solver(SLEW, Gauss(2, Cayley(RIGID)), 6), ((IDENTITY, REST), OPPOSITE, 60.0), {}
    ),
}  # fmt: skip


def moved_by_both(conditions: Any, guess: Any) -> None:
    """Compare what both make of a guess."""
    first, assembled = conditions.begin(guess)
    expected, held = aside(conditions, first, assembled)
    search = Search(core_search.made(conditions), 1e-8, 100)
    put(search.trajectory, conditions, first)
    assert search.perturb() == held[0]
    at, unknowns = search.trajectory, expected.unknowns
    arrays = {"CENTRES": unknowns.centres, "CONTROLS": unknowns.controls, "COSTATES": expected.costates}
    if hasattr(unknowns, "velocities"):
        arrays |= {"VELOCITIES": unknowns.velocities}
    for array, own in arrays.items():
        size = max(1e-6, np.abs(own).max())
        np.testing.assert_allclose(at[array], own.ravel(), rtol=1e-7, atol=1e-7 * size, err_msg=array)
    assert not at["LIMIT_MULTIPLIERS"].any()


@pytest.mark.parametrize("name", [*CASES, *DEGENERATE, *OTHERS])
def test_a_guess_is_moved_as_by_the_engine(name, monkeypatch):
    """Guesses of solves, and for states in R^n the same with all states at the start, where nothing is spread."""
    run_on_core(monkeypatch)
    solver, way, options = (CASES | DEGENERATE | OTHERS)[name]()
    conditions, guess = posed(solver, way, monkeypatch, throw=False, **options)
    moved_by_both(conditions, guess)
    if name in DEGENERATE:
        rest = guess.unknowns._replace(centres=np.zeros_like(guess.unknowns.centres))
        moved_by_both(conditions, guess._replace(unknowns=rest))


@pytest.mark.parametrize("name", DEGENERATE)
def test_searches_from_beside_a_degenerate_guess_end(name, monkeypatch):
    run_on_core(monkeypatch)
    solver, way, options = DEGENERATE[name]()
    expected = solver.solve(*way, **options)
    runs, run = [], Search.run
    monkeypatch.setattr(Search, "run", lambda own: runs.append(run(own)) or runs[-1])
    run_on_core(monkeypatch, "search")
    found = solver.solve(*way, **options)
    assert SearchStatus.DEGENERATE in runs
    assert found.success
    assert found.cost == pytest.approx(expected.cost, rel=1e-8)
