"""Pieces of ``P_f`` of equal ranks: that they are found, and told apart."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import OptimalControlProblem, classify
from retrax.manifolds import Euclidean


@pytest.mark.slow
def test_pieces_of_equal_ranks_that_cross_are_told_apart():
    """``x' = u1``, ``y' = u2``, cost ``x y u3``: ``p = 0`` and ``x y = 0``; ``u2`` is free on ``x = 0``, ``u1`` on ``y
    = 0``."""
    problem = OptimalControlProblem(Euclidean(2), lambda q, u: u[:2], lambda q, u: q[0] * q[1] * u[2], 3)
    seen = set()
    for seed in (0, 1, 4):
        c = classify(problem, seed=seed)
        lines = [s for s in c.strata if s.codimension == 3]
        assert c.stratified
        assert len({s.feedback.pivots.free for s in lines}) == len(lines), str(c)
        seen |= {s.feedback.pivots.free for s in lines}
        for i, s in enumerate(lines):
            (free,) = s.feedback.pivots.free
            assert (s.k_f, s.k_f_base, s.free_controls, s.equations.names) == (1, 0, 1, ("primary",) * 3), str(c)
            assert abs(s.q[free]) > 1e-3 > abs(s.q[1 - free]), "the point is on one of the pieces alone"
            control = c.choose(i).control(jnp.eye(2)[free], jnp.zeros(2), jnp.array([0.7]))
            np.testing.assert_allclose(control, 0.7 * np.eye(3)[free], atol=1e-12)
        # What is left is the crossing itself, where u1 = u2 = 0 and u3 is free.
        assert all(s.codimension == 4 and s.feedback.pivots.free == (2,) for s in c.strata if s not in lines)
    assert seen == {(0,), (1,)}


def test_flat_pieces_are_told_apart_by_their_tangent_spaces():
    """``q' = 0``, cost ``x y u``: ``x = 0`` and ``y = 0`` have equal ranks and controls; a circle is one piece."""
    found = {}
    for name, function in (("lines", lambda q: q[0] * q[1]), ("circle", lambda q: q @ q - 1)):
        problem = OptimalControlProblem(Euclidean(2), lambda q, u: 0 * q, lambda q, u, f=function: f(q) * u[0], 1)
        found[name] = classify(problem)
    assert [s.codimension for s in found["lines"].strata] == [1, 1]
    for stratum in found["lines"].strata:
        assert np.max(np.abs(stratum.states[0][:, np.argmin(np.abs(stratum.q))])) < 1e-9
    assert "[1] point" in str(found["lines"])
    assert not found["circle"].stratified


class Crossing(eqx.Module):
    """``x^2 y^2 (1 + share (y - 1)) / 2``."""

    share: Array

    def __call__(self, q, u):
        return (q[0] * q[1]) ** 2 * (1 + self.share * (q[1] - 1)) / 2


@pytest.mark.slow
def test_curved_pieces_are_told_apart_by_directions_that_they_have_in_common():
    """``q' = 0``, cost ``(w - z^2) u1 + x y u2``: two parabolic cylinders, in ``x = 0`` and in ``y = 0``."""
    problem = OptimalControlProblem(
        Euclidean(4), lambda q, u: 0 * q, lambda q, u: (q[3] - q[2] ** 2) * u[0] + q[0] * q[1] * u[1], 2
    )
    for seed in range(3):
        c = classify(problem, seed=seed)
        assert [s.codimension for s in c.strata] == [2, 2]
        assert [s.dimension for s in c.strata] == [2 * c.problem.manifold.dimension - 2] * 2
        across = [int(np.argmin(np.abs(s.q[:2]))) for s in c.strata]
        assert set(across) == {0, 1}
        for piece, i in zip(c.strata, across, strict=True):
            assert np.max(np.abs(piece.states[0][:, i])) < 1e-9
            assert not piece.flat
    assert ("curved pieces of equal ranks" in str(c)) == c.irregular


@pytest.mark.slow
def test_pieces_are_found_where_the_steps_of_newton_go_to_their_crossing():
    """``q' = u``, cost ``x^2 y^2/2``: ``x = 0`` and ``y = 0``, of equal ranks; and ``x^2 y^3/2``, irregular on ``y =
    0``."""
    problem, half = (OptimalControlProblem(Euclidean(2), lambda q, u: u, Crossing(jnp.array(a)), 2) for a in (0.0, 1.0))
    for seed in range(3):
        c = classify(problem, seed=seed)
        assert [s.signature for s in c.strata] == [(3, 1, 0)] * 2
        assert {s.feedback.pivots.free for s in c.strata} == {(0,), (1,)}
        assert not c.sparse
    c = classify(half)
    assert c.sparse
    assert c.gauge_components == (1,)
    assert f"{max(level.missing for level in c.levels)} of 20 points, which were not found" in str(c)
