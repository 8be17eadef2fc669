"""The QR factorisation of matrices that have nothing below their diagonal, as at the centre of a retraction."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, Solver
from retrax.manifolds import Stiefel
from retrax.retractions import Cayley, Midpoint
from retrax.tape import Tape

RANDOM = np.random.default_rng(0)
MATRICES = {
    "identity": np.eye(4)[:, :2],
    "negative": -np.eye(3)[:, :2],
    "triangular": np.triu(RANDOM.normal(size=(3, 3))),
    "tall": np.vstack([np.triu(RANDOM.normal(size=(2, 2))), np.zeros((3, 2))]),
    "a column": np.array([[2.0], [0.0], [0.0]]),
    "next to nothing below": np.array([[1.0, 0.3], [1e-200, 0.2], [0.0, 0.5]]),
    "nothing in one column": np.array([[1.0, 0.3], [0.0, 0.2], [0.0, 0.5]]),
}


@pytest.mark.parametrize("name", MATRICES)
def test_factors_of_triangular_matrices_have_their_derivatives(name):
    matrix = MATRICES[name]
    weights = np.arange(1.0, 1 + matrix.size).reshape(matrix.shape)

    def number(x):
        q, r = jnp.linalg.qr(x)
        return jnp.sum(jnp.sin(q * weights)) + jnp.sum(r**3)

    by_xla = jax.jit(lambda x: (jnp.linalg.qr(x), jax.jacfwd(jnp.linalg.qr)(x), jax.hessian(number)(x)))
    factors, slopes, curvature = by_xla(matrix)
    tape = Tape.trace(jnp.linalg.qr, matrix)
    for found, expected in zip(tape(matrix[..., None]), factors, strict=True):
        np.testing.assert_allclose(found[..., 0], expected, atol=1e-15)
    slope = np.concatenate([np.reshape(j, (-1, matrix.size)) for j in slopes])
    np.testing.assert_allclose(tape.jacobian()(matrix[..., None])[..., 0], slope, rtol=1e-12, atol=1e-12)
    found = Tape.trace(number, matrix).hessian()(matrix[..., None])[..., 0]
    np.testing.assert_allclose(found, np.reshape(curvature, found.shape), rtol=1e-11, atol=1e-11)


@pytest.mark.long("4-2")
@pytest.mark.parametrize(("n", "p"), [(3, 1), (4, 2)])
def test_a_way_on_a_stiefel_manifold_by_the_cayley_map(n, p):
    """The guess rests at the centres of its steps."""
    manifold = Stiefel(n, p)
    problem = OptimalControlProblem(
        manifold, lambda q, u: manifold.projection(q, u.reshape(n, p)), lambda q, u: u @ u / 2, controls=n * p
    )
    start, end = (np.asarray(manifold.random_point(jax.random.key(k))) for k in (0, 1))
    found = [
        Solver(problem, Midpoint(Cayley(manifold)), 10, evaluator=evaluator).solve(start, end, 1.0)
        for evaluator in ("tape", "xla")
    ]
    assert found[0].cost == pytest.approx(found[1].cost, rel=1e-10)
    np.testing.assert_allclose(found[0].states, found[1].states, atol=1e-9)
