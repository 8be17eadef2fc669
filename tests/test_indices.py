"""Indices of entries that are not there are refused where a function is read, however it comes by them."""

import inspect
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.index_bounds import require_indices
from retrax.integrators import (
    DiracIntegrator,
    DiracSystem,
    OptimalControlProblem,
    Solver,
    SymplecticIntegrator,
    classify,
    integrate,
)
from retrax.manifolds import Euclidean, InvalidInputError, LevelSet
from retrax.retractions import CotangentLift, Midpoint, default_retraction
from retrax.tracing import trace_program

A = np.arange(9.0).reshape(3, 3)

OUTSIDE: dict[str, tuple[Any, int, int]] = {  # with the index, and the axis
    "entry": (lambda u: u[3], 3, 0),
    "entry from the end": (lambda u: u[-4], -4, 0),
    "row of a matrix that is read": (lambda u: A @ u + jnp.asarray(A)[3], 3, 0),
    "column": (lambda u: (A * u)[:, 3], 3, 1),
    "entry of a row": (lambda u: (A * u)[1][3], 3, 0),
    "some of several": (lambda u: u[jnp.array([0, 2, 5])], 5, 0),
    "pairs": (lambda u: (A * u)[np.array([0, 1]), np.array([1, 3])], 3, 1),
    "block": (lambda u: (A * u)[np.ix_([0, 1], [1, 3])], 3, 1),
    "an index that is computed": (lambda u: u[2 * jnp.arange(3)], 4, 0),
    "slice that is moved": (lambda u: jax.lax.dynamic_slice(u, (2,), (2,)), 2, 0),
    "part that is moved": (lambda u: jax.lax.dynamic_update_slice(u, u[:2], (2,)), 2, 0),
    "entry that is set": (lambda u: u.at[3].set(1.0), 3, 0),
    "entry that is set from the end": (lambda u: u.at[-5].set(1.0), -5, 0),
    "entry that is increased": (lambda u: (A * u).at[0, 3].add(1.0), 3, 1),
    "column that is set": (lambda u: (A * u).at[:, 4].set(u), 4, 1),
    "in jit": (lambda u: jax.jit(lambda v, k: v[k])(u, 3), 3, 0),
    "in vmap": (lambda u: jax.vmap(lambda row: row[3])(A * u), 3, 1),
    "set in vmap": (lambda u: jax.vmap(lambda row: row.at[3].set(1.0))(A * u), 3, 1),
    "in a loop": (lambda u: jax.lax.fori_loop(0, 4, lambda _, s: s + u[3], 0.0), 3, 0),
    "in an open loop": (lambda u: jax.lax.while_loop(lambda s: s[3] < 1, lambda s: s + 1, u), 3, 0),
    "in a branch": (lambda u: jax.lax.cond(u[0] > 0, lambda v: v[0], lambda v: v[3], u), 3, 0),
    "in a checkpoint": (jax.checkpoint(lambda u: 2 * u[3]), 3, 0),
    "in a derivative": (jax.grad(lambda u: u[3] ** 2), 3, 0),
    "by a function of JAX": (
        lambda u: jnp.take(A * u, 3, axis=1, mode="wrap") + jax.lax.dynamic_index_in_dim(u, 3),
        3,
        0,
    ),
}
INSIDE: dict[str, Any] = {
    "last": lambda u: u[-1] + u[2] + u[-3],
    "by truths": lambda u: u[np.array([True, False, True])],
    "several": lambda u: u[jnp.array([0, -1, 2])] + (A * u)[np.ix_([0, 2], [1, -1])].sum(),
    "slices": lambda u: u[1:7].sum() + u[-9:2].sum(),
    "clipped as asked": lambda u: u.at[jnp.array([0, 3])].get(mode="clip"),
    "clipped when taken": lambda u: (
        jnp.take(u, 5, mode="clip") + jax.vmap(lambda r: jnp.take(r, 5, mode="clip"))(A * u)
    ),
    "in a branch that is not taken": lambda u: jax.lax.cond(u.size > 3, lambda v: v[3], lambda v: 0.0, u),
    "in another case": lambda u: jax.lax.switch(0, [lambda v: v[2], lambda v: v[3]], u),
    "columns first": lambda u: u[jnp.ravel(jnp.array([[0, 1], [2, 0]]), order="F")],
    "filled as asked": lambda u: u.at[3].get(mode="fill", fill_value=0.0),
    "one of two is set": lambda u: u.at[jnp.arange(2, 4)].set(1.0),
    "by the input": lambda u: u[u[0].astype(int)],
    "by the round": lambda u: jax.lax.fori_loop(0, 3, lambda k, s: s + u[k], 0.0),
    "table": lambda u: jnp.interp(u, np.arange(4.0), np.arange(4.0) ** 2),
    "mapped": lambda u: jax.vmap(lambda row: row[2] * row[-3])(A * u),
    "sorted": lambda u: jnp.sort(u)[::-1] + jnp.linalg.solve(A + np.eye(3), jnp.roll(u, 4)),
}


