"""Slacks of inequalities: their stiffness, and which members of a batch get a lower barrier or a higher price of
excesses."""

import numpy as np
import pytest
from retrax.integrators.boundary_value.engine.barrier import DEAREST, LAST, NEAR, PRICE, SOLVED, TELLS, Barrier
from retrax.integrators.boundary_value.engine.inequalities import Held, Surveyed, central, stiffness

MU = np.array([1e-2])
VALUES = np.linspace(-1.0, 1.0, 41)


def held(values: np.ndarray) -> Held:
    """One inequality with these values along the points of a step."""
    values = values[None, None, :, None]
    return Held(values, np.ones((*values.shape, 1)), np.ones(values.shape))


@pytest.mark.parametrize("price", [0.01, 1.0, 10.0, np.inf])
def test_the_stiffness_is_what_a_multiplier_changes_by(price):
    """Of central slacks the multiplier is a function of the value alone, from where it holds to where it is
    violated."""
    values = VALUES[VALUES < -0.01] if np.isinf(price) else VALUES
    step = 1e-6
    ahead, behind = (central(held(values + d), MU, np.full((1, 1, values.size, 1), price)) for d in (step, -step))
    slope = (ahead.multipliers - behind.multipliers) / (2 * step)
    at = central(held(values), MU, np.full((1, 1, values.size, 1), price))
    np.testing.assert_allclose(stiffness(at), slope, rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("error", [0.0, 0.5, 0.999, 1.001, 2.0, 1e3])
@pytest.mark.parametrize("value", [-0.5, -1e-3, 1e-3, 0.5])
def test_excesses_cost_more_where_a_problem_is_solved_with_multipliers_near_their_price(value, error):
    """Central slacks leave nothing but the error, which is in units of what counts as solved."""
    barrier, given = Barrier(np.ones(1), np.ones((1, 1)), np.zeros((1, 1), bool), np.ones(1)), held(np.array([value]))
    slacks = central(given, MU, np.full((1, 1, 1, 1), PRICE))
    found = Surveyed(*barrier.surveyed(given, slacks))
    lower, cheap = barrier.lowered(found, slacks, error * SOLVED * MU, 1e-8, barrier.dear(found))
    solved, near = error < 1, float(slacks.multipliers[0, 0, 0, 0]) > NEAR * PRICE
    assert near == (value > 0)
    assert cheap.tolist() == [solved and near]
    assert (lower.barrier < MU).tolist() == [solved and not near]


def dearer(slacks, factor):
    """The slacks of a problem in which all costs that much more."""
    return slacks.scaled(np.array([factor]))._replace(barrier=factor * slacks.barrier)


@pytest.mark.parametrize("share", [1e-4, 0.1, 0.99, 1.01, 3.0])
def test_what_excesses_cost_is_judged_below_a_barrier_at_whatever_price(share):
    """Beside multipliers and a barrier that have grown with the price: the error that counts as solved is
    relative."""
    barrier, given = Barrier(np.ones(1), np.ones((1, 1)), np.zeros((1, 1), bool), np.ones(1)), held(np.array([0.5]))
    for factor in 3.0 ** np.arange(11):
        for error in (0.9, 1.1):
            mu = share * TELLS * np.ones(1)
            slacks = dearer(central(given, mu, np.full((1, 1, 1, 1), PRICE)), factor)
            found = Surveyed(*barrier.surveyed(given, slacks))
            lower, cheap = barrier.lowered(found, slacks, error * SOLVED * mu, 1e-8, barrier.dear(found))
            assert cheap.tolist() == [error < 1 and share < 1], (factor, error)
            # Where it is lowered first, the price is judged where the problem with that barrier is solved.
            assert (lower.barrier < slacks.barrier).tolist() == [error < 1 and share > 1], (factor, error)


def test_the_barrier_of_dear_excesses_falls_to_its_last_value_where_errors_are_rounding():
    barrier, given, tolerance = (
        Barrier(np.ones(1), np.ones((1, 1)), np.zeros((1, 1), bool), np.ones(1)),
        held(np.array([-0.5])),
        1e-11,
    )
    for factor in 3.0 ** np.arange(11):
        mu = np.array([1e-16])
        slacks = dearer(central(given, mu, np.full((1, 1, 1, 1), PRICE)), factor)
        found = Surveyed(*barrier.surveyed(given, slacks))
        # Times the price, what is left of the last barrier is far less than rounding.
        lower, _ = barrier.lowered(found, slacks, np.array([1e-14]), tolerance, barrier.dear(found))
        assert lower.barrier[0] <= 1.01 * LAST * tolerance, factor


def test_what_is_left_over_at_the_highest_price_contradicts_where_nothing_is_left_to_lower():
    """Through the tolerance, and through its root, above which an excess tells before the last barrier."""
    barrier, tolerance = Barrier(np.ones(1), np.ones((1, 1)), np.zeros((1, 1), bool), np.ones(1)), 1e-8
    for mu in (1e-1, 1e-6, 0.1 * tolerance):
        for left in (0.5, 2.0, 1e2, 1e5):
            given = held(np.array([left * tolerance]))
            slacks = central(given, np.array([mu]), np.full((1, 1, 1, 1), PRICE * DEAREST))
            found = Surveyed(*barrier.surveyed(given, slacks))
            told = left > 1 if mu <= tolerance else left > 1e4 and mu < 1e-4
            for error in (0.5, 2.0):
                said = barrier.is_infeasible(found, slacks, np.array([error * tolerance]), tolerance)
                assert said.tolist() == [told and error < 1], (mu, left, error)
