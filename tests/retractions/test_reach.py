"""The ends of domains: from vectors of length 1 to those whose squares overflow, in both precisions.

A tangent vector is in the domain where the inverse gives it back to more than half of its digits; whatever its length,
its value is a point of the manifold to rounding, or not finite.
"""

import time
from contextlib import nullcontext
from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from retrax.manifolds import SPD, Stiefel
from retrax.manifolds.numerics import ambient as vec
from retrax.manifolds.numerics.frames import qr_factor
from retrax.manifolds.numerics.matrices import exponential
from retrax.retractions import Exponential, Midpoint, Retraction, SPDLogEuclidean, StiefelCanonicalExponential
from retrax.retractions.groups.functions import rotations, unitary
from retrax.testing.numerics import compiled

from tests.support.cases import RETRACTIONS, reach

LENGTHS = {"double": (1.0, 1e2, 1e4, 1e8, 1e16, 1e160), "single": (1.0, 1e2, 1e4, 1e8, 1e16, 1e30)}
PRECISIONS = {"double": nullcontext, "single": partial(jax.enable_x64, False)}
POINTS = 20

# Rounding units, relative to 1 + the size of the value, to which values satisfy the equations of their manifold.
UNITS = 500
# Where the exponential of a matrix, or of many turns, is taken this grows as |v|: its squarings, or the angle, have the
# rounding.
GROWING = ("exponential-", "frobenius-", "canonical-", "orthographic-curve")
# Of SL(3) a value is x g with det g = 1 to rounding, in which that of det x g is magnified by the products of three
# entries of the value, which the size of the value alone does not say: relative to its cube.
CUBED = ("exponential-SL3",)

# Those of the default run, one for each way in which a domain ends; the slow one has all. Logarithms of SO(4) and U(2)
# need more digits of a point than single precision has, unless they are taken with care.
QUICK = {
    "double": ("exponential-S2", "projection-S2", "cayley-SO2", "polar-SO3", "softmax-simplex3", "quadratic-SPD2"),
    "single": ("exponential-SO4", "exponential-U2"),
}


def _cases():
    for name in RETRACTIONS:
        for precision, quick in QUICK.items():
            yield pytest.param(
                name, precision, marks=[pytest.mark.slow] * (name not in quick), id=f"{name}-{precision}"
            )


def _facts(retraction: Retraction, key: jax.Array, length: jax.Array) -> dict:
    """Of one random point and vector: whether it is in the domain, comes back, and how far off the manifold its value
    is."""
    manifold = retraction.manifold
    first, second = jax.random.split(key)
    x = manifold.random_point(first)
    u = manifold.random_tangent(second, x)
    v = vec.scale(length / jnp.sqrt(vec.pairing(u, u)), u)
    y = retraction(x, v)
    error = vec.size(vec.subtract(retraction.preimage(x, y), v)) / (1 + vec.size(v))
    off = vec.size(manifold.violations(y)) / (1 + vec.size(y))
    return {"inside": retraction.domain(x, v), "error": error, "off": off, "size": vec.size(y)}


@pytest.mark.long("projection-S2-double", "cayley-SO2-double", "quadratic-SPD2-double", "exponential-U2-single")
@pytest.mark.parametrize(("name", "precision"), list(_cases()))
def test_a_vector_of_any_length_comes_back_or_is_outside_the_domain(name, precision):
    retraction, lengths = RETRACTIONS[name], (min(1.0, reach(name)), *LENGTHS[precision][1:])
    with PRECISIONS[precision]():
        keys = jax.random.split(jax.random.key(7), POINTS)
        of_length = jax.vmap(lambda key, length: _facts(retraction, key, length), (0, None))
        facts = compiled(jax.vmap(of_length, (None, 0)))(keys, jnp.asarray(lengths))
        eps = float(jnp.finfo(jnp.zeros(()).dtype).eps)
    inside, size = facts["inside"], facts["size"]
    assert np.all(inside[0])
    assert np.all(facts["error"][inside] <= eps**0.5)
    growth = 1 + np.asarray(lengths)[:, None] if name.startswith(GROWING) else 1.0
    growth = growth * (1 + size) ** 2 if name in CUBED else growth
    assert np.all((facts["off"] <= UNITS * eps * growth) | ~np.isfinite(size))


