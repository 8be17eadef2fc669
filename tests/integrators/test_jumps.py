"""Jumps in the controls are refused by name, however small; steps that make no jump are not."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import OptimalControlProblem
from retrax.manifolds import InvalidInputError

from .test_kinks import AT, PLANE, Priced, cart, problem

REST = np.zeros(1)

JUMPS: dict[str, tuple[Any, str]] = {
    "jnp.round": (lambda u: jnp.round(40 * u[0]) / 1e3, "jnp.round"),
    "round": (lambda u: round(u[0]), "jnp.round and a whole number"),
    "floor": (lambda u: jnp.floor(u[0] / 3e3), "jnp.floor"),
    "sign": (lambda u: jnp.sign(u[0] - 7.0), "jnp.sign"),
    "argmax": (lambda u: jnp.argmax(jnp.stack([u[0], -u[0]])), "jnp.argmax"),
    "cast": (lambda u: u[0].astype(int), "a whole number"),
    "step": (lambda u: jnp.where(u[0] > 0.3, 1.0, 0.0), "a comparison"),
    "remainder": (lambda u: u[0] % 1.0, "the remainder of a division"),
    "place in a table": (lambda u: jnp.searchsorted(jnp.array([0.1, 0.3, 0.6]), u[0]), "a comparison"),
    "within a checkpoint": (lambda u: jax.checkpoint(jnp.floor)(u[0] / 3e3), "jnp.floor"),
}

CONTINUOUS = {
    "odd": lambda u: jnp.sign(u[0]) * u[0] ** 2,
    "branches": lambda u: jnp.where(u[0] > 0.3, (u[0] - 0.3) ** 3, 0.0),
    "table": lambda u: jnp.interp(u[0], jnp.array([-1e2, 0, 0.4, 1e2]), jnp.array([3e2, 0, 0.1, 4e2])),
    "steep": lambda u: jnp.where(u[0] < 9e9, jnp.tanh(1e4 * u[0]), 0.0),
    "triangle": lambda u: jnp.abs(u[0] - jnp.round(u[0])),
}


@pytest.mark.parametrize("name", JUMPS)
def test_jumps_are_refused_by_what_makes_them(name):
    step, words = JUMPS[name]
    with pytest.raises(InvalidInputError, match=f"running_cost jumps in the controls at u = .* it computes {words}"):
        problem(lambda u, number: u @ u / 2 + number * step(u)).check(AT, REST)


def test_jumps_of_the_dynamics_are_refused():
    given = OptimalControlProblem(
        PLANE, lambda q, u: jnp.stack([q[1], u[0] + jnp.round(u[0])]), lambda q, u: u @ u / 2, 1
    )
    with pytest.raises(InvalidInputError, match=r"dynamics jumps in the controls at u = .*jnp\.round"):
        given.check(AT, REST)


def test_a_constraint_that_is_a_step_is_answered_with_one_that_is_none():
    def given(limit: Any) -> OptimalControlProblem:
        return OptimalControlProblem(PLANE, cart, lambda q, u: u @ u / 2, 1, constraints={"most": limit})

    words = r"constraints\['most'\] jumps in the controls at u = \[1.\].*; return a number that is not positive where"
    with pytest.raises(InvalidInputError, match=rf"{words} the control is admissible, as u\[0\] - 1 for u\[0\] < 1$"):
        given(lambda q, u: jnp.where(u[0] < 1, 0.0, 1.0)).check(AT, REST)
    given(lambda q, u: u[0] - 1).check(AT, REST)


@pytest.mark.parametrize("name", CONTINUOUS)
def test_steps_that_make_no_jump_are_not_refused(name):
    step = CONTINUOUS[name]
    problem(lambda u, number: u @ u / 2 + number * step(u)).check(AT, REST)


def stair(u: Array, height: Array) -> Array:
    return u @ u / 2 + jnp.where(u[0] > 0.3, height, 0.0)


def ramp(u: Array, width: Array) -> Array:
    """The same stair over a width."""
    return u @ u / 2 + jnp.where(u[0] > 0.3, jnp.minimum((u[0] - 0.3) / width, 1.0), 0.0)


@pytest.mark.parametrize("height", [0.0, *10.0 ** np.arange(-14, 5, 3)])
def test_a_jump_is_seen_from_a_height_on(height):
    given = OptimalControlProblem(PLANE, cart, Priced(stair, jnp.asarray(height)), 1)
    if height > 1e-6:
        with pytest.raises(InvalidInputError, match="jumps in the controls"):
            given.check(AT, REST)
    else:
        given.check(AT, REST)


@pytest.mark.parametrize("width", 10.0 ** np.arange(-8, 1, 2))
def test_a_steep_ramp_is_not_a_jump(width):
    problem(ramp, width).check(AT, REST)
