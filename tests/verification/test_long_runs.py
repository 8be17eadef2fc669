"""Long runs: what is conserved, and what only oscillates."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import (
    DiracIntegrator,
    DiracSystem,
    Integrator,
    OptimalControlProblem,
    Result,
    SymplecticIntegrator,
    Trajectory,
    integrate,
)
from retrax.integrators.singular.strategies import ControlAffineSplitting, RattleIntegrator
from retrax.manifolds import CotangentBundle, Euclidean, Submanifold, hat
from retrax.retractions import Addition, Cayley, CotangentLift, Euler, Midpoint, Projection

from tests.integrators.problems import SO3, SPHERE, pendulum_energy, rigid_body_energy

pytestmark = pytest.mark.usefixtures("traced_once")

STEPS = 600
MAPS = {"midpoint": Midpoint(Projection(SPHERE)), "euler": Euler(Projection(SPHERE))}
WORST = {"midpoint": 4.7e-3, "euler": 5.0e-2}

for_both_maps = pytest.mark.parametrize("name", MAPS)


@cache
def pendulum(name: str) -> Trajectory:
    """The spherical pendulum from the horizontal over 60 units of time, in steps of 1/10."""
    start = jnp.array([1.0, 0.0, 0.0]), jnp.array([0.0, 0.6, 0.3])
    return integrate(pendulum_energy, SymplecticIntegrator(CotangentLift(MAPS[name])), start, 0.1, STEPS)


def energy_errors(name: str) -> np.ndarray:
    trajectory = pendulum(name)
    energies = np.asarray(jax.vmap(pendulum_energy)(trajectory.q, trajectory.p))
    return energies - energies[0]


@for_both_maps
def test_the_pendulum_conserves_its_vertical_momentum(name):
    q, p = np.asarray(pendulum(name).q), np.asarray(pendulum(name).p)
    momentum = q[:, 0] * p[:, 1] - q[:, 1] * p[:, 0]
    assert np.max(np.abs(momentum - 0.6)) < 1e-12


@for_both_maps
def test_the_pendulum_stays_on_its_cotangent_bundle(name):
    q, p = np.asarray(pendulum(name).q), np.asarray(pendulum(name).p)
    assert np.max(np.abs(np.sum(q * q, axis=1) - 1)) < 2e-15
    assert np.max(np.abs(np.sum(q * p, axis=1))) < 2e-15


@for_both_maps
def test_the_largest_energy_error_of_the_pendulum_is_known(name):
    assert np.max(np.abs(energy_errors(name))) == pytest.approx(WORST[name], rel=0.02)


@for_both_maps
def test_the_energy_error_of_the_pendulum_does_not_drift(name):
    """A line through it gains less over the whole run than a tenth of its largest value."""
    errors = energy_errors(name)
    slope, _ = np.polyfit(np.arange(STEPS + 1), errors, 1)
    assert abs(slope) * STEPS < 0.1 * np.max(np.abs(errors))
    quarters = [np.max(np.abs(part)) for part in np.array_split(errors, 4)]
    assert max(quarters) < 1.1 * min(quarters)


@pytest.mark.slow
def test_a_free_rigid_body_after_a_million_steps():
    """Rounding adds up in the momentum alone; the energy oscillates as the step size squared, and as much in every
    quarter."""
    integrator = SymplecticIntegrator(CotangentLift(Midpoint(Cayley(SO3))))

    @partial(
        jax.jit, compiler_options={"xla_backend_optimization_level": 3, "xla_llvm_disable_expensive_passes": False}
    )
    def run(*start: Array) -> Trajectory:
        return integrate(rigid_body_energy, integrator, start, 0.05, 1_000_000, save_every=100)

    path = run(jnp.eye(3), hat(jnp.array([0.3, 1.0, -0.5])) / 2)
    assert path.result == Result.successful
    attitude, momentum = np.asarray(path.q), np.asarray(jax.vmap(SO3.spatial)(path.q, path.p))
    assert np.max(np.abs(np.swapaxes(attitude, 1, 2) @ attitude - np.eye(3))) < 1e-14
    assert np.max(np.abs(momentum - momentum[0])) < 1e-9
    energies = np.asarray(jax.vmap(rigid_body_energy)(path.q, path.p))
    spreads = [np.ptp(part) for part in np.array_split(energies, 4)]
    assert 9e-6 < max(spreads) < 1.001 * min(spreads) < 1.2e-5
    means = [np.mean(part) for part in np.array_split(energies, 4)]
    assert np.ptp(means) < 0.02 * max(spreads)


R5 = Euclidean(5)


def quartic_energy(q: jax.Array, p: jax.Array) -> jax.Array:
    """Of ``q = (x, y, z)`` with ``y``, ``z`` in the plane [McLachlan, Perlmutter, J. Nonlinear Sci. 16, 2006]."""
    y, z = q[1:3], q[3:]
    return p @ p / 2 + (q @ q + z[0] ** 2 * z[1] ** 2 + y**2 @ z**2) / 2


# x' + y . z' = 0
QUARTIC = DiracSystem(R5, quartic_energy, lambda q: jnp.concatenate([jnp.array([1.0, 0.0, 0.0]), q[1:3]])[None])


def spread_of_the_energy(integrator: Integrator, system: object) -> tuple[float, float]:
    """How much more the energy changes over half a run of 8000 steps than over an eighth of it.

    The logarithm of the ratio of the root mean squares over all such spans of the run: its mean over 32 starts, and the
    standard error of that mean. Zero for a bounded error that has forgotten its start after an eighth of the run, log 2
    for a random walk.
    """
    q = 1.5 * jax.random.normal(jax.random.key(0), (32, 5))
    p = jax.vmap(QUARTIC.project)(q, 1.5 * jax.random.normal(jax.random.key(1), (32, 5)))

    @jax.jit
    @jax.vmap
    def energies(q: jax.Array, p: jax.Array) -> jax.Array:
        path = integrate(system, integrator, (q, p), 0.1, 8000, save_every=20)
        return jax.vmap(quartic_energy)(path.q, path.p)

    found = np.asarray(energies(q, p))
    change = [np.mean((found[:, span:] - found[:, :-span]) ** 2, axis=1) for span in (50, 200)]
    spread = np.log(change[1] / change[0]) / 2
    return float(np.mean(spread)), float(np.std(spread, ddof=1) / np.sqrt(len(spread)))


@pytest.mark.slow
def test_a_nonholonomic_constraint_lets_the_energy_of_chaotic_motion_wander():
    """Reversible and symmetric as the method is; without the constraint the same method, then symplectic, does not.

    Over six draws of the starts the means were -0.4 to 1.6 standard errors without the constraint, and 6.2 to 8.0 with
    it.
    """
    lift = CotangentLift(Midpoint(Addition(R5)))
    mean, error = spread_of_the_energy(SymplecticIntegrator(lift), quartic_energy)
    assert abs(mean) < 4 * error
    assert error < 0.1
    mean, error = spread_of_the_energy(DiracIntegrator(lift), QUARTIC)
    assert mean > 4 * error


def curved_drift(q: Array, u: Array) -> Array:
    """A bounded motion on a curved final manifold, the control along a field that is not constant."""
    free = jnp.stack([0.2 * q[1], 0.8 * q[0] + 0.2 * q[0] ** 2 - 0.1 * q[0] * q[1], 0.3 * q[0]])
    return free + u[0] * jnp.stack([jnp.ones(()), 0.6 * q[0], 0.4 * q[1]])


def curved_cost(q: Array, u: Array) -> Array:
    """Without a cost of control."""
    return q[0] ** 2 / 2 + q[0] ** 4 / 8 - q[1] ** 2 / 2 - q[1] ** 4 / 10 + q[0] * q[1] / 10


@pytest.mark.slow
def test_rattle_stays_on_a_curved_final_manifold_and_its_energy_does_not_drift():
    """From this start in steps of 1/10 an independent program finds errors up to 1.08e-5 in every quarter of 1000
    steps.

    They are largest once a period, of some 70 steps, so a hundred times as many steps find the same. The third
    coordinate, which the equations do not contain, comes to -176; a start far along it changes nothing but the
    precision of times.
    """
    space = Euclidean(3)
    problem = OptimalControlProblem(space, curved_drift, curved_cost, 1)
    split = ControlAffineSplitting(problem, (0,))

    def equations(z: tuple[Array, Array]) -> Array:
        return jnp.concatenate([split.primary(*z), split.secondary(*z)])

    guess = 0.45 * jnp.array([0.3, 0.5, -0.4]), 0.45 * jnp.array([0.1, 0.6, -0.5])
    start = Submanifold(CotangentBundle(space), equations).nearby(guess)
    rattle = RattleIntegrator(CotangentLift(Midpoint(Addition(space))), (0,))
    paths = [
        integrate(problem, rattle, (start[0].at[2].add(-offset), start[1]), 0.1, steps, save_every=10)
        for offset, steps in ((0.0, 100_000), (1.0, 1000), (1e3, 1000), (1e6, 1000))
    ]
    for path in paths:
        primary, secondary = np.abs(np.asarray(jax.vmap(lambda q, p: equations((q, p)))(path.q, path.p))).T
        assert np.max(primary) < 2e-15
        assert np.max(secondary / np.max(np.abs(path.q), axis=1)) < 1e-14
    energies = np.asarray(jax.vmap(split.energy)(paths[0].q, paths[0].p))
    errors = energies - energies[0]
    quarters = [np.max(np.abs(part)) for part in np.array_split(errors, 4)]
    np.testing.assert_allclose(quarters, 1.08e-5, rtol=5e-3)
    means = [np.mean(part) for part in np.array_split(errors, 50)]
    (drift, _), covariance = np.polyfit(np.arange(50.0), means, 1, cov=True)
    assert abs(drift) < 2 * np.sqrt(covariance[0, 0])