@lru_cache
def _logarithms(kind: str):
    """Logarithms of rotations, or of unitary matrices, with given angles in random planes: whether in the domain, and
    errors."""

    def facts(key: jax.Array, angles: jax.Array) -> tuple[jax.Array, jax.Array]:
        if kind == "U":
            draws = jax.random.normal(key, (2, angles.size, angles.size))
            q = qr_factor(draws[0] + 1j * draws[1])
            a, y = (q * (1j * angles)) @ q.conj().T, (q * jnp.exp(1j * angles)) @ q.conj().T
        else:
            q, turn = qr_factor(jax.random.normal(key, (2 * angles.size,) * 2)), jnp.array([[0.0, -1.0], [1.0, 0.0]])
            cosines, sines = jnp.repeat(jnp.cos(angles), 2), jnp.kron(jnp.diag(jnp.sin(angles)), turn)
            a, y = q @ jnp.kron(jnp.diag(angles), turn) @ q.T, (q * cosines) @ q.T + q @ sines @ q.T
        a = (a - a.conj().T) / 2
        return unitary.injective(a), jnp.max(jnp.abs(unitary.logarithm(y) - a))

    return compiled(jax.vmap(jax.vmap(facts, (0, None)), (None, 0)))


def _angles(kind: str, eps: float) -> tuple[np.ndarray, np.ndarray]:
    """Three angles, two of them at distances from a half turn that come as near to it and to each other as one likes.

    Of U the second may be on the other side of it; and by how much rounding turns the two planes into each other.
    """
    near = np.geomspace(eps, 1.0, 25)
    gaps = np.array([(d, min(d * (1 + apart), 3.0)) for d in near for apart in (0.0, 1e-9, 1e-4, 0.5, 1e4)])
    sides = np.array([1.0, -1.0 if kind == "U" else 1.0])
    angles = np.concatenate([(np.pi - gaps) * sides, np.full((len(gaps), 1), 0.3)], axis=1)
    return angles, np.sum(gaps, axis=1)


@pytest.mark.long("SO-single", "U-single")
@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("kind", ["SO", "U"])
def test_the_logarithm_tells_planes_that_are_near_a_half_turn_together(kind, precision):
    with PRECISIONS[precision]():
        eps = float(jnp.finfo(jnp.zeros(()).dtype).eps)
        angles, apart = _angles(kind, eps)
        inside, error = _logarithms(kind)(jax.random.split(jax.random.key(3), 5), jnp.asarray(angles))
    # In the domain if both are a few roundings from the half turn and their distances make up a few roots of eps, out
    # if not.
    single = np.pi - np.max(np.abs(angles), axis=1)
    far, near = (single > 400 * eps) & (apart > 40 * eps**0.5), (single < 20 * eps) | (apart < 10 * eps**0.5)
    assert np.all(inside[far])
    assert not np.any(inside[near])
    assert np.all(error[inside] < np.broadcast_to(100 * eps * (1 + 1 / apart)[:, None], inside.shape)[inside])


@pytest.mark.parametrize("kind", ["SO", "U"])
def test_the_logarithm_is_exact_whichever_way_angles_lie(kind):
    angles = np.array(
        [(t, sign * s, 0.7) for t in np.linspace(0, 3, 16) for s in (0.0, 1.5, 1.6, 2.5, t) for sign in (1, -1)]
    )
    inside, error = _logarithms(kind)(jax.random.split(jax.random.key(3), 5), jnp.asarray(angles))
    assert np.all(inside)
    assert np.max(error) < 1e-13


@lru_cache
def _defects(kind: str):
    """How far Cayley transforms and polar factors of ``I + a`` are from unitary, ``a`` with given angles in random
    planes."""
    make = rotations if kind == "SO" else unitary

    def facts(key: jax.Array, angles: jax.Array) -> jax.Array:
        if kind == "U":
            draws = jax.random.normal(key, (2, angles.size, angles.size))
            q = qr_factor(draws[0] + 1j * draws[1])
            a = (q * (1j * angles)) @ q.conj().T
        else:
            q, turn = qr_factor(jax.random.normal(key, (2 * angles.size,) * 2)), jnp.array([[0.0, -1.0], [1.0, 0.0]])
            a = q @ jnp.kron(jnp.diag(angles), turn) @ q.T
        a = (a - a.conj().T) / 2
        return jnp.stack(
            [jnp.max(jnp.abs(y.conj().T @ y - jnp.eye(y.shape[0]))) for y in (make.cayley(a), make.polar(a))]
        )

    return compiled(jax.vmap(jax.vmap(facts, (0, None)), (None, 0)))


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("kind", ["SO", "U"])
@pytest.mark.usual(1)
def test_turns_in_one_plane_are_unitary_however_long(kind, precision):
    with PRECISIONS[precision]():
        eps = float(jnp.finfo(jnp.zeros(()).dtype).eps)
        lengths = np.geomspace(1.0, 0.01 / eps, 20)
        # The other plane turns as far, or less and less, and not at all at last.
        angles = np.array([(t, t * other) for t in lengths for other in (1.0, 1e-2, 1e-4, 1e-8, 1e-16, 0.0)])
        defects = _defects(kind)(jax.random.split(jax.random.key(3), 5), jnp.asarray(angles))
    assert np.all((defects <= UNITS * eps) | np.isnan(defects))
    assert not np.any(np.isnan(defects[angles[:, 0] < 1 / (8 * eps**0.5)]))


