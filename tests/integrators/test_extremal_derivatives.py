"""JAX's derivatives of what is computed from an extremal, in both modes, against differences of solutions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import DifferentiableSolution, OptimalControlProblem, Solver
from retrax.manifolds import Euclidean, InvalidInputError, Sphere, hat
from retrax.retractions import Exponential, Gauss, Midpoint, Projection, default_retraction

from .problems import INERTIA, REST, RIGID, rotation

PLANE, SPHERE = Euclidean(2), Sphere(2)
DRAG = {"mass": 1.3, "rates": np.array([0.3, 0.1])}


def cart(q, u, p):
    """A mass with linear and cubic drag."""
    return jnp.stack([q[1], (u[0] - p["rates"][0] * q[1] - p["rates"][1] * q[1] ** 3) / p["mass"]])


def pointed(q, u, p):
    """A point of the sphere, turned by a control and by a wind."""
    return jnp.cross(p["mass"] * u + jnp.array([0, p["rates"][1], 0.4]), q)


def body(q, u, p):
    """Rigid body with three torques."""
    return q[0] @ hat(q[1]), (u - jnp.cross(q[1], INERTIA * q[1])) / INERTIA / p["mass"]


def effort(q, u):
    return u @ u / 2


CASES = {
    "cart": (
        OptimalControlProblem(PLANE, cart, effort, 1),
        Gauss(2, Exponential(PLANE)),
        np.zeros(2),
        np.array([1.0, 0.2]),
    ),
    "sphere": (
        OptimalControlProblem(SPHERE, pointed, lambda q, u: u @ u / 2 + 0.3 * q[2] ** 2, 3),
        Midpoint(Projection(SPHERE)),
        np.array([1.0, 0, 0]),
        np.array([0.6, 0, 0.8]),
    ),
    "slew with a free end": (
        OptimalControlProblem(RIGID, body, effort, 3),
        Gauss(2, default_retraction(RIGID)),
        (np.eye(3), REST),
        (rotation([0.5, 0.3, -0.8]), None),
    ),
}


@jax.jit
def loss(found: DifferentiableSolution):
    """One number of everything that an extremal has."""
    parts = [
        jnp.sum(jnp.sin(leaf) * jnp.cos(jnp.arange(leaf.size).reshape(leaf.shape))) for leaf in jax.tree.leaves(found)
    ]
    return sum(parts) + found.cost**2


def along(tree, direction, size):
    return jax.tree.map(lambda a, v: a + size * v, tree, direction)


@pytest.mark.parametrize(
    "name", ["cart", *(pytest.param(name, marks=pytest.mark.slow) for name in ("sphere", "slew with a free end"))]
)
def test_both_modes_are_the_differences_of_solutions(name):
    """By the horizon and the parameters, and by ends that move along curves of the manifold."""
    problem, method, start, end = CASES[name]
    solver, manifold = Solver(problem, method, 4), problem.manifold
    fixed = end[0] if isinstance(end, tuple) else end
    factor = manifold.factors[0] if isinstance(end, tuple) else manifold
    axis = factor.projection(fixed, 0.3 * jnp.cos(jnp.arange(fixed.size)).reshape(fixed.shape))

    @jax.jit
    def moved(aside):
        return default_retraction(factor)(fixed, aside * axis)

    def total(aside, horizon, parameters):
        there = (moved(aside), None) if isinstance(end, tuple) else moved(aside)
        return loss(solver.extremal(start, there, horizon, parameters=parameters))

    at, direction = (0.0, 1.1, DRAG), (0.7, -0.4, {"mass": 0.5, "rates": np.array([0.2, -0.9])})
    plus, minus = (total(*along(at, direction, size)) for size in (1e-5, -1e-5))
    value, slope = jax.jvp(total, at, direction)
    gradient = jax.grad(total, (0, 1, 2))(*at)
    pairs = zip(jax.tree.leaves(gradient), jax.tree.leaves(direction), strict=True)
    assert float(value) == pytest.approx(float(total(*at)), rel=1e-13)
    assert float(slope) == pytest.approx(float(plus - minus) / 2e-5, rel=1e-6)
    assert sum(float(jnp.sum(g * v)) for g, v in pairs) == pytest.approx(float(slope), rel=1e-12)


def test_the_gradient_of_the_cost_by_the_ends_is_the_costate():
    problem, method, start, end = CASES["sphere"]
    solver = Solver(problem, method, 4)
    solution = solver.solve(start, end, 1.1, parameters=DRAG)

    def cost(*given):
        return solver.extremal(*given, guess=solution, parameters=DRAG).cost

    by_start, by_end, by_horizon = jax.grad(cost, (0, 1, 2))(start, end, 1.1)
    np.testing.assert_allclose(by_start, -solution.costates[0], atol=1e-12)
    np.testing.assert_allclose(by_end, solution.costates[-1], atol=1e-12)
    assert float(by_horizon) == pytest.approx(float(solver.sensitivity(solution).horizon.cost), rel=1e-12)
    assert jax.jacobian(lambda q: solver.extremal(q, end, 1, parameters=DRAG).controls)(start).shape == (4, 3, 3)


def test_where_it_is_not_offered_it_says_so():
    problem, method, start, end = CASES["cart"]
    solver = Solver(problem, method, 3)

    def cost(mass):
        return solver.extremal(start, end, 1.0, parameters={**DRAG, "mass": mass}).cost

    for wrong in (jax.jit(cost), jax.hessian(cost), lambda m: jax.vmap(cost)(jnp.stack([m, m]))):
        with pytest.raises(InvalidInputError, match="extremal is called with values that JAX is tracing"):
            wrong(jnp.asarray(1.0))
    with pytest.raises(InvalidInputError, match=r"solve runs outside jit, .*; try solver.extremal"):
        jax.grad(lambda mass: solver.solve(start, end, 1.0, parameters={**DRAG, "mass": mass}).cost)(1.0)
    with pytest.raises(InvalidInputError, match="extremal takes numbers and arrays of them, got 'soon'"):
        solver.extremal(start, end, "soon", parameters=DRAG)
    with pytest.raises(InvalidInputError, match="horizon must be a positive finite time"):
        jax.grad(lambda horizon: solver.extremal(start, end, horizon, parameters=DRAG).cost)(-1.0)
