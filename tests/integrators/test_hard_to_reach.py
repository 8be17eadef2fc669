"""Linear-quadratic problems whose last states controls hardly reach, against least squares on the same mesh."""

from functools import cache

import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Phase, Solver, solve_phases
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Gauss
from scipy.integrate import solve_ivp

STEPS = 10


def lags(n, c):
    """First-order lags in a row, each driven by the one before."""
    return -np.diag(np.linspace(0.5, 2, n)) + c * np.eye(n, k=-1), np.eye(n)[:, :1]


def unstable(n, c):
    a, b = lags(n, c)
    return a + 2.5 * np.eye(n), b


def halves(n, c):
    """Lags of which controls do not reach the second half at all."""
    a, b = lags(n, c)
    a[n // 2 :, : n // 2] = 0
    return a, b


def springs(n, c):
    """Masses between springs, with a force on the first; stiffer with ``c``."""
    m = n // 2
    stiffness = c * (2 * np.eye(m) - np.eye(m, k=1) - np.eye(m, k=-1))
    a = np.block([[np.zeros((m, m)), np.eye(m)], [-stiffness, np.zeros((m, m))]])
    return a, np.eye(2 * m)[:, m : m + 1]


def rod(n, c):
    """A rod that is heated at one end."""
    return c * n**2 / 10 * (np.eye(n, k=1) + np.eye(n, k=-1) - 2 * np.eye(n)), c * n**2 / 10 * np.eye(n)[:, :1]


def least(a, b, start, horizon, weight=0.0, steps=STEPS):
    """The least cost of ``Gauss(2)`` with ``q q + .01 u u`` and ``weight q q / 2`` at the end, by dynamic programming
    over square roots: no state has a unit."""
    n, h, s = len(a), horizon / steps, np.sqrt(3) / 6
    inside = np.array([[0.25, 0.25 - s], [0.25 + s, 0.25]])
    solve = np.linalg.solve(np.eye(2 * n) - h * np.kron(inside, a), np.eye(2 * n))
    rates = solve @ np.kron(np.ones((2, 1)), a), solve @ np.kron(np.eye(2), b)
    at, to = (h * np.kron(inside, np.eye(n)) @ rate for rate in rates)
    at = at + np.kron(np.ones((2, 1)), np.eye(n))
    on, by = (h * np.kron([[0.5, 0.5]], np.eye(n)) @ rate for rate in rates)
    on, root = on + np.eye(n), np.sqrt(weight / 2) * np.eye(n)
    for _ in range(steps):
        over_u = np.vstack([np.sqrt(h / 2) * to, 0.1 * np.sqrt(h / 2) * np.eye(2 * b.shape[1]), root @ by])
        over_q = np.vstack([np.sqrt(h / 2) * at, np.zeros((2 * b.shape[1], n)), root @ on])
        q, _ = np.linalg.qr(over_u)
        root = np.linalg.qr(over_q - q @ (q.T @ over_q), mode="r")
    return np.sum((root @ start) ** 2)


def chain(q, u, of):
    return of["a"] @ q + of["b"] @ u


def costs(q, u, of):
    return q @ q + 0.01 * u @ u


def at_the_end(q, of):
    return of["weight"] * (q @ q) / 2


@cache
def solver(states, evaluator="tape"):
    """One solver for all chains of so many states, which are parameters."""
    problem = OptimalControlProblem(Euclidean(states), chain, costs, 1, at_the_end)
    return Solver(problem, Gauss(2, Addition(Euclidean(states))), STEPS, evaluator=evaluator)


def check(system, start, horizon=1.0, weight=0.0):
    of = {"a": system[0], "b": system[1], "weight": weight}
    found = solver(len(start)).solve(start, None, horizon, parameters=of)
    assert found.cost == pytest.approx(least(*system, start, horizon, weight), rel=1e-8)
    assert found.statistics.iterations <= 6  # one, and what rounding of it asks for


def test_the_judge_is_riccatis_equation():
    (a, b), start = lags(6, 0.3), np.ones(6)

    def rate(_, p):
        p = p.reshape(6, 6)
        return (a.T @ p + p @ a - p @ b @ b.T @ p / 0.01 + np.eye(6)).ravel()

    found = solve_ivp(rate, (0, 1), np.zeros(36), rtol=1e-11, atol=1e-13)
    assert least(a, b, start, 1.0, steps=160) == pytest.approx(start @ found.y[:, -1].reshape(6, 6) @ start, rel=1e-9)


@pytest.mark.parametrize("coupling", 10.0 ** np.arange(-9, 3, 2))
@pytest.mark.parametrize("states", [2, 6, 12])
@pytest.mark.usual(2)
def test_lags_that_are_coupled_by_next_to_nothing(states, coupling):
    """Through the coupling at which the last state is not reached any more, from all states and from either end."""
    for start in (np.ones(states), np.eye(states)[0], np.eye(states)[-1]):
        check(lags(states, coupling), start)


KINDS = {"lags": lags, "unstable": unstable, "halves": halves, "springs": springs, "rod": rod}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("states", [10, *(pytest.param(n, marks=pytest.mark.slow) for n in (20, 40))])
@pytest.mark.parametrize("weight", [0.0, 1e-2, 1e3])
@pytest.mark.usual(2)
def test_long_chains(kind, states, weight):
    drawn = np.random.default_rng(states).standard_normal(states)
    for coupling in (1e-6, 1e-2, 1.0):
        for start in (np.ones(states), drawn):
            check(KINDS[kind](states, coupling), start, weight=weight)


@pytest.mark.slow
@pytest.mark.parametrize("horizon", [1.0, 5.0])
@pytest.mark.parametrize("kind", ["springs", "rod"])
def test_sixty_states(kind, horizon):
    for start in (np.ones(60), *np.eye(60)[[0, 20, 59]]):
        check(KINDS[kind](60, 1.0), start, horizon)


@pytest.mark.parametrize("evaluator", ["tape", pytest.param("xla", marks=pytest.mark.slow)])
def test_batches_and_phases_find_the_same(evaluator):
    starts, own = np.array([np.ones(6), np.eye(6)[0], np.eye(6)[-1]]), solver(6, evaluator)
    for coupling in (1e-5, 1e-3, 1e-1):
        a, b = lags(6, coupling)
        of, expected = {"a": a, "b": b, "weight": 0.0}, [least(a, b, start, 1.0) for start in starts]
        batch = {name: np.stack(3 * [np.asarray(value)]) for name, value in of.items()}
        found = own.solve_many(starts, None, 1.0, parameters=batch)
        assert found.success.all()
        np.testing.assert_allclose(found.cost, expected, rtol=1e-8)
        each = {"problem": own.problem, "method": own.method, "steps": 5, "duration": 0.5, "parameters": of}
        assert solve_phases([Phase(**each, start=starts[0]), Phase(**each)]).cost == pytest.approx(
            expected[0], rel=1e-8
        )
