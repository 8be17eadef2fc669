"""A start time of problems with explicit time, beside the same problem with shifted functions and closed forms."""

import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Solver, discretization_error, solve
from retrax.manifolds import SO, Euclidean, InvalidInputError, hat
from retrax.retractions import Addition, Cayley, Gauss, Midpoint

LINE, TURNS = Euclidean(1), SO(3)
TIMES = [-3.0, -1e-3, 0.0, 0.7, 40.0]


SHIFTED = OptimalControlProblem(
    LINE,
    lambda q, u, t, begin: u + jnp.sin(t + begin),
    lambda q, u, t, begin: u @ u / 2 + 0.1 * jnp.cos(t + begin),
    1,
    terminal_cost=lambda q, t, begin: 0.05 * (t + begin) ** 2,
    constraints={"wall": lambda q, u, t, begin: q[0] - 2 - 0.1 * jnp.sin(t + begin)},
    time_dependent=True,
)


@pytest.mark.parametrize("horizon", [2.0, Free(2.0, lower=0.5, upper=6.0)], ids=["fixed", "free"])
@pytest.mark.usual(1)
def test_a_start_time_is_a_shift_of_the_functions(horizon):
    """A ship in a current of the time, which ends at a price of the time."""
    solver = Solver(SHIFTED, Gauss(2, Addition(LINE)), 12)
    for begin in TIMES:
        known = solver.solve(0.0, 1.0, horizon, parameters=begin)
        found = solver.solve(0.0, 1.0, horizon, parameters=0.0, start_time=begin)
        assert found.success
        assert found.cost == pytest.approx(known.cost, rel=1e-9)
        assert np.allclose(found.times, begin + known.times, atol=1e-7)
        assert np.allclose(found.controls, known.controls, atol=1e-6)
    assert discretization_error(SHIFTED, Addition(LINE), found, 0.0).largest["R^1"] < 1e-4


def test_one_solver_serves_all_start_times_and_refines_its_mesh():
    """An attitude that drifts with the time, by the closed form: the control is constant in the drifting frame."""
    problem = OptimalControlProblem(
        TURNS,
        lambda q, u, t, rate: q @ hat(u + jnp.array([0.0, 0.0, rate * t])),
        lambda q, u, t, rate: u @ u / 2,
        3,
        time_dependent=True,
    )
    solver = Solver(problem, Midpoint(Cayley(TURNS)), 40)
    guess = None
    for begin in TIMES[:-1]:
        end = np.array([[np.cos(0.5), -np.sin(0.5), 0], [np.sin(0.5), np.cos(0.5), 0], [0, 0, 1.0]])
        drift = 0.2 * ((begin + 1.0) ** 2 - begin**2) / 2
        found = solver.solve(np.eye(3), end, 1.0, parameters=0.2, start_time=begin, guess=guess)
        assert found.cost == pytest.approx((0.5 - drift) ** 2 / 2, rel=2e-3, abs=1e-6)
        many = solver.solve_many(np.eye(3), end, 1.0, parameters=np.full(2, 0.2), start_time=np.array([begin, 0.0]))
        assert many.success.all()
        assert many.cost == pytest.approx([found.cost, (0.5 - 0.1) ** 2 / 2], rel=2e-3, abs=1e-6)
        assert many[0].t == pytest.approx(found.t)
        assert solver.sensitivity(found).parameters.cost == pytest.approx(
            -(0.5 - drift) * drift / 0.2, rel=2e-3, abs=1e-5
        )
        guess = found
    refined = solve(problem, np.eye(3), end, 1.0, parameters=0.2, start_time=TIMES[-2])
    assert refined.cost == pytest.approx((0.5 - drift) ** 2 / 2, rel=1e-6)


def test_a_start_time_that_nothing_takes_is_said():
    still = OptimalControlProblem(LINE, lambda q, u: u, lambda q, u: u @ u / 2, 1)
    with pytest.raises(InvalidInputError, match="the functions of the problem take no time"):
        solve(still, 0.0, 1.0, 1.0, start_time=2.0)
    for wrong in (np.nan, "noon", np.ones(2)):
        with pytest.raises(InvalidInputError, match="start_time must be a finite number"):
            solve(SHIFTED, 0.0, 1.0, 1.0, parameters=0.0, start_time=wrong)
    solver = Solver(SHIFTED, Midpoint(Addition(LINE)), 4)
    for wrong, words in (
        (np.array([0.0, np.nan]), "start_time must be a finite number"),
        (np.zeros(3), "start times 3, parameters 2"),
    ):
        with pytest.raises(InvalidInputError, match=words):
            solver.solve_many(0.0, 1.0, 1.0, parameters=np.zeros(2), start_time=wrong)
