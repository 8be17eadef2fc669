"""Compositions of symmetric steps: their order, and what they keep of their substeps."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from retrax.integrators import (
    KAHAN_LI_6,
    KAHAN_LI_8,
    SUZUKI,
    TRIPLE_JUMP,
    YOSHIDA_6,
    Composition,
    OptimalControlProblem,
    PresymplecticIntegrator,
    SymplecticIntegrator,
    integrate,
)
from retrax.manifolds import CotangentBundle, InvalidInputError, form_matrix, hat
from retrax.retractions import Cayley, CotangentLift, Midpoint, Projection

from tests.support.numerics import SEEDS, compiled, norm, slope

from .problems import INERTIA, SO3, SPHERE, pendulum_energy

WEIGHTS = {
    "triple jump": (TRIPLE_JUMP, 4, (16, 32, 64)),
    "Suzuki": (SUZUKI, 4, (8, 16, 32)),
    "Yoshida": (YOSHIDA_6, 6, (8, 12, 16)),
    "Kahan-Li 6": (KAHAN_LI_6, 6, (6, 8, 12)),
    "Kahan-Li 8": (KAHAN_LI_8, 8, (3, 4, 6)),
}
PENDULUM = SymplecticIntegrator(CotangentLift(Midpoint(Projection(SPHERE))))
START = jnp.array([0.6, 0.0, -0.8]), jnp.array([0.4, 0.6, 0.3])
HORIZON = 2.0


def final_state(weights, steps: int) -> np.ndarray:
    path = integrate(pendulum_energy, Composition(PENDULUM, weights), START, HORIZON / steps, steps, save_every=steps)
    return np.concatenate([path.q[-1], path.p[-1]])


@cache
def exact_state() -> np.ndarray:
    return final_state(KAHAN_LI_8, 60)


SLOW = ("triple jump", "Yoshida", "Kahan-Li 6", "Kahan-Li 8")


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in WEIGHTS])
def test_order(name):
    weights, order, counts = WEIGHTS[name]
    errors = np.array([np.max(np.abs(final_state(weights, n) - exact_state())) for n in counts])
    assert slope(1 / np.array(counts), errors, 1e-13) == pytest.approx(order, abs=0.5 if order > 4 else 0.1)


@cache
def kernel():
    bundle, integrator = CotangentBundle(SPHERE), Composition(PENDULUM)

    def facts(seed: jax.Array) -> dict:
        z0 = bundle.random_point(jax.random.key(seed))
        frame = bundle.basis(z0)

        def step(h: float, z: tuple) -> tuple:
            result = integrator.step(pendulum_energy, h, *z, integrator.begin(pendulum_energy, *z))
            return result.q, result.p

        images = jax.vmap(lambda w: jax.jvp(lambda z: step(0.1, z), (z0,), (w,))[1])(frame)
        z1 = step(0.1, z0)
        back = step(-0.1, z1)
        defect = form_matrix(bundle.two_form, z1, images) - form_matrix(bundle.two_form, z0, frame)
        return {
            "symplectic": defect,
            "back": jax.tree.map(jnp.subtract, back, z0),
            "spin": SPHERE.momentum(*z1) - SPHERE.momentum(*z0),
        }

    return compiled(facts)


@pytest.mark.slow
@given(seed=SEEDS)
def test_a_composition_is_symplectic_reversible_and_keeps_the_momentum_about_the_vertical(seed):
    facts = kernel()(seed)
    assert norm(facts["symplectic"]) < 1e-11
    assert norm(facts["back"]) < 1e-12
    assert abs(facts["spin"][2]) < 1e-13


def test_the_controls_of_all_substeps_are_kept_with_their_times():
    problem = OptimalControlProblem(SO3, lambda q, u: q @ hat(u), lambda q, u: u @ (INERTIA * u) / 2, 3)
    integrator = Composition(PresymplecticIntegrator(CotangentLift(Midpoint(Cayley(SO3)))), SUZUKI)
    mu = jnp.array([0.4, -0.7, 0.2])
    path = integrate(problem, integrator, (jnp.eye(3), SO3.covector(jnp.eye(3), mu)), 0.2, 5)
    assert path.controls.shape == (5, 5, 3)
    assert path.stage_times.shape == (5, 5)
    ends = np.cumsum(SUZUKI)
    np.testing.assert_allclose(path.stage_times[0], 0.2 * (ends - np.array(SUZUKI) / 2), atol=1e-15)
    np.testing.assert_allclose(path.stage_times[4] - path.stage_times[0], 0.8, atol=1e-14)
    # The stage controls are u = J^-1 mu of the free rigid body, whose momentum has constant length.
    sizes = np.linalg.norm(np.asarray(path.controls) * INERTIA, axis=-1)
    np.testing.assert_allclose(sizes, np.linalg.norm(mu), rtol=5e-3)


def test_weights_that_do_not_sum_to_one_are_refused():
    with pytest.raises(InvalidInputError, match=r"sum to 1, got \(0.5, 0.6\); try SUZUKI"):
        Composition(PENDULUM, (0.5, 0.6))
    with pytest.raises(InvalidInputError, match="takes an integrator, got 3"):
        Composition(3)
