"""Inverses far from the origin: they lead to the point that was asked for, in the manifold's own measure, or say that
they do not. The judge is mpmath.
"""

from typing import final

import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from retrax.manifolds import (
    SE,
    SL,
    SO,
    SPD,
    DomainError,
    Euclidean,
    Hyperbolic,
    InvalidInputError,
    MatrixLieGroup,
    NotOnManifoldError,
    Power,
    Sphere,
    U,
)
from retrax.retractions import Exponential, Projection, Retraction
from retrax.testing.numerics import compiled

HALF = 1.5e-8  # half of the digits
GRACE = 30  # by which what is judged in floating point and by mpmath may differ
EPS = np.finfo(float).eps


@final
class GLPlus(MatrixLieGroup):
    """Invertible matrices of positive determinant."""

    @property
    def algebra(self) -> np.ndarray:
        return np.eye(9).reshape(9, 3, 3)


def turn(*angles: float) -> np.ndarray:
    """A rotation of space from three angles."""
    (a, b, c), (x, y, z) = np.cos(angles), np.sin(angles)
    return (
        np.array([[a, -x, 0], [x, a, 0], [0, 0, 1]])
        @ np.array([[b, 0, y], [0, 1, 0], [-y, 0, b]])
        @ np.array([[1, 0, 0], [0, c, -z], [0, z, c]])
    )


def hyperbolic(s: float, second: bool) -> np.ndarray:
    """Points at distance ``s`` from the apex, 2 rad apart."""
    angle = 0.3 + 2 * second
    return np.array([np.cosh(s), np.sinh(s) * np.cos(angle), np.sinh(s) * np.sin(angle)])


def definite(s: float, second: bool) -> np.ndarray:
    """Matrices of condition ``e^s`` with two sets of eigenvectors."""
    q = turn(0.3, 0.5, -0.2) if second else turn(-0.4, 0.1, 1.0)
    x = (q * np.exp([0, s / 3, s])) @ q.T
    return (x + x.T) / 2


def motion(s: float, second: bool) -> np.ndarray:
    """Motions that are ``1e-2`` apart, at a distance of ``e^s``."""
    out = np.eye(4)
    out[:3, :3] = turn(0.1, 0.2, 0.3) if second else turn(-0.2, 0.4, 0.1)
    out[:3, 3] = np.exp(s) * np.array([0.6, 0.8, 0.0]) + 1e-2 * second
    return out


def unimodular(s: float, second: bool) -> np.ndarray:
    """Matrices of determinant one with singular values ``e^s``, 1 and ``e^-s``, and a near neighbour of each."""
    x = turn(0.3, 0.5, -0.2) @ np.diag(np.exp([s, 0, -s])) @ turn(-0.4, 0.1, 1.0)
    return x @ turn(0.2, -0.1, 0.3) if second else x


def positive(s: float, second: bool) -> np.ndarray:
    """The same times ``e^s``, or twice that."""
    return (1 + second) * np.exp(s) * unimodular(s, second)


def exact(x: np.ndarray) -> mpmath.matrix:
    """A matrix of mpmath with the same numbers."""
    return mpmath.matrix(x.tolist())


def hyperbolic_gap(z: np.ndarray, y: np.ndarray) -> float:
    """Hyperbolic distance of the two points with these space coordinates."""
    (a, b), (c, d) = (map(mpmath.mpf, p[1:].tolist()) for p in (z, y))
    return float(mpmath.acosh(mpmath.sqrt(1 + a * a + b * b) * mpmath.sqrt(1 + c * c + d * d) - a * c - b * d))


def relative_gap(z: np.ndarray, y: np.ndarray) -> float:
    """Largest entry of ``y^-1 z - I``."""
    return float(max(map(abs, exact(y) ** -1 * exact(z) - mpmath.eye(len(y)))))


def definite_gap(z: np.ndarray, y: np.ndarray) -> float:
    """Largest ``|log|`` of the eigenvalues of ``y^-1 z``."""
    inverse = mpmath.cholesky(exact(y)) ** -1
    return float(max(abs(mpmath.log(value)) for value in mpmath.eigsy(inverse * exact(z) * inverse.T, True)))


def flat_gap(z: np.ndarray, y: np.ndarray) -> float:
    """Largest entry of the difference."""
    return float(np.max(np.abs(z - y)))


LINE = Euclidean(2)
# A retraction, its points, the judge of a miss, and the last distance of the sweep at which it has to be found.
CASES = {
    "hyperbolic": (Exponential(Hyperbolic(2)), hyperbolic, hyperbolic_gap, 5.0),
    "central": (Projection(Hyperbolic(2)), hyperbolic, hyperbolic_gap, 4.0),
    "definite": (Exponential(SPD(3)), definite, definite_gap, 14.0),
    "motions": (Exponential(SE(3)), motion, flat_gap, 40.0),
    "unimodular": (Exponential(SL(3)), unimodular, relative_gap, 5.0),
    "positive": (Exponential(GLPlus()), positive, relative_gap, 5.0),
    "flat": (Exponential(LINE), lambda s, second: np.exp(s) * np.array([1.0, second - 0.7]), flat_gap, 40.0),
}
SWEEP = (0.5, *range(1, 15), 17, 20, 25, 30, 40)


