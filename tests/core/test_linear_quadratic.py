"""Searches of the core for linear-quadratic problems, against their dynamic programme and a linear system in 60 digits.

One Newton step solves such a problem, however little of a state controls reach.
"""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from mpmath import mp, mpf
from retrax.integrators import OptimalControlProblem, Solver
from retrax.integrators.reporting.result_sentences import sentence
from retrax.manifolds import Euclidean, Product
from retrax.retractions import Exponential, Gauss

from ..integrators import test_hard_to_reach
from ..integrators.test_hard_to_reach import KINDS, STEPS, least

COUPLINGS = 10.0 ** np.arange(-10, 3, 4)
EVERY = 10.0 ** np.arange(-10, 3)
REACHED = 1e-8  # share of the largest state that controls of size one move a prescribed one by
ROUNDED = 1e-12  # relative change of a target, of which the cost has to be no more than 1e-9


def exact(array):
    return np.array([mpf(float(x)) for x in np.ravel(array)], dtype=object).reshape(np.shape(array))


def solved(a, b):
    """Gauss's elimination, in the digits of its numbers."""
    a, b, n = a.copy(), b.copy(), len(a)
    for k in range(n):
        pivot = k + max(range(n - k), key=lambda i, k=k, a=a: abs(a[k + i, k]))
        a[[k, pivot]], b[[k, pivot]] = a[[pivot, k]], b[[pivot, k]]
        for i in range(k + 1, n):
            if a[i, k] != 0:
                factor = a[i, k] / a[k, k]
                a[i, k:] -= factor * a[k, k:]
                b[i] -= factor * b[k]
    for k in range(n - 1, -1, -1):
        b[k] = (b[k] - (a[k, k + 1 :] @ b[k + 1 :] if k < n - 1 else 0)) / a[k, k]
    return b


class Condensed:
    """The end and the cost of the mesh as functions of its controls, in 60 digits."""

    def __init__(self, system, start):
        mp.dps = 60
        a, b, n = exact(system[0]), exact(system[1]), len(start)
        h, s, quarter = mpf(1) / STEPS, mp.sqrt(3) / 6, mpf(1) / 4
        inside = np.array([[quarter, quarter - s], [quarter + s, quarter]], dtype=object)
        same, both, one = exact(np.eye(n)), exact(np.eye(2)), exact(np.ones((2, 1)))
        rates = solved(exact(np.eye(2 * n)) - h * np.kron(inside, a), np.hstack([np.kron(one, a), np.kron(both, b)]))
        points = h * np.kron(inside, same) @ rates
        points[:, :n] += np.kron(one, same)
        ahead = h * np.kron(exact([[0.5, 0.5]]), same) @ rates
        ahead[:, :n] += same
        count = 2 * STEPS
        self.end, self.hessian = exact(np.zeros((n, count + 1))), exact(np.zeros((count + 1, count + 1)))
        self.end[:, -1] = exact(start)
        for k in range(STEPS):
            at = points[:, :n] @ self.end
            at[:, 2 * k : 2 * k + 2] += points[:, n:]
            self.hessian += h / 2 * (at.T @ at)
            self.end = ahead[:, :n] @ self.end
            self.end[:, 2 * k : 2 * k + 2] += ahead[:, n:]
        for i in range(count):
            self.hessian[i, i] += h / 2 * mpf(0.01)

    def least(self, fixed, target):
        """The least cost with some entries of the end given."""
        count, hessian = 2 * STEPS, self.hessian
        rows = [i for i in fixed if np.any(self.end[i, :-1] != 0)]
        sizes = [max(abs(x) for x in self.end[i, :-1]) for i in rows]
        matrix = exact(np.zeros((count + len(rows),) * 2))
        matrix[:count, :count] = hessian[:count, :count]
        side = exact(np.zeros((count + len(rows), 1)))
        side[:count, 0] = -hessian[:count, -1]
        for k, i in enumerate(rows):
            matrix[count + k, :count] = matrix[:count, count + k] = self.end[i, :-1] / sizes[k]
            side[count + k, 0] = (exact(target[i]).item() - self.end[i, -1]) / sizes[k]
        u = np.append(solved(matrix, side)[:count, 0], mpf(1))
        return u @ hessian @ u

    def reaches(self, fixed, target):
        """Whether controls of size one move the given entries by more than rounding of the others."""
        size = max(1.0, np.abs(target).max())
        reached = [max(abs(x) for x in self.end[i, :-1]) > REACHED * size for i in fixed]
        if not all(reached):
            return False
        cost, way = self.least(fixed, target), np.where(np.arange(len(target)) % 2, -ROUNDED, ROUNDED)
        return abs(self.least(fixed, target * (1 + way)) - cost) < 1e-9 * cost


@cache
def solver(states):
    """One solver for all systems of so many states in two halves."""
    first, last = states // 2, states - states // 2
    space = Product(Euclidean(first), Euclidean(last))

    def rate(q, u, of):
        moved = of["a"] @ jnp.concatenate(q) + of["b"] @ u
        return moved[:first], moved[first:]

    def cost(q, u):
        q = jnp.concatenate(q)
        return q @ q + 0.01 * u @ u

    def last_cost(q, of):
        q = jnp.concatenate(q)
        return of["weight"] * (q @ q) / 2

    problem = OptimalControlProblem(space, rate, cost, 1, last_cost)
    return Solver(problem, Gauss(2, Exponential(space)), STEPS)


def found(system, start, end=None, weight=0.0):
    of, half = {"a": system[0], "b": system[1], "weight": weight}, len(start) // 2
    return solver(len(start)).solve((start[:half], start[half:]), end, 1.0, parameters=of, throw=False)


