"""RATTLE on the final constraint manifold of a singular problem on the sphere: a long run, its leaves, wrong input."""

from functools import cache
from types import SimpleNamespace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import Composition, OptimalControlProblem, integrate
from retrax.integrators.singular.strategies import (
    ControlAffineSplitting,
    NotApplicableError,
    RattleIntegrator,
    leaf_flow,
)
from retrax.integrators.singular.strategies.control_affine_splitting import affine_tolerance
from retrax.manifolds import (
    ConvergenceError,
    CotangentBundle,
    Euclidean,
    InvalidInputError,
    NotOnManifoldError,
    Submanifold,
    hat,
)
from retrax.retractions import Addition, Cayley, CotangentLift, Midpoint, Projection

from tests.integrators.problems import SO3, SPHERE
from tests.integrators.singular.cases import classified, scaled
from tests.support.numerics import compiled, norm, slope

BUNDLE, LIFT = CotangentBundle(SPHERE), CotangentLift(Midpoint(Projection(SPHERE)))
AXIS = jnp.array([0.0, 0.0, 1.0])


def turned(q: Array, u: Array) -> Array:
    """A drift, and a control that turns the sphere about the vertical."""
    return SPHERE.projection(q, jnp.array([0.1 * q[2], 0.15 * q[0] * q[1], q[1] + 0.1 * q[0]])) + u[0] * jnp.cross(
        AXIS, q
    )


def height_cost(q: Array, u: Array) -> Array:
    """Without a cost of control."""
    return 2 * q[0] - 2 * q[2] ** 2 + 0.2 * q[0] * q[2] + 0.1 * q[1]


PROBLEM = OptimalControlProblem(SPHERE, turned, height_cost, 1)
COSTLY = OptimalControlProblem(SPHERE, turned, lambda q, u: height_cost(q, u) + u @ u, 1)
SPLIT = ControlAffineSplitting(PROBLEM, (0,))
RATTLE = RattleIntegrator(LIFT, (0,))
# x' = y, y' = u with the cost y^3 / 6 - x / 2.
CUBIC = OptimalControlProblem(
    Euclidean(2), lambda q, u: jnp.stack([q[1], u[0]]), lambda q, u: q[1] ** 3 / 6 - q[0] / 2, 1
)
CUBIC_RATTLE = RattleIntegrator(CotangentLift(Midpoint(Addition(Euclidean(2)))), (0,))


def constraints(q: Array, p: Array) -> Array:
    return jnp.concatenate([SPLIT.primary(q, p), SPLIT.secondary(q, p)])


@cache
def start() -> tuple:
    guess = jnp.array([-0.93, 0.09, 0.3557]), jnp.array([0.11, -0.01, 0.295])
    return Submanifold(BUNDLE, lambda z: constraints(*z)).nearby(guess)


@pytest.mark.slow
def test_a_long_run_stays_on_the_final_manifold_and_its_energy_does_not_drift():
    path = integrate(PROBLEM, RATTLE, start(), 0.1, 2400, save_every=4)
    energies = np.asarray(jax.vmap(SPLIT.energy)(path.q, path.p))
    errors = np.max(np.abs(energies - energies[0])[1:].reshape(4, -1), axis=1)
    assert np.max(np.abs(jax.vmap(constraints)(path.q, path.p))) < 1e-13
    assert np.ptp(errors) < 0.02 * np.max(errors) < 2e-6


@pytest.mark.slow
def test_the_control_of_a_step_is_that_of_the_arc_to_second_order():
    """On the arc it is known: ``psi' = {psi, H_0} + u {psi, phi} = 0``."""
    control = jax.jit(jax.vmap(classified("sphere").control))
    steps, errors = np.array([0.1, 0.05, 0.025]), []
    for h in steps:
        path = integrate(PROBLEM, RATTLE, start(), h, 10)
        at_nodes = control(path.q, path.p)
        errors.append(np.max(np.abs(path.controls - (at_nodes[:-1] + at_nodes[1:]) / 2)))
    assert errors[1] < 1e-4
    assert slope(steps, np.array(errors), 1e-13) == pytest.approx(2, abs=0.2)


def test_steps_keep_both_constraints_with_the_mean_control_of_the_arc():
    """``y = sqrt(1 - t)`` on ``P_f`` and ``p_x = (1 - t) / 2``; moves along the leaves change ``y`` alone."""
    h, z = 0.05, (jnp.array([0.0, 1.0]), jnp.array([0.5, 0.0]))
    memory = CUBIC_RATTLE.begin(CUBIC, *z)
    step = compiled(lambda q, p, memory: CUBIC_RATTLE.step(CUBIC, h, q, p, memory))
    for t in (h, 2 * h):
        before, new = z[0][1], step(*z, memory)
        assert new.converged
        z, memory, y = (new.q, new.p), new.unknowns, np.sqrt(1 - t)
        np.testing.assert_allclose((z[0][1], *z[1]), (y, y**2 / 2, 0.0), atol=1e-14)
        np.testing.assert_allclose(CUBIC_RATTLE.control(memory), [(y - before) / h], rtol=1e-12)


def test_moving_along_a_leaf_keeps_the_level_and_composes():
    z = start()
    flow = jax.jit(lambda z, t: leaf_flow(SPLIT.primary, z, t))
    there = flow(flow(z, jnp.array([0.1])), jnp.array([0.05]))
    at_once = flow(z, jnp.array([0.15]))
    np.testing.assert_allclose(there, at_once, atol=1e-14)
    # phi = <p, e3 x q>: its flow turns both about the vertical.
    c, s = np.cos(0.15), np.sin(0.15)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(at_once, (turn @ z[0], turn @ z[1]), atol=1e-14)