def verdicts(retraction: Retraction, points, gap) -> dict[float, str]:
    """Along the sweep: ``found`` where the inverse leads to the point, ``refused``, or ``missed`` with the miss."""
    move, found = compiled(retraction), {}
    for s in SWEEP:
        x, y = points(s, False), points(s, True)
        try:
            v = retraction.inverse(jnp.asarray(x), jnp.asarray(y))
        except InvalidInputError:  # a matrix whose determinant is rounding is no point
            found[s] = "refused"
            continue
        z = move(x, np.asarray(v))
        rounding = np.max(np.abs(z - y)) <= GRACE * EPS * max(np.max(np.abs(x)), np.max(np.abs(y)))
        with mpmath.workdps(60):
            miss = gap(z, y)
        found[s] = "found" if rounding or miss <= GRACE * HALF else f"missed by {miss:.2g}"
    return found


@pytest.mark.parametrize("name", CASES)
@pytest.mark.usual(1)
def test_an_inverse_leads_to_its_point_or_is_refused_however_far_out(name):
    retraction, points, gap, last = CASES[name]
    found = verdicts(retraction, points, gap)
    assert not [f"{s}: {words}" for s, words in found.items() if words.startswith("missed")]
    assert [s for s in SWEEP if s <= last and found[s] == "refused"] == []


@pytest.mark.parametrize("far", [5.0, 40.0])
def test_an_inverse_on_a_product_is_that_of_its_worst_factor(far):
    x, y = hyperbolic(far, False), hyperbolic(far, True)
    product = Exponential(Hyperbolic(2) * LINE), (x, np.zeros(2)), (y, np.ones(2))
    power = Exponential(Power(Hyperbolic(2), 2)), np.stack([x, x]), np.stack([x, y])
    for retraction, first, second in (product, power):
        if far < 10:
            retraction.inverse(first, second)
        else:
            with pytest.raises(DomainError, match="too far for the precision in use"):
                retraction.inverse(first, second)


NO_POINTS = {
    "scaled rotation": (Exponential(SO(3)), np.eye(3), 2 * turn(0.1, 0.2, 0.3), "SO"),
    "reflection": (Exponential(SO(3)), np.eye(3), np.diag([1.0, 1.0, -1.0]), "SO"),
    "indefinite": (Exponential(SPD(3)), np.eye(3), np.diag([1.0, 1.0, -1.0]), "SPD"),
    "volume": (Exponential(SL(3)), np.eye(3), 2 * np.eye(3), "SL"),
    "unitary": (Exponential(U(2)), np.eye(2, dtype=complex), 2j * np.eye(2), "U"),
    "sphere": (Projection(Sphere(2)), np.eye(3)[2], 2 * np.eye(3)[2], "Sphere"),
    "other sheet": (Exponential(Hyperbolic(2)), np.eye(3)[0], -np.eye(3)[0], "Hyperbolic"),
}


@pytest.mark.parametrize("name", NO_POINTS)
def test_what_is_no_point_is_told_so(name):
    retraction, x, y, group = NO_POINTS[name]
    with pytest.raises(NotOnManifoldError, match=rf"^the point is no point: not on {group}"):
        retraction.inverse(jnp.asarray(x), jnp.asarray(y))


def test_a_base_point_that_is_none_is_told_so():
    with pytest.raises(NotOnManifoldError, match="the base point is no point"):
        Exponential(SO(3)).inverse(2 * jnp.eye(3), jnp.eye(3))


def logarithm(b: np.ndarray) -> np.ndarray:
    """The principal logarithm of a 2 x 2 matrix with two conjugate eigenvalues, by mpmath."""
    with mpmath.workdps(50):
        b, eye = exact(b), mpmath.eye(2)
        real, size = (b[0, 0] + b[1, 1]) / 2, b[0, 0] * b[1, 1] - b[0, 1] * b[1, 0]
        imaginary = mpmath.sqrt(size - real * real)
        log = mpmath.atan2(imaginary, real) / imaginary * (b - real * eye) + mpmath.log(size) / 2 * eye
        return np.array(log.tolist(), float)


def test_the_logarithm_loses_no_more_than_its_condition_towards_a_half_turn():
    """Rounding of a matrix at the distance ``d`` from a half turn is magnified by ``1 / d``."""
    inverse, rng = compiled(Exponential(SL(2)).inverse), np.random.default_rng(0)
    for gap in np.geomspace(1e-2, 6e-5, 40):
        (c, s), (e, t) = ((np.cos(a), np.sin(a)) for a in (np.pi - gap, rng.uniform(0, np.pi)))
        stretch = np.array([[e, -t], [t, e]]) * np.array([1.5, 1 / 1.5])
        y = stretch @ np.array([[c, -s], [s, c]]) @ np.linalg.inv(stretch)
        np.testing.assert_allclose(inverse(np.eye(2), y), logarithm(y), rtol=0, atol=1e3 * EPS / gap)