@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_exponential_of_a_matrix_is_right_or_nan_however_large(precision):
    with PRECISIONS[precision]():
        eps = float(jnp.finfo(jnp.zeros(()).dtype).eps)
        sizes = np.geomspace(1.0, 1e16, 33)
        turn = jnp.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
        angles = jnp.asarray(sizes)
        found = compiled(jax.vmap(lambda t: exponential(t * turn)))(angles)
        exact = np.stack([np.cos(angles), -np.sin(angles), np.sin(angles), np.cos(angles)], axis=1).reshape(-1, 2, 2)
    known = np.isfinite(found[:, 0, 0])
    assert np.all(known[sizes < 2e3])
    assert not np.any(known[sizes > 2e5])
    assert np.all(np.isnan(found[~known]))
    error = np.max(np.abs(found[known, :2, :2] - exact[known]), axis=(1, 2))
    assert np.all(error < 10 * eps * sizes[known])


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize(
    "family", [Exponential, pytest.param(SPDLogEuclidean, marks=pytest.mark.slow)], ids=["affine", "log"]
)
def test_a_definite_matrix_stays_one_however_far_its_eigenvalues_spread(family, precision):
    retraction, spreads = family(SPD(3)), np.linspace(1.0, 100.0, 100)

    def facts(key: jax.Array, spread: jax.Array) -> tuple:
        q = qr_factor(jax.random.normal(key, (3, 3)))
        x, v = jnp.eye(3), (q * jnp.array([0.0, spread / 3, spread])) @ q.T
        y = retraction(x, v)
        return (
            retraction.domain(x, v),
            y,
            vec.size(retraction.preimage(x, y) - v) / spread,
            retraction.manifold.violations(y),
        )

    with PRECISIONS[precision]():
        eps = float(jnp.finfo(jnp.zeros(()).dtype).eps)
        keys = jax.random.split(jax.random.key(0), 10)
        inside, y, error, off = compiled(jax.vmap(jax.vmap(facts, (0, None)), (None, 0)))(keys, jnp.asarray(spreads))
    known = np.isfinite(y[..., 0, 0])
    assert np.all(inside[spreads < -0.4 * np.log(eps)])
    assert not np.any(inside[spreads > -0.5 * np.log(eps)])
    assert np.all(error[inside] < 4 * eps**0.5)
    assert np.all(known[inside])
    assert not np.any(known[spreads > -np.log(eps)])
    assert all(np.all(value[known] <= 0) for value in off.values())


@pytest.mark.parametrize("name", ["exponential-SO4", pytest.param("exponential-SU3", marks=pytest.mark.slow)])
def test_midpoints_in_single_precision_are_right_to_six_digits(name):
    retraction = RETRACTIONS[name]
    midpoint = Midpoint(retraction)

    def error(key: jax.Array, length: jax.Array) -> jax.Array:
        first, second = jax.random.split(key)
        x = retraction.manifold.random_point(first)
        u = retraction.manifold.random_tangent(second, x)
        z = x, length / jnp.sqrt(vec.pairing(u, u)) * u
        return vec.size(vec.subtract(midpoint.inverse(*midpoint(*z)), z))

    with PRECISIONS["single"]():
        keys = jax.random.split(jax.random.key(1), 100)
        errors = compiled(jax.vmap(jax.vmap(error, (0, None)), (None, 0)))(keys, jnp.array([1e-4, 0.3, 1.0, 3.0]))
    assert np.max(errors) < 3e-6


@pytest.mark.slow
@pytest.mark.parametrize("size", [(5, 1), (4, 2)])
def test_the_canonical_logarithm_of_frames_compiles_in_seconds(size):
    inverse, frame = StiefelCanonicalExponential(Stiefel(*size)).inverse, jax.ShapeDtypeStruct(size, float)
    lowered, start = jax.jit(inverse).lower(frame, frame), time.process_time()
    lowered.compile()
    assert time.process_time() - start < 10
