"""Two extremals with a free horizon that merge: which of them is a strict minimum, and what is said where there is
none."""

import jax
import numpy as np
import pytest
from retrax.integrators import Free, OptimalControlProblem, Solver
from retrax.manifolds import Euclidean
from retrax.retractions import Addition, Midpoint

LINE = Euclidean(1)
APART = ["1e-06", "1e-08", "1e-10", "1e-11", "1e-12", "1e-13", "1e-14", "1e-16", "0.0"]
APART += ["-1e-16", "-1e-14", "-1e-13", "-1e-12", "-1e-11", "-1e-10", "-1e-08"]
ROUNDING = 16 * np.finfo(float).eps  # of the cost's derivative by the horizon, whose terms of size one cancel
NEAR = 3e-5  # of the horizon: by so much the tolerance does not decide equations whose solutions merge


def late(q: jax.Array, t: jax.Array, apart: jax.Array) -> jax.Array:
    """With the least effort ``1 / (2 T)`` the cost is ``x^3 / 3 - a x + O(x^4)``, ``x = T - 1``."""
    x = t - 1
    return -(1 - x + x**2 - x**3) / 2 + x**3 / 3 - apart * x


FOLD = OptimalControlProblem(
    LINE, lambda q, u, t, a: u, lambda q, u, t, a: u @ u / 2, 1, terminal_cost=late, time_dependent=True
)
SOLVER = Solver(FOLD, Midpoint(Addition(LINE)), 5)


def roots(apart: float) -> list[float]:
    """Where the derivative of the cost by the horizon vanishes near one, in ascending order: maximum, minimum."""
    x = np.polynomial.Polynomial([0, 1])
    slope = -1 + 2 * (1 + x) ** 2 * ((1 - 2 * x + 3 * x**2) / 2 + x**2 - apart)
    return sorted(z.real for z in slope.roots() if abs(z.imag) < 1e-12 and abs(z) < 0.2)


@pytest.mark.parametrize("apart", APART)
@pytest.mark.usual("1e-10", "1e-13", "-1e-13")
def test_a_strict_minimum_is_the_minimum_of_two_extremals_that_merge(apart):
    a = float(apart)
    way = np.sqrt(abs(a))
    for share in (-2.0, -1.0, -0.9, 0.0, 0.9, 1.0, 2.0, 1e-4 / max(way, 1e-8)):
        horizon = 1 + share * way
        near = SOLVER.solve(np.zeros(1), np.ones(1), horizon, parameters=a)
        found = SOLVER.solve(np.zeros(1), np.ones(1), Free(horizon), near, a, throw=False)
        x = found.horizon - 1
        if abs(x) > 0.2:  # the minimum far from the fold
            assert found.success
            assert x == pytest.approx(-0.31, abs=0.01)
        elif found.checks.strict_minimum:
            assert abs(a) < ROUNDING or x > np.mean(roots(a))  # the other extremal is the maximum
            assert abs(x**2 - a) < ROUNDING or x == pytest.approx(roots(a)[1], rel=0.3), (share, x)
        elif found.success:
            assert min([abs(x), *(abs(x - root) for root in roots(a))]) < NEAR, (share, x)
