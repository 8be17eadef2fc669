"""Pieces of ``P_f``, of unlike ranks and of equal ones: that they are found, told apart and chosen."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from retrax.integrators import OptimalControlProblem, classify
from retrax.integrators.singular.integrability.random_points import random_starts
from retrax.manifolds import SO, Euclidean, InvalidInputError, hat

from tests.integrators.singular.cases import martinet

REST, LINES = (2, 0, 4), (3, 1, 2)
ON_A_LINE = jnp.zeros(3), jnp.array([0.0, 0.0, 1.0])


@pytest.mark.slow
@pytest.mark.parametrize(("bend", "seeds"), [(0.0, [0]), (0.0, [1, 2]), (0.5, [0, 1, 2])])
def test_abnormal_extremals_of_the_martinet_distribution(bend, seeds):
    # H = p1 u1 + (p2 + p3 x^2 / 2) u2 / (1 + bend x).
    for seed in seeds:
        c = classify(martinet(bend), seed=seed)
        assert c.zero_costate_excluded
        assert [s.signature for s in c.strata] == [REST, LINES], str(c)
        assert c.irregular, "some starts come to where the pieces cross"
        assert "of them where equations are irregular, as where pieces cross: not counted" in " ".join(str(c).split())
        rest, lines = c.strata
        assert np.max(np.abs(rest.u)) < 1e-7
        assert np.max(np.abs([lines.q[0], lines.u[0], *lines.p[:2]])) < 1e-12
        np.testing.assert_allclose(np.abs(np.concatenate(lines.kernel, axis=1)), [[0, 1, 0, 0, 0, 0]], atol=1e-12)
        assert min(level.gap for level in c.levels) > 1e6
    for words in ("abnormal (p_0 = 0)", "strata           2: P_f is not one manifold", "[1] P_f          dimension 3"):
        assert words in str(c)


@pytest.mark.parametrize("bend", [0.0, pytest.param(0.5, marks=pytest.mark.slow)])
def test_a_piece_is_looked_for_near_a_state(bend):
    c = classify(martinet(bend), near=ON_A_LINE)
    lines = next(s for s in c.strata if s.signature == LINES)
    assert lines.count >= 3
    assert np.max(np.abs(lines.states[0])) < 0.5
    # The starts are the state and points around it, in the state by about 1/10 and in the costate by about |p|/10.
    away = jnp.array([3.0, 0.0, 0.0]), jnp.array([0.0, -45.0, 10.0])
    q, p = random_starts(martinet(bend), 0, 20, 0, away).at.z
    np.testing.assert_array_equal([q[0], p[0]], away)
    assert 0.05 < np.std(q - away[0]) < 0.2
    assert 2.5 < np.std(p - away[1]) < 9


@pytest.mark.slow
def test_one_of_several_pieces_is_chosen():
    c = classify(martinet(0.5), near=ON_A_LINE)
    lines = c.choose([s.signature for s in c.strata].index(LINES))
    assert not lines.stratified
    assert (lines.dimension, lines.rank, lines.gauge_components) == (3, 2, (1,))
    q, p = lines.manifold.nearby(jax.tree.map(lambda a: a + 0.1, ON_A_LINE))
    np.testing.assert_allclose([q[0], p[0], p[1]], 0, atol=1e-15)
    np.testing.assert_allclose(lines.control(q, p, jnp.array([0.7])), [0, 0.7], atol=1e-12)
    with pytest.raises(InvalidInputError, match="there is no stratum 5; expected one of"):
        c.choose(5)


@pytest.mark.slow
def test_the_levels_of_a_piece_are_those_of_most_of_its_points():
    """``x' = u1``, ``y' = x u2``, cost ``u1^2/2``: ``p2 x = 0``, of which the piece ``p2 = 0`` is primary from most
    starts."""
    problem = OptimalControlProblem(
        Euclidean(2), lambda q, u: jnp.stack([u[0], q[0] * u[1]]), lambda q, u: u[0] ** 2 / 2, 2
    )
    found = [
        [(s.signature, s.k_f, s.equations.names) for s in classify(problem, seed=seed).strata] for seed in range(3)
    ]
    assert found[0] == found[1] == found[2]
    assert (0, ("primary",)) in [piece[1:] for piece in found[0]]


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


@pytest.mark.slow
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


class Engel(eqx.Module):
    """``u1 d/dx + u2 (d/dy + x d/dz + x^2/2 d/dw)``."""

    def __call__(self, q, u):
        return jnp.stack([u[0], u[1], q[0] * u[1], q[0] ** 2 / 2 * u[1]])


@pytest.mark.slow
def test_the_morse_family_is_one_where_the_rank_of_the_form_drops():
    """``D(dH/du)`` has rank 2 wherever ``p`` is not zero; that of the form drops where ``p3 + x p4 = 0``."""
    problem = OptimalControlProblem(Euclidean(4), Engel(), lambda q, u: u @ u / 2, 2, abnormal=True)
    for away in (0.0, 1e-12, 1e-6, 1e-3, 1.0):
        near = jnp.array([0.5, 0, 0, 0]), jnp.array([0, 0.125 - away / 2, away - 0.5, 1.0])
        c = classify(problem, near=near, seed=1)
        (x, *_), (_, _, p3, p4) = (np.transpose(part) for part in c.morse.states)
        exact = [
            np.linalg.svd([[0, 1, 0, 0, 0], [h, 0, 1, a, a**2 / 2]])[1] for a, h in zip(x, p3 + x * p4, strict=True)
        ]
        assert np.min(exact) > 0.9
        assert c.morse.family, str(c)
        assert c.morse.count >= 15
        assert "is a Morse family" in str(c)


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


@pytest.mark.slow
@pytest.mark.parametrize("inertia", [2.0, 0.5, 0.99])
def test_a_control_on_another_piece_that_was_not_told_apart_is_the_right_one_or_nan(inertia):
    """``H = p u - (u1^2 + a u2^2) / 2`` of a rotation: on ``p3 = 0`` one of p1 and p2 is zero, and u is ``(p1, p2 / a,
    0)``."""
    group = SO(3)
    problem = OptimalControlProblem(
        group, lambda q, u: q @ hat(u), lambda q, u: (u[0] ** 2 + inertia * u[1] ** 2) / 2, controls=3
    )
    found, right = classify(problem), 0
    for key in jax.random.split(jax.random.key(0), 8):
        z = found.manifold.random_point(key)
        momentum, control = np.asarray(group.body(*z)), np.asarray(found.control(*z))
        if np.all(np.isfinite(control)):
            right += 1
            np.testing.assert_allclose(control, [momentum[0], momentum[1] / inertia, 0.0], atol=1e-7)
    assert right
