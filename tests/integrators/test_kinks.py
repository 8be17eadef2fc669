"""Kinks in the controls are told from singular controls, and from curvature that is narrow or weak."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import OptimalControlProblem, classify, solve
from retrax.integrators.problem.initial_controls import resting_control
from retrax.integrators.problem_checks.inspection import Inspection
from retrax.integrators.problem_checks.smoothness.kinks import find_kinks
from retrax.manifolds import Euclidean, InvalidInputError, Sphere
from retrax.problems import SINGULAR
from retrax.retractions import Addition, Midpoint

PLANE, MIDPOINT = Euclidean(2), Midpoint(Addition(Euclidean(2)))
AT = np.array([0.3, 0.2])


def cart(q: Array, u: Array) -> Array:
    return jnp.stack([q[1], u[0]])


class Priced(eqx.Module):
    """A function of the first control and one number: that number is data, so that one kernel serves a sweep."""

    price: Any
    number: Array

    def __call__(self, q: Array, u: Array) -> Array:
        return self.price(u, self.number)


def problem(price: Any, number: float = 1.0, controls: int = 1, dynamics: Any = cart) -> OptimalControlProblem:
    return OptimalControlProblem(PLANE, dynamics, Priced(price, jnp.asarray(number)), controls)


def verdict(given: OptimalControlProblem) -> str:
    """``regular``, ``singular`` or, if that is what it is refused for, ``kink``."""
    try:
        given.check(AT, resting_control(given.controls))
        return "regular" if Inspection(given, AT, resting_control(given.controls)).is_regular else "singular"
    except InvalidInputError as error:
        named = "has a kink or a jump in the controls", "jumps in the controls"
        return "kink" if any(words in str(error) for words in named) else str(error)


def huber(u: Array, width: Array) -> Array:
    return jnp.where(jnp.abs(u[0]) < width, u[0] ** 2 / (2 * width), jnp.abs(u[0]) - width / 2)


def smoothed(u: Array, width: Array) -> Array:
    return jnp.sqrt(u[0] ** 2 + width**2)


def mixed(u: Array, weight: Array) -> Array:
    return weight * jnp.abs(u[0]) + u @ u / 2


SWEEPS = {
    "a kink anywhere": (
        lambda u, a: jnp.abs(u[0] - a),
        [0, *10.0 ** np.arange(-12, 5), *(-(10.0 ** np.arange(-4, 4)))],
        "kink",
    ),
    "of any size": (lambda u, a: a * jnp.abs(u[0]), 10.0 ** np.arange(-15, 16, 3), "kink"),
    "beside a larger slope": (lambda u, a: a * jnp.abs(u[0]) + u[0], 10.0 ** np.arange(-10, 11, 2), "kink"),
    "one-sided": (lambda u, a: jnp.maximum(u[0] - a, 0), [-3.0, 0.0, 1e-3, 3.0], "kink"),
    "as a root": (lambda u, a: jnp.sqrt((u[0] - a) ** 2), [-3.0, 1.0, 0.1, 3.0], "kink"),
    "rounded down": (lambda u, a: jnp.floor(a * u[0]), [1e-2, 1.0, 1e2], "kink"),
    "narrow curvature": (huber, 10.0 ** np.arange(-9, 7), "regular"),
    "smoothed": (smoothed, 10.0 ** np.arange(-9, 4), "regular"),
    "with weak curvature": (lambda u, a: jnp.abs(u[0]) + a * u @ u, 10.0 ** np.arange(-10, 4), "regular"),
    "affine": (lambda u, a: a * u[0] + 1, [0, *10.0 ** np.arange(-15, 16, 3)], "singular"),
    "hidden rounding": (lambda u, a: (u[0] + a) ** 2 / 2 - u[0] ** 2 / 2, [0.3, 1e-3, 77.0], "singular"),
    "weak cost": (lambda u, a: a * u @ u, 10.0 ** np.arange(-15, 16, 3), "regular"),
    "a cube": (lambda u, a: a * u[0] ** 2 * jnp.abs(u[0]), [1e-9, 1.0, 1e9], "regular"),
}


@pytest.mark.parametrize("name", SWEEPS)
@pytest.mark.usual(2)
def test_a_kink_is_no_singular_control_and_no_curvature(name):
    price, numbers, expected = SWEEPS[name]
    assert {float(a): verdict(problem(price, a)) for a in numbers} == {float(a): expected for a in numbers}


TWO = {
    "one of two": (lambda u, a: u[0] ** 2 + jnp.abs(u[1] - a), "kink"),
    "aslant": (lambda u, a: (u[0] - u[1]) ** 2 + 1e-9 * jnp.abs(u[0] + u[1] - a), "kink"),
    "sum": (lambda u, a: jnp.sum(jnp.abs(u - a)), "kink"),
    "largest": (lambda u, a: jnp.max(jnp.abs(u - a)), "kink"),
    "cone": (lambda u, a: jnp.linalg.norm(u - a), "kink"),
    "one affine": (lambda u, a: u[0] ** 4 + a * u[1], "singular"),
    "ridge": (lambda u, a: (u[0] - a * u[1]) ** 2, "singular"),
    "unequal": (lambda u, a: u[0] ** 2 + 1e-15 * (u[1] - a) ** 2, "regular"),
}


@pytest.mark.parametrize("name", TWO)
@pytest.mark.usual(2)
def test_every_direction_of_two_controls_is_looked_at(name):
    price, expected = TWO[name]
    assert [verdict(problem(price, a, controls=2)) for a in (1e-3, 1.0, 20.0)] == 3 * [expected]


DYNAMICS = {
    "bent": (lambda u: u - jnp.abs(u) / 5, "a kink .* its first one changes by "),
    "clipped": (lambda u: jnp.clip(u, -1, 1), "a kink .* its first one changes by "),
    "narrowly clipped": (lambda u: jnp.clip(u, -1e-3, 1e-3), "a kink .* does not account for the change of its value "),
    "switched": (lambda u: jnp.where(u > 0, 1.0, -1.0), "jumps in the controls "),
}


@pytest.mark.parametrize("name", DYNAMICS)
def test_a_kink_of_the_dynamics_is_named(name):
    force, words = DYNAMICS[name]
    given = OptimalControlProblem(PLANE, lambda q, u: jnp.stack([q[1], force(u[0])]), lambda q, u: q @ q, 1)
    with pytest.raises(InvalidInputError, match=rf"^dynamics .*{words}.*jnp\.tanh"):
        given.check(AT, np.zeros(1))


@pytest.mark.parametrize("name", SINGULAR)
def test_the_known_singular_problems_have_none(name):
    known = SINGULAR[name]().problem
    known.check(known.manifold.random_point(jax.random.key(3)), resting_control(known.controls))


@pytest.mark.parametrize("beside", [0.0, 1e-16, 1e-14, 1e-12, 1e-7, 1e-4, 10.0**-3.5])
def test_the_rounding_of_terms_that_cancel_is_no_kink(beside):
    """The tangential part of two controls on the circle, near points where one of them has no tangential part."""
    circle = Sphere(1)
    problem = OptimalControlProblem(circle, lambda q, u: u - (q @ u) * q, lambda q, u: (u @ u - (q @ u) ** 2) / 2, 2)
    for angle in np.pi / 2 * np.arange(4) + beside:
        problem.check(np.array([np.cos(angle), np.sin(angle)]), np.zeros(2))


def test_what_takes_a_problem_names_its_kink():
    """``|u|`` from rest to rest was solved: ``dH/du`` was 2 at five of ten stages."""
    fuel = problem(lambda u, a: jnp.abs(u[0]))
    with pytest.raises(
        InvalidInputError, match=r"running_cost has a kink.* try u = a - b with the cost a \+ b.*jnp\.sqrt"
    ):
        solve(fuel, np.zeros(2), np.array([1.0, 0.0]), 1.0, method=MIDPOINT, steps=10)
    for symbolic in (False, True):
        with pytest.raises(InvalidInputError, match="running_cost has a kink"):
            classify(fuel, symbolic=symbolic)


def stationarity(given: OptimalControlProblem, solution: Any) -> float:
    """Largest ``|dH/du|`` at the stages, relative to its two parts."""
    at = [jnp.asarray(a) for a in (solution.stage_states, solution.stage_costates, solution.controls)]
    slopes = jax.vmap(lambda q, p, u: jax.jacrev(lambda u: jnp.stack(given._parts(q, p, u)))(u))(*at)
    return float(jnp.max(jnp.abs(slopes[:, 0] - slopes[:, 1])) / jnp.max(jnp.abs(slopes)))


@pytest.mark.parametrize("price", [mixed, pytest.param(smoothed, marks=pytest.mark.slow)])
def test_a_success_is_stationary_at_the_controls_it_returns(price):
    """Through the weights at which Newton's method no longer gets past the kink, and the widths that it can follow.

    What is no success says why, and names no kink of a smooth function.
    """
    found = []
    for number in 10.0 ** np.arange(-3, 3):
        given = problem(price, number)
        solution = solve(given, np.zeros(2), np.array([1.0, 0.0]), 1.0, method=MIDPOINT, steps=10, throw=False)
        assert not solution.success or stationarity(given, solution) < 1e-9, number
        kink = "running_cost has a kink or a jump in the controls at u = [0.]" in solution.result
        assert kink == (price is mixed and not solution.success), (number, solution.result)
        found.append(solution.success)
    assert len(set(found)) == 2, "the sweep passes through the decision"


class Stopped(NamedTuple):
    """What is looked at of a solution without success, at a few controls of some size."""

    controls: np.ndarray
    stage_states: np.ndarray
    stage_costates: np.ndarray
    stage_times: np.ndarray


def stopped(size: float, controls: int = 1) -> Any:
    draw = np.random.default_rng(0).standard_normal
    return Stopped(size * draw((7, controls)), draw((7, 2)), draw((7, 2)), np.arange(7.0))


def power(u: Array, exponent: Array) -> Array:
    return jnp.abs(u[0]) ** exponent + u[0] ** 2


def bounded(u: Array, a: Array) -> Array:
    return -a * jnp.log(1.1 - u[0] ** 2) + jnp.exp(3 * u[0])


CURVED = {
    "beside curvature": (lambda u, a: jnp.abs(u[0]) + a * u[0] ** 2, 10.0 ** np.arange(-6, 5), "has a kink"),
    "of a weight": (lambda u, a: a * jnp.abs(u[0]) + u[0] ** 4 + u[0] ** 2, 10.0 ** np.arange(-1, 5), "has a kink"),
    "below rounding in single precision": (lambda u, a: a * jnp.abs(u[0]) + u[0] ** 2, [0.0, 1e-15, 1e-12, 1e-8], ""),
    "at another control": (
        lambda u, a: jnp.abs(u[0] - a) + jnp.cosh(u[0]),
        [-0.5, -1e-3, 1e-9, 0.25, 0.7],
        "has a kink",
    ),
    "one-sided": (lambda u, a: jnp.maximum(u[0] - a, 0) + u[0] ** 2, [-0.3, 0.0, 0.3], "has a kink"),
    "a maximum": (lambda u, a: jnp.max(jnp.abs(u - a)) + u @ u, [-0.3, 0.0, 0.3], "has a kink"),
    "powers": (power, [1.5, 1.95, 2.0, 2.5, 3.0], ""),
    "Huber": (lambda u, a: huber(u, a) + u[0] ** 2 / 10, 10.0 ** np.arange(-9, 2), ""),
    "smoothed": (lambda u, a: smoothed(u, a) + u[0] ** 2 / 10, 10.0 ** np.arange(-9, 2), ""),
    "smoothed elsewhere": (lambda u, a: smoothed(u - 0.3, a) + u[0] ** 2, 10.0 ** np.arange(-8, 2), ""),
    "barriers": (bounded, 10.0 ** np.arange(-9, 2), ""),
    "wiggles": (lambda u, a: jnp.sin(u[0] / a) + u[0] ** 2, 10.0 ** np.arange(-4, 2), ""),
}


@pytest.mark.parametrize("name", CURVED)
@pytest.mark.usual(2)
def test_a_kink_beside_curvature_is_told_from_narrow_curvature(name):
    price, numbers, expected = CURVED[name]
    for a in numbers:
        words = find_kinks(problem(price, a), stopped(1.0))
        assert expected in words, a
        assert bool(words) == bool(expected), (a, words)


@pytest.mark.parametrize("unit", 10.0 ** np.arange(-6, 7, 3))
def test_a_kink_beside_curvature_has_no_unit(unit):
    def kinked(u: Array, a: Array) -> Array:
        return jnp.abs(u[0] / a) + (u[0] / a) ** 2

    def smooth(u: Array, a: Array) -> Array:
        return smoothed(u / a, jnp.asarray(1e-6)) + (u[0] / a) ** 2

    assert "has a kink or a jump in the controls at u = [0.]" in find_kinks(problem(kinked, unit), stopped(unit))
    assert not find_kinks(problem(smooth, unit), stopped(unit))


def test_a_kink_beside_curvature_is_found_along_every_direction():
    def price(u: Array, a: Array) -> Array:
        return jnp.abs(u[0] - 2 * u[1]) + a * u @ u

    assert "running_cost has a kink" in find_kinks(problem(price, 0.1, 2), stopped(1.0, 2))
    clipped = problem(lambda u, a: u @ u, 1.0, dynamics=lambda q, u: jnp.stack([q[1], jnp.clip(u[0], -0.3, 0.3)]))
    assert "dynamics has a kink" in find_kinks(clipped, stopped(1.0))


@pytest.mark.slow
def test_a_smoothed_kink_is_followed_to_the_width_that_is_wanted():
    """What the message advises: each solution is the guess of the next."""
    guess = None
    for width in (10.0, 3.0, 1.0, 0.3, 0.1):
        given = problem(smoothed, width)
        guess = solve(given, np.zeros(2), np.array([1.0, 0.0]), 1.0, method=MIDPOINT, steps=10, guess=guess)
    assert 2.0 < guess.cost < 2.3  # above the two impulses of the limit
