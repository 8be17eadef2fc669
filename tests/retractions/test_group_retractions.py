"""Exponentials, logarithms and Cayley transforms of matrix Lie groups, and retractions from any map of the algebra."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from hypothesis import assume, given
from hypothesis import strategies as st
from retrax.manifolds import (
    SE,
    SL,
    SO,
    SU,
    DomainError,
    Euclidean,
    InvalidInputError,
    LeftInvariantMetric,
    MatrixLieGroup,
    U,
    UnknownRetractionError,
)
from retrax.manifolds.numerics import ambient as vec
from retrax.retractions import (
    QR,
    SOQR,
    Cayley,
    Exponential,
    FrobeniusExponential,
    GroupCayley,
    Polar,
    SEDecoupled,
    SOPolar,
    Translated,
)
from retrax.retractions.groups.functions import rigid_motions, rotations, unitary

from tests.support.cases import Heisenberg
from tests.support.numerics import SEEDS, compiled, draw_point

GROUPS: dict[str, MatrixLieGroup] = {"SO4": SO(4), "SE2": SE(2), "SE3": SE(3), "SU2": SU(2), "SU3": SU(3), "SL2": SL(2)}
WITH_ANGLES = ["SO4", "SE2", "SE3", "SU2", "SU3"]
PLANES = {"SO4": 2, "SU3": 1}  # how many eigenvalues share the largest angle, where there are others

LENGTHS = st.one_of(st.floats(0.0, 3.0), st.sampled_from([0.0, 1e-12, 1e-8, 1e-4]))


@lru_cache
def _exponential(name: str):
    group, retraction = GROUPS[name], Exponential(GROUPS[name])

    def facts(c):
        a = group.hat(c)
        x = retraction(group.identity, a)
        back = retraction.preimage(group.identity, x)
        return {
            "a": a,
            "exp": x,
            "log": back,
            "root": retraction.square_root(x),
            "inside": retraction.domain(group.identity, a),
        }

    return compiled(facts)


def facts_at(name: str, seed: int, length: float) -> dict:
    """Exponential and logarithm of an element of the algebra of this Frobenius norm."""
    c = np.random.default_rng(seed).standard_normal(GROUPS[name].dimension)
    norm = np.linalg.norm(GROUPS[name].hat(jnp.asarray(c)))
    return _exponential(name)(length * c / norm)


@pytest.mark.parametrize("name", GROUPS)
@given(seed=SEEDS, length=LENGTHS)
@pytest.mark.usual(1)
def test_exponential_and_logarithm_are_those_of_scipy(name, seed, length):
    facts = facts_at(name, seed, length)
    np.testing.assert_allclose(facts["exp"], scipy.linalg.expm(facts["a"]), atol=1e-13)
    if length > 1e-3:
        np.testing.assert_allclose(facts["log"], scipy.linalg.logm(facts["exp"]), atol=2e-12)


@pytest.mark.parametrize("name", GROUPS)
@given(seed=SEEDS, length=LENGTHS)
@pytest.mark.usual(2)
def test_the_logarithm_inverts_the_exponential_and_halves_are_square_roots(name, seed, length):
    facts = facts_at(name, seed, length)
    assert facts["inside"]
    np.testing.assert_allclose(facts["log"], facts["a"], atol=1e-13)
    np.testing.assert_allclose(facts["root"] @ facts["root"], facts["exp"], atol=1e-13 * np.linalg.cond(facts["exp"]))


@pytest.mark.parametrize("name", WITH_ANGLES)
@given(seed=SEEDS, gap=st.sampled_from([1e-2, 1e-4, 1e-6, 1e-8]))
@pytest.mark.usual(1)
def test_the_logarithm_is_accurate_to_the_edge_of_its_domain(name, seed, gap):
    # A vector whose largest angle is pi - gap. Planes that reach the half turn together are told apart to 1e-16 / gap
    # only.
    a = facts_at(name, seed, 1.0)["a"]
    angles = np.sort(np.abs(np.linalg.eigvals(a).imag))
    largest = angles[-1]
    assume(largest > 0.2)
    assume(name not in PLANES or largest - angles[-1 - PLANES[name]] > 0.1 * largest)
    facts = facts_at(name, seed, (np.pi - gap) / largest)
    # In SU(2) all directions meet at -I: rounding of points away from the identity hides them before.
    assert facts["inside"] or (name == "SU2" and gap < 4e-7)
    np.testing.assert_allclose(facts["log"], facts["a"], rtol=0, atol=1e-13 * (1 + np.max(np.abs(facts["a"]))))


def test_a_published_screw_motion():
    # [Lynch, Park 2017, Example 3.26]: S = (0, 0, 1, 3.37, -3.37, 0), theta = 30 degrees, three digits.
    def planar(degrees, x, y):
        c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
        return jnp.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]])

    group = SE(3)
    moved = planar(60, 2, 1) @ group.inverse(planar(30, 1, 2))
    twist = group.vee(Exponential(group).inverse(group.identity, moved))
    np.testing.assert_allclose(twist / (np.pi / 6), [0, 0, 1, 3.37, -3.37, 0], atol=5e-3)


@compiled
def _log_of_motions(a, b):
    def along(s):
        return rigid_motions.logarithm(rigid_motions.exponential(s[0] * a) @ rigid_motions.exponential(s[1] * b))

    zero = jnp.zeros(2)
    return jax.jacfwd(along)(zero), jax.jacrev(along)(zero), jax.jacfwd(jax.jacrev(along))(zero)


@pytest.mark.slow
@given(seed=SEEDS)
def test_the_logarithm_of_motions_has_the_derivatives_of_baker_campbell_hausdorff_at_the_identity(seed):
    # log(exp(s a) exp(t b)) = s a + t b + s t [a, b]/2 + ...
    a, b = (np.asarray(SE(3).hat(jnp.asarray(c))) for c in np.random.default_rng(seed).standard_normal((2, 6)))
    forward, reverse, twice = _log_of_motions(a, b)
    for first in (forward, reverse):
        np.testing.assert_allclose(first, np.stack([a, b], axis=-1), atol=1e-14)
    bracket = (a @ b - b @ a) / 2
    np.testing.assert_allclose(
        twice, np.stack([0 * a, bracket, bracket, 0 * a], axis=-1).reshape(4, 4, 2, 2), atol=1e-13
    )


@compiled
def _logarithm_derivatives(a, b):
    def curve(s):
        return unitary.unitary_logarithm(jax.scipy.linalg.expm(s[0] * a + s[1] * b))

    zero = jnp.zeros(2)
    return jax.jvp(curve, (zero,), (jnp.ones(2),))[1], jax.jacrev(curve)(zero)


@given(seed=SEEDS)
def test_the_logarithm_of_rotations_has_its_derivatives_at_the_identity(seed):
    # Where all eigenvalues are equal: log(exp(s a + t b)) = s a + t b is linear.
    a, b = (np.asarray(SO(4).hat(jnp.asarray(c))) for c in np.random.default_rng(seed).standard_normal((2, 6)))
    along, reverse = _logarithm_derivatives(a, b)
    np.testing.assert_allclose(along, a + b, atol=1e-13)
    np.testing.assert_allclose(reverse, np.stack([a, b], axis=-1), atol=1e-13)


NOWHERE = {
    "SE3": (SE(3), np.block([[np.diag([-1.0, -1.0, 1.0]), np.ones((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]])),
    "U2": (U(2), np.diag([1.0, -1.0 + 0j])),
    "SU2": (SU(2), -np.eye(2, dtype=complex)),
    "SO4, two planes": (SO(4), -np.eye(4)),
    "SU3, angles that sum to a full turn": (SU(3), np.exp(2j * np.pi / 3) * np.eye(3)),
    "SL2": (SL(2), -np.eye(2)),
}


@pytest.mark.parametrize("name", NOWHERE)
@pytest.mark.usual("SE3")
def test_what_has_no_logarithm_is_refused(name):
    group, y = NOWHERE[name][0], jnp.asarray(NOWHERE[name][1])
    assert group.contains(y)
    with pytest.raises(DomainError, match="outside the image of"):
        Exponential(group).inverse(group.identity, y)


@compiled
def _cayley_at_its_edge(scale):
    group = SL(2)
    a = scale * jnp.array([[0.0, 4.0], [1.0, 0.0]])  # with the eigenvalues 2 and -2 where scale is 1
    y = Cayley(group)(group.identity, a)
    return a, Cayley(group).domain(group.identity, a), Cayley(group).preimage(group.identity, y)


@pytest.mark.parametrize("scale", [1e-12, 0.5, 1 - 1e-3, 1 + 1e-3, 3.0])
def test_the_cayley_transform_is_inverted_on_both_sides_of_the_eigenvalue_two(scale):
    a, inside, back = _cayley_at_its_edge(scale)
    assert inside
    np.testing.assert_allclose(back, a, rtol=0, atol=1e-15 / min(abs(scale - 1), 0.1))
    # Nearer to it the value is so large that its determinant is rounding.
    assert not any(_cayley_at_its_edge(at)[1] for at in (1 - 1e-5, 1.0, 1 + 1e-8))


def test_the_cayley_transform_is_known_where_it_stays_in_the_group():
    assert all(Cayley.knows(group) for group in (SE(3), U(3), SU(2), SU(3), SL(2), Heisenberg()))
    assert not Cayley.knows(SL(3))
    with pytest.raises(UnknownRetractionError, match=r"Cayley is not known on .*known there: Exponential"):
        Cayley(SL(3))
    with pytest.raises(UnknownRetractionError, match=r"leads from the algebra of .* out of the group"):
        GroupCayley(SL(3))
    with pytest.raises(UnknownRetractionError, match="known there: Exponential, Projection, Cayley"):
        Polar(SE(3))


def _apart(a):
    """Turn and shift apart: a map that conjugations do not commute with."""
    return SE(2).pose(rotations.exponential(a[:2, :2]), a[:2, 2])


def _apart_inverse(y):
    return SE(2).tangent(rotations.logarithm(y[:2, :2]), y[:2, 2])


@compiled
def _translated(x, z, v):
    out = {}
    for side in ("left", "right"):
        mine, known = Translated(SE(2), _apart, side=side), Translated(SE(2), _apart, _apart_inverse, side)
        y = mine(x, v)
        moved = mine(z @ x, z @ v) - z @ y if side == "left" else mine(x @ z, v @ z) - y @ z
        out[side] = {"y": y, "newton": mine.preimage(x, y), "closed": known.preimage(x, y), "moved": moved}
    return out


@given(seed=SEEDS)
def test_a_map_of_the_algebra_translated_is_a_retraction(seed):
    x, v, _ = (np.asarray(a) for a in draw_point(SE(2), seed))
    z = draw_point(SE(2), seed + 1)[0]
    x, v, z = x.reshape(3, 3), 0.3 * v.reshape(3, 3), z.reshape(3, 3)
    facts = _translated(x, z, v)
    assert np.max(np.abs(facts["left"]["y"] - facts["right"]["y"])) > 1e-9
    for side in ("left", "right"):
        assert SE(2).contains(facts[side]["y"], 1e-13)
        np.testing.assert_allclose(facts[side]["newton"], v, atol=1e-13)
        np.testing.assert_allclose(facts[side]["closed"], v, atol=1e-13)
        np.testing.assert_allclose(facts[side]["moved"], 0, atol=1e-13)


@compiled
def _factorisations(x, v):
    values = {"polar": Polar(U(2)), "qr": QR(U(2))}
    return {name: (r(x, v), r.preimage(x, r(x, v)), r.domain(x, v)) for name, r in values.items()}


@given(seed=SEEDS)
def test_the_factorisations_of_unitary_matrices_are_those_of_numpy_and_have_inverses(seed):
    key = jax.random.key(seed)
    x = U(2).random_point(key)
    v = U(2).random_tangent(key, x)
    q, r = np.linalg.qr(x + v)
    expected = {"polar": scipy.linalg.polar(np.asarray(x + v))[0], "qr": q * (np.diag(r) / np.abs(np.diag(r)))}
    for name, (y, back, inside) in _factorisations(x, v).items():
        np.testing.assert_allclose(y, expected[name], atol=1e-13)
        np.testing.assert_allclose(back, v, atol=1e-15 * (10 + np.linalg.norm(v) ** 2))  # the image is flat far out
        assert inside


BAD_MAPS = {
    "no group": ((Euclidean(3), rigid_motions.cayley), "takes a MatrixLieGroup"),
    "no function": ((SE(2), "cayley"), "takes functions of matrices"),
    "side": ((SE(2), rigid_motions.cayley, None, "both"), "side must be 'left' or 'right'"),
    "shape": ((SE(2), lambda a: a[:2]), "must return an array of"),
    "scale": ((SE(2), lambda a: rigid_motions.exponential(1.01 * a)), r"must have Dg\(0\) = Id, it misses it by 0\.01"),
    "origin": ((SE(2), lambda a: a), r"must have g\(0\) = I"),
}


@pytest.mark.parametrize("kind", BAD_MAPS)
def test_a_wrong_group_map_is_refused(kind):
    arguments, words = BAD_MAPS[kind]
    with pytest.raises(InvalidInputError, match=words):
        Translated(*arguments)


@pytest.mark.parametrize(
    "arguments", [(SO(3),), (SE(3), SOQR(SO(3))), (SE(3), SOPolar(SO(2)))], ids=["SO", "QR", "size"]
)
def test_a_wrong_decoupled_retraction_is_refused(arguments):
    with pytest.raises(InvalidInputError, match="SEDecoupled takes a"):
        SEDecoupled(*arguments)


def test_the_decoupled_exponential_turns_and_shifts():
    group, (w, v) = SE(3), np.random.default_rng(0).standard_normal((2, 3))
    a = group.hat(jnp.concatenate([jnp.asarray(w), jnp.asarray(v)]))
    y = SEDecoupled(group)(group.identity, a)
    np.testing.assert_allclose(y[:3, :3], scipy.linalg.expm(np.asarray(a)[:3, :3]), atol=1e-14)
    np.testing.assert_allclose(y[:3, 3], v, atol=1e-15)


@pytest.mark.parametrize(
    "retraction",
    [Cayley(SO(3) * Euclidean(2)), Polar(SO(4)), Exponential(SU(2)), Exponential(SE(2)), QR(SO(3))],
    ids=str,
)
@pytest.mark.usual(1)
def test_charts_and_pairs_are_the_retraction_itself(retraction):
    """Closed forms of ``R(x, sum c_k E_k)`` and of ``R(x, -v)``, ``R(x, v)``."""
    manifold = retraction.manifold
    c = np.random.default_rng(0).standard_normal(manifold.dimension)

    @jax.jit
    def apart(key):
        x = manifold.random_point(key)
        v = vec.combine(manifold.basis(x), c)
        forwards, backwards = retraction(x, v), retraction(x, vec.scale(-1.0, v))
        chart, both = retraction.chart(x, retraction.frame(x), c), retraction.both_ways(x, v)
        return vec.size(vec.subtract(chart, forwards)), vec.size(vec.subtract(both, (backwards, forwards)))

    assert max(apart(jax.random.key(0))) < 1e-14


@lru_cache
def _frobenius_geodesic():
    """Time derivatives of the body velocity of a geodesic on SL(3), against the basis, and those of Euler and
    Poincare."""
    group = SL(3)
    retraction, metric = FrobeniusExponential(group), LeftInvariantMetric(group, group.lie_algebra.gram)
    basis = jnp.asarray(group.algebra)

    def facts(x, a, time):
        def velocity(t):
            y, dy = jax.jvp(lambda s: retraction(x, x @ (s * a)), (t,), (1.0,))
            return group.inverse(y) @ dy

        u, change = jax.jvp(velocity, (time,), (1.0,))

        def product(b, c):
            return metric.inner_product(group.identity, b, c)

        return {
            "start": velocity(0.0) - a,
            "left": jax.vmap(lambda w: product(change, w))(basis),
            "right": jax.vmap(lambda w: product(u, u @ w - w @ u))(basis),
        }

    return compiled(facts)


@given(seed=SEEDS)
def test_geodesics_of_the_frobenius_metric_solve_the_euler_poincare_equation(seed):
    rng = np.random.default_rng(seed)
    a = np.tensordot(rng.standard_normal(8), SL(3).algebra, 1)
    x = scipy.linalg.expm(np.tensordot(rng.standard_normal(8), SL(3).algebra, 1) / 3)
    facts = _frobenius_geodesic()(x, a / np.linalg.norm(a), rng.uniform(0, 2))
    np.testing.assert_allclose(facts["start"], 0, atol=1e-13)
    np.testing.assert_allclose(facts["left"], facts["right"], atol=1e-12)


@pytest.mark.parametrize("name", ["SO4", "SU3"])
def test_the_frobenius_exponential_is_that_of_the_group_where_it_acts_by_unitary_matrices(name):
    group = GROUPS[name]
    a = group.hat(np.linspace(-0.5, 0.6, group.dimension))
    here, there = FrobeniusExponential(group), Exponential(group)
    np.testing.assert_allclose(*jax.jit(lambda a: (here.group_map(a), there.group_map(a)))(a), atol=1e-14)


def test_the_frobenius_exponential_is_refused_where_its_formula_leaves_the_group():
    with pytest.raises(UnknownRetractionError, match="does not hold the adjoint"):
        FrobeniusExponential(SE(2))


@compiled
def _there_and_back(points):
    group = SL(2)
    exponential = Exponential(group)
    back = jax.vmap(lambda y: exponential.preimage(group.identity, y))(points)
    return back, jax.vmap(lambda v: exponential(group.identity, v))(back)


@pytest.mark.parametrize("stretch", [1.0 + 1e-6, 1.01, 1.5, 4.0])
@pytest.mark.usual(1)
def test_the_logarithm_is_nan_or_leads_back_on_the_way_through_a_half_turn(stretch):
    """Rotations by ``t`` times ``diag(s, 1/s)``: where the trace is below -2 it is not an exponential."""
    t = np.pi * np.array([0.0, 0.3, 0.7, 0.9, 0.99, 0.9999, 1.0])
    turns = np.stack([np.stack([np.cos(t), -np.sin(t)], -1), np.stack([np.sin(t), np.cos(t)], -1)], -2)
    points = turns @ np.diag([stretch, 1 / stretch])
    back, there = _there_and_back(points)
    known = ~np.any(np.isnan(back), axis=(1, 2))
    assert np.max(np.abs(there - points)[known]) < 1e-6
    trace = np.trace(points, axis1=1, axis2=2)
    assert np.all(known[trace > -2 + 1e-3])
    assert not np.any(known[trace < -2])