class Paid(eqx.Module):
    """The cost of the cubic problem, and of the control."""

    weight: Array

    def __call__(self, q: Array, u: Array) -> Array:
        return CUBIC.running_cost(q, u) + self.weight * u[0] ** 2 / 2


def test_it_applies_where_second_derivatives_by_a_control_are_rounding():
    states = jax.tree.map(lambda a: a[None], (jnp.array([0.0, 1.0]), jnp.array([0.5, 0.0])))
    for share in (0.0, 1e-3, 0.05, 20.0, 1e3, 1e9, 1e14):
        problem = OptimalControlProblem(
            CUBIC.manifold, CUBIC.dynamics, Paid(jnp.array(share * affine_tolerance())), CUBIC.controls
        )
        found: Any = SimpleNamespace(
            problem=problem, stratum=SimpleNamespace(states=states, count=1, u=jnp.array([-0.5]))
        )
        if share < 1:
            assert RattleIntegrator.suited(found, CUBIC_RATTLE.lift, None)[0].singular == (0,)
        else:
            with pytest.raises(NotApplicableError, match="H has a second derivative in every control"):
                RattleIntegrator.suited(found, CUBIC_RATTLE.lift, None)


def test_bad_input_is_refused_with_the_reason():
    z = start()
    with pytest.raises(NotOnManifoldError, match="phi = dH/du"):
        integrate(PROBLEM, RATTLE, (z[0], z[1] + SPHERE.projection(z[0], AXIS) + 0.1 * jnp.cross(AXIS, z[0])), 0.1, 1)
    with pytest.raises(InvalidInputError, match="not affine in the controls"):
        integrate(COSTLY, RATTLE, z, 0.1, 1)
    with pytest.raises(InvalidInputError, match="name controls by their indices"):
        integrate(PROBLEM, RattleIntegrator(LIFT, (1,)), z, 0.1, 1)
    chain = OptimalControlProblem(Euclidean(2), lambda q, u: jnp.stack([q[1], u[0]]), lambda q, u: q[0] ** 2 / 2, 1)
    with pytest.raises(InvalidInputError, match="higher order"):
        integrate(chain, CUBIC_RATTLE, (jnp.zeros(2), jnp.zeros(2)), 0.1, 1)


@pytest.mark.slow
@pytest.mark.parametrize("h", [0.1, 0.025])
def test_where_an_arc_ends_the_error_says_so(h):
    """``{phi, psi} = y`` and ``u = -1/(2 y)``, so ``y^2 = 1 - t``."""
    method = Composition(CUBIC_RATTLE, (1.0,))
    arc = integrate(CUBIC, method, (jnp.array([0.0, 1.0]), jnp.array([0.5, 0.0])), h, 60, throw=False)
    failed = int(arc.failed_step)
    assert abs(failed * h - 1) < 2 * h
    where = rf"step {failed}, from t = {failed * h:.6g}"
    words = rf"{where}: .*leaves the regular part of P_f.*value is 1 at first, 0\.[0-3].* at last"
    with pytest.raises(ConvergenceError, match=words):
        integrate(CUBIC, method, (jnp.array([0.0, 1.0]), jnp.array([0.5, 0.0])), h, 60)


@pytest.mark.slow
def test_moves_along_leaves_that_are_too_long_for_their_flow_are_no_steps():
    """At ``t = 1.22`` the bracket vanishes, and beyond it Newton's method finds a control of -91, whose flow leaves
    SO(3)."""
    problem = OptimalControlProblem(
        SO3,
        lambda q, u: q @ hat(jnp.stack([u[0], u[1], q[2, 0] / 2])),
        lambda q, u: u[0] ** 2 / 2 + q[2, 2] + 0.3 * q[0, 0] + 0.4 * q[2, 1] ** 2,
        2,
    )
    split = ControlAffineSplitting(problem, (1,))
    final = Submanifold(CotangentBundle(SO3), lambda z: jnp.concatenate([split.primary(*z), split.secondary(*z)]))
    guess = (
        [[0.94, -0.17, -0.28], [0.26, 0.91, 0.33], [0.2, -0.38, 0.9]],
        [[0.01, -0.06, 0.07], [-0.07, 0.17, -0.41], [0.03, 0.42, 0.17]],
    )
    z = final.nearby(tuple(jnp.array(part) for part in guess))
    arc = integrate(problem, RattleIntegrator(CotangentLift(Midpoint(Cayley(SO3))), (1,)), z, 0.05, 40, throw=False)
    assert int(arc.failed_step) == 24
    assert norm(jnp.swapaxes(arc.q, 1, 2) @ arc.q - jnp.eye(3)) < 1e-14


@pytest.mark.slow
@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_what_is_zero_is_judged_in_the_units_of_the_problem(size):
    """Costs ``size`` times as large make costates so, and the control may be in other units: the verdicts are the
    same."""
    q, p = start()
    for control in (1.0, size):
        larger, costly = (scaled(problem, (1.0, size, control)) for problem in (PROBLEM, COSTLY))
        RATTLE.check(larger, q, size * p)
        beside = size * (p + 1e-6 * SPHERE.projection(q, jnp.cross(AXIS, q)))
        with pytest.raises(NotOnManifoldError, match="phi = dH/du"):
            RATTLE.check(larger, q, beside)
        with pytest.raises(InvalidInputError, match="not affine in the controls"):
            RATTLE.check(costly, q, size * p)
