"""Motions on matrix Lie groups: conserved spatial momenta, a covering of groups, optima with complex entries."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Solver, SymplecticIntegrator, integrate, solve
from retrax.manifolds import SE, SO, SU, ComplexStiefel, LeftInvariantMetric, Sphere
from retrax.retractions import Cayley, CotangentLift, Exponential, Midpoint

INERTIA = jnp.array([1.0, 2.0, 3.0])


def free_motion(group, retraction, inertia, mu, steps=20):
    """A trajectory of the geodesics of a left-invariant metric from the identity, with body covector ``mu``."""
    metric = LeftInvariantMetric(group, inertia)
    start = group.identity, group.covector(group.identity, jnp.asarray(mu))
    return integrate(
        metric.kinetic_energy, SymplecticIntegrator(CotangentLift(Midpoint(retraction))), start, 0.05, steps
    )


def check_momenta(group, motion):
    """Spatial momenta are constant, body momenta are not, and the motion stays on the group."""
    spatial, body = jax.jit(jax.vmap(lambda q, p: (group.spatial(q, p), group.body(q, p))))(motion.q, motion.p)
    np.testing.assert_allclose(spatial, np.broadcast_to(spatial[0], spatial.shape), atol=1e-12)
    assert np.max(np.ptp(body, axis=0)) > 1e-2
    assert group.contains(motion.q[-1], 1e-13)


def test_spatial_momenta_of_left_invariant_hamiltonians_are_conserved():
    # A body in a fluid: inertia that couples turning and shifting.
    group = SE(3)
    inertia = jnp.eye(6) + 0.3 * jnp.cos(jnp.add.outer(jnp.arange(6), jnp.arange(6)))
    motion = free_motion(group, Cayley(group), inertia, np.random.default_rng(1).standard_normal(6))
    check_momenta(group, motion)


@pytest.mark.slow
def test_the_covering_of_rotations_by_unit_quaternions_takes_motions_to_motions():
    mu = [1.0, -0.5, 0.7]
    above, below = (free_motion(group, Exponential(group), INERTIA, mu) for group in (SU(2), SO(3)))
    check_momenta(SU(2), above)
    np.testing.assert_allclose(jax.vmap(SU(2).Ad)(above.q), below.q, atol=1e-12)
    body = jax.vmap(SU(2).body)(above.q, above.p)
    np.testing.assert_allclose(body, jax.vmap(SO(3).body)(below.q, below.p), atol=1e-12)
    assert np.max(np.abs(below.q[-1] - below.q[0])) > 0.3


@pytest.mark.slow
def test_the_cheapest_turn_of_a_spin_is_a_one_parameter_subgroup():
    # x' = x hat(u), cost |u|^2 / 2 over time 2: u is constant, x(t) = exp(t hat(u)), the cost |w|^2 / 4 with x(2) =
    # exp(hat(w)).
    group, w = SU(2), jnp.array([0.5, -1.0, 0.8])
    problem = OptimalControlProblem(group, lambda x, u: x @ group.hat(u), lambda x, u: u @ u / 2, controls=3)
    end = Exponential(group)(group.identity, group.hat(w))
    solution = solve(problem, group.identity, end, horizon=2.0, method=Midpoint(Exponential(group)), steps=4)
    assert solution.success
    np.testing.assert_allclose(solution.cost, w @ w / 4, rtol=1e-12)
    np.testing.assert_allclose(solution.controls, np.broadcast_to(w / 2, (4, 3)), atol=1e-10)
    (body,) = solution.body_costates.values()
    np.testing.assert_allclose(body, np.broadcast_to(w / 2, (5, 3)), atol=1e-10)


def qubit(manifold, act):
    """Least energy of two fields that turn a qubit which precesses about the third axis at a rate ``d``."""
    x, y, z = -0.5j * np.array([[[0, 1], [1, 0]], [[0, -1j], [1j, 0]], [[1, 0], [0, -1]]])
    first, second, drift = map(act, (x, y, z))
    return OptimalControlProblem(
        manifold,
        lambda q, u, d: (u[0] * first + u[1] * second + d * drift) @ q,
        lambda q, u, d: u @ u / 2,
        controls=2,
    )


@pytest.mark.slow
def test_states_of_a_qubit_are_complex_frames_or_points_of_a_sphere():
    """From the first state to a superposition with a phase, at rates of precession through resonance."""
    pairs = [
        (ComplexStiefel(2, 1), lambda a: a, lambda q: q[:, None]),
        (Sphere(3), lambda a: np.block([[a.real, -a.imag], [a.imag, a.real]]), lambda q: np.r_[q.real, q.imag]),
    ]
    start, end = np.array([1.0, 0j]), np.exp(0.3j) * np.array([0.6, 0.8j])
    solvers = [Solver(qubit(manifold, act), Midpoint(Exponential(manifold)), 20) for manifold, act, _ in pairs]
    for d in (-1.0, 0.0, 0.5, 2.0):
        frame, point = (
            solver.solve(write(start), write(end), 3.0, parameters=d)
            for solver, (_, _, write) in zip(solvers, pairs, strict=True)
        )
        assert frame.success
        assert point.success
        np.testing.assert_allclose(frame.cost, point.cost, rtol=1e-10)
        np.testing.assert_allclose(frame.controls, point.controls, atol=1e-10)
        states = frame.states[..., 0]
        np.testing.assert_allclose(np.concatenate([states.real, states.imag], axis=1), point.states, atol=1e-10)
