"""RATTLE on the final constraint manifold of a singular problem on the sphere, beside a projection method.

The manifold ``P_f = {phi = 0, psi = 0}`` in ``T*S^2`` is curved, so that a method can fail on it: the projection must.
"""

from collections.abc import Callable
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import Composition, OptimalControlProblem, SymplecticIntegrator, integrate
from retrax.integrators.singular import ControlAffineSplitting, RattleIntegrator, leaf_flow
from retrax.manifolds import CotangentBundle, Euclidean, InvalidInputError, NotOnManifoldError
from retrax.manifolds.numerics import ambient as vec
from retrax.manifolds.numerics.rank import null_space
from retrax.retractions import Addition, CotangentLift, Midpoint, Projection

from tests.integrators.problems import SPHERE
from tests.support.numerics import slope

BUNDLE, LIFT = CotangentBundle(SPHERE), CotangentLift(Midpoint(Projection(SPHERE)))
AXIS = jnp.array([0.0, 0.0, 1.0])


def turned(q: Array, u: Array) -> Array:
    """A drift, and a control that turns the sphere about the vertical."""
    return SPHERE.projection(q, jnp.array([0.1 * q[2], 0.15 * q[0] * q[1], q[1] + 0.1 * q[0]])) + u[0] * jnp.cross(AXIS, q)


def height_cost(q: Array, u: Array) -> Array:
    """Without a cost of control."""
    return 2 * q[0] - 2 * q[2] ** 2 + 0.2 * q[0] * q[2] + 0.1 * q[1]


PROBLEM = OptimalControlProblem(SPHERE, turned, height_cost, 1)
SPLIT = ControlAffineSplitting(PROBLEM, (0,))
RATTLE = RattleIntegrator(LIFT, (0,))
STEPS = np.array([0.2, 0.1, 0.05])


def constraints(q: Array, p: Array) -> Array:
    return jnp.concatenate([SPLIT.primary(q, p), SPLIT.secondary(q, p)])


def nearest(z: tuple, steps: int) -> tuple:
    """Gauss-Newton steps of least length to ``P_f``."""

    def residual(c: Array, z: tuple) -> Array:
        return constraints(*BUNDLE.restore(vec.add(z, vec.combine(BUNDLE.basis(z), c))))

    def move(_: int, z: tuple) -> tuple:
        jacobian = jax.jacfwd(residual)(jnp.zeros(4), z)
        shortest = -jacobian.T @ jnp.linalg.solve(jacobian @ jacobian.T, residual(jnp.zeros(4), z))
        return BUNDLE.restore(vec.add(z, vec.combine(BUNDLE.basis(z), shortest)))

    return jax.lax.fori_loop(0, steps, move, z)


@cache
def start() -> tuple:
    z = BUNDLE.restore((jnp.array([-0.93, 0.09, 0.3557]), jnp.array([0.11, -0.01, 0.295])))
    return jax.jit(lambda z: nearest(BUNDLE.restore(z), 8))(z)


def rattled(h: Array, z: tuple) -> tuple:
    new = RATTLE.step(PROBLEM, h, *z, RATTLE.begin(PROBLEM, *z))
    return new.q, new.p


def total_energy(q: Array, p: Array) -> Array:
    """``H_0 + u phi`` with the control ``u(q, p)`` that keeps ``psi = 0`` on ``P_f``."""
    _, across = SPLIT.brackets((q, p))
    motion = BUNDLE.sharp((q, p), jax.grad(lambda z: SPLIT.energy(*z))((q, p)))
    u = jnp.linalg.solve(across.T, jax.jvp(SPLIT.secondary, (q, p), motion)[1])
    return SPLIT.energy(q, p) + u @ SPLIT.primary(q, p)


def projected(h: Array, z: tuple) -> tuple:
    """A symplectic step of order 2 of the whole motion, moved to the nearest point of ``P_f``."""
    free = SymplecticIntegrator(LIFT)
    new = free.step(total_energy, h, *z, free.begin(None, *z))
    return nearest((new.q, new.p), 6)


@cache
def kernel(step: Callable) -> Callable:
    """The image of a step from ``z``, its derivative along a basis of ``T_zP_f``, and the constraints' derivatives there."""

    def facts(h: Array, z: tuple, frame: tuple) -> tuple:
        z1 = step(h, z)
        push = jax.vmap(lambda a: jax.jvp(lambda y: step(h, y), (z,), (a,))[1])(frame)
        return z1, push, constraints(*z1)

    return jax.jit(facts)


