"""Gauss methods: their tableaus, their ends and points, one stage as the midpoint map, wrong arguments."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.manifolds import SE, SO, Euclidean, InvalidInputError, Sphere, Stiefel
from retrax.manifolds.numerics import ambient as vec
from retrax.retractions import Addition, Cayley, Exponential, Gauss, Midpoint, Projection, Retraction

from tests.support.numerics import compiled, norm

STAGES = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20)
EPS = np.finfo(float).eps
RETRACTIONS: dict[str, Retraction] = {
    "Cayley's on SO(3)": Cayley(SO(3)),
    "the projection of S^2": Projection(Sphere(2)),
    "the exponential of SO(3) x R^3": Exponential(SO(3) * Euclidean(3)),
    "Cayley's on SE(3)": Cayley(SE(3)),
    "R^2": Addition(Euclidean(2)),
    "Cayley's on St(4, 2)": Cayley(Stiefel(4, 2)),
}


def gauss(stages: int) -> Gauss:
    return Gauss(stages, Addition(Euclidean(2)))


def legendre_values(x: np.ndarray, degree: int) -> np.ndarray:
    """Legendre's polynomials at ``x``, by Bonnet's recursion in the extended precision that the machine has."""
    values = [np.ones_like(x), x]
    for k in range(1, degree):
        values.append(((2 * k + 1) * x * values[k] - k * values[k - 1]) / (k + 1))
    return np.stack(values[: degree + 1])


@pytest.mark.parametrize("stages", STAGES)
def test_the_tableau_integrates_legendres_polynomials_exactly(stages):
    """``sum b_j P_k(c_j) = 0`` for ``0 < k < 2 s``, ``sum a_ij P_k(c_j) = int_0^c_i P_k`` for ``k < s``:
    definitions."""
    method = gauss(stages)
    x = 2 * method.nodes.astype(np.longdouble) - 1
    values = legendre_values(x, 2 * stages)
    np.testing.assert_allclose(values[1:-1] @ method.weights, 0, atol=8 * EPS)
    assert np.sum(method.weights) == pytest.approx(1, abs=4 * EPS)
    integrals = [(1 + x) / 2, *((values[k + 1] - values[k - 1]) / (2 * (2 * k + 1)) for k in range(1, stages))]
    np.testing.assert_allclose(method.matrix @ values[:stages].T, np.stack(integrals, 1).astype(float), atol=8 * EPS)


@pytest.mark.parametrize("stages", STAGES)
def test_the_tableau_is_symmetric_and_symplectic(stages):
    method = gauss(stages)
    b, c, a, centred = method.weights, method.nodes, method.matrix, method.centred
    assert np.all(np.diff(c) > 0)
    assert np.all(b > 0)
    np.testing.assert_allclose(c + c[::-1], 1, atol=EPS)
    np.testing.assert_allclose(centred, -centred[::-1, ::-1], atol=EPS)
    np.testing.assert_allclose(b[:, None] * centred, -(b[:, None] * centred).T, atol=EPS)
    np.testing.assert_allclose(a - centred, np.tile(b / 2, (stages, 1)), atol=EPS)
    assert method.order == 2 * stages
    assert method.theta == 0.5


def test_the_methods_of_one_two_and_three_stages_are_those_of_the_books():
    """[Hairer, Lubich, Wanner 2006, table II.1.1]."""
    assert np.all(gauss(1).matrix == 0.5)
    assert np.all(gauss(1).centred == 0)
    r = np.sqrt(3) / 6
    np.testing.assert_allclose(gauss(2).matrix, [[1 / 4, 1 / 4 - r], [1 / 4 + r, 1 / 4]], atol=EPS)
    s = np.sqrt(15)
    three = [
        [5 / 36, 2 / 9 - s / 15, 5 / 36 - s / 30],
        [5 / 36 + s / 24, 2 / 9, 5 / 36 - s / 24],
        [5 / 36 + s / 30, 2 / 9 + s / 15, 5 / 36],
    ]
    np.testing.assert_allclose(gauss(3).matrix, three, atol=EPS)
    np.testing.assert_allclose(gauss(3).nodes, [1 / 2 - s / 10, 1 / 2, 1 / 2 + s / 10], atol=EPS)


def test_the_arrays_of_a_tableau_cannot_be_written_to():
    with pytest.raises(ValueError, match="read-only"):
        gauss(3).weights[0] = 1


@cache
def kernel(name: str):
    """What is left of the facts of a method at random points: one compiled function for each manifold."""
    retraction = RETRACTIONS[name]
    manifold, method = retraction.manifold, Gauss(1, retraction)

    def facts(seed: jax.Array) -> dict:
        point, *keys = jax.random.split(jax.random.key(seed), 3)
        x, (eta, nu) = manifold.random_point(point), (0.4 * jax.random.normal(k, (manifold.dimension,)) for k in keys)
        frame, basis = method.frame(x), manifold.basis(x)
        q, v = method.velocity(x, frame, eta, nu)
        centre, still = method.velocity(x, frame, 0 * eta, nu)
        dt = 1e-4
        after, before = (method.point(x, frame, eta + t * nu) for t in (dt, -dt))
        displaced = Midpoint(retraction)(x, vec.combine(basis, eta))
        return {
            "ends of the midpoint map": vec.subtract(method.ends(x, frame, eta), displaced),
            "point": vec.subtract(q, retraction(x, vec.combine(basis, eta))),
            "centre": vec.subtract(centre, x),
            "velocity at the centre": vec.subtract(still, vec.combine(basis, nu)),
            "tangent": vec.subtract(v, manifold.projection(q, v)),
            "difference": vec.subtract(v, vec.scale(1 / (2 * dt), vec.subtract(after, before))),
        }

    return compiled(facts)


@pytest.mark.parametrize("name", RETRACTIONS)
@pytest.mark.usual("Cayley's on SO(3)", "the projection of S^2")
def test_one_stage_is_the_midpoint_map_and_velocities_are_derivatives(name, seeds):
    for seed in seeds:
        facts = kernel(name)(seed)
        assert norm(facts.pop("difference")) < 1e-7  # of a central difference
        assert norm(facts) < 1e-14, facts


@pytest.mark.parametrize("stages", [0, -1, 1.0, True, "3", None, (2,)])
def test_a_number_of_stages_that_is_none_is_refused(stages):
    with pytest.raises(InvalidInputError, match=r"whole number of at least 1, got .*; try Gauss\(3, R\)"):
        gauss(stages)


@pytest.mark.parametrize("given", [Sphere(2), Exponential, Midpoint(Cayley(SO(3))), None])
def test_a_method_of_something_else_than_a_retraction_is_refused(given):
    with pytest.raises(
        InvalidInputError, match=r"made from a retraction, got .*; try Gauss\(2, default_retraction\(manifold\)\)"
    ):
        Gauss(2, given)


def test_a_method_is_data_that_compares_by_its_stages():
    assert gauss(np.int64(2)) == gauss(2)
    assert gauss(2) != gauss(3)
    doubled = jax.jit(lambda method, eta: method.point(jnp.zeros(2), None, eta))(gauss(2), jnp.ones(2))
    np.testing.assert_array_equal(doubled, np.ones(2))
