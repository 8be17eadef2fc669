"""Guesses that controls cannot lead away from, which the core perturbs."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.compute.binding.search import Search, SearchStatus
from retrax.integrators import OptimalControlProblem, Solver
from retrax.integrators.boundary_value.transcription import core_transcription
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Cayley, Gauss, Midpoint
from scipy.optimize import minimize

from ..integrators.problems import IDENTITY, REST, RIGID, SLEW, half_square
from .trajectories import CASES, posed, put

SPACE, STEPS = Euclidean(3), 12


def car(q: Any, u: Any) -> Any:
    """A car, which cannot move sideways."""
    return jnp.stack([u[0] * jnp.cos(q[2]), u[0] * jnp.sin(q[2]), u[1]])


def heisenberg(q: Any, u: Any) -> Any:
    """A curve in the plane with the area that it sweeps."""
    return jnp.stack([u[0], u[1], (q[0] * u[1] - q[1] * u[0]) / 2])


def beside(field: Any, end: tuple[float, ...], method: Any, **options: Any) -> tuple[Solver, tuple, dict[str, Any]]:
    """A way to a point that no control leads to at first."""
    problem = OptimalControlProblem(SPACE, field, half_square, 2, **options)
    return Solver(problem, method, STEPS), (np.zeros(3), np.array(end), 1.0), {}


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
UNKNOWNS = "CENTRES", "VELOCITIES", "CONTROLS"


def perturbed(phase: Any, guess: Any) -> tuple[bool, dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Whether a perturbation hardly moves something, and the arrays before and behind it."""
    search = Search(core_transcription.make_transcription(phase), 1e-8, 1)
    put(search.trajectory, phase, guess)
    before = {name: search.trajectory[name].copy() for name in UNKNOWNS}
    search.run()
    search.trajectory.set_iterate(search.read().first)
    held, at = search.perturb(), search.trajectory
    return held, before, {name: at[name].copy() for name in (*UNKNOWNS, "COSTATES", "LIMIT_MULTIPLIERS")}


@pytest.mark.parametrize("name", [*CASES, *DEGENERATE, *OTHERS])
@pytest.mark.usual(2)
def test_a_perturbation_is_always_the_same_and_on_the_manifold(name, monkeypatch):
    """Without multipliers: the multipliers of a degenerate guess tell nothing."""
    solver, way, options = (CASES | DEGENERATE | OTHERS)[name]()
    phase, guess = posed(solver, way, monkeypatch, throw=False, **options)
    (held, before, found), (again, _, same) = perturbed(phase, guess), perturbed(phase, guess)
    assert held == again
    for array, own in found.items():
        np.testing.assert_array_equal(own, same[array])
        assert np.isfinite(own).all()
    assert not found["LIMIT_MULTIPLIERS"].any()
    manifold, layout = phase.transcription.manifold, phase.at_nodes.layout
    centres = jnp.asarray(found["CENTRES"].reshape(-1, layout.size))
    for violation in jax.vmap(lambda row: manifold.violations(layout.point(row)))(centres).values():
        assert np.all(np.abs(violation) < 1e-12)
    assert any(np.any(found[array] != before[array]) for array in UNKNOWNS)
    if name in DEGENERATE:  # by about the distance from the start to the end
        assert np.abs(found["CENTRES"] - before["CENTRES"]).max() < 2.0


def roll(u: np.ndarray, field: Any, method: Any) -> np.ndarray:
    """The end to which controls lead by the method, with fixed-point iterations for its points."""
    gauss = method if isinstance(method, Gauss) else Gauss(1, Addition(SPACE))
    q, h = np.zeros(3), 1 / STEPS
    for own in u.reshape(STEPS, gauss.stages, 2):
        rates = np.zeros((gauss.stages, 3))
        for _ in range(40):
            rates = np.stack([field(q + h * row @ rates, v) for row, v in zip(gauss.matrix, own, strict=True)])
        q = q + h * gauss.weights @ rates
    return q


def car_in_numpy(q: np.ndarray, u: np.ndarray) -> np.ndarray:
    return np.array([u[0] * np.cos(q[2]), u[0] * np.sin(q[2]), u[1]])


@pytest.mark.parametrize("name", DEGENERATE)
@pytest.mark.usual(1)
def test_searches_from_beside_a_degenerate_guess_end_at_a_minimum(name, monkeypatch):
    """The area within a way of twelve steps is that of a regular polygon; of a car SciPy finds no lower cost nearby."""
    solver, way, options = DEGENERATE[name]()
    runs, run = [], Search.run
    monkeypatch.setattr(Search, "run", lambda own: runs.append(run(own)) or runs[-1])
    found = solver.solve(*way, **options)
    assert SearchStatus.DEGENERATE in runs
    assert found.success
    if name == "an area":
        assert found.cost == pytest.approx(2 * STEPS * np.tan(np.pi / STEPS), rel=1e-8)
        return
    method, controls = solver.method, np.ravel(found.controls)
    weights = np.repeat(np.tile(method.weights if isinstance(method, Gauss) else [1.0], STEPS) / STEPS, 2)
    np.testing.assert_allclose(roll(controls, car_in_numpy, method), way[1], atol=1e-9)
    ends = {"type": "eq", "fun": lambda u: roll(u, car_in_numpy, method) - way[1]}
    best = minimize(lambda u: weights @ u**2 / 2, controls, jac=lambda u: weights * u, constraints=[ends],
                    bounds=[(-9.0, 9.0) if "limited" in name else (None, None)] * len(controls),
                    options={"maxiter": 20, "ftol": 1e-12})  # fmt: skip
    assert best.fun == pytest.approx(found.cost, rel=1e-6)
