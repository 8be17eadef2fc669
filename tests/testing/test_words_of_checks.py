"""Words of the kit on equations, bases and generators that are wrong, and checks at given points alone."""

import re

import jax
import jax.numpy as jnp
import pytest
from retrax.manifolds import Euclidean, InvalidInputError, LevelSet, Sphere
from retrax.retractions import Projection, Retraction
from retrax.testing import check_manifold, check_retraction

from .wrong_spaces import MutantManifold

SPHERE, EAST = Sphere(2), jnp.array([0.0, 0.6, 0.8])


class Orthonormal(LevelSet):
    """Orthogonal matrices, by all entries of a symmetric equation."""

    def constraint(self, x):
        return x.T @ x - jnp.eye(len(x))


@pytest.mark.parametrize("size", [2, 3])
@pytest.mark.usual(1)
def test_equations_that_follow_from_others_are_named_without_a_traceback(size, capfd, caplog):
    named = {2: "2", 3: "3, 6, 7"}[size]
    words = f"of its values, counted from 0 row by row, {named} follow from those before"
    frames = Orthonormal(shape=(size, size))
    lost = f"rank lost by .* is {size * (size - 1) // 2}, .*; {words}"
    assert re.search(lost, frames.contains(jnp.eye(size)).reason)
    with pytest.raises(InvalidInputError, match=words):
        frames.random_point(jax.random.key(0))
    report = check_manifold(frames, throw=False)
    assert re.search(words, str(report).splitlines()[1])
    assert "Traceback" not in capfd.readouterr().err + caplog.text


def test_points_without_seeds_are_enough():
    sphere = MutantManifold(SPHERE, random_point=lambda key: 1 / 0)
    report = check_manifold(sphere, seeds=(), points=[EAST, jnp.array([0.8, 0.6, 0.0])])
    left = {outcome.check.name: outcome.words for outcome in report.outcomes if outcome.status == "not applicable"}
    assert left["random_points_spread_in_every_direction"] == "without a seed no random point is drawn"
    assert not check_retraction(
        Projection(SPHERE), seeds=(), points=[EAST], only="values_stay_on_the_manifold"
    ).failures
    with pytest.raises(InvalidInputError, match="got no seed and no point"):
        check_manifold(SPHERE, seeds=())


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_a_basis_without_its_derivative_fails_in_words(share):
    """From a basis with its whole derivative to one that is constant to JAX."""

    def basis(x):
        e = SPHERE.basis(x)
        return (1 - share) * e + share * jax.lax.stop_gradient(e)

    name = "derivative_of_the_basis_keeps_it_an_orthonormal_basis"
    report = check_manifold(MutantManifold(SPHERE, basis=basis), only=name, throw=False)
    assert bool(report.failures) == (share > 0)
    assert ("the basis is constant to JAX" in str(report)) == (share == 1)


@pytest.mark.parametrize("k", range(3))
def test_a_generator_with_a_wrong_sign_is_named(k):
    class Slipped(Sphere):
        def generators(self, x):
            xi = SPHERE.generators(x)
            return xi.at[k].set(jnp.where(jnp.arange(3) == jnp.argmax(jnp.abs(xi[k])), -1.0, 1.0) * xi[k])

    name = "generators_of_the_action_span_the_tangent_spaces"
    report = check_manifold(Slipped(2), only=name, throw=False)
    assert f"generator {k} is not tangent" in str(report)


class Stretched(Retraction):
    """``R(x, v) = x + (1 + size) v`` on the line."""

    size: float

    @property
    def manifold(self):
        return Euclidean(1)

    def retract(self, x, v):
        return x + (1 + self.size) * v


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_a_difference_that_is_divided_by_a_size_is_called_relative(size):
    """``|D_v R E - E| = size`` and ``E = 1``."""
    report = check_retraction(Stretched(size), only="derivative_at_zero_is_the_identity", throw=False)
    words = r"\|D_v R\(x, 0\) E_i - E_i\|, relative to 1 \+ the largest entry expected, is (\S+), expected at most"
    found = re.search(words, str(report))
    assert found is not None, report
    assert float(found[1]) == pytest.approx(size / 2, rel=0.01)