@pytest.mark.parametrize("name", OUTSIDE)
def test_an_index_outside_is_refused_with_its_line(name):
    function, index, axis = OUTSIDE[name]
    with pytest.raises(InvalidInputError) as caught:
        require_indices(trace_program(function, np.ones(3)), "the cost")
    line = inspect.getsourcelines(inspect.unwrap(function))[1]
    assert f"has index {index} on axis {axis} of an array of shape (3" in str(caught.value)
    assert f", line {line} of {__file__}," in str(caught.value)


@pytest.mark.parametrize("name", INSIDE)
def test_other_indices_are_not(name):
    require_indices(trace_program(INSIDE[name], np.ones(3)), "the cost")


@pytest.mark.parametrize("index", range(-5, 6))
def test_the_range_that_is_named_is_that_which_is_accepted(index):
    def refused(k: int) -> str:
        try:
            require_indices(trace_program(lambda u: u[k] + 0 * (A * u)[k, 0], np.ones(3)), "the cost")
        except InvalidInputError as error:
            return str(error)
        return ""

    words = refused(index)
    assert bool(words) == (not -3 <= index <= 2)
    assert not words or "expected -3 to 2;" in words


def given(**changed: Any) -> OptimalControlProblem:
    functions = {"dynamics": lambda q, u: u, "running_cost": lambda q, u: u @ u / 2, **changed}
    return OptimalControlProblem(Euclidean(3), controls=3, **functions)


@pytest.mark.parametrize(
    "changed",
    [
        {"dynamics": lambda q, u: jnp.stack([u[0], u[1], u[3]])},
        {"running_cost": lambda q, u: u @ u / 2 + q[3] ** 2},
        {"terminal_cost": lambda q: q[3] ** 2},
        {"constraints": {"wall": lambda q, u: q[3] - 5.0}},
        {"boundary_constraints": {"loop": lambda start, end: end[3] - start[0]}},
    ],
    ids=lambda changed: next(iter(changed)),
)
def test_no_function_of_a_problem_reads_what_is_not_there(changed):
    words = "a function of the problem, in <lambda>, line .*: *has index 3|has index 3 on axis 0"
    with pytest.raises(InvalidInputError, match=words):
        Solver(given(**changed), Midpoint(default_retraction(Euclidean(3))), 4)
    with pytest.raises(InvalidInputError, match=words):
        given(**changed).check(np.zeros(3), np.zeros(3))


def test_nor_does_one_that_is_classified():
    with pytest.raises(InvalidInputError, match="has index 3 on axis 0"):
        classify(given(running_cost=lambda q, u: q @ q / 2 + u[3] ** 2 / 2))


def test_nor_does_a_hamiltonian_or_a_constraint_of_velocities():
    plane = Euclidean(3)
    start, lift = (np.ones(3), np.zeros(3)), CotangentLift(Midpoint(default_retraction(plane)))
    with pytest.raises(InvalidInputError, match=r"the Hamiltonian, in .* has index 3 on axis 0"):
        integrate(lambda q, p: p @ p / 2 + q[3] ** 2, SymplecticIntegrator(lift), start, 0.1, 3)
    system = DiracSystem(plane, lambda q, p: p @ p / 2, lambda q: jnp.stack([jnp.eye(3)[0] * q[3]]))
    with pytest.raises(InvalidInputError, match=r"a function of the constraints, in .* has index 3 on axis 0"):
        integrate(system, DiracIntegrator(lift), start, 0.1, 3)


class Circle(LevelSet):
    shape = (2,)

    def constraint(self, x: Any) -> Any:
        return x[0] ** 2 + x[2] ** 2 - 1


def test_nor_does_the_constraint_of_a_level_set():
    with pytest.raises(InvalidInputError, match=r"the constraint of Circle, in .*constraint, line .* has index 2 on"):
        Circle()
