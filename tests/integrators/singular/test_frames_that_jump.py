"""What ``classify`` finds does not depend on where the frames of a manifold jump."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.integrators import OptimalControlProblem, classify
from retrax.manifolds import Sphere

SPHERE = Sphere(2)


class Turned(eqx.Module):
    """A direction ``q`` that turns about two axes of a triad, at the rates 1 and u: ``q' = (e1 + u e3) x q``."""

    triad: jax.Array

    def __call__(self, q, u):
        return jnp.cross(self.triad[0] + u[0] * self.triad[2], q)


class Height(eqx.Module):
    """The cost ``(e3 . q)^2 / 2``."""

    triad: jax.Array

    def __call__(self, q, u):
        return (self.triad[2] @ q) ** 2 / 2


@pytest.mark.slow
@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-9, 1e-4, 0.3])
def test_singular_arcs_on_a_circle_on_which_the_frames_of_the_sphere_jump(angle):
    # With L = q x p the levels are e3 . L = 0, e2 . L = 0 and (e1 . L) u = (e1 . q) (e3 . q); where e1 . L is not zero
    # L . q = 0 asks for e1 . q = 0, and u = 0. For the angle 0 that circle is x = 0.
    c, s = np.cos(angle), np.sin(angle)
    triad = jnp.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    found = classify(OptimalControlProblem(SPHERE, Turned(triad), Height(triad), 1))
    assert (found.dimension, found.rank) == (2, 2)
    assert all(stratum.dimension <= 2 for stratum in found.strata)
    q, p = (np.asarray(leaf) for leaf in found.strata[0].states)
    turning = np.cross(q, p)
    np.testing.assert_allclose(turning @ triad[1:].T, 0.0, atol=1e-9)
    np.testing.assert_allclose((turning @ triad[0]) * (q @ triad[0]), 0.0, atol=1e-9)
    assert min(found.levels[1].strata, key=lambda signature: signature.codimension).codimension == 2
