"""Maps that are no retractions: solves and integrations refuse them, however small the error in the derivative."""

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import OptimalControlProblem, SymplecticIntegrator, integrate, solve
from retrax.manifolds import Euclidean, InvalidInputError, Product, Sphere
from retrax.retractions import Addition, CotangentLift, Gauss, Midpoint, ProductRetraction, Retraction

S2 = Sphere(2)
START, END = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.6, 0.8])


class Rescaled(Retraction):
    """``x + factor v + shift x * v`` scaled to length 1."""

    manifold: Sphere
    factor: float
    shift: float = 0.0

    def retract(self, x: Array, v: Array) -> Array:
        y = x + self.factor * v + self.shift * jnp.array([0.0, 0.0, 1.0])
        return y / jnp.sqrt(y @ y)


PROBLEM = OptimalControlProblem(S2, lambda q, u: jnp.cross(u, q), lambda q, u: u @ u / 2, 3)


@pytest.mark.parametrize("error", [-1.0, -1e-2, -1e-3, 0.0, 1e-12, 1e-3, 1e-2, 1.0])
@pytest.mark.usual(2)
def test_a_derivative_that_is_not_the_identity_is_refused(error: float) -> None:
    R = Rescaled(S2, 1.0 + error)
    path = SymplecticIntegrator(CotangentLift(Midpoint(R)))
    start = START, np.array([0.0, 0.3, 0.2])
    if abs(error) < 1e-6:
        assert solve(PROBLEM, START, END, 1.0, method=Gauss(2, R), steps=10).success
        integrate(lambda q, p: p @ p / 2 + q[2], path, start, 0.1, 3)
        return
    with pytest.raises(InvalidInputError, match=r"is no retraction: at x = .*D_v R\(x, 0\) - Id is .*check_retraction"):
        solve(PROBLEM, START, END, 1.0, method=Gauss(2, R), steps=10)
    with pytest.raises(InvalidInputError, match="is no retraction"):
        integrate(lambda q, p: p @ p / 2 + q[2], path, start, 0.1, 3)


def test_a_map_that_does_not_begin_at_its_point_is_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"R\(x, 0\) is 0\.1.* away from x, expected 0"):
        solve(PROBLEM, START, END, 1.0, method=Gauss(2, Rescaled(S2, 1.0, 0.3)), steps=10)


def test_a_factor_of_a_product_is_looked_at() -> None:
    line = Euclidean(1)
    R = ProductRetraction(Rescaled(S2, 2.0), Addition(line))
    problem = OptimalControlProblem(
        Product(S2, line), lambda q, u: (jnp.cross(u[:3], q[0]), u[3:]), lambda q, u: u @ u / 2, 4
    )
    with pytest.raises(InvalidInputError, match="is no retraction"):
        solve(problem, (START, np.zeros(1)), (END, np.ones(1)), 1.0, method=Midpoint(R), steps=10)
