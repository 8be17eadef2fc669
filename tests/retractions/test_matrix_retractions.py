"""Closed forms of the retractions of matrix manifolds against their definitions, their special cases and other
libraries."""

import warnings
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from retrax.manifolds import SO, ComplexStiefel, FixedRank, Grassmann, Oblique, Sphere, Stiefel
from retrax.manifolds.numerics.matrices import exponential
from retrax.retractions import (
    QR,
    Cayley,
    Columnwise,
    Exponential,
    FixedRankOrthographic,
    GrassmannPolar,
    Polar,
    Projection,
    SphereExponential,
    StiefelCanonicalExponential,
    StiefelPolar,
)
from retrax.retractions.groups.functions import rotations
from scipy.linalg import expm

from tests.support.matrices import draw, round_trip
from tests.support.numerics import (
    CENTRAL_NODES,
    FRACTIONS,
    SEEDS,
    compiled,
    differences,
    draw_point,
    draw_tangent,
    norm,
)

STEP = 4e-3


def stiefel_polar(x, v):
    u, _, w = np.linalg.svd(x + v, full_matrices=False)
    return u @ w


def stiefel_cayley(x, v):
    eye = np.eye(len(x))
    p = eye - x @ x.conj().T / 2
    w = p @ v @ x.conj().T - x @ v.conj().T @ p
    return np.linalg.solve(eye - w / 2, (eye + w / 2) @ x)


def stiefel_canonical(x, v):
    p = np.eye(len(x)) - x @ x.conj().T / 2
    return expm(p @ v @ x.conj().T - x @ v.conj().T @ p) @ x


def stiefel_exponential(x, v):
    return expm(v @ x.conj().T - x @ v.conj().T) @ x @ expm(-x.conj().T @ v)


def stiefel_qr(x, v):
    q, r = np.linalg.qr(x + v)
    return q * np.sign(np.diag(r))


def rotated(function):
    """``q x q'`` with ``q`` a function of ``[v, x]``."""

    def value(x, v):
        q = function(v @ x - x @ v)
        return q @ x @ q.T

    return value


def grassmann_polar(x, v):
    q = np.linalg.svd((x + v) @ x)[0][:, :2]
    return q @ q.T


def truncated(x, v):
    u, s, w = np.linalg.svd(x + v)
    return u[:, :2] * s[:2] @ w[:2]


DEFINITIONS = {
    "Stiefel polar": (Polar(Stiefel(4, 2)), stiefel_polar),
    "Stiefel QR": (QR(Stiefel(4, 2)), stiefel_qr),
    "Stiefel canonical": (StiefelCanonicalExponential(Stiefel(4, 2)), stiefel_canonical),
    "exponential, St(3, 2)": (Exponential(Stiefel(3, 2)), stiefel_exponential),
    "exponential, St(4, 2)": (Exponential(Stiefel(4, 2)), stiefel_exponential),
    "exponential, St(5, 2)": (Exponential(Stiefel(5, 2)), stiefel_exponential),
    "Stiefel Cayley": (Cayley(Stiefel(4, 2)), stiefel_cayley),
    "complex polar": (Polar(ComplexStiefel(3, 2)), stiefel_polar),
    "complex QR": (QR(ComplexStiefel(3, 2)), stiefel_qr),
    "complex Cayley": (Cayley(ComplexStiefel(3, 2)), stiefel_cayley),
    "complex exponential, n <= 2p": (Exponential(ComplexStiefel(3, 2)), stiefel_exponential),
    "complex exponential, n > 2p": (Exponential(ComplexStiefel(3, 1)), stiefel_exponential),
    "Grassmann exponential": (Exponential(Grassmann(4, 2)), rotated(expm)),
    "Grassmann Cayley": (
        Cayley(Grassmann(4, 2)),
        rotated(lambda a: np.linalg.solve(np.eye(4) - a / 2, np.eye(4) + a / 2)),
    ),
    "Grassmann polar": (Polar(Grassmann(4, 2)), grassmann_polar),
    "fixed rank projection": (Projection(FixedRank(4, 3, 2)), truncated),
}


@pytest.mark.parametrize("name", DEFINITIONS)
@given(seed=SEEDS, length=st.floats(0.0, 1.0))
@pytest.mark.usual(2)
def test_closed_forms_are_their_definitions(name, seed, length):
    retraction, definition = DEFINITIONS[name]
    x, v = draw(retraction.manifold, seed, length)
    np.testing.assert_allclose(round_trip(retraction, x, v)[0], definition(x, v), atol=2e-14)


@compiled
def two_turns(a, d, e):
    """Exponentials of a skew matrix, and first and second derivatives along two others."""

    def along(function):
        return jax.jvp(lambda a: jax.jvp(function, (a,), (d,)), (a,), (e,))

    return along(rotations.exponential), along(exponential)