def starts(states):
    return np.ones(states), np.eye(states)[0], np.eye(states)[-1]


LONG = [pytest.param(n, marks=pytest.mark.slow) for n in (3, 12, 20, 30)]  # the core takes 1024 parameters


def couplings(states):
    """Couplings of long chains with which controls of size one move no state by 1e9: else their cost is rounding."""
    every = COUPLINGS if states == 6 else EVERY[::2]
    return every if states < 12 else every[every < 10]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("states", [2, 6, *LONG])
@pytest.mark.usual(2)
def test_free_and_weighted_ends(kind, states):
    """Through the coupling at which the last state is not reached any more."""
    if kind == "springs" and states % 2:
        pytest.skip("a mass has a place and a speed")
    for coupling in couplings(states):
        system = KINDS[kind](states, coupling)
        for start in starts(states):
            for weight in (0.0, 1e-2, 1e3):
                solution = found(system, start, None, weight)
                assert solution.success, (coupling, start, weight)
                assert solution.cost == pytest.approx(least(*system, start, 1.0, weight), rel=1e-8)


@pytest.mark.parametrize("kind", ["lags", "unstable"])
@pytest.mark.parametrize("states", [6, *(pytest.param(n, marks=pytest.mark.slow) for n in (12, 30, 60))])
@pytest.mark.usual(1)
def test_a_success_is_right_where_controls_reach_farther_than_any_solution(kind, states):
    """Through the coupling beyond which a Newton step has no right digit: a failure there, and no wrong success."""
    solved = 0
    for coupling in 10.0 ** np.arange(0, 5):
        system = KINDS[kind](states, coupling)
        for start in starts(states):
            for weight in (0.0, 1e3):
                solution = found(system, start, None, weight)
                solved += solution.success
                if solution.success:
                    assert solution.cost == pytest.approx(least(*system, start, 1.0, weight), rel=1e-8)
    assert solved >= 6


@pytest.mark.parametrize("steps", [40, 80])
def test_more_steps_solve_what_controls_move_too_far_in_one(steps):
    """Through the coupling beyond which no step of ten resolves the cost of its controls beside what they move."""
    own = test_hard_to_reach.solver(6)
    finer = Solver(own.problem, own.method, steps)
    for coupling in (200.0, 500.0, 1000.0):
        a, b = KINDS["lags"](6, coupling)
        for start in starts(6):
            solution = finer.solve(start, None, 1.0, parameters={"a": a, "b": b, "weight": 0.0})
            assert solution.cost == pytest.approx(least(a, b, start, 1.0, 0.0, steps), rel=1e-8)


@pytest.mark.parametrize("stiffness", 10.0 ** np.arange(0, 5))
def test_slopes_are_measured_by_their_parts_where_steps_are_stiff(stiffness):
    """Through time constants far below a step; a slope is no more than the parts that cancel in it."""
    a, b = KINDS["rod"](2, stiffness)
    own, of = test_hard_to_reach.solver(2), {"a": a, "b": b, "weight": 0.0}
    for start in (np.ones(2), np.eye(2)[1]):
        told = []
        solution = own.solve(start, None, 1.0, parameters=of, throw=False, callback=told.append)
        assert solution.success
        assert solution.cost == pytest.approx(least(a, b, start, 1.0), rel=1e-8)
        assert max(one.stationarity[0] for one in told) <= 1 + 1e-9


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("states", [2, 4, 6, 8])
@pytest.mark.usual(1)
def test_prescribed_ends(kind, states):
    """The whole end, or either half of it, at what controls of size one reach."""
    half, tried = states // 2, 0
    for coupling in COUPLINGS if states == 4 else EVERY:
        system = KINDS[kind](states, coupling)
        for start in starts(states):
            judge = Condensed(system, start)
            target = (judge.end @ np.append(exact(np.sin(np.arange(1.0, 21.0))), mpf(1))).astype(float)
            first, last = target[:half], target[half:]
            for end in ((first, last), (first, None), (None, last)):
                fixed = [i for i in range(states) if end[i >= half] is not None]
                if not judge.reaches(fixed, target):
                    continue
                solution = found(system, start, end)
                assert solution.success, (coupling, start, fixed)
                assert solution.cost == pytest.approx(float(judge.least(fixed, target)), rel=1e-8)
                tried += 1
    assert tried


@pytest.mark.parametrize(
    ("kind", "states"), [*((kind, n) for kind in ("lags", "unstable") for n in (2, 4, 6)), ("springs", 4)]
)
@pytest.mark.usual(1)
def test_no_success_where_rounding_decides_whether_controls_reach_the_end(kind, states):
    """Through the coupling at which controls move the end by less than its rounding: the right cost, or a failure."""
    half, rounded, solved = states // 2, 0, 0
    for coupling in EVERY[::2]:
        system = KINDS[kind](states, coupling)
        for start in starts(states)[::2]:
            judge = Condensed(system, start)
            reached = (judge.end @ np.append(exact(np.sin(np.arange(1.0, 21.0))), mpf(1))).astype(float)
            for target in (reached, np.zeros(states)):
                for end in ((target[:half], target[half:]), (None, target[half:])):
                    solution = found(system, start, end)
                    rounded += solution.result == sentence("rounded_end")
                    solved += solution.success
                    if solution.success:
                        fixed = [i for i in range(states) if end[i >= half] is not None]
                        assert solution.cost == pytest.approx(float(judge.least(fixed, target)), rel=1e-8)
    assert rounded
    assert solved
