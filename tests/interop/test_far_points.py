"""Distances, logarithms and transports through the doors, far out and off the manifold: right, or an error that says
why. The judge is mpmath.
"""

import mpmath
import numpy as np
import pytest
from retrax.interop import to_geomstats, to_pymanopt
from retrax.manifolds import SE, SO, SPD, SU, DomainError, Hyperbolic, NotOnManifoldError, Oblique, Power, Sphere, U

EPS = np.finfo(float).eps
HALF = EPS**0.5
DOORS = {"geomstats": to_geomstats, "pymanopt": to_pymanopt}
DISTANCES = (1e-8, 1e-4, 0.1, 1.0, 5.0, 10.0, 20.0, 25.0, 30.0, 40.0, 100.0, 400.0, 700.0)
CONDITIONS = 10.0 ** np.arange(0, 13, 2)


def door(name: str, manifold):
    """Functions ``dist(x, y)``, ``log(x, y)`` and, of geomstats, ``transport(x, y, v)`` of a manifold."""
    if name == "pymanopt":
        space = to_pymanopt(manifold)
        return space.dist, space.log, None
    metric = to_geomstats(manifold).metric
    return (
        metric.dist,
        lambda x, y: metric.log(y, x),
        lambda x, y, v: metric.parallel_transport(v, x, end_point=y),
    )


def hyperbolic(s: float, angle: float) -> np.ndarray:
    """The point at distance ``s`` from the apex in this direction."""
    return np.array([np.cosh(s), np.sinh(s) * np.cos(angle), np.sinh(s) * np.sin(angle)])


def lorentz(x, y):
    """The Lorentz form of two vectors of mpmath."""
    return -x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


def exact_hyperbolic(x: np.ndarray) -> mpmath.matrix:
    """The point of mpmath with the same space coordinates."""
    a, b = map(mpmath.mpf, x[1:].tolist())
    return mpmath.matrix([mpmath.sqrt(1 + a * a + b * b), a, b])


def hyperbolic_distance(x: np.ndarray, y: np.ndarray) -> float:
    """The distance in as many digits as two points at 700 from the apex need."""
    with mpmath.workdps(1300):
        return float(mpmath.acosh(-lorentz(exact_hyperbolic(x), exact_hyperbolic(y))))


def definite(condition: float, second: bool) -> np.ndarray:
    """A matrix of this condition with eigenvectors of its own."""
    q = np.linalg.qr(np.random.default_rng(second).standard_normal((3, 3)))[0]
    x = (q * condition ** np.array([0, -0.4, -1.0])) @ q.T
    return (x + x.T) / 2


def definite_parts(x: np.ndarray, y: np.ndarray):
    """``x`` and ``y`` of mpmath, the inverse of the Cholesky factor ``l`` of ``x``, and ``l^-1 y l^-T`` by its
    eigenvalues and eigenvectors."""
    there = mpmath.matrix(y.tolist())
    factor = mpmath.cholesky(mpmath.matrix(x.tolist()))
    inverse = factor**-1
    return factor, inverse, mpmath.eigsy(inverse * there * inverse.T)


def definite_distance(x: np.ndarray, y: np.ndarray) -> float:
    """The affine-invariant distance from the generalised eigenvalues, in 60 digits."""
    with mpmath.workdps(60):
        values, _ = definite_parts(x, y)[2]
        return float(mpmath.norm([mpmath.log(value) for value in values]))


@pytest.mark.parametrize("name", DOORS)
def test_hyperbolic_distances_are_right_both_ways_round_from_near_to_far(name):
    dist, _, _ = door(name, Hyperbolic(2))
    apex = hyperbolic(0.0, 0.0)
    pairs = [(hyperbolic(s, angle), apex) for s in DISTANCES for angle in (0.0, 2.0)]
    pairs += [(hyperbolic(s, 0.3), hyperbolic(s, 0.3 + angle)) for s in DISTANCES for angle in (1e-3, 2.0, 3.1)]
    pairs += [(hyperbolic(s, 0.0), hyperbolic(s + by, 0.0)) for s in DISTANCES for by in (1e-8, 1e-3, 1.0)]
    for x, y in pairs:
        expected = hyperbolic_distance(x, y)
        np.testing.assert_allclose([dist(x, y), dist(y, x)], expected, rtol=1e-13)


@pytest.mark.parametrize("name", DOORS)
def test_distances_of_definite_matrices_are_as_exact_as_their_condition(name):
    dist, _, _ = door(name, SPD(3))
    for condition in CONDITIONS:
        x, y = definite(condition, False), definite(condition, True)
        np.testing.assert_allclose([dist(x, y), dist(y, x)], definite_distance(x, y), rtol=0, atol=20 * EPS * condition)


def hyperbolic_transport(x: np.ndarray, y: np.ndarray, v: np.ndarray) -> np.ndarray:
    """``v + <y, v>/(1 - <x, y>) (x + y)``, the transport along the geodesic."""
    with mpmath.workdps(100):
        p, q, w = exact_hyperbolic(x), exact_hyperbolic(y), mpmath.matrix(v.tolist())
        w[0] = (p[1] * w[1] + p[2] * w[2]) / p[0]
        moved = w + lorentz(q, w) / (1 - lorentz(p, q)) * (p + q)
        return np.array(moved.tolist(), float)[:, 0]


