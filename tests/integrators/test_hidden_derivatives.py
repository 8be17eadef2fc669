"""Derivatives that do not tell of the values of their functions: nothing of it ends in a success."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import OptimalControlProblem
from retrax.manifolds import InvalidInputError

from .test_state_jumps import AT, END, PLANE, cart, solver_of

STOPPED = {
    "state": (lambda q, u: u @ u / 2 + jax.lax.stop_gradient(q[0]) ** 2, "states"),
    "control": (lambda q, u: u @ u / 2 + u[0] * jax.lax.stop_gradient(u[0]), "controls"),
    "rule": (lambda q, u: u @ u / 2 + wrong_square(q[0]), "states"),
}


@jax.custom_jvp
def wrong_square(x: Array) -> Array:
    return x**2


wrong_square.defjvp(lambda x, t: (x[0] ** 2, x[0] * t[0]))


@pytest.mark.parametrize("name", STOPPED)
def test_derivatives_that_do_not_tell_of_the_values_are_refused(name):
    price, about = STOPPED[name]
    with pytest.raises(
        InvalidInputError, match=f"running_cost changes with the {about} at another rate than its derivative"
    ):
        OptimalControlProblem(PLANE, cart, price, 1).check(AT, np.zeros(1))


@jax.custom_jvp
def unity(x: Array) -> Array:
    return jnp.ones_like(x)


unity.defjvp(lambda x, t: (jnp.ones_like(x[0]), jnp.zeros_like(t[0])))


@pytest.mark.parametrize("power", [1, 2, 3, 4, 6])
def test_values_that_cancel_are_no_proof_against_a_derivative(power):
    """``(1 + x^k) - 1`` near zero, where it changes in steps of the rounding of 1."""
    problem = OptimalControlProblem(PLANE, cart, lambda q, u: u @ u / 2 + (unity(q[0]) + q[0] ** power) - 1, 1)
    problem.check(np.zeros(2), np.zeros(1))


class Hidden(eqx.Module):
    """A cost of which a share is hidden: that share is data, so that one kernel serves a sweep."""

    weight: Array

    def __call__(self, q: Array, u: Array) -> Array:
        return u @ u / 2 + q[0] ** 2 + self.weight * jax.lax.stop_gradient(q[0]) ** 2


def test_what_is_hidden_along_a_trajectory_is_seen_where_the_start_shows_nothing():
    """The share is zero up to a place, which moves through the trajectory, and from there on a cube."""

    def price(q: Array, u: Array, given: tuple[Array, Array]) -> Array:
        place, hidden = given
        beyond = jnp.maximum(q[0] - place, 0.0) ** 3
        return u @ u / 2 + (1 - hidden) * beyond + hidden * jax.lax.stop_gradient(beyond)

    solver = solver_of(price)
    for hidden in (0.0, 1e-12, 1e-2, 1.0):
        for place in (-0.1, 0.1, 0.6, 1.5):
            solution = solver.solve(0 * END, END, 1.0, parameters=(np.array(place), np.array(hidden)), throw=False)
            assert solution.success == (hidden < 1e-9 or place > 1), (place, hidden, solution.result)
            assert solution.success or "running_cost changes with the states at another rate" in solution.result


def is_refused(share: float, unit: float) -> bool:
    try:
        OptimalControlProblem(PLANE, cart, Hidden(jnp.asarray(share)), 1).check(unit * AT, np.zeros(1))
    except InvalidInputError as error:
        return "jax.lax.stop_gradient" in str(error)
    return False


@pytest.mark.parametrize("unit", [pytest.param(1e-6, marks=pytest.mark.slow), 1e6])
def test_what_is_hidden_is_seen_from_a_share_on(unit):
    shares = [0.0, 1e-12, 1e-8, 1e-4, 1.0, 1e4]
    assert [is_refused(share, unit) for share in shares] == [False, False, False, True, True, True]


TRUE = (
    lambda q: jax.scipy.special.logsumexp(30 * q),
    lambda q: jax.lax.stop_gradient(jnp.sin(3.0)) * q[0],
    lambda q: jax.nn.relu(q[0]),
    lambda q: jax.nn.softplus(100 * (q[0] - 0.1)),
)


def test_derivatives_that_are_true_are_not_refused():
    problem = OptimalControlProblem(PLANE, cart, lambda q, u: u @ u / 2 + sum(f(q) for f in TRUE), 1)
    for at in (AT, 0 * AT, 1e5 * AT):
        problem.check(at, np.zeros(1))


def test_a_hidden_end_is_refused():
    ends = {"boresight": lambda first, last: jax.lax.stop_gradient(last)[:1]}
    with pytest.raises(InvalidInputError, match=r"boundary_constraints\['boresight'\] changes with the states"):
        OptimalControlProblem(PLANE, cart, lambda q, u: u @ u / 2, 1, boundary_constraints=ends).check(AT, np.zeros(1))
