"""The spacecraft of the first page with limits that are swept through what is feasible: right answers, or words."""

from functools import cache

import casadi as ca
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Solution, Solver, solve
from retrax.interop import to_casadi
from retrax.manifolds import SO, Euclidean, hat
from retrax.retractions import Cayley, Midpoint
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

INERTIA = np.array([5621.0, 4547.0, 2364.0])
CRAFT = SO(3) * Euclidean(3)
METHOD, STEPS, HORIZON = Midpoint(Cayley(CRAFT)), 20, 60.0
TARGET = Rotation.from_rotvec([50, 100, -100], degrees=True).as_matrix()
ENDS = (np.eye(3), np.zeros(3)), (TARGET, np.zeros(3))
BORESIGHT = np.array([1.0, 0.0, 0.0])
QUIET = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes", "ipopt.tol": 1e-10}
JUST = 10.0 ** np.arange(-8, 0)
SHARES = np.concatenate([[-0.9, -0.5], -JUST[::-1], JUST, [0.3, 1.0, 10.0, 1e3, 1e6]])
SHARES = np.sort(np.concatenate([SHARES, 3 * JUST[1:-1], -3 * JUST[1:-1]]))
WIDEST = 1e6  # times the least time: there IPOPT does not arrive
# Far from what is feasible and next to it, on both sides.
FEW = [-0.5, -1e-8, 1e-8, 10.0]


def turn(q: tuple, u: jax.Array) -> tuple:
    R, w = q
    return R @ hat(w), (u - jnp.cross(w, INERTIA * w)) / INERTIA


def effort(q: tuple, u: jax.Array, *given: jax.Array) -> jax.Array:
    return u @ u / 2


def limited(limit: float) -> OptimalControlProblem:
    return OptimalControlProblem(CRAFT, turn, effort, 3, control_bounds=(-limit, limit))


def by_ipopt(problem: OptimalControlProblem, horizon: float) -> float:
    """The least cost that IPOPT finds for the discrete problem."""
    discrete = to_casadi(problem, METHOD, *ENDS, horizon, STEPS)
    solver = ca.nlpsol("solver", "ipopt", discrete.nlp, QUIET)
    found = solver(**discrete.arguments)
    assert solver.stats()["success"]
    return float(found["f"])


def missed(found: Solution) -> float:
    """How far from the target the controls lead, step by step constant, by another integrator."""

    def rate(_: float, y: np.ndarray, u: np.ndarray) -> np.ndarray:
        w = y[9:]
        return np.concatenate(
            [(y[:9].reshape(3, 3) @ np.asarray(hat(w))).ravel(), (u - np.cross(w, INERTIA * w)) / INERTIA]
        )

    y = np.concatenate([np.eye(3).ravel(), np.zeros(3)])
    for k, u in enumerate(found.controls):
        y = solve_ivp(rate, found.times[k : k + 2], y, args=(u,), rtol=1e-9, atol=1e-12).y[:, -1]
    return float(np.abs(y[:9].reshape(3, 3) - TARGET).max())


def check(found: Solution, problem: OptimalControlProblem, name: str, feasible: bool) -> None:
    """Right and optimal, or words that name what holds it."""
    if not found.success:
        assert not feasible, found.result
        assert name in found.result
        return
    assert missed(found) < 0.1  # twenty steps
    assert found.cost <= by_ipopt(problem, found.horizon) * (1 + 1e-6)


@cache
def least_limit() -> float:
    """The least limit of the torques by which the slew is done in its time: a parameter that is all that costs."""
    free = solve(OptimalControlProblem(CRAFT, turn, effort, 3), *ENDS, HORIZON, method=METHOD, steps=STEPS)
    within = {"above": lambda q, u, limit: u - 10 * limit, "below": lambda q, u, limit: -u - 10 * limit}
    problem = OptimalControlProblem(
        CRAFT,
        lambda q, u, limit: turn(q, u),
        lambda q, u, limit: 0.0 * limit,
        3,
        terminal_cost=lambda q, limit: limit,
        constraints=within,
    )
    found = solve(problem, *ENDS, HORIZON, method=METHOD, steps=STEPS, guess=free, parameters=Free(1.0, 0.1, 2.0))
    return 10 * float(found.parameters)


