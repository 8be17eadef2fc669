"""Extremals with ``p = 0`` are left out only where Pontryagin's principle excludes them, whatever the unit of the
cost."""

import re
from itertools import product

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import OptimalControlProblem, classify, solve
from retrax.integrators.problem_checks.costs import is_steep
from retrax.manifolds import Euclidean, InvalidInputError
from retrax.retractions import Addition, Midpoint, default_retraction

LINE = Euclidean(1)
PAIR = LINE * LINE


class Running(eqx.Module):
    """``rate + price u^2 / 2 + turn x u + pull x^2 / 2``; along ``x' = u`` the third is ``d/dt turn x^2 / 2``."""

    rate: Array
    price: Array
    turn: Array
    pull: Array

    def __call__(self, q: Array, u: Array) -> Array:
        return self.rate + self.price * u @ u / 2 + self.turn * q[0] * u[0] + self.pull * q @ q / 2


class Terminal(eqx.Module):
    """``unit (tilt x + bend (x - 1)^2 / 2)``."""

    unit: Array
    tilt: Array
    bend: Array

    def __call__(self, q: Array) -> Array:
        return self.unit * (self.tilt * q[0] + self.bend * (q[0] - 1) ** 2 / 2)


def problem(rate=0.0, price=0.0, turn=0.0, pull=0.0, unit=1.0, tilt=0.0, bend=1.0) -> OptimalControlProblem:
    running = Running(*map(jnp.asarray, (rate, price, turn, pull)))
    terminal = Terminal(*map(jnp.asarray, (unit, tilt, bend)))
    return OptimalControlProblem(LINE, lambda q, u: u, running, 1, terminal_cost=terminal)


def answer(given: OptimalControlProblem, end: np.ndarray | None = None) -> tuple[bool, float, float] | str:
    """Success, cost and end from ``x = 0``, by default to a free end; the message where the problem is refused."""
    try:
        found = solve(given, np.zeros(1), end, 1.0, method=Midpoint(Addition(LINE)), steps=4, throw=False)
    except InvalidInputError as error:
        return str(error)
    return found.success, found.cost, float(found.states[-1, 0])


@pytest.mark.slow
def test_a_target_that_costs_nothing_is_reached_down_to_no_running_cost():
    """``x' = u``, cost ``c u^2/2 + (x - 1)^2/2``: ``x(1) = 1/(1 + c)`` at the cost ``c/(1 + c)/2``, with ``p = -c/(1 +
    c)``."""
    for c, unit in product((1.0, 1e-3, 1e-6, 1e-12, 0.0), (1e-12, 1.0, 1e12)):
        success, cost, end = answer(problem(price=c * unit, unit=unit))
        assert success, (c, unit)
        np.testing.assert_allclose([end, cost / unit], [1 / (1 + c), c / (1 + c) / 2], rtol=1e-9, atol=1e-15)


@pytest.mark.slow
def test_a_constant_running_cost_is_part_of_no_condition():
    for rate in (0.0, 1e-12, 1.0, 1e6):
        success, cost, end = answer(problem(rate=rate))
        assert success, rate
        np.testing.assert_allclose([end, cost], [1, rate], rtol=1e-12, atol=1e-15)
        assert answer(problem(rate=rate, tilt=1.0, bend=0.0)).startswith(
            "the problem is singular, and no point of P_f, on which"
        )


@pytest.mark.slow
def test_no_extremal_has_a_vanishing_costate_where_the_terminal_cost_is_steep_everywhere():
    """``x + a (x - 1)^2/2`` is least at ``x = 1 - 1/a``, and unbounded below for ``a = 0``, to rounding."""
    for a in (1.0, 1e-2, 1e-4, 0.0, 1e-18):
        given = problem(tilt=1.0, bend=a)
        c = classify(given)
        assert (c.zero_costate_excluded, c.empty) == (a < 1e-16, a < 1e-16)
        if c.empty:
            text = " ".join(answer(given).split())
            assert "p = 0 is excluded (exclude_zero_costate=False admits it)" in text
            assert (
                "empty: the conditions up to level 0 contradict each other at every point tried; extremals with p = 0"
                in text
            )
            assert not classify(given, exclude_zero_costate=False).empty
        else:
            success, _, end = answer(given)
            assert success, a
            np.testing.assert_allclose(end, 1 - 1 / a, rtol=1e-6)


@pytest.mark.slow
def test_a_total_derivative_tells_no_curve_from_another():
    """It was solved: all curves from start to end cost the same. Whatever else there is of the cost counts."""
    for pull in (0.0, 1e-20):
        words = answer(problem(turn=1.0, pull=pull), np.ones(1))
        assert words.startswith(
            "the control is free on P_f, of dimension 1: every curve from start to end is an extremal"
        )
    for pull in (1e-6, 1.0):
        assert "the boundary data admit no extremal" in answer(problem(turn=1.0, pull=pull), np.ones(1))


STEEP_IN_ONE = OptimalControlProblem(
    PAIR, lambda q, u: (u[:1], u[1:]), lambda q, u: 0.0, 2, terminal_cost=lambda q: q[0][0] + (q[1][0] - 1) ** 2 / 2
)


def test_a_terminal_cost_that_is_steep_where_the_end_is_prescribed_excludes_nothing():
    free = ((), (False, False), (True, False), (False, True))
    assert [is_steep(STEEP_IN_ONE, fixed) for fixed in free] == [True, True, False, True]


@pytest.mark.slow
def test_the_free_part_of_an_end_is_brought_to_where_its_cost_is_least():
    """``x' = u1``, ``y' = u2`` at the terminal cost ``x + (y - 1)^2/2``, with ``x(1)`` prescribed or free."""
    given = STEEP_IN_ONE
    start, rest = (np.zeros(1), np.zeros(1)), (np.full(1, 2.0), None)
    found = solve(given, start, rest, 1.0, method=Midpoint(default_retraction(PAIR)), steps=4)
    np.testing.assert_allclose(found.states[1][-1], 1, rtol=1e-12)
    with pytest.raises(InvalidInputError, match=r"exclude_zero_costate=False admits it"):
        solve(given, start, None, 1.0, method=Midpoint(default_retraction(PAIR)), steps=4)


@pytest.mark.slow
def test_the_size_of_a_contradiction_has_no_unit_of_the_cost():
    """``x' = u`` at the terminal cost ``x``, where ``p = 0`` and ``p = -1`` contradict each other."""
    sizes = set()
    for rate in (0.0, 1e-12, 1e-6, 1.0, 1e6):
        for unit in (1e-12, 1.0, 1e12):
            given = problem(rate=rate, unit=unit, tilt=1.0, bend=0.0)
            c = classify(given, exclude_zero_costate=False)
            with pytest.raises(InvalidInputError, match="the boundary data admit no extremal") as caught:
                solve(given, np.zeros(1), None, 1.0, method=Midpoint(Addition(LINE)), steps=4, classification=c)
            sizes |= {abs(float(size)) for size in re.findall(r"equation = (\S+) \(relative\)", str(caught.value))}
    assert sizes == {1.0}