@given(seed=SEEDS, angles=st.tuples(*(st.sampled_from([0.0, 1e-9, 0.5, 1 - 1e-9, 1.0, 2.0, np.pi, 7.0]),) * 2))
def test_the_exponential_in_four_dimensions_has_the_derivatives_of_the_general_one(seed, angles):
    """With angles that are equal, opposite, zero and full turns, to where a series takes the place of a quotient."""
    frame, *others = np.random.default_rng(seed).standard_normal((3, 4, 4))
    turns = np.kron(np.diag(angles), [[0.0, -1.0], [1.0, 0.0]])
    frame = np.linalg.qr(frame)[0]
    closed, general = two_turns(frame @ turns @ frame.T, *(a - a.T for a in others))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-12), closed, general)


@given(seed=SEEDS, length=st.floats(0.0, 0.5))
def test_the_orthographic_retraction_moves_along_a_normal_vector(seed, length):
    retraction = FixedRankOrthographic(FixedRank(4, 3, 2))
    x, v = draw(retraction.manifold, seed, length)
    y = round_trip(retraction, x, v)[0]
    assert np.linalg.svd(y, compute_uv=False)[2] < 1e-14
    assert norm(x.T @ (y - x - v)) < 1e-13
    assert norm(x @ (y - x - v).T) < 1e-13


SPHERE, ROTATIONS, ONE, ALL = Sphere(2), SO(3), Stiefel(3, 1), Stiefel(3, 3)
COINCIDENT = {
    "polar, one column": (Polar(ONE), Projection(SPHERE)),
    "QR, one column": (QR(ONE), Projection(SPHERE)),
    "exponential, one column": (Exponential(ONE), Exponential(SPHERE)),
    "polar, all columns": (Polar(ALL), Polar(ROTATIONS)),
    "QR, all columns": (QR(ALL), QR(ROTATIONS)),
    "Cayley, all columns": (Cayley(ALL), Cayley(ROTATIONS)),
}


@lru_cache
def _both(name):
    ours, theirs = COINCIDENT[name]
    shapes = ours.manifold.ambient.shape, theirs.manifold.ambient.shape

    def values(x, v):
        return ours(x.reshape(shapes[0]), v.reshape(shapes[0])).reshape(-1), theirs(
            x.reshape(shapes[1]), v.reshape(shapes[1])
        ).reshape(-1)

    return compiled(values)


@pytest.mark.parametrize("name", COINCIDENT)
@given(seed=SEEDS, length=st.floats(0.0, 2.0))
def test_one_column_is_the_sphere_and_all_columns_are_rotations(name, seed, length):
    manifold = COINCIDENT[name][1].manifold
    x, v = draw(manifold, seed, length)
    np.testing.assert_allclose(*_both(name)(x.reshape(-1), v.reshape(-1)), atol=5e-15)


@given(seed=SEEDS, length=st.floats(0.0, 1.0))
def test_a_column_at_a_time_is_the_sphere_at_a_time(seed, length):
    retraction = Exponential(Oblique(3, 2))
    assert retraction == Columnwise(Oblique(3, 2), SphereExponential(Sphere(2)))
    x, v = draw(Oblique(3, 2), seed, length)
    y = round_trip(retraction, x, v)[0]
    for a, b, c in zip(x.T, v.T, y.T, strict=True):
        t = np.linalg.norm(b)
        np.testing.assert_allclose(c, np.cos(t) * a + np.sinc(t / np.pi) * b, atol=1e-15)


def test_frames_of_one_subspace_have_one_polar_and_qr_retraction():
    assert type(QR(Grassmann(4, 2))) is GrassmannPolar
    assert type(Projection(Stiefel(4, 2))) is StiefelPolar


@compiled
def _along_the_geodesic(x, v):
    exponential = Exponential(Stiefel(3, 2))

    def velocity(s):
        return jax.jvp(lambda s: exponential(x, s * v), (s,), (1.0,))

    acceleration = jax.jvp(lambda s: velocity(s)[1], (0.7,), (1.0,))[1]
    y, w = velocity(0.7)
    return y, w, acceleration, exponential(y, 0.5 * w), exponential(x, 1.2 * v)


@given(seed=SEEDS, length=st.floats(0.1, 2.5))
def test_geodesics_of_frames_have_normal_acceleration_and_one_speed(seed, length):
    x, v = draw(Stiefel(3, 2), seed, length)
    y, w, acceleration, further, at_once = _along_the_geodesic(x, v)
    tangential = acceleration - y @ (y.T @ acceleration + acceleration.T @ y) / 2
    assert norm(tangential) < 1e-12 * (1 + length**2)
    assert np.linalg.norm(w) == pytest.approx(length, rel=1e-13)
    np.testing.assert_allclose(further, at_once, atol=1e-13)