@cache
def least_time() -> float:
    quickest = OptimalControlProblem(CRAFT, turn, lambda q, u: 1.0, 3, control_bounds=(-8.0, 8.0))
    return solve(quickest, *ENDS, Free(HORIZON), method=METHOD, steps=STEPS).horizon


@pytest.mark.slow
def test_the_least_time_and_the_least_limit_belong_together():
    limit = least_limit()
    quickest = OptimalControlProblem(CRAFT, turn, lambda q, u: 1.0, 3, control_bounds=(-limit, limit))
    assert solve(quickest, *ENDS, Free(HORIZON), method=METHOD, steps=STEPS).horizon == pytest.approx(HORIZON, rel=1e-7)


@pytest.mark.long("-0.5", "10.0")
@pytest.mark.parametrize(
    "share", [pytest.param(s, marks=[] if s in FEW else pytest.mark.slow) for s in SHARES.tolist()]
)
def test_a_limit_of_torques_through_the_least(share):
    limit = least_limit() * (1 + share)
    found = solve(limited(limit), *ENDS, HORIZON, method=METHOD, steps=STEPS, max_iterations=200, throw=False)
    check(found, limited(limit), "control_bounds", share > 0)
    assert not found.success or np.abs(found.controls).max() <= limit * (1 + 1e-9)
    assert found.success == (share > 0)


@pytest.mark.long("-0.5", "10.0")
@pytest.mark.parametrize(
    "share", [pytest.param(s, marks=[] if s in FEW else pytest.mark.slow) for s in SHARES.tolist() if s < WIDEST]
)
def test_a_horizon_through_the_least_time(share):
    horizon = least_time() * (1 + share)
    # A tenth of the least time asks for a hundred times the torque, and the excess grows to it step by step.
    found = solve(limited(8.0), *ENDS, horizon, method=METHOD, steps=STEPS, throw=False, max_iterations=200)
    check(found, limited(8.0), "control_bounds", share > 0)
    assert not found.success or np.abs(found.controls).max() <= 8.0 * (1 + 1e-9)
    assert found.success == (share > 0)


@cache
def keeping_out() -> tuple[Solver, np.ndarray, float]:
    """A direction near the middle of the way of the boresight, and the angle between it and the nearer end."""
    middle = BORESIGHT + TARGET @ BORESIGHT
    across = np.cross(BORESIGHT, TARGET @ BORESIGHT)
    sun = middle / np.linalg.norm(middle) + 0.1 * across / np.linalg.norm(across)
    sun /= np.linalg.norm(sun)
    cone = {"cone": lambda q, u, cosine: (q[0] @ BORESIGHT) @ sun - cosine}
    problem = OptimalControlProblem(CRAFT, lambda q, u, cosine: turn(q, u), effort, 3, constraints=cone)
    return Solver(problem, METHOD, STEPS), sun, float(np.arccos(max(BORESIGHT @ sun, (TARGET @ BORESIGHT) @ sun)))


@pytest.mark.parametrize(
    "share",
    [
        pytest.param(s, marks=[] if s in FEW else pytest.mark.slow)
        for s in [*(-SHARES[SHARES > 0]).tolist(), *SHARES.tolist()]
        if -1 < s < 1.5
    ],
)
@pytest.mark.usual(1)
def test_a_cone_that_grows_until_it_contains_an_end(share):
    solver, sun, nearest = keeping_out()
    angle = nearest * (1 + share)
    found = solver.solve(*ENDS, HORIZON, parameters=np.cos(angle), throw=False)
    cone = {"cone": lambda q, u: (q[0] @ BORESIGHT) @ sun - np.cos(angle)}
    problem = OptimalControlProblem(CRAFT, turn, effort, 3, constraints=cone)
    check(found, problem, "cone", share < 0)
    assert not found.success or ((found.stage_states[0] @ BORESIGHT) @ sun).max() <= np.cos(angle) + 1e-9
    assert found.success == (share < 0)
