"""Smooth tables, against the splines of SciPy and against problems with the function that is in the table."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import retrax as rx
from retrax.manifolds import InvalidInputError
from retrax.tape import Tape
from scipy.interpolate import CubicSpline, PchipInterpolator, RectBivariateSpline

RNG = np.random.default_rng(4)
GRID = np.cumsum(RNG.uniform(0.2, 1.0, 9)) - 2.0
VALUES = RNG.normal(size=(9, 3))
POINTS = np.sort(np.concatenate([RNG.uniform(GRID[0], GRID[-1], 40), GRID[[0, -1]]]))
JUDGES = {
    "not-a-knot": CubicSpline(GRID, VALUES),
    "natural": CubicSpline(GRID, VALUES, bc_type="natural"),
    "clamped": CubicSpline(GRID, VALUES, bc_type="clamped"),
    "monotone": PchipInterpolator(GRID, VALUES),
}
PLANE = rx.Euclidean(2)
LAST, SPEED = 2.0, 1.5


@pytest.mark.parametrize("kind", JUDGES)
@pytest.mark.usual(1)
def test_values_and_two_derivatives_are_those_of_scipy(kind):
    function = rx.tabulated(GRID, VALUES, kind)
    first, second = jax.vmap(jax.jacfwd(function)), jax.vmap(jax.jacrev(jax.jacfwd(function)))
    for count, found in enumerate((function, first, second)):
        expected = JUDGES[kind](POINTS, count)
        np.testing.assert_allclose(found(POINTS), expected, rtol=0, atol=1e-12 * np.max(np.abs(expected)))


@pytest.mark.parametrize("kind", ["not-a-knot", "monotone"])
def test_a_tape_has_the_same_values_and_derivatives(kind):
    def weighed(x):
        return jnp.sum(rx.tabulated(GRID, VALUES, kind)(x[0]) * jnp.array([1.0, -2.0, 0.5]))

    tape = Tape.trace(weighed, np.zeros(1)).second_order(argnums=0)
    for count, found in enumerate(tape(POINTS[None])):
        expected = JUDGES[kind](POINTS, count) @ np.array([1.0, -2.0, 0.5])
        np.testing.assert_allclose(np.ravel(found), expected, rtol=0, atol=1e-12 * np.max(np.abs(expected)))


def test_a_table_of_two_grids_is_the_tensor_product_spline():
    other = np.array([-1.0, -0.4, 0.1, 0.5, 1.3, 2.0])
    values = RNG.normal(size=(9, 6))
    function, judge = rx.tabulated((GRID, other), values), RectBivariateSpline(GRID, other, values, s=0)
    x, y = POINTS, RNG.uniform(-1, 2, POINTS.shape)
    np.testing.assert_allclose(function(x, y), judge(x, y, grid=False), rtol=0, atol=1e-12)
    mixed = jax.vmap(jax.grad(jax.grad(function, 0), 1))
    np.testing.assert_allclose(mixed(x, y), judge(x, y, dx=1, dy=1, grid=False), rtol=0, atol=1e-11)
    np.testing.assert_allclose(Tape.trace(function, 0.0, 0.0)(x, y), function(x, y), rtol=0, atol=1e-12)
    assert function(x[:, None], y[:5]).shape == (len(x), 5)


@pytest.mark.parametrize("beyond", [-1e-12, 0.0, 1e-12, 1e-3, 1.0])
def test_the_value_outside_is_chosen(beyond):
    none, constant = rx.tabulated(GRID, VALUES), rx.tabulated(GRID, VALUES, outside="constant")
    for end, sign in ((0, -1), (-1, 1)):
        x = GRID[end] + sign * beyond
        assert bool(jnp.all(jnp.isnan(none(x)))) == (beyond > 1e-9)
        assert np.allclose(constant(x), VALUES[end], rtol=0, atol=1e-10)
        assert np.allclose(Tape.trace(constant, 0.0)(np.array([x]))[:, 0], constant(x), rtol=0, atol=1e-13)
        assert bool(np.all(np.isnan(Tape.trace(none, 0.0)(np.array([x]))))) == (beyond > 1e-9)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([0.0, 1.0, 1.0], np.zeros(3)), "at least two numbers that increase"),
        (([0.0], np.zeros(1)), "at least two numbers"),
        (([0.0, 1.0], np.zeros(3)), r"shape \(3,\), expected \(2,\)"),
        (([0.0, np.nan], np.zeros(2)), "must be finite"),
        (([0.0, 1.0], ["a", "b"]), "must be finite real numbers"),
        (([0.0, 1.0], np.zeros(2), "cubic"), "kind must be one of not-a-knot"),
        (([0.0, 1.0], np.zeros(2), "natural", "zero"), 'must be "nan"'),
        ((([0.0, 1.0], [0.0, 1.0]), np.zeros(2)), "grids of 2 and 2 points"),
    ],
)
def test_other_tables_raise_errors(arguments, words):
    with pytest.raises(InvalidInputError, match=words):
        rx.tabulated(*arguments)


def test_a_table_counts_its_arguments():
    with pytest.raises(InvalidInputError, match="table of 1 grids"):
        rx.tabulated(GRID, VALUES)(0.0, 1.0)
    assert repr(rx.tabulated([0.0, 2.0], [1.0, 1.0])) == "Table(on [0, 2], 'nan' outside)"


def wind(height):
    """A jet stream: the wind along the first axis."""
    return 2.0 * jnp.exp(-((height - 1.0) ** 2))


@cache
def flown(points):
    """The least effort to fly upwards and to the side through the wind, of a table, or of its function for None."""
    heights = np.linspace(-1.0, 3.0, points or 2)
    along = wind if points is None else rx.tabulated(heights, wind(heights))
    problem = rx.OptimalControlProblem(
        PLANE, lambda q, u: u + jnp.array([1.0, 0.0]) * along(q[1]), lambda q, u: u @ u / 2, controls=2
    )
    solution = rx.Solver(problem, rx.Gauss(2, rx.default_retraction(PLANE)), 20).solve(np.zeros(2), [SPEED, LAST], 2.0)
    assert solution.success
    return solution


def test_flights_through_a_table_converge_to_the_flight_through_its_function():
    counts = np.array([8, 16, 32, 64])
    errors = np.array([np.max(np.abs(flown(int(count)).controls - flown(None).controls)) for count in counts])
    assert errors[-1] < 1e-5
    slope = np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert slope < -2.7  # the force has the derivative of the table, which is of third order