INVERSES = {
    "Stiefel polar": Polar(Stiefel(4, 2)),
    "Grassmann Cayley": Cayley(Grassmann(3, 1)),
    "fixed rank projection": Projection(FixedRank(3, 3, 1)),
}


@lru_cache
def _inverse_along_curves(name):
    retraction = INVERSES[name]

    def facts(x, v, a, b):
        """The inverse between ``R(x, s a)`` and ``R(x, v + s b)``, and its derivatives at ``s = 0``."""

        def between(s):
            return jnp.sum(jnp.cos(jnp.arange(x.size)) * jnp.ravel(retraction.preimage(retraction(x, s * a), y(s))))

        def y(s):
            return retraction(x, v + s * b)

        slope = jax.grad(between)
        return {
            "values": jax.vmap(between)(STEP * CENTRAL_NODES),
            "slopes": jax.vmap(slope)(STEP * CENTRAL_NODES),
            "forward": jax.jvp(between, (0.0,), (1.0,))[1],
            "reverse": slope(0.0),
            "second": jax.jvp(slope, (0.0,), (1.0,))[1],
        }

    return compiled(facts)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if n == "fixed rank projection" else n for n in INVERSES]
)
@given(seed=SEEDS, fraction=FRACTIONS)
@example(seed=0, fraction=0.0)
@pytest.mark.usual("Stiefel polar")
def test_inverses_have_their_derivatives_at_zero_too(name, seed, fraction):
    manifold, rng = INVERSES[name].manifold, np.random.default_rng(seed)
    x, _, basis = draw_point(manifold, seed)
    a, b, v = (draw_tangent(rng, basis, length) for length in (0.5, 0.5, 0.5 * fraction))
    facts = _inverse_along_curves(name)(*(z.reshape(manifold.ambient.shape) for z in (x, v, a, b)))
    np.testing.assert_allclose(facts["forward"], differences(facts["values"], STEP), atol=1e-9)
    np.testing.assert_allclose(facts["reverse"], facts["forward"], atol=1e-12)
    np.testing.assert_allclose(facts["second"], differences(facts["slopes"], STEP), atol=1e-8)


@lru_cache
def peers():
    """pymanopt's and geomstats' manifolds; what they warn about on import is theirs."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import geomstats.geometry.grassmannian
        import pymanopt.manifolds
    return pymanopt.manifolds, geomstats.geometry.grassmannian


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.usual(1)
def test_pymanopts_values_on_frames(seed):
    pymanopt, _ = peers()
    x, v = draw(Stiefel(4, 2), seed, 0.9)
    for name in ("polar", "qr"):
        theirs = pymanopt.Stiefel(4, 2, retraction=name)
        ours = round_trip(DEFINITIONS["Stiefel polar" if name == "polar" else "Stiefel QR"][0], x, v)[0]
        np.testing.assert_allclose(ours, theirs.retraction(x, v), atol=1e-14)
    x, v = draw(Stiefel(3, 2), seed, 0.9)
    ours = round_trip(Exponential(Stiefel(3, 2)), x, v)[0]
    np.testing.assert_allclose(ours, pymanopt.Stiefel(3, 2).exp(x, v), atol=1e-14)


@pytest.mark.parametrize("seed", range(3))
def test_pymanopts_truncation(seed):
    pymanopt, _ = peers()
    theirs = pymanopt.FixedRankEmbedded(4, 3, 2)
    x, v = draw(FixedRank(4, 3, 2), seed, 0.4)
    u, s, w = (part[..., :2].T if i == 2 else part[..., :2] for i, part in enumerate(_svd(x)))
    y = theirs.retraction((u, s, w), theirs.projection((u, s, w), v))
    ours = round_trip(DEFINITIONS["fixed rank projection"][0], x, v)[0]
    np.testing.assert_allclose(ours, y[0] * y[1] @ y[2], atol=1e-13)


def _svd(x):
    u, s, w = np.linalg.svd(x, full_matrices=False)
    return u, s, w.T


@pytest.mark.parametrize("seed", range(3))
def test_geomstats_values_on_subspaces(seed):
    _, geomstats = peers()
    metric = geomstats.Grassmannian(4, 2).metric
    x, v = draw(Grassmann(4, 2), seed, 0.9)
    y, back, _ = round_trip(Exponential(Grassmann(4, 2)), x, v)
    np.testing.assert_allclose(y, metric.exp(v, x), atol=1e-13)
    np.testing.assert_allclose(back, metric.log(y, x), atol=1e-10)