@cache
def tangents() -> tuple:
    """A basis of the tangent space of ``P_f`` at the start."""
    z, frame = start(), BUNDLE.basis(start())
    normals = jax.vmap(lambda a: jax.jvp(constraints, z, a)[1])(frame)
    return vec.combine_each(frame, jnp.asarray(null_space(np.asarray(normals.T)).T))


def defect(step: Callable, h: float) -> tuple[float, float]:
    """Change of ``omega_f`` over one step, and how far the image is from ``P_f``."""
    z, frame = start(), tangents()
    z1, push, gap = kernel(step)(h, z, frame)
    before, after = (
        float(BUNDLE.two_form(x, *(jax.tree.map(lambda leaf, i=i: leaf[i], f) for i in (0, 1))))
        for x, f in ((z, frame), (z1, push))
    )
    assert abs(before) > 0.1
    return abs(after - before), float(np.max(np.abs(gap)))


@pytest.mark.slow
def test_rattle_keeps_the_final_manifold_and_its_form():
    for h in STEPS:
        change, gap = defect(rattled, h)
        assert gap < 1e-14
        assert change < 1e-13


@pytest.mark.slow
def test_a_projection_method_keeps_the_manifold_but_not_its_form():
    changes, gaps = zip(*(defect(projected, h) for h in STEPS / 2), strict=True)
    assert max(gaps) < 1e-13
    assert slope(STEPS / 2, np.array(changes), 1e-13) == pytest.approx(3, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(("integrator", "order"), [(RATTLE, 2), (Composition(RATTLE), 4)])
def test_order(integrator, order):
    counts = np.array([10, 20, 40, 160])
    ends = []
    for n in counts:
        path = integrate(PROBLEM, integrator, start(), 1.0 / n, int(n), save_every=int(n))
        ends.append(np.concatenate([path.q[-1], path.p[-1]]))
    errors = np.array([np.max(np.abs(end - ends[-1])) for end in ends[:-1]])
    assert slope(1 / counts[:-1], errors, 1e-13) == pytest.approx(order, abs=0.05)


@pytest.mark.slow
def test_a_long_run_stays_on_the_final_manifold_and_its_energy_does_not_drift():
    path = integrate(PROBLEM, RATTLE, start(), 0.1, 2400, save_every=4)
    energies = np.asarray(jax.vmap(SPLIT.energy)(path.q, path.p))
    errors = np.max(np.abs(energies - energies[0])[1:].reshape(4, -1), axis=1)
    assert np.max(np.abs(jax.vmap(constraints)(path.q, path.p))) < 1e-13
    assert np.ptp(errors) < 0.02 * np.max(errors) < 2e-6
    # On the arc the control is known: psi' = {psi, H_0} + u {psi, phi} = 0.
    assert np.all(np.isfinite(path.controls))


def test_moving_along_a_leaf_keeps_the_level_and_composes():
    z = start()
    flow = jax.jit(lambda z, t: leaf_flow(SPHERE, SPLIT.primary, z, t))
    there = flow(flow(z, jnp.array([0.1])), jnp.array([0.05]))
    at_once = flow(z, jnp.array([0.15]))
    np.testing.assert_allclose(there, at_once, atol=1e-14)
    # phi = <p, e3 x q>: its flow turns both about the vertical.
    c, s = np.cos(0.15), np.sin(0.15)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(at_once, (turn @ z[0], turn @ z[1]), atol=1e-14)


def test_bad_input_is_refused_with_the_reason():
    z = start()
    with pytest.raises(NotOnManifoldError, match="phi = dH/du"):
        integrate(PROBLEM, RATTLE, (z[0], z[1] + SPHERE.projection(z[0], AXIS) + 0.1 * jnp.cross(AXIS, z[0])), 0.1, 1)
    costly = OptimalControlProblem(SPHERE, turned, lambda q, u: height_cost(q, u) + u @ u, 1)
    with pytest.raises(InvalidInputError, match="not affine in the controls"):
        integrate(costly, RATTLE, z, 0.1, 1)
    with pytest.raises(InvalidInputError, match="name controls by their indices"):
        integrate(PROBLEM, RattleIntegrator(LIFT, (1,)), z, 0.1, 1)
    chain = OptimalControlProblem(Euclidean(2), lambda q, u: jnp.stack([q[1], u[0]]), lambda q, u: q[0] ** 2 / 2, 1)
    higher = RattleIntegrator(CotangentLift(Midpoint(Addition(Euclidean(2)))), (0,))
    with pytest.raises(InvalidInputError, match="higher order"):
        integrate(chain, higher, (jnp.zeros(2), jnp.zeros(2)), 0.1, 1)
