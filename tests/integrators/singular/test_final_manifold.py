"""P_f as a manifold, its controls, and the Lagrangian submanifolds L_H, S_H and S_f."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, classify
from retrax.integrators.singular import L_H, S_H
from retrax.manifolds import Euclidean, InvalidInputError, NotOnManifoldError, is_lagrangian
from retrax.manifolds.numerics import ambient as vec
from retrax.retractions import Projection

from tests.integrators.singular.cases import classified, known
from tests.support.numerics import slope

CASES = ["academic", "massless particle"]


@eqx.filter_jit
def _walk(manifold, key):
    """A point, a tangent vector, and the ends of the retraction and of the straight line for several lengths."""
    x = manifold.random_point(key)
    v = manifold.random_tangent(key, x)
    retraction = Projection(manifold)
    lengths = jnp.array([0.1, 0.05, 0.025, 0.0125])
    ends = jax.vmap(lambda t: retraction(x, vec.scale(t, v)))(lengths)
    straight = jax.vmap(lambda t: vec.add(x, vec.scale(t, v)))(lengths)
    away = vec.add(x, vec.scale(0.05, vec.normal(key, manifold.ambient)))
    return (
        x,
        v,
        ends,
        vec.subtract(ends, straight),
        manifold.nearby(away),
        retraction.preimage(x, jax.tree.map(lambda a: a[0], ends)),
    )


@pytest.mark.parametrize("name", CASES)
@pytest.mark.usual("academic")
def test_the_final_manifold_has_points_tangents_and_a_retraction(name):
    manifold = classified(name).manifold
    x, v, ends, gaps, near, back = _walk(manifold, jax.random.key(5))
    assert manifold.dimension == known(name).dimension
    for point in [x, near, *(jax.tree.map(lambda a, i=i: a[i], ends) for i in range(4))]:
        verdict = manifold.contains(point, 1e-11)
        assert verdict, verdict.reason
    sizes = [max(float(np.max(np.abs(a[i]))) for a in jax.tree.leaves(gaps)) for i in range(4)]
    assert slope(np.array([0.1, 0.05, 0.025, 0.0125]), np.array(sizes), 1e-13) > 1.8
    np.testing.assert_allclose(vec.size(vec.subtract(back, vec.scale(0.1, v))), 0, atol=1e-11)


def closed_form(name: str, q, p):
    """The control on P_f as published."""
    return {"academic": lambda: p[:1] - q[:1], "aly-chan": lambda: -q[:1]}[name]()


@eqx.filter_jit
def _controls(classification, key):
    q, p = classification.manifold.random_point(key)
    gauge = jnp.full(classification.gauge_controls, 0.3)
    return q, p, classification.control(q, p, gauge), jax.jacfwd(classification.control, argnums=(0, 1))(q, p, gauge)


@pytest.mark.parametrize(("name", "derivative"), [("academic", [-1.0, 0, 1, 0]), ("aly-chan", [-1.0, 0, 0, 0])])
@pytest.mark.usual("academic-derivative0")
def test_determined_controls_are_functions_of_state_and_costate(name, derivative):
    c = classified(name)
    for seed in range(3):
        q, p, u, (by_q, by_p) = _controls(c, jax.random.key(seed))
        np.testing.assert_allclose(u[:1], closed_form(name, q, p), atol=1e-12)
        np.testing.assert_allclose(np.concatenate([by_q[0], by_p[0]]), derivative, atol=1e-12)
        np.testing.assert_array_equal(u[1:], np.full(c.gauge_controls, 0.3))


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) for name in ("academic", "massless particle", "chain of 2")]
)
def test_the_dynamics_is_lagrangian_over_the_final_manifold(name):
    c = classified(name)
    submanifold = c.dynamics
    for seed in range(2):
        y = submanifold.source.random_point(jax.random.key(seed))
        verdict = is_lagrangian(submanifold, y)
        assert verdict, verdict.reason
        assert verdict.shared == {"academic": 2, "massless particle": 0, "chain of 2": 0}[name]


@pytest.mark.parametrize("name", ["academic", "sphere"])
@pytest.mark.parametrize("made", [L_H, S_H])
@pytest.mark.usual("S_H-academic")
def test_the_necessary_conditions_are_lagrangian(name, made):
    submanifold = made(known(name).problem)
    n = known(name).problem.manifold.dimension
    y = jax.jit(submanifold.source.random_point)(jax.random.key(3))
    verdict = is_lagrangian(submanifold, y)
    assert verdict, verdict.reason
    assert verdict.dimension == 2 * n
    assert submanifold.target.manifold.contains(submanifold(y), 1e-11)


@pytest.mark.parametrize("made", [L_H, S_H])
def test_what_is_no_extremal_is_not_certified(made):
    submanifold = made(known("academic").problem)
    z, u = (jnp.ones(2), jnp.ones(2)), jnp.zeros(2)  # dH/du = (p_x - x - u1, -y) = (0, -1)
    with pytest.raises(
        NotOnManifoldError, match=r"(?s)y is not a point .* max \|equation / its gradient\| is 1, expected"
    ):
        is_lagrangian(submanifold, (z, u))
    with pytest.raises(InvalidInputError, match="expected an OptimalControlProblem, got None"):
        made(None)


@pytest.mark.slow
def test_the_necessary_conditions_of_a_dummy_control_are_not_lagrangian():
    # dH/du = 0 holds for every value of it: the critical set has one dimension too many, and H is no Morse family.
    submanifold = L_H(known("dummy control").problem)
    with pytest.raises(InvalidInputError, match="no point of Submanifold"):
        submanifold.source.random_point(jax.random.key(0))


def test_the_control_is_compiled_once():
    """Of one classification, at all points and for both kinds of gauge; a piece that is chosen compiles its own."""
    calls = []

    def cost(q, u):
        calls.append(q)
        return q @ q / 2 + q @ u + u[0] ** 2 / 2

    drift = lambda q, u: jnp.stack([jnp.sin(q[0]) + u[0], q[1]])  # noqa: E731
    found = classify(OptimalControlProblem(Euclidean(2), drift, cost, 2))
    for gauge in (None, jnp.array([0.7])):
        counts = []
        for k in range(3):
            q, p = jnp.array([0.7 + k, 0.0]), jnp.array([-0.3, 0.2 * k])
            u = found.control(q, p, gauge)
            np.testing.assert_allclose(u[0], p[0] - q[0], atol=1e-14)
            assert gauge is None or u[1] == 0.7
            counts.append(len(calls))
        assert counts[0] == counts[1] == counts[2], counts