def definite_transport(x: np.ndarray, y: np.ndarray, v: np.ndarray) -> np.ndarray:
    """``e v e'`` with ``e = (y x^-1)^1/2``, the transport along the geodesic."""
    with mpmath.workdps(60):
        factor, inverse, (values, vectors) = definite_parts(x, y)
        root = vectors * mpmath.diag([mpmath.sqrt(value) for value in values]) * vectors.T
        e = factor * root * inverse
        return np.array((e * mpmath.matrix(v.tolist()) * e.T).tolist(), float)


SWEEPS = {
    "hyperbolic": (
        Hyperbolic(2),
        [(hyperbolic(s, 0.3), hyperbolic(s, 2.3)) for s in DISTANCES[2:]],
        [(hyperbolic(s, 0.3), hyperbolic(0.0, 0.0)) for s in DISTANCES[2:]],
        hyperbolic_distance,
        hyperbolic_transport,
        5.0,
    ),
    "definite": (
        SPD(3),
        [(definite(c, False), definite(c, True)) for c in CONDITIONS],
        [(definite(c, False), np.eye(3)) for c in CONDITIONS],
        definite_distance,
        definite_transport,
        10.0,
    ),
}


@pytest.mark.parametrize("name", SWEEPS)
@pytest.mark.usual(1)
def test_logarithms_and_transports_are_right_or_refused_however_far_out(name):
    manifold, pairs, others, distance, transported, known = SWEEPS[name]
    metric = to_geomstats(manifold).metric
    _, log, transport = door("geomstats", manifold)
    refused = []
    for x, y in pairs + others:
        expected = distance(x, y)
        try:
            v = log(x, y)
            w = transport(x, y, v)
        except DomainError as error:
            refused.append((expected, str(error)))
            continue
        assert metric.norm(v, x) == pytest.approx(expected, rel=30 * HALF)
        size = max(1.0, np.max(np.abs(y)))
        np.testing.assert_allclose(w / size, transported(x, y, v) / size, rtol=0, atol=1e3 * HALF * (1 + expected))
    assert refused
    assert all(length > known and "too far out, for the precision in use" in words for length, words in refused)


@pytest.mark.parametrize("name", DOORS)
def test_no_words_on_shortest_geodesics_where_there_is_always_one(name):
    manifold = SPD(2) * Hyperbolic(2) if name == "geomstats" else Power(Hyperbolic(2), 2)
    x, y = hyperbolic(40.0, 0.3), hyperbolic(40.0, 2.3)
    if name == "geomstats":
        x, y = np.concatenate([np.eye(2).ravel(), x]), np.concatenate([np.eye(2).ravel(), y])
    else:
        x, y = np.stack([x, x]), np.stack([x, y])
    dist, log, _ = door(name, manifold)
    assert dist(x, y) == pytest.approx(hyperbolic_distance(hyperbolic(40.0, 0.3), hyperbolic(40.0, 2.3)))
    with pytest.raises(DomainError, match="too far apart, or too far out"):
        log(x, y)


def turned(angle: float) -> np.ndarray:
    """A rotation of space about an axis."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def pose(rotation: np.ndarray) -> np.ndarray:
    """A motion without a translation."""
    out = np.eye(4)
    out[:3, :3] = rotation
    return out


# A manifold, a point, and what is none.
NO_POINTS = {
    "scaled rotation": (SO(3), turned(0.3), 1.001 * turned(0.5)),
    "reflection": (SO(3), turned(0.3), np.diag([1.0, 1.0, -1.0])),
    "reflected pose": (SE(3), pose(turned(0.3)), pose(np.diag([1.0, 1.0, -1.0]))),
    "scaled unitary": (U(2), np.eye(2, dtype=complex), 2j * np.eye(2)),
    "other determinant": (SU(2), np.eye(2, dtype=complex), 1j * np.eye(2)),
    "sphere": (Sphere(2), np.eye(3)[0], 1.1 * np.eye(3)[1]),
    "columns": (Oblique(3, 2), np.eye(3)[:, :2], 2 * np.eye(3)[:, :2]),
    "indefinite": (SPD(2), np.eye(2), np.diag([1.0, -1.0])),
    "other sheet": (Hyperbolic(2), np.eye(3)[0], -np.eye(3)[0]),
    "copies": (Power(Sphere(2), 2), np.eye(3)[:2], 2 * np.eye(3)[:2]),
}


@pytest.mark.parametrize("case", NO_POINTS)
@pytest.mark.parametrize("name", DOORS)
@pytest.mark.usual(2)
def test_what_is_no_point_has_no_distance_and_no_logarithm(name, case):
    manifold, x, y = NO_POINTS[case]
    dist, log, _ = door(name, manifold)
    assert dist(x, x) == pytest.approx(0, abs=1e-12)
    for first, second in ((x, y), (y, x)):
        with pytest.raises(NotOnManifoldError, match="not a point: not on"):
            dist(first, second)
    with pytest.raises(NotOnManifoldError, match="not a point: not on"):
        log(x, y)


def test_what_is_no_point_has_no_transport():
    space, x = to_geomstats(SO(3)), turned(0.3)
    v, y = space.to_tangent(np.arange(9.0).reshape(3, 3), x), 1.001 * turned(0.5)
    with pytest.raises(NotOnManifoldError, match="not a point"):
        space.metric.parallel_transport(v, x, end_point=y)
    with pytest.raises(NotOnManifoldError, match="not a point"):
        to_pymanopt(Sphere(2)).transport(np.eye(3)[0], 2 * np.eye(3)[1], np.eye(3)[2])
